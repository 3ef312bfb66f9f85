"""`topobatch export --format grid`: the walls of a run or a site for map_server and AMCL."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

from ..topology.errors import DataError, TopobatchError, UsageError
from ..topology.wording import counted, listed
from .output import Advance, Screen
from .workspace import Workspace

if TYPE_CHECKING:
    from ..ingest.read_settings import ReadSettings
    from ..ingest.remote.path import LogPath
    from ..ingest.run_scans import LaidScans
    from ..merge.merged_schema import MergedDocument
    from ..topology.arrays import FloatArray
    from ..topology.run import Grid
    from ..topology.topomap import TopoMap

    Placed = Callable[[FloatArray], FloatArray]

CELL_M = 0.05
"""Side of a cell, as map savers write them."""
LARGE_BYTES = 2_000_000
"""Logs of more together take some seconds, which a line says where there is no bar."""
PICTURE = ".pgm"
"""Suffix of pictures."""


@dataclass(frozen=True, slots=True, eq=False)
class Exported:
    """A map to export: a run's, or a component's with its document."""

    name: str
    topomap: TopoMap
    maps: dict[str, TopoMap]
    document: MergedDocument | None = None
    component: int = 0


def grid_texts(
    place: Workspace, source: Exported, log: LogPath | None, picture: str, screen: Screen
) -> dict[str, str | bytes]:
    """The two files of the grid of a run or of all runs of a site, by their names. picture: name of
    the one that the other refers to.

    Raises DataError where no run has scans, views or a saved map.
    """
    from ..topology.views import CELL_M as VIEW_CELL_M
    from ..viz.exports import map_picture, map_yaml

    if log is not None and len(source.maps) != 1:
        raise UsageError(f"--log goes with one run; {source.name} has {len(source.maps)}")
    bare = sorted(run for run, m in source.maps.items() if not len(m.views))
    if len(bare) == len(source.maps):
        raise DataError(f"{source.name}: {_why_bare(place, source)}")
    if bare:
        screen.warn(f"{listed(bare, 3)}: no laser shows walls; the grid is without")
    logs = _Logs(place, source, log)
    size = sum(logs.bytes.values())
    if size > LARGE_BYTES:
        screen.begin(f"{source.name}: reading {counted(len(logs.bytes), 'log')} again")
    with screen.progress(f"{source.name}: reading", size, "bytes") as advance:
        grid, told = _grid(source, logs, advance)
    for run, why in sorted(logs.gone.items()):
        screen.warn(
            f"{why}; the walls of {run} are those of its views, in cells of {VIEW_CELL_M:g} m"
        )
    if grid is None:
        raise DataError(f"{source.name}: nothing is known of its walls")
    frame = f"{source.name}, in the frame {source.topomap.frame} of its other exports"
    return {
        f"{source.name}{PICTURE}": map_picture(grid),
        f"{source.name}.yaml": map_yaml(grid, picture, [frame, *told]),
    }


def _why_bare(place: Workspace, source: Exported) -> str:
    """Why no run shows walls, and what to do."""
    lost = sorted(run for run, m in source.maps.items() if m.views_lost)
    if lost:
        return f"{place.map_views(lost[0])} is lost or damaged; ingest the log again (--force)"
    if not source.maps:
        return "none of its maps can be read; ingest its logs again"
    return (
        "no laser, cloud or saved map shows walls, only junction detections; --format nav2 exports "
        "its graph. If a log has a laser as well, ingest it again with --junctions-from scan"
    )


class _Logs:
    """The logs of runs, read again; gone: runs whose log cannot be, and why."""

    def __init__(self, place: Workspace, source: Exported, log: LogPath | None) -> None:
        from ..ingest.reading import log_size

        self.gone: dict[str, str] = {}
        self._at: dict[str, LogPath] = {}
        self._named, self._place = log is not None, place
        self.bytes: dict[str, int] = {}
        for run, topomap in sorted(source.maps.items()):
            if len(topomap.views):
                with self._failing(run):
                    self._at[run] = log or place.log_of(run)
                    self.bytes[run] = log_size(self._at[run])

    @contextmanager
    def _failing(self, run: str) -> Iterator[None]:
        """What cannot be read is gone, unless the user named it."""
        try:
            yield
        except (TopobatchError, OSError) as error:
            if self._named:
                raise
            self.gone[run] = str(error)

    def scans(self, topomap: TopoMap, on_bytes: Callable[[int], None]) -> LaidScans | None:
        """The scans of a run on its map."""
        from ..ingest.run_scans import scans_on_map

        with self._failing(topomap.run):
            at, settings = self._how(topomap.run)
            return scans_on_map(at, settings, topomap, on_bytes=on_bytes)
        return None

    def saved(self, topomap: TopoMap, on_bytes: Callable[[int], None]) -> Grid | None:
        """The grid that a map was made from."""
        from ..ingest.logs.grids import GridLog
        from ..ingest.reading import log_fingerprint, read_log

        with self._failing(topomap.run):
            at, settings = self._how(topomap.run)
            made_from = (self._place.ingested(topomap.run) or {}).get("content")
            found = read_log(at, settings, on_bytes=on_bytes)
            if made_from != log_fingerprint(at) or not isinstance(found, GridLog):
                raise DataError(f"{at}: changed since the map of {topomap.run} was made from it")
            return found.grid
        return None

    def _how(self, run: str) -> tuple[LogPath, ReadSettings]:
        from .ingest_worker import read_again

        if run not in self._at:
            raise DataError(self.gone[run])
        return self._at[run], read_again(self._place.ingested(run) or {})


def _grid(source: Exported, logs: _Logs, advance: Advance) -> tuple[Grid | None, list[str]]:
    """The grid in the frame of the map, and what it was made from.

    Scans of all runs are laid together; what these do not know is told by saved maps, the largest
    first, and what these do not know by views.
    """
    import numpy as np

    from ..ingest.run_scans import Occupancy
    from ..topology.grids import layered, resampled
    from ..topology.se2 import compose
    from ..viz.walls import walls_of

    done = 0

    def on_bytes(more: int) -> None:
        nonlocal done
        done += more
        advance(done)

    frame, placed = source.topomap.frame, _placements(source)
    seen = {run: m for run, m in sorted(source.maps.items()) if len(m.views)}
    read = {
        run: logs.saved(m, on_bytes) for run, m in seen.items() if not len(m.observation_time_ns)
    }
    saved = {run: grid for run, grid in read.items() if grid is not None}
    if len(seen) == 1 and saved:
        ((run, grid),) = saved.items()
        if not grid.origin[2] and not placed[run](np.zeros((1, 2))).any():
            return grid, [f"saved map of {run}"]  # as it is
    cast = Occupancy(_cell_m(source, saved, placed))
    by_scans = []
    for run in sorted(seen.keys() - read.keys()):
        scans = logs.scans(seen[run], on_bytes)
        if scans is not None:
            advance(done, doing=f"{source.name}: drawing what {run} saw")
            cast.add(scans.keyframes, compose(placed[run](scans.body[:, :2]), scans.body))
            by_scans.append(run)
    others = sorted(seen.keys() - saved.keys() - set(by_scans))
    views = {run: seen[run].views for run in others}
    laid = [v.moved(placed[run](v.pose[:, :2])) for run, v in views.items()]
    pictures = [resampled(g, placed[run], cast.cell_m, frame) for run, g in saved.items()]
    pictures.sort(key=lambda g: 0 if g is None else -int((~g.unknown).sum()))
    found = [cast.grid(frame), *pictures, walls_of(laid, frame, cast.cell_m)]
    parts = {"scans": by_scans, "saved maps": saved, "views": others}
    told = [f"{what} of {', '.join(sorted(runs))}" for what, runs in parts.items() if runs]
    return layered([grid for grid in found if grid is not None]), told


def _cell_m(source: Exported, saved: Mapping[str, Grid], placed: Mapping[str, Placed]) -> float:
    """The side of a cell, by what the grid has to hold."""
    import numpy as np

    from ..topology.grids import cell_for
    from ..topology.se2 import apply
    from ..topology.views import REACH_M

    points = [source.topomap.xy, *source.topomap.paths]
    for run, m in source.maps.items():
        points.append(apply(placed[run](m.views.pose[:, :2]), m.views.pose[:, :2]))
    corners = np.array([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)])
    for run, grid in saved.items():
        side = grid.resolution_m * np.array(grid.free.shape[::-1])
        own = apply(np.array(grid.origin), side * corners)
        points.append(apply(placed[run](own), own))
    return cell_for(np.ptp(np.concatenate(points), axis=0) + 2 * REACH_M, CELL_M)


def _placements(source: Exported) -> dict[str, Placed]:
    """For each run the transforms (k, 3) from its map's frame to that of the export at points (k,
    2) of its map."""
    import numpy as np

    from ..merge.document import result_from_document
    from ..merge.result import placed_at

    if source.document is None:
        return {run: lambda xy: np.zeros((len(xy), 3)) for run in source.maps}
    result = result_from_document(source.document)
    (component,) = (c for c in result.components if c.id == source.component)
    return {run: partial(placed_at, result.fused, component, m) for run, m in source.maps.items()}
