"""Crossings that appear as two forks: at acute angles, or of slightly offset corridors.

The skeleton of a scan or grid may fork twice where other passes, and detectors, show one crossing.
So each of two close forks in such a map can also be matched as the whole crossing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...topology.arrays import ComplexArray, FloatArray, IntArray
from .settings import MATCH


@dataclass(frozen=True, slots=True, eq=False)
class Halves:
    """half: (n,) the other fork of each vertex, itself if there is none. unit, rarity: (n, 4) of
    the branches of both without the two between them, as in `Prepared`; 0 if there is no other
    fork."""

    half: IntArray
    unit: ComplexArray
    rarity: FloatArray


def halves(
    z: ComplexArray,
    unit: ComplexArray,
    rarity: FloatArray,
    ends: tuple[IntArray, IntArray],
    *,
    shows_bends: bool,
) -> Halves:
    """Pairs of forks that are nearest to each other along a corridor.

    z: (n,) positions; unit, rarity: (n, d) of the branches; ends: tail and head of the directed
    corridors; shows_bends: whether the map's detector is not a skeleton.
    """
    n, count = len(z), np.count_nonzero(unit, axis=1)
    half = np.arange(n)
    out = Halves(half, np.zeros((n, 4), np.complex128), np.zeros((n, 4)))
    tail, head = ends
    away = np.abs(z[head] - z[tail])
    rows = (away < MATCH.crossing_m) & (count[tail] == 3) & (count[head] == 3)
    rows = np.flatnonzero(rows & (not shows_bends))
    if len(rows) == 0:
        return out
    rows = rows[np.lexsort((head[rows], away[rows], tail[rows]))]
    rows = rows[np.unique(tail[rows], return_index=True)[1]]
    nearest = half.copy()
    nearest[tail[rows]] = head[rows]
    one = np.flatnonzero((nearest[nearest] == half) & (nearest != half))
    two = nearest[one]
    half[one] = two
    # Of three branches, the two that lead elsewhere.
    towards = (z[two] - z[one]) / np.abs(z[two] - z[one])
    elsewhere = np.argsort(-np.abs(unit[one, :3] - towards[:, None]), axis=1, kind="stable")[:, :2]
    for table, given in ((out.unit, unit), (out.rarity, rarity)):
        table[one, :2] = given[one[:, None], elsewhere]
        table[one, 2:] = table[two, :2]
    return out
