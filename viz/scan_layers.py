"""A laser's view as layers below the map: walls, and junctions as they were detected."""

from __future__ import annotations

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from ..topology.arrays import FloatArray, IntArray
from ..topology.run import ScanPasses
from ..topology.se2 import apply
from ..topology.topomap import TopoMap
from ..topology.views import CELL_M
from . import palette
from .recording import CLOCKS, PathParts, Recording
from .robot_track import RobotTrack

MOST_CELLS = 150_000
"""Limit on cells (8 bytes each), above which they are made larger."""
MOST_STEPS = 400
"""Walls are logged in at most this many steps over the run."""
SURE = 5.5 / 7
"""Confidence above which a junction is drawn as sure: six of the detector's seven variants
agree."""

WALLS_SO_FAR = rrb.VisibleTimeRanges(
    [
        rrb.VisibleTimeRange(
            clock,
            start=rr.TimeRangeBoundary.infinite(),
            end=rr.TimeRangeBoundary.cursor_relative(),
        )
        for clock in CLOCKS
    ]
)
"""How a view shows walls: all that were seen up to the cursor."""


def write_scans(
    recording: Recording, root: PathParts, passes: ScanPasses, topomap: TopoMap, track: RobotTrack
) -> None:
    """Write the walls of the map's views and the junctions of a run's scans below `root`/scans,
    placed on the map by the track."""
    _walls(recording, (*root, "scans", "walls"), topomap)
    if len(passes) == 0:
        return
    sure = (passes.confidence > SURE)[:, None]
    dots = rr.Points2D(
        apply(track.at(passes.time_ns), passes.centre),
        radii=rr.Radius.ui_points(2.5),
        colors=np.where(sure, palette.DETECTION, palette.DOUBTFUL).astype(np.uint8),
        draw_order=palette.Order.TIE,
    )
    told = rr.AnyValues(
        seen=np.arange(len(passes)),
        confidence=passes.confidence,
        branches=passes.branches.counts,
        windows=passes.windows,
        clearance_m=passes.clearance_m,
    )
    recording.static((*root, "scans", "junctions"), dots, told)


def _walls(recording: Recording, path: PathParts, topomap: TopoMap) -> None:
    """Write the walls over time, in steps."""
    xy, view = topomap.views.walls()
    walls, time_ns, cell_m = _cells(xy, topomap.views.time_ns[view])
    n = len(walls)
    if n == 0:
        return
    steps = np.unique(np.linspace(0, n, min(MOST_STEPS, n) + 1).astype(np.int64))
    columns = rr.Points2D.columns(positions=walls.astype(np.float32))
    # A step has the time of its last cell: nothing is shown before it was seen.
    recording.over_time(path, time_ns[steps[1:] - 1], columns.partition(np.diff(steps)))
    look = rr.Points2D.from_fields(
        radii=cell_m / 2, colors=palette.WALL, draw_order=palette.Order.WALL
    )
    recording.static(path, look)


def _cells(xy: FloatArray, time_ns: IntArray) -> tuple[FloatArray, IntArray, float]:
    """Centres of the cells that hold points, in the order of the first point's time; those times;
    and the cell size [m], doubled until there are at most MOST_CELLS."""
    order = np.argsort(time_ns, kind="stable")
    xy, time_ns, cell_m = xy[order], time_ns[order], CELL_M
    while True:
        cell = np.floor(xy / cell_m).astype(np.int64)
        first = np.sort(np.unique(cell, axis=0, return_index=True)[1])
        if len(first) <= MOST_CELLS:
            return np.asarray((cell[first] + 0.5) * cell_m), time_ns[first], cell_m
        cell_m *= 2
