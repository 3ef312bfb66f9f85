"""Results to rerun recordings. Imports `topology` and the result types of `merge`.

rerun takes up to a second to import, so the modules that use it are imported by the functions
below, when a recording is written.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ..merge.decision import Decision
    from ..merge.paper.explain import Explanation
    from ..merge.result import MergeResult
    from ..topology.odometry import Odometry
    from ..topology.run import Detections, Grid, Scanned
    from ..topology.topomap import TopoMap


def write_map_recording(
    path: Path,
    topomap: TopoMap,
    *,
    odometry: Odometry | None = None,
    detections: Detections | None = None,
    scanned: Scanned | None = None,
    grid: Grid | None = None,
) -> None:
    """Write the recording of one run's map, `maps/<run>.rrd`, atomically.

    odometry, detections, scanned: the run's own, as recorded; with them the recording shows what
    closing the loops changed, where the robot is on the map at any time, and what its detector or
    its laser saw there. grid: that the map was made from, in place of a run. Raises OSError if the
    file cannot be written.
    """
    from .map_recording import write

    write(path, topomap, odometry=odometry, detections=detections, scanned=scanned, grid=grid)


def write_merged_recording(path: Path, result: MergeResult, maps: Sequence[TopoMap]) -> None:
    """Write the recording of a merge, `merged.rrd`, atomically.

    maps: the map of every run that the result speaks of, in any order. Raises ValueError if one
    is missing or two share a name, OSError if the file cannot be written.
    """
    from .merged_recording import write

    write(path, result, maps)


def write_decision_recording(path: Path, a: TopoMap, b: TopoMap, decision: Decision) -> None:
    """Write why two runs were merged or not, atomically: the placements with the matched junctions
    tied, the evidence term by term, the threshold.

    Raises OSError if the file cannot be written.
    """
    from .decision_recording import write

    write(path, a, b, decision)


def write_explain_recording(path: Path, a: TopoMap, b: TopoMap, explanation: Explanation) -> None:
    """Write what structural matching found between two maps, atomically: the table of vertex
    pairs, the clusters in transform space, and where the best clusters place b over a.

    Raises OSError if the file cannot be written.
    """
    from .explain_recording import write

    write(path, a, b, explanation)


def write_raw_log(path: Path, views: Path, log: Path, recording: Path, topomap: TopoMap) -> None:
    """Write the recording of a run's map together with its raw log, an MCAP file or a folder of
    them: topics lie below /log, and share the map's time.

    recording: of the map; views: a recording to open before `path`, which says how to show both.
    Raises LogError if the viewer cannot read the log, OSError if a file cannot be written.
    """
    from .raw_log import write

    write(path, views, log, recording, topomap)
