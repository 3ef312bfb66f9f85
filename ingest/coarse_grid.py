"""Coarsening of grids that are too large for thinning at full resolution."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.ndimage import distance_transform_cdt

from ..topology.arrays import BoolArray
from ..topology.run import Grid
from .logs.saved_map import coarser
from .scans.grid import GridSettings, without_islands

MOST_CELLS = 1 << 21
"""Largest number of cells that are thinned, 70 by 70 m at 5 cm, 140 at the 10 cm of scans:
distances from walls take 64 bytes each."""

MOST_PEELED = 1 << 28
"""Thinning visits all cells for every layer of the widest open space. This many visits, in all
variants, take a second."""

ISLAND_M = GridSettings().island_m


class Affordable(NamedTuple):
    """A grid that can be thinned; open_: (h, w) its free cells with islands filled; told: a warning
    if it was coarsened."""

    grid: Grid
    open_: BoolArray
    told: tuple[str, ...]


def affordable(grid: Grid, island_m: float = ISLAND_M) -> Affordable:
    """The grid, with larger cells if there are too many.

    A larger cell is free if all its parts are: walls stay, corridors get narrower by at most a
    cell. island_m: isolated obstacles up to this size are not walls. O(cells).
    """
    factor = math.ceil(math.sqrt(grid.free.size / MOST_CELLS))
    # With a cell around: a grid in one row is three of them.
    while math.prod(2 - (-n // factor) for n in grid.free.shape) > MOST_CELLS:
        factor += 1
    found = coarser(grid, factor)
    open_ = _filled(found, island_m)
    reach = int(distance_transform_cdt(np.pad(open_, 1), "chessboard").max())
    peel = math.ceil((found.free.size * reach / MOST_PEELED) ** (1 / 3))
    if peel > 1:
        factor *= peel
        found = coarser(grid, factor)
        open_ = _filled(found, island_m)
    if factor == 1:
        return Affordable(grid, open_, ())
    height, width = grid.free.shape
    cell = factor * grid.resolution_m
    told = (
        f"the free space of the grid, {width} x {height} cells, is large; cells of {cell:g} m are "
        "taken"
    )
    return Affordable(found, open_, (told,))


def _filled(grid: Grid, island_m: float) -> BoolArray:
    """Its free cells, with islands filled."""
    settings = replace(GridSettings(), island_m=island_m, cell_m=grid.resolution_m)
    return without_islands(grid.free, settings)
