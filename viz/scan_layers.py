"""A laser's view as layers below the map: walls, junctions, windows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from ..topology.arrays import FloatArray, IntArray
from ..topology.odometry import Odometry
from ..topology.run import Scanned, ScanPasses
from ..topology.se2 import apply
from ..topology.topomap import TopoMap
from ..topology.views import CELL_M
from . import palette
from .recording import CLOCKS, HAIR, PathParts, Recording, entity
from .robot_track import RobotTrack

MOST_CELLS = 150_000
"""Limit on cells (8 bytes each), above which they are made larger."""
MOST_STEPS = 400
"""Walls are logged in at most this many steps over the run."""
SURE = 5.5 / 7
"""Confidence above which a junction is drawn as sure: six of the detector's seven variants
agree."""


@dataclass(frozen=True, slots=True, eq=False)
class ScanLayers:
    """The layers in the map's frame.

    walls: (n, 2) cell centres, in the order of time_ns (n,), when each was seen first; passes,
    their centres (p, 2) and closed window outlines (p, 5, 2); surest: for each vertex of the map
    its pass of highest confidence, -1 for none.
    """

    walls: FloatArray
    time_ns: IntArray
    cell_m: float
    passes: ScanPasses
    centre: FloatArray
    windows: FloatArray
    surest: IntArray


def scan_layers(
    scanned: Scanned, topomap: TopoMap, odometry: Odometry, track: RobotTrack
) -> ScanLayers:
    """The walls of the map's views, and the junctions, placed on the map by the track."""
    passes = scanned.passes
    walls, view = topomap.views.walls()
    walls, seen_ns, cell_m = _cells(walls, topomap.views.time_ns[view])
    pose = track.at(passes.time_ns)
    # Windows are aligned with the axes of the odometry's frame.
    turn = pose[:, 2] - odometry.at(passes.time_ns)[:, 2]
    corners = scanned.window_m * np.array([[1, 1], [-1, 1], [-1, -1], [1, -1], [1, 1]])
    square = np.column_stack([pose[:, :2], turn])
    return ScanLayers(
        walls,
        seen_ns,
        cell_m,
        passes,
        apply(pose, passes.centre),
        np.stack([apply(square, np.tile(c, (len(square), 1))) for c in corners], axis=1),
        _surest(passes, topomap),
    )


def _surest(passes: ScanPasses, topomap: TopoMap) -> IntArray:
    """(n,) the pass of highest confidence at each vertex, the first of equal ones; -1 for none."""
    row = {t: k for k, t in enumerate(passes.time_ns.tolist())}
    of = np.array([row.get(t, -1) for t in topomap.observation_time_ns.tolist()], np.int64)
    seen = np.flatnonzero(of >= 0)
    vertex, of = topomap.observation_vertex[seen], of[seen]
    best = np.lexsort((of, -passes.confidence[of], vertex))
    known, first = np.unique(vertex[best], return_index=True)
    out = np.full(len(topomap), -1, np.int64)
    out[known] = of[best[first]]
    return out


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


def write_scans(recording: Recording, root: PathParts, layers: ScanLayers) -> None:
    """Write the layers below `root`/scans."""
    here = (*root, "scans")
    _walls(recording, (*here, "walls"), layers)
    passes = layers.passes
    if len(passes) == 0:
        return
    _on_selection(recording, (*root, "junctions"), layers)
    told = rr.AnyValues(
        seen=np.arange(len(passes)),
        confidence=passes.confidence,
        branches=passes.branches.counts,
        windows=passes.windows,
        clearance_m=passes.clearance_m,
    )
    sure = (passes.confidence > SURE)[:, None]
    colours = np.where(sure, palette.DETECTION, palette.DOUBTFUL).astype(np.uint8)
    dots = rr.Points2D(
        layers.centre, radii=rr.Radius.ui_points(2.5), colors=colours, draw_order=palette.Order.TIE
    )
    recording.static((*here, "junctions"), dots, told)
    outlines = rr.LineStrips2D(
        list(layers.windows), radii=HAIR, colors=colours, draw_order=palette.Order.WINDOW
    )
    recording.static((*here, "windows"), outlines, told)
    last = rr.LineStrips2D.columns(strips=list(layers.windows)).partition(
        np.ones(len(passes), np.int64)
    )
    recording.over_time((*here, "window"), passes.time_ns, last)
    look = rr.LineStrips2D.from_fields(
        radii=HAIR, colors=palette.DETECTION, draw_order=palette.Order.WINDOW
    )
    recording.static((*here, "window"), look)


def _on_selection(recording: Recording, path: PathParts, layers: ScanLayers) -> None:
    """Write the window that shows a junction best, invisible: the viewer outlines it when the
    junction is selected, since both have the same index in one entity."""
    none = np.zeros((0, 2))
    strips = [layers.windows[k] if k >= 0 else none for k in layers.surest.tolist()]
    look = rr.LineStrips2D(
        strips, radii=HAIR, colors=palette.BACKGROUND, draw_order=palette.Order.CARD
    )
    recording.static(path, look)


def _walls(recording: Recording, path: PathParts, layers: ScanLayers) -> None:
    """Write the walls over time, in steps."""
    n = len(layers.walls)
    if n == 0:
        return
    steps = np.unique(np.linspace(0, n, min(MOST_STEPS, n) + 1).astype(np.int64))
    columns = rr.Points2D.columns(positions=layers.walls.astype(np.float32))
    # A step has the time of its last cell: nothing is shown before it was seen.
    recording.over_time(path, layers.time_ns[steps[1:] - 1], columns.partition(np.diff(steps)))
    look = rr.Points2D.from_fields(
        radii=layers.cell_m / 2, colors=palette.WALL, draw_order=palette.Order.WALL
    )
    recording.static(path, look)


def overrides_of_scans(
    root: PathParts,
) -> dict[str, rrb.EntityBehavior | rrb.VisibleTimeRanges]:
    """A view's overrides: walls are shown up to the cursor, the windows of all passes are hidden at
    first."""
    so_far = [
        rrb.VisibleTimeRange(
            clock,
            start=rr.TimeRangeBoundary.infinite(),
            end=rr.TimeRangeBoundary.cursor_relative(),
        )
        for clock in CLOCKS
    ]
    return {
        entity((*root, "scans", "walls")): rrb.VisibleTimeRanges(so_far),
        entity((*root, "scans", "windows")): rrb.EntityBehavior(visible=False),
    }
