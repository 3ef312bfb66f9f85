"""The Python interface `import topobatch`: the steps of the command as functions.

Nothing here prints, exits, or writes a file. All deliberate errors are TopobatchErrors.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from .workspace import Workspace

if TYPE_CHECKING:
    from ..ingest.read_settings import Stamp, Way
    from ..merge.locks import Lock
    from ..merge.result import MergeResult
    from ..topology.topomap import TopoMap

__all__ = ["Workspace", "ingest", "merge", "read_map", "to_networkx"]


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
    time: Literal["header", "log"] = "header",
    closure: Literal["none", "gated", "full"] = "full",
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
        elsewhere (``s3://bucket/run1.mcap``; docs/remote.md). Or several of them, and folders of
        logs, in a list.
    name
        What to call the run; after the log by default, of several logs of one name after their
        folders as well.
    laser_pose
        x, y [m] and yaw [rad] of the laser on the robot.
    cloud_band
        Lowest and highest points of a cloud that make a scan, above the robot's frame [m].
    odometry_topic, junction_topic, junction_fields, junctions_from, scan_topic, scan_stamp, \
    base_frame, time, closure, strict, separate, allow_scan
        As the options of ``topobatch ingest``; by default the log tells them.

    Returns
    -------
    tuple of TopoMap
        One map of each log, by the order of the list and, of a folder, by name; more only where
        the odometry broke and nothing ties its pieces together.

    Raises
    ------
    LogError
        The log cannot be read, or holds nothing that can be used.
    DataError
        What it holds makes no map: no junction was passed, or the odometry does not move.
    UsageError
        The log has several topics to choose from, an option makes no sense, or a folder that is
        not in a list holds several logs.

    Examples
    --------
    >>> import topobatch
    >>> (maze,) = topobatch.ingest("sample_logs/maze-1.mcap")
    >>> len(maze), len(maze.source)
    (26, 29)
    """
    from ..ingest.mapping import map_of_log
    from ..ingest.mapping_settings import MappingSettings
    from ..ingest.reading import ReadSettings, read_log
    from ..ingest.remote.path import log_path
    from ..ingest.scans.slicing import SliceSettings
    from ..merge.pieces import joined_pieces
    from ..topology.errors import UsageError
    from ..topology.wording import listed
    from .log_paths import logs_of
    from .run_names import run_names
    from .workspace import checked_run_name

    several = not isinstance(log, str | os.PathLike)
    given = [
        log_path(os.fspath(each), allow_scan=allow_scan)
        for each in ([log] if isinstance(log, str | os.PathLike) else log)
    ]
    logs, missing = logs_of(given, warn=lambda _: None, separate=separate)
    for _, error in missing:
        raise error
    if len(logs) > 1 and not several:
        told = listed([str(each) for each in logs], 3)
        raise UsageError(f"{given[0]}: holds {len(logs)} logs; name one: {told}; or give a list")
    if len(logs) > 1 and name is not None:
        raise UsageError(f"name goes with one log; {len(logs)} are given")
    names = run_names(logs) if name is None else dict.fromkeys(logs, checked_run_name(name))
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
    with _on_one_thread():
        read = (replace(read_log(log, settings), name=run) for log, run in names.items())
        mapped = (map_of_log(found, MappingSettings(closure=closure)) for found in read)
        return tuple(piece for each in mapped for piece in joined_pieces(each))


def read_map(path: str | Path) -> TopoMap:
    """Read the map of a run, ``maps/RUN.json`` of a workspace.

    Parameters
    ----------
    path
        The document.

    Returns
    -------
    TopoMap
        Its arrays are read-only; their shapes and units stand in its docstring.

    Raises
    ------
    DocumentError
        It cannot be read, or is no such document; the message names the place of the first fault.

    Examples
    --------
    >>> import topobatch
    >>> topomap = topobatch.read_map("topobatch-workspace/maps/maze-1.json")  # doctest: +SKIP
    """
    from ..topology.document import read_map as read

    return read(Path(path))


def merge(
    maps: Iterable[TopoMap],
    *,
    false_merge_rate: float | None = None,
    locks: Sequence[Lock] = (),
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
    from ..merge.merging import MergeSettings, merge_maps
    from ..topology.errors import UsageError

    settings = MergeSettings()
    if false_merge_rate is not None:
        if not 0 < false_merge_rate <= 0.5:
            raise UsageError(f"false_merge_rate must lie in 0 … 0.5, not {false_merge_rate}")
        robust = replace(settings.robust, false_merge_rate=false_merge_rate)
        settings = replace(settings, robust=robust)
    with _on_one_thread():
        return merge_maps(list(maps), settings, locks=locks)


def to_networkx(graph: TopoMap | MergeResult) -> Any:
    """A map, or the fused maps of a merge, as a graph of networkx.

    Parameters
    ----------
    graph
        A map, or the result of a merge.

    Returns
    -------
    networkx.MultiGraph
        Nodes and edges with the attributes of the documents (``topobatch schema``): ``x``, ``y``,
        ``branches``, ``observations``; ``length``, ``path``, ``traversals``. Of a merge it has the
        components apart, each node with its ``component`` and ``members``.

    Examples
    --------
    >>> import topobatch
    >>> (maze,) = topobatch.ingest("sample_logs/maze-1.mcap")
    >>> graph = topobatch.to_networkx(maze)
    >>> graph.number_of_nodes(), graph.graph["run"]
    (26, 'maze-1')
    """
    import networkx as nx

    from ..merge.document import merged_to_document
    from ..merge.result import MergeResult
    from ..topology.document import map_to_document

    if isinstance(graph, MergeResult):
        return nx.node_link_graph(merged_to_document(graph), edges="edges")
    document = map_to_document(graph)
    return nx.node_link_graph(document, edges="edges")


def _on_one_thread() -> AbstractContextManager[object]:
    """One thread for linear algebra, as `cli.main` sets for the command."""
    import scipy.linalg  # noqa: F401  loads a library of its own, which is to be held as well
    from threadpoolctl import threadpool_limits

    held: AbstractContextManager[object] = threadpool_limits(limits=1)
    return held
