"""The Python interface `import topobatch`: the steps of the command as functions.

Nothing here prints, exits, or writes a file. All deliberate errors are TopobatchErrors.
"""

from __future__ import annotations

import io
import os
from collections.abc import Iterable, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from glob import glob, has_magic
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal

from ..ingest.logs.topics import Way
from ..ingest.mapping import map_of_log
from ..ingest.mapping_settings import MappingSettings
from ..ingest.read_settings import ReadSettings, Stamp
from ..ingest.reading import read_log
from ..ingest.remote.path import is_remote, log_path
from ..ingest.scans.slicing import SliceSettings
from ..merge.change import Change
from ..merge.changes import all_changes
from ..merge.component_map import component_map
from ..merge.decision_text import lines
from ..merge.document import merged_to_document
from ..merge.drive import Drive
from ..merge.drives import drives
from ..merge.locks import Lock
from ..merge.merging import MergeSettings, merge_maps
from ..merge.pieces import joined_pieces
from ..merge.result import Component, MergeResult
from ..merge.robust.explained import Merge
from ..merge.robust.explained import explain as decision_of
from ..topology.document import map_to_document
from ..topology.document import read_map as map_at
from ..topology.errors import LogError, UsageError
from ..topology.topomap import TopoMap
from ..topology.wording import listed
from ..viz.exports import MAP_FORMATS, map_texts
from .draw import quiet_fonts
from .run_logs import logs_of, run_names
from .workspace import Workspace, checked_file_name  # noqa: F401  offered as functions are


def ingest(
    log: str | os.PathLike[str] | Iterable[str | os.PathLike[str]],
    *,
    name: str | None = None,
    odometry_topic: str | None = None,
    junction_topic: str | None = None,
    junction_fields: str | None = None,
    junctions_from: Way | None = None,
    scan_topic: str | None = None,
    laser_pose: tuple[float, float, float] | None = None,
    scan_stamp: Stamp = "begin",
    cloud_band: tuple[float, float] | None = None,
    base_frame: str | None = None,
    robot_radius: float = 0.25,
    time: Literal["header", "log"] = "header",
    closure: Literal["none", "full"] = "full",
    strict: bool = False,
    separate: bool = False,
    allow_scan: bool = False,
) -> tuple[TopoMap, ...]:
    """Turn a log into its topological map, or several into theirs.

    Linear algebra runs on one thread meanwhile: its matrices are small.

    Parameters
    ----------
    log
        An MCAP file, a ROS 1 bag, a ROS 2 bag folder, or a saved map; or the address of one
        elsewhere (``s3://bucket/run1.mcap``; docs/remote.md). Or a folder of logs, a pattern
        (``"day1/*.mcap"``), or a list of all these.
    name
        What to call the run; after the log by default, of several logs of one name after their
        folders as well.
    laser_pose
        x, y [m] and yaw [rad] of the laser on the robot.
    cloud_band
        Lowest and highest points of a cloud that make a scan, above the robot's frame [m].
    robot_radius
        Radius [m] of the robot that has to fit through the corridors of a grid.
    odometry_topic, junction_topic, junction_fields, junctions_from, scan_topic, scan_stamp, \
    base_frame, time, closure, strict, separate, allow_scan
        As the options of ``topobatch ingest``; by default the log tells them.

    Returns
    -------
    tuple of TopoMap
        One map of each log, by the order of the list and, in it, by name; more only where
        the odometry broke and nothing ties its pieces together.

    Raises
    ------
    LogError
        The log cannot be read, or holds nothing that can be used.
    DataError
        What it holds makes no map: no junction was passed, or the odometry does not move.
    UsageError
        The log has several topics to choose from, or an option makes no sense.

    Examples
    --------
    >>> import topobatch
    >>> (maze,) = topobatch.ingest("sample_logs/maze-1.mcap")
    >>> len(maze), len(maze.source)
    (26, 29)
    """
    named = [log] if isinstance(log, str | os.PathLike) else log
    given = [log_path(each, allow_scan=allow_scan) for each in _expanded(named)]
    logs, missing = logs_of(given, separate=separate)
    for _, error in missing:
        raise error
    if len(logs) > 1 and name is not None:
        raise UsageError(f"name goes with one log; {len(logs)} are given")
    names = run_names(logs) if name is None else dict.fromkeys(logs, checked_file_name(name))
    settings = ReadSettings(
        odometry_topic=odometry_topic,
        junction_topic=junction_topic,
        junction_fields=junction_fields,
        junctions_from=junctions_from,
        scan_topic=scan_topic,
        laser_pose=laser_pose,
        scan_stamp=scan_stamp,
        slices=SliceSettings(cloud_band),
        base_frame=base_frame,
        time=time,
        strict=strict,
    )
    mapping = MappingSettings(closure=closure, robot_radius_m=robot_radius)
    with _on_one_thread():
        read = (replace(read_log(log, settings), name=run) for log, run in names.items())
        mapped = (map_of_log(found, mapping) for found in read)
        return tuple(piece for each in mapped for piece in joined_pieces(each))


def _expanded(named: Iterable[str | os.PathLike[str]]) -> Iterator[str]:
    """The paths, with those that match a pattern in its place; LogError if none does."""
    for each in (os.fspath(path) for path in named):
        if is_remote(each) or not has_magic(each) or os.path.lexists(each):
            yield each
        elif found := sorted(glob(each, recursive=True)):
            yield from found
        else:
            raise LogError(f"{each}: nothing matches this pattern")


def read_map(path: str | Path) -> TopoMap:
    """The map of a run by its document, ``maps/RUN.json`` of a workspace.

    Its arrays are read-only; their shapes and units stand in its docstring. Raises DocumentError if
    it cannot be read, or is no such document; the message names the place of the first fault.

    >>> import topobatch
    >>> topomap = topobatch.read_map("topobatch-workspace/maps/maze-1.json")  # doctest: +SKIP
    """
    return map_at(Path(path))


def merge(
    maps: Iterable[TopoMap], *, false_merge_rate: float | None = None, locks: Sequence[Lock] = ()
) -> MergeResult:
    """Merge the maps of many runs, where the evidence says that they overlap.

    Parameters
    ----------
    maps
        In any order; every run once.
    false_merge_rate
        Share of batches that may hold any false merge, between 0 and 0.5; 0.001 by default.
    locks
        What a person knows: ``topobatch.merge.locks.Lock(a, b, "same" or "never")``.

    Returns
    -------
    MergeResult
        A verdict for every pair of runs, the components, and the fused map of each.

    Raises
    ------
    DataError
        Two maps are of the same run.
    UsageError
        The rate makes no sense, two locks contradict each other, or one names a junction that its
        map does not have.

    Examples
    --------
    >>> import topobatch
    >>> logs = ("maze-1.mcap", "maze-2.bag")
    >>> maps = [m for log in logs for m in topobatch.ingest(f"sample_logs/{log}")]
    >>> (pair,) = topobatch.merge(maps).verdicts
    >>> str(pair.verdict), len(pair.best.matched)
    ('merged', 12)
    """
    settings = MergeSettings()
    if false_merge_rate is not None:
        if not 0 < false_merge_rate <= 0.5:
            raise UsageError(f"false_merge_rate must lie in 0 … 0.5, not {false_merge_rate}")
        robust = replace(settings.robust, false_merge_rate=false_merge_rate)
        settings = replace(settings, robust=robust)
    with _on_one_thread():
        return merge_maps(list(maps), settings, locks=locks)


def to_networkx(graph: TopoMap | MergeResult) -> Any:
    """A map, or the fused maps of a merge, as a ``networkx.MultiGraph``.

    Its nodes and edges have the attributes of the documents (``topobatch schema``): ``x``, ``y``,
    ``branches``, ``observations``; ``length``, ``path``, ``traversals``. Of a merge it has the
    components apart, each node with its ``component`` and ``members``.

    >>> import topobatch
    >>> (maze,) = topobatch.ingest("sample_logs/maze-1.mcap")
    >>> graph = topobatch.to_networkx(maze)
    >>> graph.number_of_nodes(), graph.graph["run"]
    (26, 'maze-1')
    """
    import networkx as nx

    if isinstance(graph, MergeResult):
        return nx.node_link_graph(merged_to_document(graph), edges="edges")
    return nx.node_link_graph(map_to_document(graph), edges="edges")


def site_map(result: MergeResult, maps: Iterable[TopoMap], run: str) -> TopoMap:
    """The merged map of the site that a run is part of, as one map in the frame of the site, called
    like it.

    result, maps: a merge, and the maps that it merged; run: any run of the site, or its name.
    Raises UsageError if there is none.
    """
    component = next((c for c in _of_merge(result).components if run == c.name), None)
    component = component or _component_of(result, run)
    own = {m.run: m for m in maps if m.run in component.poses}
    return component_map(result, component.id, component.name, own)


def explain(result: MergeResult, maps: Iterable[TopoMap], a: str, b: str) -> str:
    """Why two runs were merged or not: the evidence as ``topobatch explain``, in several lines.

    result, maps: a merge by the default settings, and the maps that it merged; a, b: two of its
    runs. Raises UsageError if one of them was not merged.
    """
    for run in (a, b):
        _component_of(result, run)
    by_run = {m.run: m for m in maps}
    if lost := {a, b} - by_run.keys():
        raise UsageError(f"the map of {min(lost)} is not among the maps")
    with _on_one_thread():
        return "\n".join(lines(decision_of(Merge.of(result, by_run.__getitem__), a, b)))


def changes(result: MergeResult, maps: Iterable[TopoMap]) -> tuple[Change, ...]:
    """What is there in some runs of a site and not in others, beyond chance.

    result, maps: a merge, and the maps that it merged. The changes are given site by site, by
    decreasing evidence; ``words(site)`` of each are its description.
    """
    by_run = {m.run: m for m in maps}
    return tuple(c for c in all_changes(_of_merge(result), by_run) if c.sure)


def next_drives(result: MergeResult, most: int = 5) -> tuple[Drive, ...]:
    """What to record next, so that more runs of a merge come together: `most` drives, best first.

    ``words`` of each are where it is and what it would settle, ``path`` is its way.
    """
    return drives(_of_merge(result), most)


class Picture(str):
    """A picture as the text of an SVG, which notebooks show."""

    def _repr_svg_(self) -> str:
        return str(self)


def draw(
    graph: TopoMap | MergeResult,
    maps: Iterable[TopoMap] = (),
    *,
    theme: Literal["light", "dark"] = "light",
) -> Picture:
    """A map, or all sites of a merge, as the text of an SVG, for light paper or a dark screen.

    maps: those that were merged: their walls are drawn below, where lasers saw any. Notebooks show
    the picture; ``Path("maze.svg").write_text(...)`` keeps it.

    >>> import topobatch
    >>> (maze,) = topobatch.ingest("sample_logs/maze-1.mcap")
    >>> topobatch.draw(maze)[:5]
    '<?xml'
    """
    from ..viz import draw as drawings  # which loads matplotlib
    from ..viz.palette import THEMES

    quiet_fonts()
    colours = THEMES[theme]
    if isinstance(graph, MergeResult):
        canvas = drawings.draw_merged(graph, colours, maps={m.run: m for m in maps})
    else:
        canvas = drawings.draw_map(graph, colours)
    return Picture(canvas.as_bytes("svg").decode())


def export(topomap: TopoMap, form: str) -> dict[str, str]:
    """A map in a format that others load (docs/exports.md): the text of each file, by its ending.

    topomap: of a run, or of a site (`site_map`); form: ``"nav2"``, ``"lif"``, ``"rmf"``,
    ``"tmap2"``, ``"graphml"`` or ``"csv"``. Raises UsageError if there is no such format, or if it
    needs more than a map.
    """
    if isinstance(topomap, MergeResult):
        raise UsageError("a map is exported; of a merge that of a site: site_map(merge, maps, run)")
    if form not in MAP_FORMATS:
        raise UsageError(f"no map is exported as {form!r}: {', '.join(MAP_FORMATS)}")
    return map_texts(topomap, form)


def to_dataframe(topomap: TopoMap, of: Literal["junctions", "corridors"] = "junctions") -> Any:
    """The junctions or the corridors of a map, of a run or of a site (`site_map`), as a table.

    A ``pandas.DataFrame`` or, where pandas is not installed, a ``pyarrow.Table``, with the columns
    of ``topobatch export --format csv``.

    >>> import topobatch
    >>> (maze,) = topobatch.ingest("sample_logs/maze-1.mcap")
    >>> len(topobatch.to_dataframe(maze, "corridors"))
    29
    """
    from pyarrow import csv

    if of not in ("junctions", "corridors"):
        raise UsageError(f"no table of {of!r}: 'junctions' or 'corridors'")
    text = export(topomap, "csv")[f".{of}.csv"]
    table = csv.read_csv(io.BytesIO(text.encode()))
    return table.to_pandas() if find_spec("pandas") else table


def _of_merge(result: object) -> MergeResult:
    """UsageError for what is no result of a merge, its document for instance."""
    if isinstance(result, MergeResult):
        return result
    raise UsageError("a MergeResult is needed: of merge(maps), or Workspace.read_result()")


def _component_of(result: MergeResult, run: str) -> Component:
    """The component that a run is part of."""
    components = _of_merge(result).component_of
    if run not in components:
        raise UsageError(f"no run {run!r} was merged; there are {listed(sorted(components), 12)}")
    return components[run]


def _on_one_thread() -> AbstractContextManager[object]:
    """One thread for linear algebra, as `cli.main` sets for the command."""
    import scipy.linalg  # noqa: F401  loads a library of its own, which is to be held as well
    from threadpoolctl import threadpool_limits

    held: AbstractContextManager[object] = threadpool_limits(limits=1)
    return held
