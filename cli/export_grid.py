"""`topobatch export --format grid`: the walls of a run or a site for map_server and AMCL."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from ..ingest.logs.grids import GridLog
from ..ingest.reading import log_exists, log_fingerprint, read_log
from ..ingest.remote.path import LogPath, log_path
from ..ingest.run_scans import LaidScans, Occupancy, scans_on_map
from ..merge.result import Component, MergeResult, placed_at
from ..topology.arrays import FloatArray
from ..topology.errors import DataError, TopobatchError
from ..topology.grids import cell_for, layered, resampled
from ..topology.run import Grid
from ..topology.se2 import apply, compose
from ..topology.topomap import TopoMap
from ..topology.views import CELL_M as VIEW_CELL_M
from ..topology.views import REACH_M
from ..topology.wording import listed
from ..viz.exports.map_server import map_picture, map_yaml
from ..viz.walls import walls_of
from .output import counting, megabytes, progress, warn
from .workspace import Workspace

Placed = Callable[[FloatArray], FloatArray]
OnBytes = Callable[[int], None]

CELL_M = 0.05
"""Side of a cell, as map savers write them."""
PICTURE = ".pgm"
"""Suffix of pictures."""


@dataclass(frozen=True, slots=True, eq=False)
class Exported:
    """A map to export: a run's, or a component's with its merge."""

    name: str
    topomap: TopoMap
    maps: dict[str, TopoMap]
    merge: tuple[MergeResult, Component] | None = None


def grid_texts(
    place: Workspace, source: Exported, log: LogPath | None, picture: str
) -> dict[str, str | bytes]:
    """The two files of the grid of a run or of all runs of a site, by their endings. picture: name
    of the one that the other refers to.

    Raises DataError where no run has scans, views or a saved map.
    """
    bare = sorted(run for run, m in source.maps.items() if not len(m.views))
    if len(bare) == len(source.maps):
        raise DataError(f"{source.name}: {_why_bare(place, source)}")
    if bare:
        warn(f"{listed(bare, 3)}: no laser shows walls; the grid is without")
    grid, remarks = _grid(place, source, log)
    if grid is None:
        raise DataError(f"{source.name}: nothing is known of its walls")
    frame = f"{source.name}, in the frame {source.topomap.frame} of its other exports"
    return {PICTURE: map_picture(grid), ".yaml": map_yaml(grid, picture, [frame, *remarks])}


def grid_of_saved(place: Workspace, source: Exported) -> Grid | None:
    """The grid that `grid_texts` writes for a site of several saved maps, in which nothing but
    their pictures has to be read; None of others."""
    if len(source.maps) < 2 or any(m.is_driven for m in source.maps.values()):
        return None
    grid, _ = _grid(place, source, None)
    return grid


def log_of(place: Workspace, run: str, named: LogPath | None = None) -> LogPath:
    """The log that a run's map was made from, where a person named it or ingest read it. DataError
    if that is not recorded, or its content is another."""
    record = place.ingested(run)
    if named is None and record.log is None:
        raise DataError(f"run {run}: it is not recorded where its log is; name it by --log")
    at = named or log_path(str(record.log))
    if isinstance(at, Path) and not log_exists(at):
        raise DataError(
            f"{at}: the log of run {run} is not there; ingest it from where it is now, which keeps "
            "the map, or name it by --log"
        )
    if record.content not in (None, log_fingerprint(at)):
        raise DataError(
            f"{at}: is not the log that the map of run {run} was made from, or changed since; "
            "ingest it again"
        )
    return at


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


def _seen(
    place: Workspace, topomap: TopoMap, named: LogPath | None, on_bytes: OnBytes
) -> LaidScans | Grid | None:
    """What a run's log shows of its walls: its scans on its map, or the saved map that it is. None,
    with a warning, where it cannot be read; one that the user named has to be."""
    try:
        at, settings = log_of(place, topomap.run, named), place.ingested(topomap.run).settings()
        if topomap.is_driven:
            return scans_on_map(at, settings, topomap, on_bytes=on_bytes)
        found = read_log(at, settings, on_bytes=on_bytes)
        if not isinstance(found, GridLog):
            raise DataError(f"{at}: is not the saved map that {topomap.run} was made from")
        return found.grid
    except (TopobatchError, OSError) as error:
        if named is not None:
            raise
        walls = f"the walls of {topomap.run} are those of its views, in cells of {VIEW_CELL_M:g} m"
        warn(f"{error}; {walls}")
        return None


def _grid(place: Workspace, source: Exported, log: LogPath | None) -> tuple[Grid | None, list[str]]:
    """The grid in the frame of the map, and what it was made from.

    Scans of all runs are laid together; what these do not know is told by saved maps, the largest
    first, and what these do not know by views.
    """
    frame, placed = source.topomap.frame, _placements(source)
    seen = {run: m for run, m in sorted(source.maps.items()) if len(m.views)}
    with progress(f"{source.name}: reading its logs", 0) as advance:
        on_bytes = counting(lambda done: advance(done, f"{megabytes(done)} MB"))
        undriven = [run for run, m in seen.items() if not m.is_driven]
        read = {run: _seen(place, seen[run], log, on_bytes) for run in undriven}
        saved = {run: grid for run, grid in read.items() if isinstance(grid, Grid)}
        if len(seen) == 1 and saved:
            ((run, grid),) = saved.items()
            if not grid.origin[2] and not placed[run](np.zeros((1, 2))).any():
                return grid, [f"saved map of {run}"]  # as it is
        cast = Occupancy(_cell_m(source, saved, placed))
        by_scans = []
        for run in sorted(seen.keys() - read.keys()):
            scans = _seen(place, seen[run], log, on_bytes)
            if isinstance(scans, LaidScans):
                cast.add(scans.keyframes, compose(placed[run](scans.body[:, :2]), scans.body))
                by_scans.append(run)
    others = sorted(seen.keys() - saved.keys() - set(by_scans))
    views = {run: seen[run].views for run in others}
    laid = [v.moved(placed[run](v.pose[:, :2])) for run, v in views.items()]
    pictures = [resampled(g, placed[run], cast.cell_m, frame) for run, g in saved.items()]
    pictures.sort(key=lambda g: 0 if g is None else -int((~g.unknown).sum()))
    found = [cast.grid(frame), *pictures, walls_of(laid, frame, cast.cell_m)]
    parts = {"scans": by_scans, "saved maps": saved, "views": others}
    remarks = [f"{what} of {', '.join(sorted(runs))}" for what, runs in parts.items() if runs]
    return layered([grid for grid in found if grid is not None]), remarks


def _cell_m(source: Exported, saved: Mapping[str, Grid], placed: Mapping[str, Placed]) -> float:
    """The side of a cell, by what the grid has to hold."""
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
    if source.merge is None:
        return {run: lambda xy: np.zeros((len(xy), 3)) for run in source.maps}
    result, component = source.merge
    return {run: partial(placed_at, result.fused, component, m) for run, m in source.maps.items()}
