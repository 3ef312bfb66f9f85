"""A skeleton as numbered forks and the lines between them, before simplification."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from ...topology.arrays import BoolArray, Float32Array, FloatArray, IntArray
from ...topology.connected import connected
from ...topology.errors import DataError
from .grid import Labels

SHORTEST_CELLS = 5.0
"""Least mean number of cells per line: floors of 6,000 rooms, in the largest cells that they are
mapped in, have 6, other buildings 8 to 60; noise of single cells, of any density, 1.4 to 4. Shorter
lines are not resolved: three of their cells are the forks'."""

FEW_LINES = 1 << 13
"""So few lines are traced in any case: it takes less than a second."""

MOST_LINES = 1 << 14
"""A floor of 4,700 rooms has as many, which takes about three seconds."""

MOST_CELLS = 64 * MOST_LINES
"""Cells of a skeleton: lines of buildings have up to 60 each. That of a checkerboard fills half of
the grid."""


@dataclass(frozen=True, slots=True, eq=False)
class Lines:
    """Forks and lines of a skeleton, each numbered from 1 on.

    cells: (c, 2) row and column of all cells of lines, one line after another, each in the order
    along it; line: (c,) line of each; fork_xy: (f + 1, 2) centre of each fork, from that of the
    first cell [m]; fork_clearance_m: (f + 1,) distance of the nearest wall; fork_cells: (f + 1,)
    number of cells; length_m: (l + 1,) of each line, including its ends in the forks; ends:
    (l + 1, 2) fork at the first cell of each line, and at the last one, 0 for none; border: lines
    that run into the border of the grid; clearance_m: (h, w) distance of all cells from walls;
    cell_m: size of a cell.
    """

    cells: IntArray
    line: Labels
    fork_xy: FloatArray
    fork_clearance_m: FloatArray
    fork_cells: FloatArray
    length_m: FloatArray
    ends: IntArray
    border: frozenset[int]
    clearance_m: Float32Array | FloatArray
    cell_m: float


def lines_of(
    skeleton: BoolArray, clearance_m: Float32Array | FloatArray, cell_m: float, border: BoolArray
) -> Lines:
    """The forks and lines of a skeleton (h, w); clearance_m: (h, w) distance from walls; border:
    (h, w) cells at the end of the grid, where corridors may go on.

    Raises DataError on noise, and if there are too many. O(h w).
    """
    count = int(np.count_nonzero(skeleton))
    if count > MOST_CELLS:
        raise DataError(
            f"{count:,} cells of the free space are the middle of a way, more than the "
            f"{MOST_CELLS:,} that are traced: this is noise, or has to be cut into parts"
        )
    cells = np.argwhere(skeleton)
    pairs, steps = _neighbours(cells)
    # A cell of a line has at most two neighbours.
    fork = np.bincount(pairs.ravel(), minlength=len(cells)) > 2
    alike = pairs[:, fork[pairs[0]] == fork[pairs[1]]]
    part = connected(alike[0], alike[1], len(cells))
    number, line = _numbered(part, fork), _numbered(part, ~fork)
    forks, lines = int(number.max(initial=0)), int(line.max(initial=0))
    _check(int(np.count_nonzero(line)), lines)
    order, length, ends = _traced(cells, line, number, (pairs, steps))
    at_border = np.unique(line[border[tuple(cells.T)]])
    rows, columns = cells[fork].T
    number = number[fork]
    size = np.bincount(number, minlength=forks + 1)
    safe = np.maximum(size, 1)
    x = np.bincount(number, columns, forks + 1) / safe * cell_m
    y = np.bincount(number, rows, forks + 1) / safe * cell_m
    wide = np.zeros(forks + 1)
    np.maximum.at(wide, number, clearance_m[rows, columns])
    return Lines(
        cells[order],
        line[order],
        np.stack([x, y], axis=1),
        wide,
        size.astype(np.float64),
        length * cell_m,
        ends,
        frozenset(at_border[at_border > 0].tolist()),
        clearance_m,
        cell_m,
    )


def _numbered(part: IntArray, marked: BoolArray) -> Labels:
    """(c,) number of each marked cell's part among those of marked cells, from 1 on; 0 of
    others."""
    out = np.zeros(len(part), np.int32)
    out[marked] = np.unique(part[marked], return_inverse=True)[1] + 1
    return out


def _traced(
    cells: IntArray, line: Labels, fork: Labels, beside: tuple[Labels, FloatArray]
) -> tuple[IntArray, FloatArray, IntArray]:
    """The rows of the cells (c, 2) of lines, one line after another, each from one end to the
    other; length (l + 1,) of every line in cells, including its ends in the forks; fork (l + 1, 2)
    at its first cell, and at its last one, 0 for none. line, fork: (c,) of each cell; beside: see
    `_neighbours`. O(c log c).
    """
    (pairs, steps), lines = beside, int(line.max(initial=0))
    on_line = line[pairs] > 0
    length = np.asarray(np.bincount(line[pairs].max(axis=0), steps, lines + 1), np.float64)
    length[0] = 0.0
    along = pairs[:, on_line.all(axis=0)]
    touching = pairs[:, on_line[0] > on_line[1]], pairs[::-1, on_line[1] > on_line[0]]
    # A line begins at a cell with one neighbour or none; a ring anywhere.
    degree = np.bincount(along.ravel(), minlength=len(cells))
    first = np.lexsort((degree, line))[np.searchsorted(np.sort(line), np.arange(1, lines + 1))]
    graph = coo_array((np.ones(len(along.T)), along), shape=(len(cells),) * 2).tocsr()
    away = dijkstra(graph, False, first, unweighted=True, min_only=True)
    order = np.lexsort((away, line))
    # Every line touches forks at most twice, by its ends; one of up to two cells is no ring.
    cell, by = np.hstack(touching)
    far = away[cell] > 0
    rows = np.lexsort((fork[by], far, line[cell]))
    cell, by, far = cell[rows], fork[by[rows]], far[rows]
    again = np.diff(line[cell], prepend=0) == 0
    near = np.abs(np.diff(cells[cell], axis=0, prepend=-2)).max(axis=1) <= 1
    new = ~(again & near & (np.diff(by, prepend=0) == 0))
    ends = np.zeros((lines + 1, 2), np.int64)
    ends[line[cell[new]], (far | again)[new].astype(np.int64)] = by[new]
    return order[line[order] > 0], length, ends


def _neighbours(cells: IntArray) -> tuple[Labels, FloatArray]:
    """(2, p) the numbers of adjacent cells of a list (c, 2), every pair once, and (p,) their
    distances in cells."""
    number = np.full(cells.max(axis=0, initial=0) + 3, -1, np.int32)
    rows, columns = (cells.T + 1).astype(np.int32)
    number[rows, columns] = own = np.arange(len(cells), dtype=np.int32)
    pairs, steps = [], []
    for dy, dx in ((0, 1), (1, 0), (1, 1), (1, -1)):
        beside = number[rows + dy, columns + dx]
        there = beside >= 0
        pairs.append(np.stack([own[there], beside[there]]))
        steps.append(np.full(pairs[-1].shape[1], np.hypot(dy, dx)))
    return np.hstack(pairs), np.concatenate(steps)


def _check(cells: int, lines: int) -> None:
    """Raise DataError if the number of lines, or of cells per line, is not that of a building."""
    if lines > FEW_LINES and cells < SHORTEST_CELLS * lines:
        raise DataError(
            f"the free space falls into {lines} ways of {cells / lines:.1f} cells on average: "
            "this is noise, and no building"
        )
    if lines > MOST_LINES:
        raise DataError(
            f"the free space falls into {lines} ways, more than the {MOST_LINES} that are traced; "
            "cut the grid into parts"
        )
