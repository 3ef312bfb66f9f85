"""Screening: which pairs of a batch are matched; in a large batch those that an index selects.

Matching begins with links: corridors of two maps of equal length, curvature and branches at their
ends. A correct alignment has many consistent ones. The index finds the links of one map with all
others at once, a hundred times faster than matching. Its recall on pairs that would be merged is
measured by `benchmarks/fleet.py --recall`.

Maps with views may agree in their walls alone. Such a map is also matched with the maps of the most
similar views, by rotation-invariant descriptors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from ...topology.arrays import FloatArray, IntArray
from ...topology.columns import take
from ...topology.views import CELL_M, DISC, FREE, REACH_M, SIDE, WALL, Views
from ..result import MOST_PAIRS, pairs_of
from .atlas import Atlas
from .branch_patterns import LENGTH_SCALE
from .links import Links, compatible_links, link_components, windows
from .pairing import TASKS
from .prepare import Prepared
from .settings import MATCH, RobustSettings
from .verdict import needed_bits

SHARE = 0.6
"""Least evidence of connected links, as a share of the bits that merging needs. With 0.75 still
nothing was lost of 1,354 pairs of runs that matching all 79,800 pairs joins (`benchmarks/fleet.py
--recall 400 --first 5000`). Of 692 pairs beyond chance, nearly all copies in offices, 29 are
screened out (`--beyond 160 --first 5000`): these do not count among the pairs that share the
threshold against copies, .06 bits."""


def pairs_to_match(maps: Sequence[Prepared], settings: RobustSettings) -> IntArray:
    """(k, 2) pairs i < j, sorted: all of a small batch, of a large one those that the index or the
    descriptors of views select."""
    count = pairs_of(len(maps))
    if count <= MOST_PAIRS:
        return np.stack(np.triu_indices(len(maps), 1), axis=1)
    likely = likely_pairs(maps, SHARE * needed_bits(count, settings))
    return np.unique(np.concatenate([likely, similar_pairs([m.views for m in maps])]), axis=0)


PARTNERS = 100
"""Maps that each map with views is matched with, those with the most similar views. Of 171 pairs
of one place in a batch of 109 maps all rank among the first 26 of one of the two, 95 % among the
first 16."""
RINGS, SECTORS, HARMONICS = 10, 48, (8, 4)
"""Bins of the polar histograms, and harmonics of walls and of free space in a descriptor. Twice
as many rings or harmonics rank no better."""
MOST_ALIKE = 12
"""Views that count in the similarity of two maps, the most similar: maps overlap in part."""


def similar_pairs(views: Sequence[Views]) -> IntArray:
    """(k, 2) pairs i < j of maps with views, sorted: each map with its `PARTNERS`."""
    rows = np.flatnonzero([len(v) > 0 for v in views])
    if len(rows) <= PARTNERS + 1:
        return rows[np.stack(np.triu_indices(len(rows), 1), axis=1)]
    score = similarity([v for v in views if len(v)])
    best = np.argsort(-score, axis=1, kind="stable")[:, :PARTNERS]
    pairs = np.column_stack([np.arange(len(rows)).repeat(PARTNERS), best.ravel()])
    return np.unique(np.sort(rows[pairs], axis=1), axis=0)


def similarity(views: Sequence[Views]) -> FloatArray:
    """(n, n) similarity of the views of two maps, symmetric; -inf of a map with itself.

    A view's similarity to a map is that to its most similar view, in standard deviations over all
    maps. O(views²), 2 ms of a core for each map and 1,000 others.
    """
    described = np.concatenate([descriptors(v) for v in views])
    described = (described - described.mean(axis=0)) / (described.std(axis=0) + 1e-6)
    described /= np.linalg.norm(described, axis=1, keepdims=True) + 1e-6  # 0 of one like the mean
    starts = np.cumsum([0, *map(len, views)])
    score = np.zeros((len(views), len(views)))
    for k, (start, stop) in enumerate(pairwise(starts)):
        similar = np.maximum.reduceat(described[start:stop] @ described.T, starts[:-1], axis=1)
        others = np.delete(similar, k, axis=1)
        similar = (similar - others.mean(axis=1)[:, None]) / (others.std(axis=1)[:, None] + 1e-6)
        score[k] = np.sort(similar, axis=0)[-MOST_ALIKE:].sum(axis=0)
    score += score.T
    np.fill_diagonal(score, -np.inf)
    return score


def descriptors(views: Views) -> NDArray[np.float32]:
    """(n, d) rotation-invariant descriptors of views: magnitudes of the Fourier transforms of
    walls and free space on rings around the place."""
    members, scale = _polar_bins()
    parts = []
    for state, harmonics in zip((WALL, FREE), HARMONICS, strict=True):
        marked = (views.cells.reshape(len(views), -1) == state).astype(np.float32)
        polar = (marked @ members / scale).reshape(-1, RINGS, SECTORS)
        waves = np.abs(np.fft.rfft(polar, axis=2)[:, :, :harmonics])
        parts.append(np.sqrt(waves).reshape(len(views), -1))
    return np.concatenate(parts, axis=1).astype(np.float32)


@cache
def _polar_bins() -> tuple[csr_array, FloatArray]:
    """The bins (RINGS · SECTORS) of each cell of a view, as a sparse matrix, and the square root of
    the number of cells in each."""
    axis = (np.arange(SIDE) + 0.5) * CELL_M - REACH_M
    ring = np.floor(np.hypot(axis[:, None], axis) / REACH_M * RINGS)
    sector = np.floor((np.arctan2(axis[:, None], axis) / (2 * np.pi) % 1) * SECTORS)
    cell, bin_of = np.flatnonzero(DISC), (ring * SECTORS + sector)[DISC].astype(np.int64)
    shape = (SIDE * SIDE, RINGS * SECTORS)
    members = csr_array((np.ones(len(cell), np.float32), (cell, bin_of)), shape)
    return members, np.sqrt(np.bincount(bin_of, minlength=shape[1]).clip(1))


def likely_pairs(maps: Sequence[Prepared], least_bits: float) -> IntArray:
    """(k, 2) pairs i < j, sorted, with at least so many bits by the index. O(links of the pairs).

    The pair (i, j) is looked up by map i; (j, i) differs only in the direction of corridors.
    """
    parts = [np.zeros((0, 2), np.int64)]
    for start in range(0, len(maps), TASKS.at_hand):
        part = maps[start : start + TASKS.at_hand]
        block = CorridorIndex.of(part)
        for i in range(start + len(part) - 1):
            bits = block.link_bits(maps[i], least_bits, after=max(i - start, -1))
            selected = np.flatnonzero(bits >= least_bits)
            parts.append(np.stack([np.full(len(selected), i), start + selected], axis=1))
    pairs = np.concatenate(parts)
    return pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]


@dataclass(frozen=True, slots=True, eq=False)
class CorridorIndex:
    """The directed corridors of some maps, sorted by pattern of branches, then length.

    atlas: the maps; key: (k,) pattern and length as in `Prepared.probe_key`; row: (k,) corridors of
    the atlas; owner: the map of each corridor of the atlas. length_step, worst: lengths, ascending,
    and the largest variance of corridors up to each.
    """

    atlas: Atlas
    key: FloatArray
    row: IntArray
    owner: IntArray
    length_step: FloatArray
    worst: FloatArray

    @classmethod
    def of(cls, maps: Sequence[Prepared]) -> CorridorIndex:
        """Index some maps. O(k log k)."""
        atlas = Atlas.of(maps)
        key = np.concatenate([m.probe_key for m in maps])
        first = atlas.corridor.tolist()
        row = np.concatenate([m.probe_row + start for m, start in zip(maps, first, strict=False)])
        order = np.argsort(key, kind="stable")
        owner = np.arange(len(maps)).repeat(np.diff(atlas.corridor))
        by_length = np.argsort(atlas.whole.length, kind="stable")
        worst = np.maximum.accumulate(atlas.whole.variance[by_length])
        return cls(atlas, key[order], row[order], owner, atlas.whole.length[by_length], worst)

    def worst_variance(self, length: FloatArray) -> FloatArray:
        """(q,) upper bound of the variance [m²] of corridors compatible with the lengths (q,)."""
        if not len(self.worst):
            return np.zeros(len(length))
        at = np.searchsorted(self.length_step, 2 * length, side="right") - 1
        return np.asarray(self.worst[np.maximum(at, 0)])

    def link_bits(self, a: Prepared, least_bits: float, after: int = -1) -> FloatArray:
        """For each indexed map the evidence [bits] of its best connected set of links with map a,
        minus log2 of the number of links; -inf if all links together have less than `least_bits`,
        and for the maps up to the index `after`."""
        maps, whole = len(self.atlas.maps), self.atlas.whole
        best = np.full(maps, -np.inf)
        links = self._links(a, after)
        if not len(links):
            return best
        owner = self.owner[links.b_row]
        choice_bits = np.log2(np.bincount(owner, minlength=maps) + 1.0)
        total = np.bincount(owner, np.maximum(links.bits, 0.0), maps)
        promising = np.flatnonzero((total - choice_bits >= least_bits)[owner])
        if len(promising):
            links, owner = take(links, promising), owner[promising]
            label = link_components(a, whole, links)
            np.maximum.at(best, owner, np.bincount(label, links.bits)[label])
        return np.asarray(best - choice_bits)

    def _links(self, a: Prepared, after: int) -> Links:
        """Links of corridors of a, in one direction, with those of the maps behind `after`."""
        half = len(a.tail) // 2
        variance, length = a.variance[:half], a.length[:half]
        reach = MATCH.length_sigmas * np.sqrt(variance + self.worst_variance(length))
        key = a.pattern[:half] * LENGTH_SCALE + length
        low, high = self.key.searchsorted(key - reach), self.key.searchsorted(key + reach)
        row, column = windows(low, high)
        other = self.row[column]
        later = np.flatnonzero(self.owner[other] > after)
        return compatible_links(a, self.atlas.whole, row[later], other[later])
