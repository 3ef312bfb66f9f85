"""The open space of a saved grid: where its skeleton lies, and where a robot can drive."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from ...topology.arrays import BoolArray, Float32Array, FloatArray
from ...topology.se2 import apply, compose, inverse
from .grid import Labels, without_islands

SPECK_M = 0.1
"""Isolated obstacles up to this size, or up to two cells, are noise of the mapper as often as
things: they are driven round, at a distance if there is room, and are no obstacles otherwise."""


@dataclass(frozen=True, slots=True, eq=False)
class OpenSpace:
    """A grid (h, w), with a border of walls, as a robot sees it.

    free: free cells, and specks among them; room_m: distance of the centres of cells from all
    others [m]; all_m: from all that is not free, specks as well; cell_m: size of a cell.
    """

    free: BoolArray
    room_m: Float32Array
    all_m: Float32Array
    cell_m: float

    @classmethod
    def of(cls, free: BoolArray, cell_m: float) -> OpenSpace:
        """The open space of free cells whose border is not free. O(h w)."""
        solid, all_m = without_specks(free, cell_m), distance(free, cell_m)
        room_m = all_m if np.array_equal(solid, free) else distance(solid, cell_m)
        return cls(solid, room_m, all_m, cell_m)

    def clearance_m(self, radius_m: float, island_m: float) -> Float32Array:
        """(h, w) distance of cells from walls [m], for a robot of this radius.

        What it does not fit between is one obstacle; those up to `island_m` which touch no border
        are driven round, but are no walls: furniture moves.
        """
        blocked = self.room_m <= radius_m
        filled = without_islands(self.free, island_m / self.cell_m, blocked)
        same = np.array_equal(filled, self.free)
        return self.room_m if same else distance(filled, self.cell_m)


@dataclass(frozen=True, slots=True)
class Lattice:
    """Square cells along the walls of a grid: yaw: heading of their rows [rad]; corner: centre of
    the first one [m]; shape: number of rows and columns. All from the centre of the grid's first
    cell.

    The skeleton of a hall depends on the angle between its walls and the cells. In a lattice along
    the walls that angle is the same in every map of a building.
    """

    yaw: float
    corner: tuple[float, float]
    shape: tuple[int, int]
    cell_m: float

    @classmethod
    def along(cls, yaw: float, shape: tuple[int, int], cell_m: float, own_m: float) -> Lattice:
        """The lattice in cells of `own_m` over a grid of this shape in cells of `cell_m`."""
        h, w = shape
        corners = np.array([(0, 0), (w - 1, 0), (0, h - 1), (w - 1, h - 1)]) * cell_m
        turn = np.array([0.0, 0.0, yaw])
        box = apply(inverse(turn), corners)
        x, y, _ = compose(turn, np.array([*box.min(axis=0), 0.0])).tolist()
        columns, rows = (np.ceil(np.ptp(box, axis=0) / own_m).astype(int) + 1).tolist()
        return cls(yaw, (x, y), (rows, columns), own_m)

    def out(self, xy: FloatArray) -> FloatArray:
        """Points (k, 2) of the lattice, from its corner, in the frame of the grid."""
        return apply(np.array([*self.corner, self.yaw]), xy)

    def of(self, values: Float32Array, cell_m: float) -> Float32Array:
        """(h, w) values of a grid with cells of `cell_m` interpolated at the centres of the
        lattice's cells; 0 beyond the grid."""
        c, s = np.cos(self.yaw), np.sin(self.yaw)
        turn = np.array([[c, s], [-s, c]]) * self.cell_m / cell_m
        begin = np.array(self.corner[::-1]) / cell_m
        out: Float32Array = ndimage.affine_transform(
            values, turn, begin, self.shape, order=1, mode="constant"
        )
        return out


MOST_POINTS = 1 << 14
"""Points on walls that their direction is taken from."""

PROFILE_M = 0.1
"""Walls are in line if they lie within this."""


def wall_yaw(free: BoolArray, frontier: BoolArray, cell_m: float) -> float:
    """The direction [rad] in [0, pi / 2) of most walls: that in which the fewest lines hold most of
    the edge of the free space.

    frontier: (h, w) free cells beside unknown ones, whose edges are no walls. O(cells).
    """
    edge = free & ~frontier & ~ndimage.binary_erosion(free, np.ones((3, 3), bool))
    at = np.flatnonzero(edge)
    rows, columns = np.unravel_index(at[:: 1 + len(at) // MOST_POINTS], edge.shape)
    cells = np.column_stack([columns, rows])
    # Anywhere in their cells: the rows of cells along a diagonal are no walls.
    within = np.random.default_rng(0).random(cells.shape)
    points = (cells + within) * (cell_m / PROFILE_M)
    if len(points) == 0:
        return 0.0
    best = 0.0
    for step_deg, span in ((1.0, np.arange(90)), (0.1, np.arange(-10, 11))):
        turns = best + np.radians(step_deg * span)
        best = float(turns[int(np.argmax([_in_line(points, turn) for turn in turns]))])
    return best % (0.5 * np.pi)


def _in_line(points: FloatArray, turn: float) -> float:
    """How much points (k, 2) lie in few lines along a direction or across it."""
    c, s = np.cos(turn), np.sin(turn)
    out = 0.0
    for across in (points @ np.array([-s, c]), points @ np.array([c, s])):
        counts = np.bincount((across - across.min()).astype(np.int64))
        out += float(np.sum(counts.astype(np.float64) ** 2))
    return out


def without_specks(free: BoolArray, cell_m: float) -> BoolArray:
    """Free cells (h, w), and specks (`SPECK_M`) among them."""
    return without_islands(free, max(SPECK_M, 2 * cell_m) / cell_m)


ROWS_AT_ONCE = 64
"""Rows of a grid whose distances are worked out together: they stay in the processor's cache."""


def distance(free: BoolArray, cell_m: float) -> Float32Array:
    """(h, w) distance of the centres of cells from those of cells that are not free [m]."""
    return distances(nearest_cells(free), cell_m)


def nearest_cells(free: BoolArray) -> Labels:
    """(2, h, w) row and column of the nearest cell that is not free."""
    found: Labels = ndimage.distance_transform_edt(
        free, return_distances=False, return_indices=True
    )
    return found


def distances(nearest: Labels, cell_m: float) -> Float32Array:
    """(h, w) distance of cells from their nearest ones (2, h, w) [m]; scipy's own distances take
    six times the memory."""
    _, h, w = nearest.shape
    out, columns = np.empty((h, w), np.float32), np.arange(w)
    for top in range(0, h, ROWS_AT_ONCE):
        rows = np.arange(top, min(top + ROWS_AT_ONCE, h))
        y, x = nearest[:, rows[0] : rows[-1] + 1]
        squared = np.square(y - rows[:, None], dtype=np.float64)
        squared += np.square(x - columns, dtype=np.float64)
        out[rows[0] : rows[-1] + 1] = np.sqrt(squared) * cell_m
    return out
