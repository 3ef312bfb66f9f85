"""Grids in the cells that they are mapped in, of about one size whatever they were saved in."""

from __future__ import annotations

import math
from typing import NamedTuple

from ..topology.run import Grid
from .logs.saved_map import coarser

CELL_M = 0.05
"""Cells that finer grids are joined to: most are saved in these. A robot's radius has five; finer
ones show more of the walls' roughness, which is no part of the plan."""

MOST_CELLS = 1 << 22
"""Largest number of cells whose distance from walls is measured, 100 by 100 m at 5 cm."""


class Lattice(NamedTuple):
    """A grid in the cells that it is mapped in; told: a warning if they are larger than usual."""

    grid: Grid
    told: tuple[str, ...]


def lattice(grid: Grid) -> Lattice:
    """The grid in cells of about `CELL_M`, or in larger ones if there are too many.

    A larger cell is free if all its parts are: walls stay, corridors get narrower by at most a
    cell. O(cells).
    """
    factor = max(1, int(CELL_M / grid.resolution_m + 1e-6))
    # With a cell around: a grid in one row is three of them.
    while math.prod(2 - (-n // factor) for n in grid.free.shape) > MOST_CELLS:
        factor += 1
    found = coarser(grid, factor)
    if found.resolution_m <= CELL_M * (1 + 1e-6) or factor == 1:
        return Lattice(found, ())
    height, width = grid.free.shape
    told = (
        f"the grid, {width} x {height} cells, is large; cells of {found.resolution_m:g} m are taken"
    )
    return Lattice(found, (told,))
