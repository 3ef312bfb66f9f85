"""Layout of many maps on one sheet without overlap, each rotated upright."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..merge.decision_text import short
from ..topology.arrays import FloatArray
from ..topology.se2 import apply, rotation
from .geometry import MIN_SIDE_M

ASPECT = 1.3
"""Target ratio of width to height of a sheet, that of the viewer's view."""

WIDTHS_TRIED = 24
"""Number of sheet widths that are compared."""

SHORTEST_TITLE = 5
"""Titles that would be cut to fewer letters are left out."""

STRAIGHT = 0.35
"""Corridors count as rectilinear if the mean resultant length of their directions mod 90° is at
least this."""


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


def fitting(titles: Sequence[str], room: int) -> str:
    """The first of a title's forms, longest first, that has at most `room` letters; else the last
    one, cut, or "" if the room is less than SHORTEST_TITLE."""
    found = next((title for title in titles if len(title) <= room), None)
    return found or (short(titles[-1], room) if room >= SHORTEST_TITLE else "")


def upright_rad(polylines: Sequence[FloatArray]) -> float:
    """The rotation that draws a map upright: corridors along the axes, wider than high [rad].

    Where the corridors have no common direction mod 90°, the first principal axis becomes
    horizontal.
    """
    points = np.concatenate([np.zeros((0, 2)), *polylines])
    owner = np.arange(len(polylines)).repeat([len(p) for p in polylines])
    steps = np.diff(points, axis=0)[owner[1:] == owner[:-1]]
    length = np.hypot(*steps.T)
    if not length.sum() > 0:
        return 0.0
    # Angles mod 90° are averaged as unit vectors at four times the angle.
    mean = (length * np.exp(4j * np.arctan2(steps[:, 1], steps[:, 0]))).sum() / length.sum()
    if abs(mean) >= STRAIGHT:
        turn = -float(np.angle(mean)) / 4
    else:
        _, vectors = np.linalg.eigh(np.cov((points - points.mean(axis=0)).T))
        x, y = vectors[:, -1] * (1 if vectors[0, -1] >= 0 else -1)
        turn = -float(np.arctan2(y, x))
    width, height = np.ptp(points @ rotation(turn).T, axis=0)
    return turn if width >= height else turn + np.pi / 2


def arrange(
    point_sets: Sequence[FloatArray], turns_rad: Sequence[float], margin_m: float
) -> list[Cell]:
    """A cell for each map from its points (n, 2) and rotation, in the given order.

    Cells are laid in rows, left to right, the top row first (y points up); the row width is chosen
    so that a sheet of ASPECT shows them largest. O(points).
    """
    lows, sizes = [], []
    for points, turn in zip(point_sets, turns_rad, strict=True):
        turned = apply(np.array([0.0, 0.0, turn]), points) if len(points) else np.zeros((1, 2))
        low, high = turned.min(axis=0), turned.max(axis=0)
        spare = np.maximum(MIN_SIDE_M - (high - low), 0.0) / 2
        lows.append(low - spare)
        sizes.append(high - low + 2 * spare + 2 * margin_m)
    cells = []
    for corner, low, size, turn in zip(_shelves(sizes), lows, sizes, turns_rad, strict=True):
        shift = corner + margin_m - low
        cells.append(Cell(np.array([*shift, turn]), corner, corner + size))
    return cells


def _shelves(sizes: Sequence[FloatArray]) -> list[FloatArray]:
    """The low corner of each box, laid in top-aligned rows, for the row width that gives the
    largest scale."""
    if not sizes:
        return []
    widest = max(float(w) for w, _ in sizes)
    widths = np.geomspace(widest, sum(float(w) for w, _ in sizes), WIDTHS_TRIED)
    laid = [_rows(sizes, float(width)) for width in widths]
    best = min(range(len(laid)), key=lambda i: (max(laid[i][1] / ASPECT, laid[i][2]), i))
    return laid[best][0]


def _rows(sizes: Sequence[FloatArray], width: float) -> tuple[list[FloatArray], float, float]:
    """Low corners of the boxes in rows of at most `width`, and the sheet's width and height."""
    corners = []
    x = top = row = used = 0.0
    for w, h in sizes:
        if x > 0 and x + w > width * (1 + 1e-9):
            x, top, row = 0.0, top - row, 0.0
        corners.append(np.array([x, top - h]))
        x, row = x + w, max(row, h)
        used = max(used, x)
    return corners, used, row - top


def sheet_margin_m(point_sets: Sequence[FloatArray]) -> float:
    """The cells' margin [m]: a share of the largest map's extent."""
    extents = [float(np.ptp(points, axis=0).max()) for points in point_sets if len(points)]
    return 0.08 * max([*extents, 2 * MIN_SIDE_M])
