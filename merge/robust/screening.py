"""Screening: which pairs of a batch are matched; in a large batch those that the index selects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...topology.arrays import IntArray
from ..result import pairs_of
from .index import Corridors
from .prepare import Prepared
from .settings import RobustSettings
from .tasks import TASKS
from .verdict import needed_bits


@dataclass(frozen=True, slots=True)
class ScreeningSettings:
    """Screening of large batches."""

    most_pairs: int = 5000
    """Batches with more pairs are screened: 100 runs take some seconds without."""
    share: float = 0.6
    """Connected links must have this share of the bits that merging needs. With 0.75 still nothing
    was lost of 1,354 pairs of runs that matching all 79,800 pairs joins (`benchmarks/fleet.py
    --recall 400 --first 5000`). Of 692 pairs beyond chance, nearly all copies in offices, 29 are
    screened out (`--beyond 160 --first 5000`): these do not count among the pairs that share the
    threshold against copies, .06 bits."""


SCREENING = ScreeningSettings()


def pairs_to_match(maps: Sequence[Prepared], settings: RobustSettings) -> IntArray:
    """(k, 2) pairs i < j, sorted: all of a small batch, of a large one those that the index
    selects."""
    pairs = pairs_of(len(maps))
    if pairs <= SCREENING.most_pairs:
        return np.stack(np.triu_indices(len(maps), 1), axis=1)
    return likely_pairs(maps, SCREENING.share * needed_bits(pairs, settings))


def likely_pairs(maps: Sequence[Prepared], least: float) -> IntArray:
    """(k, 2) pairs i < j, sorted, with at least so many bits by the index. O(links of the pairs).

    The pair (i, j) is looked up with map i; the result differs from (j, i) only in the direction of
    corridors.
    """
    parts = [np.zeros((0, 2), np.int64)]
    for start in range(0, len(maps), TASKS.at_hand):
        some = maps[start : start + TASKS.at_hand]
        block = Corridors.of(some)
        for i in range(start + len(some) - 1):
            bits = block.chances([maps[i]], least, np.array([max(i - start, -1)]))[0]
            found = np.flatnonzero(bits >= least)
            parts.append(np.stack([np.full(len(found), i), start + found], axis=1))
    pairs = np.concatenate(parts)
    return pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]
