"""What a laser saw, under the map that was made from it: walls, skeleton, junctions, windows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from ..topology.arrays import FloatArray, IntArray
from ..topology.odometry import Odometry
from ..topology.run import Anchored, Scanned, ScanPasses
from ..topology.se2 import apply
from ..topology.topomap import TopoMap
from . import palette
from .recording import CLOCKS, HAIR, PathParts, Recording, entity
from .robot_track import RobotTrack

CELL_M = 0.1
"""Walls are drawn by cells of this size, as the detector's grid has them."""
MOST_CELLS = 150_000
"""Of 8 bytes each; where there are more, cells are larger."""
MOST_STEPS = 400
"""Walls appear in so many steps over the whole run."""
SURE = 5.5 / 7
"""Junctions on which six of the detector's seven variants agree."""


@dataclass(frozen=True, slots=True, eq=False)
class ScanLayers:
    """In the map's frame. walls: (n, 2) cells, by the time_ns (n,) at which each was seen first;
    skeleton: (m, 2); passes, and their centres (p, 2); windows: (p, 5, 2) closed outlines;
    surest: (n,) of every vertex of the map, the pass that shows it best, -1 where there is none."""

    walls: FloatArray
    time_ns: IntArray
    cell_m: float
    skeleton: FloatArray
    passes: ScanPasses
    centre: FloatArray
    windows: FloatArray
    surest: IntArray


def scan_layers(
    scanned: Scanned, topomap: TopoMap, odometry: Odometry, track: RobotTrack
) -> ScanLayers | None:
    """What scans showed, placed by the track on the map; None if nothing was kept. What was seen
    outside of the track's time is left out."""
    if scanned.picture is None:
        return None
    picture, passes = scanned.picture, scanned.passes
    walls, seen_ns = _placed(picture.walls, track)
    walls, seen_ns, cell_m = _cells(walls, seen_ns)
    pose = track.at(passes.time_ns)
    # Windows lie along the axes of the odometry's frame.
    turn = pose[:, 2] - odometry.at(passes.time_ns)[:, 2]
    corners = picture.window_m * np.array([[1, 1], [-1, 1], [-1, -1], [1, -1], [1, 1]])
    square = np.column_stack([pose[:, :2], turn])
    return ScanLayers(
        walls,
        seen_ns,
        cell_m,
        _placed(picture.skeleton, track)[0],
        passes,
        apply(pose, passes.centre),
        np.stack([apply(square, np.tile(c, (len(square), 1))) for c in corners], axis=1),
        _surest(passes, topomap),
    )


def _surest(passes: ScanPasses, topomap: TopoMap) -> IntArray:
    """(n,) the pass by each vertex with the highest confidence, the first of several."""
    row = {t: k for k, t in enumerate(passes.time_ns.tolist())}
    of = np.array([row.get(t, -1) for t in topomap.observation_time_ns.tolist()], np.int64)
    seen = np.flatnonzero(of >= 0)
    vertex, of = topomap.observation_vertex[seen], of[seen]
    best = np.lexsort((of, -passes.confidence[of], vertex))
    known, first = np.unique(vertex[best], return_index=True)
    out = np.full(len(topomap), -1, np.int64)
    out[known] = of[best[first]]
    return out


def _placed(points: Anchored, track: RobotTrack) -> tuple[FloatArray, IntArray]:
    """(n, 2) points on the map, and the times (n,) on which they hang."""
    when = points.anchor_ns[points.anchor]
    rows = np.flatnonzero((when >= track.time_ns[0]) & (when <= track.time_ns[-1]))
    pose = track.at(points.anchor_ns)[points.anchor[rows]]
    return apply(pose, points.xy[rows].astype(np.float64)), when[rows]


def _cells(xy: FloatArray, time_ns: IntArray) -> tuple[FloatArray, IntArray, float]:
    """Middles of the cells that points lie in, by the time of the first in each; side of a cell."""
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
    if len(layers.skeleton):
        points = rr.Points2D(
            layers.skeleton.astype(np.float32),
            radii=HAIR,
            colors=palette.SKELETON,
            draw_order=palette.Order.SKELETON,
        )
        recording.static((*here, "skeleton"), points)
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
    """The window that shows a junction best, unseen until the junction is selected: the viewer then
    outlines all that the entity has of its number."""
    none = np.zeros((0, 2))
    strips = [layers.windows[k] if k >= 0 else none for k in layers.surest.tolist()]
    look = rr.LineStrips2D(
        strips, radii=HAIR, colors=palette.BACKGROUND, draw_order=palette.Order.CARD
    )
    recording.static(path, look)


def _walls(recording: Recording, path: PathParts, layers: ScanLayers) -> None:
    """Cells in the order in which they were seen, step by step."""
    n = len(layers.walls)
    if n == 0:
        return
    steps = np.unique(np.linspace(0, n, min(MOST_STEPS, n) + 1).astype(np.int64))
    columns = rr.Points2D.columns(positions=layers.walls.astype(np.float32))
    # Every step at the time of its last cell: nothing shows before it was seen.
    recording.over_time(path, layers.time_ns[steps[1:] - 1], columns.partition(np.diff(steps)))
    look = rr.Points2D.from_fields(
        radii=layers.cell_m / 2, colors=palette.WALL, draw_order=palette.Order.WALL
    )
    recording.static(path, look)


def overrides_of_scans(
    root: PathParts,
) -> dict[str, rrb.EntityBehavior | rrb.VisibleTimeRanges]:
    """How a view shows them: all walls seen up to the cursor; all windows at once only if asked."""
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
