"""A skeleton as numbered forks and the lines between them, before simplification."""

from __future__ import annotations

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
    along it; clearance_m: (c,) distance of the nearest wall; line: (c,) line of each; fork_xy:
    (f + 1, 2) centre of each fork, from that of the first cell [m]; fork_clearance_m: (f + 1,);
    fork_cells: (f + 1,) number of cells; length_m: (l + 1,) of each line, including its ends in the
    forks; ends: (l + 1, 2) fork at the first cell of each line, and at the last one, 0 for none;
    border: lines that run into the border of the grid; cell_m: size of a cell.
    """

    cells: IntArray
    clearance_m: FloatArray
    line: Labels
    fork_xy: FloatArray
    fork_clearance_m: FloatArray
    fork_cells: FloatArray
    length_m: FloatArray
    ends: IntArray
    border: frozenset[int]
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
    fork = skeleton & (_around(skeleton) > 3)
    fork_label, forks = labelled(fork)
    line = skeleton & ~fork
    line_label, lines = labelled(line)
    cells = np.argwhere(line)
    _check(len(cells), lines)
    cells, owner = _ordered(cells, line_label, lines)
    rows, columns = np.nonzero(fork)
    number = fork_label[rows, columns]
    size = np.bincount(number, minlength=forks + 1)
    safe = np.maximum(size, 1)
    x = np.bincount(number, columns, forks + 1) / safe * cell_m
    y = np.bincount(number, rows, forks + 1) / safe * cell_m
    wide = np.zeros(forks + 1)
    np.maximum.at(wide, number, clearance_m[rows, columns])
    ends = np.unique(line_label[border])
    return Lines(
        cells,
        np.asarray(clearance_m[cells[:, 0], cells[:, 1]], np.float64),
        owner,
        np.stack([x, y], axis=1),
        wide,
        size.astype(np.float64),
        _lengths(skeleton, line_label, lines) * cell_m,
        _ends(fork_label, line_label, cells, owner),
        frozenset(ends[ends > 0].tolist()),
        cell_m,
    )


def _ordered(cells: IntArray, label: Labels, lines: int) -> tuple[IntArray, Labels]:
    """The cells (c, 2) of lines, one line after another, each from one end to the other; the line
    of each. O(c log c)."""
    if len(cells) == 0:
        return cells, np.zeros(0, np.int32)
    h, w = label.shape
    number = np.full((h + 2, w + 2), -1, np.int32)
    rows, columns = cells.T + 1
    own = number[rows, columns] = np.arange(len(cells), dtype=np.int32)
    parts = []
    for dy, dx in ((0, 1), (1, 0), (1, 1), (1, -1)):
        beside_it = number[rows + dy, columns + dx]
        there = beside_it >= 0
        parts.append(np.stack([own[there], beside_it[there]]))
    one, other = np.hstack(parts)
    del number  # it takes 4 bytes a cell
    beside = np.bincount(one, minlength=len(cells)) + np.bincount(other, minlength=len(cells))
    owner = label[cells[:, 0], cells[:, 1]]
    # A line begins at a cell with one neighbour or none; a ring anywhere.
    first = np.lexsort((beside, owner))[np.searchsorted(np.sort(owner), np.arange(1, lines + 1))]
    graph = coo_array((np.ones(len(one)), (one, other)), shape=(len(cells),) * 2).tocsr()
    away = dijkstra(graph, False, first, unweighted=True, min_only=True)
    order = np.lexsort((away, owner))
    return cells[order], owner[order]


def _around(mask: BoolArray) -> NDArray[np.int8]:
    """(h, w) number of cells in a mask among each cell and its eight neighbours."""
    h, w = mask.shape
    padded = np.zeros((h + 2, w + 2), np.int8)
    padded[1:-1, 1:-1] = mask
    three = padded[:, :-2] + padded[:, 1:-1] + padded[:, 2:]
    out: NDArray[np.int8] = three[:-2] + three[1:-1] + three[2:]
    return out


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


def _lengths(skeleton: BoolArray, label: Labels, count: int) -> FloatArray:
    """(count + 1,) length of every line in cells, including its ends in the forks."""
    out = np.zeros(count + 1)
    s = skeleton
    for a, b, step in (
        (np.s_[:, :-1], np.s_[:, 1:], 1.0),
        (np.s_[:-1, :], np.s_[1:, :], 1.0),
        (np.s_[:-1, :-1], np.s_[1:, 1:], np.sqrt(2)),
        (np.s_[:-1, 1:], np.s_[1:, :-1], np.sqrt(2)),
    ):
        both = s[a] & s[b]
        la, lb = label[a][both], label[b][both]
        out += np.bincount(np.maximum(la, lb), minlength=count + 1) * step
    out[0] = 0.0
    return out


def _ends(fork: Labels, line: Labels, cells: IntArray, owner: Labels) -> IntArray:
    """(l + 1, 2) fork at the first cell of every line, and at the last one; 0 for none."""
    touching = _touching(fork, line)
    out = np.zeros((int(owner.max(initial=0)) + 1, 2), np.int64)
    bounds = np.searchsorted(owner, np.arange(len(out) + 1))
    around = np.pad(fork, 1)
    for number, forks in touching.items():
        row, column = cells[bounds[number]].tolist()
        begin = around[row : row + 3, column : column + 3]
        row, column = cells[bounds[number + 1] - 1].tolist()
        end = around[row : row + 3, column : column + 3]
        if len(forks) == 1:
            alone = (begin == forks[0]).any()
            out[number] = (forks[0], 0) if alone else (0, forks[0])
        else:
            straight = (begin == forks[0]).any() and (end == forks[1]).any()
            out[number] = forks if straight else forks[::-1]
    return out


def _touching(fork: Labels, line: Labels) -> dict[int, list[int]]:
    """The forks that each line touches, at most two: one twice if it touches it with both ends."""
    out: dict[int, list[int]] = {}
    ends_line, ends_fork, cells = [], [], []
    width = fork.shape[1]
    rows, columns = np.nonzero(fork)
    number, padded = fork[rows, columns], np.pad(line, 1)
    for dy in (-1, 0, 1):
        for dx in (-1, 0, 1):
            lines = padded[rows + 1 + dy, columns + 1 + dx]
            there = lines > 0
            ends_line.append(lines[there])
            ends_fork.append(number[there])
            cells.append(((rows + dy) * width + columns + dx)[there])
    # Sorted by (line, fork, cell), as one number each, which is faster.
    shape = int(line.max(initial=0)) + 1, int(fork.max(initial=0)) + 1, line.size
    every = (np.concatenate(c) for c in (ends_line, ends_fork, cells))
    found = np.unravel_index(np.unique(np.ravel_multi_index(tuple(every), shape)), shape)
    last: tuple[int, int, int] | None = None
    for row, by, cell in zip(*(column.tolist() for column in found), strict=True):
        beside = last is not None and last[:2] == (row, by) and _adjacent(last[2], cell, width)
        if not beside:
            out.setdefault(row, []).append(by)
        last = (row, by, cell)
    # A fork's own two cells are no ring: two ends at most.
    return {row: forks[:2] for row, forks in out.items()}


def _adjacent(a: int, b: int, width: int) -> bool:
    return max(abs(a // width - b // width), abs(a % width - b % width)) <= 1
