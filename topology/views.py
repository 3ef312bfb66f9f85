"""Views: local maps of walls and free space around a place, from a laser or a saved grid."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from .arrays import FloatArray, IntArray
from .frozen import freeze
from .se2 import apply, compose

UNKNOWN, FREE, WALL = 0, 1, 2
"""States of a cell of a view."""

CELL_M = 0.2
"""Side of a view's cell: with half of it places are separated no better, in twice the size."""
REACH_M = 8.0
"""Radius of a view, as of the grids of scans. Tried: 6 and 10 m, no change."""
SIDE = round(2 * REACH_M / CELL_M)
"""Cells along the side of a view."""
_STEP = (np.arange(SIDE) + 0.5) * CELL_M - REACH_M
DISC = np.hypot(_STEP[:, None], _STEP) <= REACH_M
"""(SIDE, SIDE) cells within the reach of a view; corners are unknown, so that it can be rotated."""


@dataclass(frozen=True, slots=True, eq=False)
class Views:
    """Local maps of walls and free space around `n` places of one run or grid, by time.

    time_ns: (n,) when the robot was there, 0 for grids; pose: (n, 3) x, y [m], theta [rad] of the
    view's frame in the map's: the place, and the direction of the view's x axis; cells: (n, SIDE,
    SIDE) uint8 of `UNKNOWN`, `FREE`, `WALL`, row y, column x, with the place at the corner between
    the four middle cells. A view is drawn in a frame of its own, so that drift of the run does not
    bend it. Raises ValueError on shapes that do not fit.
    """

    time_ns: IntArray
    pose: FloatArray
    cells: NDArray[np.uint8]

    def __post_init__(self) -> None:
        n = len(self.time_ns)
        freeze(self, np.int64, time_ns=(n,))
        freeze(self, np.float64, pose=(n, 3))
        freeze(self, np.uint8, cells=(n, SIDE, SIDE))
        if np.any(self.cells > WALL):
            raise ValueError("a cell of a view is unknown, free or a wall")

    def __len__(self) -> int:
        return len(self.time_ns)

    def moved(self, T: FloatArray) -> Views:
        """The same views in another frame: their poses moved by one transform (3,), or by one each
        (n, 3)."""
        return replace(self, pose=compose(T, self.pose))

    def walls(self) -> tuple[FloatArray, IntArray]:
        """(w, 2) centres of all cells that are walls, in the frame of the poses [m], and (w,) the
        view that each is of."""
        view, row, column = np.nonzero(self.cells == WALL)
        offset = (np.column_stack([column, row]) + 0.5) * CELL_M - REACH_M
        return apply(self.pose[view], offset), view


NO_VIEWS = Views(np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, SIDE, SIDE), np.uint8))
"""The views of a run without a laser."""


def together(views: Sequence[Views]) -> Views:
    """Views of several runs, posed in one frame, as those of one."""
    columns = [[v.time_ns, v.pose, v.cells] for v in (NO_VIEWS, *views)]
    return Views(*map(np.concatenate, zip(*columns, strict=True)))


def view_cells(hit: IntArray, free: IntArray) -> NDArray[np.uint8]:
    """(…, SIDE, SIDE) states of cells from counts of hits and of beams seen through, (…, 2 SIDE,
    2 SIDE) each, in cells of half the side.

    A cell is a wall if a quarter of its beams hit something: people who walk by are hit by fewer,
    walls at a grazing angle by not all.
    """
    wall = (hit > 0) & (3 * hit >= free)
    is_free = (free > 0) & ~wall
    shape = (*hit.shape[:-2], SIDE, 2, SIDE, 2)
    walls = wall.reshape(shape).any(axis=(-3, -1))
    clears = is_free.reshape(shape).any(axis=(-3, -1))
    states = np.where(walls, WALL, np.where(clears, FREE, UNKNOWN))
    return np.where(DISC, states, UNKNOWN).astype(np.uint8)
