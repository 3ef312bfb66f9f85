"""Layout of many maps on one sheet without overlap, each rotated upright."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..topology.arrays import FloatArray
from ..topology.se2 import apply, rotation
from .geometry import MARGIN, MIN_SIDE_M

ASPECT = 1.3
"""Target ratio of width to height of a sheet, that of the viewer's view."""


@dataclass(frozen=True, slots=True, eq=False)
class Cell:
    """A map's place on a sheet.

    T_sheet_map: (3,) pose of the map's frame; low, high: (2,) corners of the cell [m], with its
    margin.
    """

    T_sheet_map: FloatArray
    low: FloatArray
    high: FloatArray


def corners_of(cells: Sequence[Cell]) -> FloatArray:
    """(2 n, 2) the low and the high corner of every cell."""
    return np.array([(cell.low, cell.high) for cell in cells]).reshape(-1, 2)


def outline(low: ArrayLike, high: ArrayLike) -> FloatArray:
    """(5, 2) the closed outline of the rectangle between two corners."""
    (x0, y0), (x1, y1) = np.asarray(low, np.float64), np.asarray(high, np.float64)
    return np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1), (x0, y0)])


def upright_rad(polylines: Sequence[FloatArray]) -> float:
    """The rotation that draws a map upright: corridors along the axes, wider than high [rad]."""
    points = np.concatenate([np.zeros((0, 2)), *polylines])
    owner = np.arange(len(polylines)).repeat([len(p) for p in polylines])
    x, y = np.diff(points, axis=0)[owner[1:] == owner[:-1]].T
    # Angles mod 90° are averaged as unit vectors at four times the angle, by length.
    turn = -float(np.angle((np.hypot(x, y) * np.exp(4j * np.arctan2(y, x))).sum())) / 4
    if not len(points):
        return turn
    width, height = np.ptp(points @ rotation(turn).T, axis=0)
    return turn if width >= height else turn + np.pi / 2


def arrange(point_sets: Sequence[FloatArray], turns_rad: Sequence[float]) -> list[Cell]:
    """A cell for each map from its points (n, 2) and rotation, in the given order.

    Cells are laid in rows, left to right, the top row first (y points up). Of several each has room
    for a title. O(points).
    """
    corners = []
    for points, turn in zip(point_sets, turns_rad, strict=True):
        upright = apply(np.array([0.0, 0.0, turn]), points) if len(points) else np.zeros((1, 2))
        low, high = upright.min(axis=0), upright.max(axis=0)
        spare = np.maximum(MIN_SIDE_M - (high - low), 0.0) / 2
        corners.append((low - spare, high + spare))
    usual = float(np.median([np.ptp(pair, axis=0).max() for pair in corners] or [0.0]))
    margin = (1 if len(corners) == 1 else 3) * MARGIN * usual
    sizes = [high - low + 2 * margin for low, high in corners]
    cells = []
    for at, (low, _), size, turn in zip(_shelves(sizes), corners, sizes, turns_rad, strict=True):
        cells.append(Cell(np.array([*(at + margin - low), turn]), at, at + size))
    return cells


def _shelves(sizes: Sequence[FloatArray]) -> list[FloatArray]:
    """The low corner of each box, laid in top-aligned rows as wide as makes a sheet of ASPECT, and
    half a box more, as rows end ragged."""
    widest = max((float(w) for w, _ in sizes), default=0.0)
    area = sum(float(w * h) for w, h in sizes)
    width = max(widest, np.sqrt(ASPECT * area) + widest / 2)
    corners = []
    x = top = row = 0.0
    for w, h in sizes:
        if x > 0 and x + w > width:
            x, top, row = 0.0, top - row, 0.0
        corners.append(np.array([x, top - h]))
        x, row = x + w, max(row, h)
    return corners
