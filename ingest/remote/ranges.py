"""Planning of byte range requests: near ranges are merged, long ones split."""

from __future__ import annotations

import itertools

import numpy as np

from ...topology.arrays import BoolArray, IntArray

WASTE = 1 / 32
"""Share of unneeded bytes that may be read to save requests: small enough for reading at most a
tenth more than needed, together with the end of the file."""

GAP_BYTES = 1 << 20
"""Longer gaps are not read: at 100 MB/s they take as long as another request, about 10 ms."""


def coalesced(begin: IntArray, end: IntArray) -> tuple[IntArray, IntArray]:
    """Ranges in ascending order with the smallest gaps between them closed. O(n log n).

    begin, end: (n,) in any order, possibly overlapping. Closed gaps are at most WASTE of the
    ranges' bytes.
    """
    begin, end = begin[end > begin], end[end > begin]
    if len(begin) == 0:
        return begin, end
    order = np.argsort(begin, kind="stable")
    begin, end = begin[order], np.maximum.accumulate(end[order])
    gap = begin[1:] - end[:-1]
    wanted = int(end[-1] - begin[0] - np.maximum(gap, 0).sum())
    closed = np.argsort(gap, kind="stable")
    affordable = np.cumsum(np.maximum(gap[closed], 0)) <= WASTE * wanted
    closed = closed[affordable & (gap[closed] <= GAP_BYTES)]
    kept = np.ones(len(gap), bool)
    kept[closed] = False
    return begin[np.r_[True, kept]], end[np.r_[kept, True]]


def without(
    begin: IntArray, end: IntArray, held: list[tuple[int, int]]
) -> tuple[IntArray, IntArray]:
    """Ranges in ascending order without the `held` ones. O(n log n)."""
    there = np.array(held, np.int64).reshape(-1, 2)
    edges = np.unique(np.concatenate([begin, end, there.ravel()]))
    wanted = _covered(edges, begin, end) & ~_covered(edges, there[:, 0], there[:, 1])
    return edges[:-1][wanted], edges[1:][wanted]


def _covered(edges: IntArray, begin: IntArray, end: IntArray) -> BoolArray:
    """For each interval between consecutive edges whether it lies in any range; all ranges begin
    and end at edges."""
    change = np.zeros(len(edges), np.int64)
    np.add.at(change, np.searchsorted(edges, begin), 1)
    np.add.at(change, np.searchsorted(edges, end), -1)
    return np.asarray(np.cumsum(change)[:-1] > 0)


def in_parts(begin: IntArray, end: IntArray, most: int) -> list[tuple[int, int]]:
    """Ranges with those longer than `most` split into equal parts."""
    out = []
    for first, last in zip(begin.tolist(), end.tolist(), strict=True):
        count = -(-(last - first) // most)
        edges = [first + (last - first) * k // count for k in range(count + 1)]
        out += list(itertools.pairwise(edges))
    return out
