"""Walls and free space of a map, or of a site: the views of its runs laid over each other."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..topology.arrays import FloatArray, IntArray
from ..topology.grids import cell_for, cropped, grid_at
from ..topology.run import Grid
from ..topology.se2 import apply
from ..topology.views import CELL_M, FREE, REACH_M, SIDE, UNKNOWN, WALL, Views

FINE_M = CELL_M / 2
"""Side of a cell: several views of a wall, each in a lattice of its own, show it finer than one
does."""

WALL_SHARE = 0.5
"""Share of the views of a cell that show a wall there, from which on it is one."""


def walls_of(views: Sequence[Views], frame: str, cell_m: float = FINE_M) -> Grid | None:
    """Views, posed in one frame, as one grid: a cell is a wall where `WALL_SHARE` of the views that
    know it say so. None without views. O(cells of views)."""
    pose = np.concatenate([np.zeros((0, 3)), *(v.pose for v in views)])
    if not len(pose):
        return None
    low, high = pose[:, :2].min(axis=0) - REACH_M, pose[:, :2].max(axis=0) + REACH_M
    cell_m = cell_for(high - low, cell_m)
    first = np.floor(low / cell_m).astype(np.int64)
    width, height = (np.floor(high / cell_m).astype(np.int64) - first + 1).tolist()
    looks = np.zeros((WALL + 1, height, width), np.uint16)
    for each in views:
        for T, cells in zip(each.pose, each.cells, strict=True):
            corner, states = _resampled(T, cells, cell_m)
            x, y = (corner - first).tolist()
            inside = np.s_[max(y, 0) : y + len(states), max(x, 0) : x + len(states)]
            part = looks[:, *inside]
            states = states[max(-y, 0) :, max(-x, 0) :][: part.shape[1], : part.shape[2]]
            for state in (FREE, WALL):
                part[state] += states == state
    occupied = (looks[WALL] > 0) & (looks[WALL] >= WALL_SHARE * (looks[WALL] + looks[FREE]))
    return cropped(grid_at(first, occupied, looks[FREE] > 0, cell_m, frame))


def _resampled(
    T: FloatArray, cells: NDArray[np.uint8], cell_m: float
) -> tuple[IntArray, NDArray[np.uint8]]:
    """(n, n) states of a view posed at T in cells of a lattice along the axes, by the middles of
    these; and the number of the first (x, y)."""
    corner = np.floor((T[:2] - REACH_M) / cell_m).astype(np.int64)
    step = np.arange(2 * int(np.ceil(REACH_M / cell_m)) + 1) + 0.5
    x, y = (corner[:, None] + step) * cell_m - T[:2, None]
    c, s = np.cos(T[2]), np.sin(T[2])
    column = np.floor((c * x + s * y[:, None] + REACH_M) / CELL_M).astype(np.int64)
    row = np.floor((c * y[:, None] - s * x + REACH_M) / CELL_M).astype(np.int64)
    within = (column >= 0) & (column < SIDE) & (row >= 0) & (row < SIDE)
    return corner, np.where(within, cells[row % SIDE, column % SIDE], np.uint8(UNKNOWN))


def wall_points(grid: Grid | None) -> FloatArray:
    """(k, 2) points that a picture of the walls of a grid has to hold, in its frame [m]: the
    middles of their cells."""
    if grid is None:
        return np.zeros((0, 2))
    row, column = np.nonzero(~grid.free & ~grid.unknown)
    own = (np.stack([column, row], axis=-1) + 0.5) * grid.resolution_m
    return apply(np.array(grid.origin), own)
