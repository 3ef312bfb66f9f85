"""A recorded run, whatever container it came in."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from .arrays import BoolArray, FloatArray, IntArray
from .frozen import freeze
from .odometry import Odometry
from .passes import check_passes
from .ragged import Ragged
from .topomap import RunNoise
from .views import NO_VIEWS, Views


@dataclass(frozen=True, slots=True, eq=False)
class Detections:
    """Junction sightings, one row per message, in the robot's frame.

    time_ns: (k,) int64, not descending; centre: (k, 2) junction centre [m]; branches: k rows of
    headings [rad] in the order of the message. Messages in the odometry frame are turned into the
    robot's frame when they are read, so that the odometry can be corrected later.
    """

    time_ns: IntArray
    centre: FloatArray
    branches: Ragged

    def __post_init__(self) -> None:
        freeze(self, np.int64, time_ns=(None,))
        freeze(self, np.float64, centre=(len(self), 2))
        if len(self.branches) != len(self):
            raise ValueError("one row of branches per detection is needed")
        if np.any(np.diff(self.time_ns) < 0):
            raise ValueError("detections must be in the order of time")

    def __len__(self) -> int:
        return len(self.time_ns)

    def moved(self, by_m: tuple[float, float]) -> Detections:
        """The same, with centres moved in the robot's frame [m]."""
        return Detections(self.time_ns, self.centre + np.array(by_m), self.branches)


NO_DETECTIONS = Detections(
    np.zeros(0, np.int64), np.zeros((0, 2)), Ragged(np.zeros(1, np.int64), np.zeros(0))
)


@dataclass(frozen=True, slots=True, eq=False)
class ScanPasses:
    """Passes by junctions that were detected in scans, one row each, in the robot's frame at
    `time_ns`.

    time_ns: (p,) when the robot was nearest to the centre, not descending; start_ns, end_ns: (p,)
    first and last time within reach; centre: (p, 2) [m]; branches: p rows of headings [rad], at
    least one each; confidence: (p,) share (0..1] of the detector's variants that show the junction
    with exactly these branches; windows: (p,) number of overlapping windows that show it;
    clearance_m: (p,) distance of the centre from the nearest wall [m]; shared_m: (p,) 1 sigma per
    axis [m] of the centre's error that all passes by a place have in common; askew_rad: the same of
    headings [rad]; resolution_m: junctions nearer to each other than this show as one.
    """

    time_ns: IntArray
    start_ns: IntArray
    end_ns: IntArray
    centre: FloatArray
    branches: Ragged
    confidence: FloatArray
    windows: IntArray
    clearance_m: FloatArray
    shared_m: FloatArray
    resolution_m: float = 0.0
    askew_rad: float = 0.0

    def __post_init__(self) -> None:
        p = len(self.time_ns)
        freeze(self, np.int64, time_ns=(p,), start_ns=(p,), end_ns=(p,), windows=(p,))
        freeze(self, np.float64, centre=(p, 2), confidence=(p,), clearance_m=(p,), shared_m=(p,))
        check_passes(self.time_ns, self.branches)

    def __len__(self) -> int:
        return len(self.time_ns)


@dataclass(frozen=True, slots=True, eq=False)
class SeenAgain:
    """Pairs of times at which the robot was near one place, as views show.

    first_ns, second_ns: (k,) times; information: (k, 3, 3) of the second pose relative to the
    first, in the axes of the odometry frame, as the corrected odometry has it [1/m², 1/rad²].
    """

    first_ns: IntArray
    second_ns: IntArray
    information: FloatArray

    def __post_init__(self) -> None:
        k = len(self.first_ns)
        freeze(self, np.int64, first_ns=(k,), second_ns=(k,))
        freeze(self, np.float64, information=(k, 3, 3))

    def __len__(self) -> int:
        return len(self.first_ns)


NOT_SEEN_AGAIN = SeenAgain(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 3, 3)))


@dataclass(frozen=True, slots=True, eq=False)
class Scanned:
    """Junctions detected in scans; noise: of the odometry corrected by scan matching and of the
    passes; views: around places of the track, posed in the odometry frame; loops: where the track
    came by a place again."""

    passes: ScanPasses
    noise: RunNoise
    views: Views = NO_VIEWS
    loops: SeenAgain = NOT_SEEN_AGAIN


class Grid(NamedTuple):
    """An occupancy grid, ingested in place of a run.

    free, unknown: (h, w) cells known to be free, and unknown cells, row 0 at the smallest y;
    resolution_m: side of a cell; origin: x, y [m], yaw [rad] of the corner of cell (0, 0) in the
    map's frame; frame: its name.
    """

    free: BoolArray
    unknown: BoolArray
    resolution_m: float
    origin: tuple[float, float, float]
    frame: str = "map"


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """One recorded run: `name` (file name without its suffix), odometry, detections.

    source: topics, types and counts for the document's `graph.source`: JSON values that depend on
    the content alone, not on the container, the path or the machine; warnings: one sentence, with a
    count, per kind of fault found in the log; scanned: of a run whose junctions were detected in
    scans; its detections are then empty; views: of a run with detections, what its lasers saw
    around places, posed in the robot's frame of their time; misread: whether detections and
    odometry are known to be in different units, axes, frames or clocks.
    """

    name: str
    odometry: Odometry
    detections: Detections
    source: Mapping[str, Any] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    scanned: Scanned | None = None
    misread: bool = False
    views: Views = NO_VIEWS
