"""Crossings shown as two forks: at acute angles, or of corridors slightly offset from each other.

The skeleton of a scan or grid may fork twice where other looks, and detectors, show one crossing.
So each of two forks close to each other in such a map can also be matched as that whole crossing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...topology.arrays import ComplexArray, FloatArray, IntArray
from .settings import MATCH


@dataclass(frozen=True, slots=True, eq=False)
class Halves:
    """half: (n,) the other fork of each vertex, itself where it has none. unit, rarity: (n, 4) of
    the branches of both but the two between them, as in Prepared; 0 where there is no other."""

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
    """The halves among the vertices of a map: forks nearest to each other along a corridor.

    z: (n,) positions; unit, rarity: (n, d) of the branches; ends: of the corridors, both ways;
    shows_bends: the map's detector is no skeleton.
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
