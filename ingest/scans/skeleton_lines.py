"""A skeleton as numbered forks and the lines between them, before simplification."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from ...topology.arrays import BoolArray, Float32Array, FloatArray, IntArray
from ...topology.errors import DataError

Labels = NDArray[np.int32]

SHORTEST_CELLS = 5.0
"""Least mean number of cells per line: floors of 6,000 rooms, in the largest cells that they are
mapped in, have 6, other buildings 8 to 60; noise of single cells, of any density, 1.4 to 4. Shorter
lines are not resolved: three of their cells are the forks'."""

FEW_LINES = 1 << 13
"""So few lines are traced in any case: it takes less than a second."""

MOST_LINES = 1 << 14
"""A floor of 4,700 rooms has as many, which takes about three seconds."""

_AROUND = np.ones((3, 3), np.int8)


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
    skeleton: BoolArray,
    clearance_m: Float32Array | FloatArray,
    cell_m: float,
    border: BoolArray,
) -> Lines:
    """The forks and lines of a skeleton (h, w); clearance_m: (h, w) distance from walls; border:
    (h, w) cells at the end of the grid, where corridors may go on.

    Raises DataError on noise, and if there are too many. O(h w).
    """
    # A cell of a line has at most two neighbours.
    fork = skeleton & (ndimage.correlate(skeleton.view(np.int8), _AROUND, mode="constant") > 3)
    fork_label, forks = labelled(fork)
    line_label, lines = labelled(skeleton & ~fork)
    cells = np.argwhere(skeleton)
    line, number = (label[cells[:, 0], cells[:, 1]] for label in (line_label, fork_label))
    _check(int(np.count_nonzero(line)), lines)
    order, length, ends = _traced(cells, line, number, lines)
    rows, columns = cells[number > 0].T
    number = number[number > 0]
    size = np.bincount(number, minlength=forks + 1)
    safe = np.maximum(size, 1)
    x = np.bincount(number, columns, forks + 1) / safe * cell_m
    y = np.bincount(number, rows, forks + 1) / safe * cell_m
    wide = np.zeros(forks + 1)
    np.maximum.at(wide, number, clearance_m[rows, columns])
    at_border = np.unique(line_label[border])
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


def _traced(
    cells: IntArray, line: Labels, fork: Labels, lines: int
) -> tuple[IntArray, FloatArray, IntArray]:
    """The rows of the cells (c, 2) of lines, one line after another, each from one end to the
    other; length (l + 1,) of every line in cells, including its ends in the forks; fork (l + 1, 2)
    at its first cell, and at its last one, 0 for none. line, fork: (c,) of each cell. O(c log c).
    """
    length, along, touching = np.zeros(lines + 1), [], []
    for one, other, step in _neighbours(cells):
        length += np.bincount(np.maximum(line[one], line[other]), minlength=lines + 1) * step
        pair, on_line = np.stack([one, other]), np.stack([line[one], line[other]]) > 0
        along.append(pair[:, on_line.all(axis=0)])
        touching += [pair[:, on_line[0] > on_line[1]], pair[::-1, on_line[1] > on_line[0]]]
    length[0] = 0.0
    one, other = np.hstack(along)
    # A line begins at a cell with one neighbour or none; a ring anywhere.
    beside = np.bincount(np.hstack(along).ravel(), minlength=len(cells))
    first = np.lexsort((beside, line))[np.searchsorted(np.sort(line), np.arange(1, lines + 1))]
    graph = coo_array((np.ones(len(one)), (one, other)), shape=(len(cells),) * 2).tocsr()
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


def _neighbours(cells: IntArray) -> Iterator[tuple[IntArray, IntArray, float]]:
    """The numbers of adjacent cells of a list (c, 2), every pair once, by direction; and their
    distance in cells."""
    number = np.full(cells.max(axis=0, initial=0) + 3, -1, np.int32)
    rows, columns = cells.T + 1
    number[rows, columns] = own = np.arange(len(cells))
    for dy, dx in ((0, 1), (1, 0), (1, 1), (1, -1)):
        beside = number[rows + dy, columns + dx]
        there = beside >= 0
        yield own[there], beside[there].astype(np.int64), float(np.hypot(dy, dx))


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


def labelled(mask: BoolArray) -> tuple[Labels, int]:
    """Connected components of cells (8-connectivity), numbered from 1 on, and their number."""
    label, count = ndimage.label(mask, _AROUND)
    return np.asarray(label, np.int32), int(count)
