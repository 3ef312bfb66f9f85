"""The open space of a saved grid: where its skeleton lies, and where a robot can drive."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from ...topology.arrays import BoolArray, FloatArray, IntArray
from ...topology.se2 import apply, compose, inverse
from .grid import GridSettings, without_islands
from .skeleton_lines import labelled

SPECK_M = 0.1
"""Isolated obstacles up to this size, or up to two cells, are noise of the mapper as often as
things: they are driven round, at a distance if there is room, and are no obstacles otherwise."""


@dataclass(frozen=True, slots=True, eq=False)
class OpenSpace:
    """A grid (h, w), with a border of walls, as a robot sees it.

    all_m: distance of the centres of cells from all that is not free [m]; room_m: from all but
    specks; clearance_m: from walls, where small obstacles are none; cell_m: size of a cell.
    """

    clearance_m: FloatArray
    room_m: FloatArray
    all_m: FloatArray
    cell_m: float

    def drivable(self, radius_m: float) -> BoolArray:
        """Cells whose centres are as far from obstacles as a robot's is, and not beside specks."""
        return np.asarray((self.room_m > radius_m) & (self.all_m > self.cell_m))

    def on(self, lattice: Lattice) -> OpenSpace:
        """The same in the cells of a lattice."""
        return OpenSpace(
            lattice.of(self.clearance_m, self.cell_m),
            lattice.of(self.room_m, self.cell_m),
            lattice.of(self.all_m, self.cell_m),
            lattice.cell_m,
        )


@dataclass(frozen=True, slots=True)
class Lattice:
    """Square cells along the walls of a grid: yaw: heading of their rows [rad]; corner: centre of
    the first one [m]; shape: number of rows and columns. All from the centre of the grid's first
    cell.

    Where a skeleton lies in a hall depends on how its walls are turned against the cells. Against
    those of a lattice along the walls they are turned alike in every map of a building.
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

    def of(self, values: FloatArray | BoolArray, cell_m: float) -> FloatArray:
        """(h, w) values of a grid with cells of `cell_m` at the centres of the lattice's cells:
        interpolated, or those of the nearest cell for marks. Beyond the grid they are 0."""
        c, s = np.cos(self.yaw), np.sin(self.yaw)
        turn = np.array([[c, s], [-s, c]]) * self.cell_m / cell_m
        begin = np.array(self.corner[::-1]) / cell_m
        marks = values.dtype == bool
        out = ndimage.affine_transform(
            values.astype(np.uint8) if marks else values,
            turn,
            begin,
            self.shape,
            order=0 if marks else 1,
            mode="constant",
        )
        return out.astype(bool) if marks else np.asarray(out, np.float64)


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
    cells = np.argwhere(edge)[:, ::-1]
    cells = cells[:: 1 + len(cells) // MOST_POINTS]
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


def open_space(free: BoolArray, cell_m: float, radius_m: float, island_m: float) -> OpenSpace:
    """The open space of free cells (h, w) whose border is not free.

    radius_m: of the robot. What it does not fit between is one obstacle; those up to `island_m`
    which touch no border are driven round, but make no junctions: furniture moves. O(h w).
    """
    solid = without_specks(free, cell_m)
    everything = _distance(free, cell_m)
    room = everything if np.array_equal(solid, free) else _distance(solid, cell_m)
    filled = _filled(solid, room <= radius_m, island_m / cell_m)
    clearance = room if np.array_equal(filled, solid) else _distance(filled, cell_m)
    return OpenSpace(clearance, room, everything, cell_m)


def without_specks(free: BoolArray, cell_m: float) -> BoolArray:
    """Free cells (h, w), and specks (`SPECK_M`) among them."""
    specks = GridSettings(cell_m=cell_m, island_m=max(SPECK_M, 2 * cell_m))
    return without_islands(free, specks)


def _distance(free: BoolArray, cell_m: float) -> FloatArray:
    """(h, w) distance of the centres of cells from those of cells that are not free [m]."""
    away = ndimage.distance_transform_edt(free)
    return np.asarray(away * cell_m, np.float64)


def _filled(free: BoolArray, blocked: BoolArray, most_cells: float) -> BoolArray:
    """The free cells, and those of obstacles up to so many cells wide. blocked: cells that a robot
    cannot be in; what they connect is one obstacle."""
    label, count = labelled(blocked)
    rows, columns = np.nonzero(~free)
    owner = label[rows, columns].astype(np.int64)
    small = np.maximum(_extent(rows, owner, count), _extent(columns, owner, count)) <= most_cells
    small[np.unique(np.concatenate([label[0], label[-1], label[:, 0], label[:, -1]]))] = False
    out = free.copy()
    out[rows, columns] = small[owner]
    return out


def _extent(at: IntArray, owner: IntArray, count: int) -> IntArray:
    """(count + 1,) number of rows or columns that each obstacle spans."""
    low, high = np.full(count + 1, np.iinfo(np.int64).max // 2), np.zeros(count + 1, np.int64)
    np.minimum.at(low, owner, at)
    np.maximum.at(high, owner, at)
    return np.asarray(high - low + 1)
