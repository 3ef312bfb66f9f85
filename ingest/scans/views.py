"""Views along the track, and the track laid out again where they show that it came by again."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ...topology.arrays import FloatArray, IntArray
from ...topology.closure.dead_reckoning import dead_reckoning
from ...topology.closure.view_loops import view_loops
from ...topology.matching.views import ViewIndex
from ...topology.odometry import Odometry
from ...topology.passes import NO_BRANCH, Passes
from ...topology.ragged import Ragged
from ...topology.run import NOT_SEEN_AGAIN, Grid, ScanPasses, SeenAgain
from ...topology.se2 import apply, compose, inverse, turned_axes, wrap
from ...topology.topomap import RunNoise
from ...topology.track import way_at
from ...topology.views import CELL_M, DISC, FREE, NO_VIEWS, SIDE, UNKNOWN, WALL, Views
from ...topology.visits import carried_along
from .floorplan import MOST_CELLS
from .junctions import Driven
from .open_space import distance, without_specks
from .windows import WINDOWS, Seen

EVERY_M = 2 * WINDOWS.every_m
"""Way between views where there is no junction."""


def chosen_views(seen: Sequence[Seen], passes: ScanPasses, driven: Driven) -> Views:
    """The views of the windows nearest to passes, and of others every `EVERY_M`, posed in the
    frame of the track."""
    if not seen:
        return NO_VIEWS
    way = np.array([window.way for window in seen])
    at = np.interp(passes.time_ns.astype(np.float64), driven.time_ns.astype(np.float64), driven.way)
    near = np.searchsorted(0.5 * (way[1:] + way[:-1]), at)
    wanted = np.zeros(len(way), bool)
    wanted[near] = True
    last = -np.inf
    following = np.append(way[wanted], np.inf)
    for k, here in enumerate(way.tolist()):
        ahead = following[np.searchsorted(following, here)]
        if wanted[k] or (here - last >= EVERY_M and ahead - here >= EVERY_M / 2):
            wanted[k], last = True, here
    kept = [window for window, some in zip(seen, wanted, strict=True) if some]
    keyframe = np.minimum(np.searchsorted(driven.way, way[wanted]), len(driven.way) - 1)
    pose = np.zeros((len(kept), 3))
    pose[:, :2] = [window.place for window in kept]
    return Views(driven.time_ns[keyframe], pose, np.array([window.view for window in kept]))


def closed_by_views(
    odometry: Odometry, views: Views, noise: RunNoise
) -> tuple[Odometry, Views, SeenAgain]:
    """The odometry and its views, laid out again by the loops that the views show; the loops.

    noise: of the odometry.
    """
    count = len(views)
    none = Ragged(np.zeros(count + 1, np.int64), np.zeros(0))
    unknown = np.full(count, NO_BRANCH)
    times = views.time_ns
    nodes = Passes(
        *(times, times, times, views.pose[:, :2], none, unknown, unknown),
        messages=np.ones(count, np.int64),
        confidence=np.ones(count),
    )
    if count < 2:
        return odometry, views, NOT_SEEN_AGAIN
    reckoning = dead_reckoning(odometry, nodes, noise)
    closed, estimate = view_loops(reckoning, ViewIndex.of(views), way_at(odometry, times))
    loops, pose = closed.loops, np.round(estimate.pose, POSE_DIGITS)
    # Each node's pose tells how the frame of the odometry is to be moved there.
    known = times, pose, views.pose[:, :2]
    moved = carried_along(odometry, known, odometry.time_ns, odometry.pose)
    moved = np.where(np.isfinite(moved), moved, odometry.pose)
    placed = np.column_stack([pose[:, :2], wrap(views.pose[:, 2] + pose[:, 2])])
    back = turned_axes(pose[loops.target, 2])
    information = np.round(back @ loops.information @ back.transpose(0, 2, 1), INFORMATION_DIGITS)
    return (
        replace(odometry, pose=moved),
        Views(views.time_ns, placed, views.cells),
        SeenAgain(times[loops.source], times[loops.target], information),
    )


POSE_DIGITS, INFORMATION_DIGITS = 6, 3
"""Decimals of poses [m, rad], and of the loops' information [1/m², 1/rad²], some hundreds: so that
they do not depend on the order in which a processor adds."""


def grid_views(grid: Grid, along: FloatArray) -> Views:
    """Views cut from a saved grid, in the form of those that a laser saw: around places `along`
    (k, 2) [m, the map's frame] the corridors, `EVERY_M` apart or more, and in free space elsewhere,
    the widest first. None of a grid that is too large (`too_large`)."""
    if too_large(grid):
        return NO_VIEWS
    states = _states(grid)
    free = states == FREE
    if not free.any():
        return NO_VIEWS
    own = np.rint(apply(inverse(np.array(grid.origin)), along) / CELL_M).astype(np.int64)
    clearance = distance(np.pad(free, 1), CELL_M)[1:-1, 1:-1].ravel()
    at = np.flatnonzero(clearance > WINDOWS.skeleton.clearance_m)
    at = at[np.argsort(-clearance[at], kind="stable")]
    corner = _spaced([own, *_corners(at, free.shape[1])], EVERY_M / CELL_M)
    inside = (corner >= 0).all(axis=1) & (corner <= np.array(states.shape)[::-1]).all(axis=1)
    corner = corner[inside]
    # A view's place is a corner between four cells.
    padded = np.pad(states, SIDE // 2)
    cells = np.stack([padded[y : y + SIDE, x : x + SIDE] for x, y in corner.tolist()])
    pose = np.column_stack([corner * CELL_M, np.zeros(len(corner))])
    return Views(
        np.zeros(len(corner), np.int64),
        compose(np.array(grid.origin), pose),
        np.where(DISC, cells, UNKNOWN).astype(np.uint8),
    )


def too_large(grid: Grid) -> bool:
    """Whether no views are cut from a grid: it has more cells of a view than a floor plan may have,
    410 by 410 m. Coarser cells are divided."""
    return bool(grid.free.size * (grid.resolution_m / CELL_M) ** 2 > MOST_CELLS)


def _states(grid: Grid) -> NDArray[np.uint8]:
    """(h, w) states of a grid in cells of a view's size: a wall if any of its cells there is
    one, specks aside."""
    free = without_specks(grid.free & ~grid.unknown, grid.resolution_m)
    states = np.full(free.shape, WALL, np.uint8)
    states[grid.unknown] = UNKNOWN
    states[free] = FREE
    for axis in (0, 1):
        count = int(states.shape[axis])
        first = np.arange(0, count * grid.resolution_m - 1e-9, CELL_M) / grid.resolution_m
        begin = np.minimum(np.floor(first + 1e-9).astype(np.int64), count - 1)
        if grid.resolution_m < CELL_M:
            begin = np.unique(begin)
            states = np.maximum.reduceat(states, begin, axis=axis)
        else:
            states = np.take(states, begin, axis=axis)
    return states


CORNERS_AT_ONCE = 1 << 16
"""Places of a grid that are looked at together."""


def _corners(at: IntArray, width: int) -> Iterator[IntArray]:
    """(k, 2) the corners nearest to the centres of cells, given by their numbers row by row."""
    for begin in range(0, len(at), CORNERS_AT_ONCE):
        row, column = np.divmod(at[begin : begin + CORNERS_AT_ONCE], width)
        yield np.rint(np.column_stack([column, row]) + 0.5).astype(np.int64)


def _spaced(points: Sequence[IntArray], apart: float) -> IntArray:
    """Points (k, 2) in their order, without those nearer than `apart` to one before."""
    reach = int(apart)
    low = np.min([part.min(axis=0) for part in points if len(part)], axis=0) - reach
    high = np.max([part.max(axis=0) for part in points if len(part)], axis=0) + reach
    taken = np.zeros((high - low + 1)[::-1], bool)
    step = np.arange(-reach, reach + 1)
    near = step[:, None] ** 2 + step**2 < apart**2
    kept = []
    for part in (each - low for each in points):
        for x, y in part[~taken[part[:, 1], part[:, 0]]].tolist():
            if not taken[y, x]:
                kept.append((x, y))
                taken[y - reach : y + reach + 1, x - reach : x + reach + 1] |= near
    return np.asarray(np.array(kept, np.int64) + low)
