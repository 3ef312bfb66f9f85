"""Ways along corridors that a robot can drive, and their lengths."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from ...topology.arrays import BoolArray, Float32Array, FloatArray, IntArray
from ...topology.polyline import densely, simplify, way_of
from .grid import Labels, labelled
from .open_space import nearest_cells

SMOOTH_M = 0.5
"""Length over which the staircase steps of skeletons are smoothed; corridors are straight over
it."""

TOLERANCES_M = (0.08, 0.02)
"""Tolerance of simplified paths, as for the corridors of runs (`mapbuilding`), and the one taken
where that comes too near to a wall."""

MIDDLE = 4.0
"""Price of a metre beside an obstacle, less that of one in the middle of a way as wide as two
robots: ways round obstacles keep off them, where there is room."""


class Way(NamedTuple):
    """A way that can be driven: path: (k, 2) [m], k >= 2; length_m: of the way before it was
    simplified to this."""

    path: FloatArray
    length_m: float


@dataclass(frozen=True, slots=True, eq=False)
class Drivable:
    """Where a robot can drive: cells: (h, w), all connected; nearest: (2, h, w) row and column of
    that nearest to each; all_m: (h, w) distance of obstacles [m]; radius_m: of the robot."""

    cells: BoolArray
    nearest: Labels
    all_m: Float32Array
    radius_m: float
    cell_m: float

    @classmethod
    def of(
        cls, room_m: Float32Array, all_m: Float32Array, radius_m: float, cell_m: float
    ) -> Drivable:
        """The largest connected part of cells whose centres are as far from obstacles as a robot's
        is, and not beside specks. Empty if it fits nowhere. room_m, all_m: see `OpenSpace`."""
        fits = (room_m > radius_m) & (all_m > cell_m)
        label, _ = labelled(fits)
        size = np.bincount(label.ravel())
        size[0] = 0
        cells = label == size.argmax() if size.any() else fits
        return cls(cells, nearest_cells(~cells), all_m, radius_m, cell_m)

    def price(self, box: tuple[slice, slice]) -> FloatArray:
        """(h, w) price of a metre in the cells of a box."""
        near = 1 - self.all_m[box].astype(np.float64) / (2 * self.radius_m)
        return np.asarray(1 + MIDDLE * np.clip(near, 0, 1))

    def at(self, xy: FloatArray) -> tuple[IntArray, IntArray]:
        """Rows and columns of the cells of points (k, 2), those of the border for points beyond."""
        columns, rows = np.rint(xy.T / self.cell_m).astype(np.int64)
        h, w = self.cells.shape
        return np.clip(rows, 0, h - 1), np.clip(columns, 0, w - 1)

    def moved(self, xy: FloatArray) -> FloatArray:
        """(2,) the point itself if a robot can be there, or nowhere, else the nearest one where it
        can."""
        row, column = (at.item() for at in self.at(xy[None]))
        nearest = self.nearest[:, row, column]
        if self.cells[row, column] or not self.cells[tuple(nearest)]:
            return xy
        return np.asarray(nearest[::-1] * self.cell_m, np.float64)

    def holds(self, path: FloatArray) -> bool:
        """Whether a robot can drive straight from point to point of a path (k, 2)."""
        points = densely(path, 0.5 * self.cell_m)
        return bool(self.cells[self.at(points)].all())


def drivable_way(raw: FloatArray, drivable: Drivable, reach_m: FloatArray) -> Way | None:
    """The way along a line of the skeleton; None if a robot cannot drive it.

    raw: (k, 2) the line, from place to place; reach_m: (k,) distance from each of its points
    within which a way counts as one along it. Where an obstacle stands in the line, the way is the
    cheapest one round it.
    """
    for path in (_smoothed(raw, drivable.cell_m), raw):
        if drivable.holds(path):
            return _simplified(path, drivable)
    found = _round_obstacles(raw, drivable, reach_m)
    if found is None:
        return None
    smooth = _smoothed(found, drivable.cell_m)
    return _simplified(smooth if drivable.holds(smooth) else found, drivable)


def _simplified(path: FloatArray, drivable: Drivable) -> Way:
    length_m = float(way_of(path)[-1])
    for tolerance_m in TOLERANCES_M:
        simple = simplify(path, tolerance_m)
        if drivable.holds(simple):
            return Way(simple, length_m)
    return Way(path, length_m)


def _smoothed(path: FloatArray, cell_m: float) -> FloatArray:
    """A path of neighbouring cells without their steps; its ends stay."""
    cells = max(1, round(SMOOTH_M / cell_m))
    smooth = ndimage.uniform_filter1d(path, cells, axis=0, mode="nearest")
    smooth = np.concatenate([path[:1], smooth[1:-1], path[-1:]])
    step = np.hypot(*np.diff(smooth, axis=0).T)
    kept = smooth[np.concatenate([[True], step > 1e-9])]
    return kept if len(kept) > 1 else path


def _round_obstacles(raw: FloatArray, drivable: Drivable, reach_m: FloatArray) -> FloatArray | None:
    """The cheapest way from one end of a line to the other, within its reach; None if there is
    none."""
    rows, columns = drivable.at(raw)
    most = int(reach_m.max() / drivable.cell_m) + 2
    top, left = max(int(rows.min()) - most, 0), max(int(columns.min()) - most, 0)
    box = np.s_[top : int(rows.max()) + most + 1, left : int(columns.max()) + most + 1]
    cells = drivable.cells[box]
    line, reach = np.ones(cells.shape, bool), np.zeros(cells.shape)
    line[rows - top, columns - left] = False
    np.maximum.at(reach, (rows - top, columns - left), reach_m)
    away, (r, c) = ndimage.distance_transform_edt(line, return_indices=True)
    within = np.asarray(away * drivable.cell_m <= reach[r, c] + drivable.cell_m)
    found = cheapest(raw[[0, -1]], drivable, within, (top, left))
    if found is None:
        return None
    path = found[:, ::-1] * drivable.cell_m
    return np.concatenate([raw[:1], path[1:-1], raw[-1:]])


def cheapest(
    ends: FloatArray, drivable: Drivable, within: BoolArray, corner: tuple[int, int]
) -> IntArray | None:
    """Cells (k, 2), row and column, of the cheapest way between two points (2, 2) through marked
    cells, of which the first one is at `corner`; None if there is none."""
    from skimage.graph import MCP_Geometric

    h, w = within.shape
    cells = np.stack(drivable.at(ends), axis=1) - np.array(corner)
    begin, end = (tuple(cell) for cell in cells.tolist())
    inside = ((cells >= 0) & (cells < np.array([h, w]))).all()
    box = np.s_[corner[0] : corner[0] + h, corner[1] : corner[1] + w]
    within = within & drivable.cells[box]
    if begin == end or not inside or not (within[begin] and within[end]):
        return None
    search = MCP_Geometric(np.where(within, drivable.price(box), -1.0))
    costs, _ = search.find_costs([begin], [end])
    if not np.isfinite(costs[end]):
        return None
    return np.asarray(np.array(search.traceback(end)) + np.array(corner), np.int64)
