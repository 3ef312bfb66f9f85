"""Occupancy grids of one frame, on lattices along its axes: cropped, resampled, laid over each
other."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from .arrays import BoolArray, FloatArray, IntArray
from .run import Grid
from .se2 import apply, compose

MOST_CELLS = 1 << 24
"""Largest grid that is made, 16.8 million cells: 200 by 200 m at 0.05 m, the same as is read."""

BLOCK_M = 2.0
"""Side of the squares of a grid that are moved as one."""


def cell_for(extent_m: FloatArray, cell_m: float) -> float:
    """`cell_m`, doubled until a grid of this extent (width, height) [m] has at most
    `MOST_CELLS`."""
    while np.prod(np.ceil(extent_m / cell_m) + 1) > MOST_CELLS:
        cell_m *= 2
    return cell_m


def grid_at(first: IntArray, wall: BoolArray, free: BoolArray, cell_m: float, frame: str) -> Grid:
    """The grid of walls and free cells (h, w), unknown elsewhere, whose first cell has the number
    `first` (x, y) on the lattice along the axes of its frame."""
    x, y = (first * cell_m).tolist()
    return Grid(free & ~wall, ~free & ~wall, cell_m, (x, y, 0.0), frame)


def cropped(grid: Grid) -> Grid | None:
    """The part of a grid that holds all that is known; None if nothing is."""
    known = ~grid.unknown
    rows, columns = (np.flatnonzero(known.any(axis=axis)) for axis in (1, 0))
    if not len(rows):
        return None
    within = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    shift = grid.resolution_m * np.array([columns[0], rows[0], 0.0])
    x, y, yaw = compose(np.array(grid.origin), shift).tolist()
    return grid._replace(free=grid.free[within], unknown=grid.unknown[within], origin=(x, y, yaw))


def layered(grids: Sequence[Grid]) -> Grid | None:
    """Grids on one lattice, cell size and frame as one: a cell is as in the first grid
    that knows it. None without any."""
    if not grids:
        return None
    cell_m = grids[0].resolution_m
    firsts = [np.rint(np.array(g.origin[:2]) / cell_m).astype(np.int64) for g in grids]
    first = np.min(firsts, axis=0)
    ends = [f + g.free.shape[::-1] for f, g in zip(firsts, grids, strict=True)]
    width, height = (np.max(ends, axis=0) - first).tolist()
    wall, free = (np.zeros((height, width), bool) for _ in range(2))
    for (x, y), g in zip((np.array(firsts) - first).tolist(), grids, strict=True):
        part = np.s_[y : y + g.free.shape[0], x : x + g.free.shape[1]]
        unknown = ~wall[part] & ~free[part]
        free[part] |= unknown & g.free
        wall[part] |= unknown & ~g.free & ~g.unknown
    return grid_at(first, wall, free, cell_m, grids[0].frame)


def resampled(
    grid: Grid, placed_at: Callable[[FloatArray], FloatArray], cell_m: float, frame: str
) -> Grid | None:
    """A grid moved to another frame, on its lattice; None if nothing of it is known.

    placed_at: the transform (k, 3) from the grid's frame to the other at points (k, 2) of the
    grid's. Strategy: each cell as points at most half a new cell apart, `BLOCK_M` at a time; a cell
    is a wall where at least half of its known points are.
    """
    kept = cropped(grid)
    if kept is None:
        return None
    size = kept.resolution_m
    fine = int(np.ceil(2 * size / cell_m))
    side = max(1, round(BLOCK_M / size))
    sub = (np.arange(fine * side) + 0.5) / fine
    height, width = kept.free.shape
    blocks = [(y, x) for y in range(0, height, side) for x in range(0, width, side)]
    known = [not kept.unknown[y : y + side, x : x + side].all() for y, x in blocks]
    corner = np.array(blocks)[known][:, ::-1]
    middle = apply(np.array(kept.origin), (corner + side / 2) * size)
    T_new_grid = compose(placed_at(middle), np.array(kept.origin))
    ends = corner[:, None] + side * np.array([(0, 0), (1, 0), (0, 1), (1, 1)])
    reached = apply(T_new_grid[:, None], ends * size)
    first = np.floor(reached.min(axis=(0, 1)) / cell_m).astype(np.int64)
    beyond = np.floor(reached.max(axis=(0, 1)) / cell_m).astype(np.int64) + 1
    looks = np.zeros((2, *(beyond - first)[::-1].tolist()), np.uint16)
    for (x, y), T in zip(corner.tolist(), T_new_grid, strict=True):
        column, row = (at[at < end] for at, end in ((x + sub, width), (y + sub, height)))
        j, i = np.meshgrid(column.astype(np.int64), row.astype(np.int64))
        seen = ~kept.unknown[i, j]
        own = np.stack(np.meshgrid(column, row), axis=-1)[seen] * size
        at = np.floor(apply(T, own) / cell_m).astype(np.int64) - first
        np.add.at(looks, (kept.free[i, j][seen].astype(np.int64), at[:, 1], at[:, 0]), 1)
    wall = (looks[0] > 0) & (looks[0] >= looks[1])
    return grid_at(first, wall, looks[1] > 0, cell_m, frame)
