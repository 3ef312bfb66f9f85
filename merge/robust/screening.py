"""Screening: which pairs of a batch are matched; in a large batch those that an index selects.

Matching begins with links: corridors of two maps of equal length, curvature and branches at their
ends. A correct alignment has many consistent ones. The index finds them for one map in all others
at once, a hundred times faster than matching the maps. Its recall on pairs that would be merged is
measured by `benchmarks/fleet.py --recall`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...topology.arrays import FloatArray, IntArray
from ...topology.se2 import wrap
from ..result import MOST_PAIRS, pairs_of
from .branch_patterns import LENGTH_SCALE
from .links import link_components, windows
from .pairing import TASKS
from .prepare import Prepared, length_bits
from .settings import MATCH, RobustSettings
from .verdict import needed_bits

SHARE = 0.6
"""Connected links must have this share of the bits that merging needs. With 0.75 still nothing was
lost of 1,354 pairs of runs that matching all 79,800 pairs joins (`benchmarks/fleet.py --recall 400
--first 5000`). Of 692 pairs beyond chance, nearly all copies in offices, 29 are screened out
(`--beyond 160 --first 5000`): these do not count among the pairs that share the threshold against
copies, .06 bits."""


def pairs_to_match(maps: Sequence[Prepared], settings: RobustSettings) -> IntArray:
    """(k, 2) pairs i < j, sorted: all of a small batch, of a large one those that the index
    selects."""
    count = pairs_of(len(maps))
    if count <= MOST_PAIRS:
        return np.stack(np.triu_indices(len(maps), 1), axis=1)
    return likely_pairs(maps, SHARE * needed_bits(count, settings))


def likely_pairs(maps: Sequence[Prepared], least: float) -> IntArray:
    """(k, 2) pairs i < j, sorted, with at least so many bits by the index. O(links of the pairs).

    The pair (i, j) is looked up with map i; (j, i) differs only in the direction of corridors.
    """
    parts = [np.zeros((0, 2), np.int64)]
    for start in range(0, len(maps), TASKS.at_hand):
        some = maps[start : start + TASKS.at_hand]
        block = Corridors.of(some)
        for i in range(start + len(some) - 1):
            bits = block.chances(maps[i], least, after=max(i - start, -1))
            found = np.flatnonzero(bits >= least)
            parts.append(np.stack([np.full(len(found), i), start + found], axis=1))
    pairs = np.concatenate(parts)
    return pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]


@dataclass(frozen=True, slots=True, eq=False)
class Corridors:
    """The directed corridors of some maps, sorted by pattern of branches, then length.

    key: (k,) pattern and length as in `Prepared.probe_key`; the others in the same order, as there.
    owner: map of each; tail, head: vertices, numbered through all maps. length_step, worst: the
    largest variance of corridors up to each length.
    """

    maps: int
    vertices: int
    key: FloatArray
    owner: IntArray
    tail: IntArray
    head: IntArray
    length: FloatArray
    variance: FloatArray
    sagitta: FloatArray
    angle: FloatArray
    rarity: FloatArray
    end_information: FloatArray
    length_step: FloatArray
    worst: FloatArray

    @classmethod
    def of(cls, maps: Sequence[Prepared]) -> Corridors:
        """Index some maps. O(k log k)."""
        first = np.cumsum([0, *(len(m) for m in maps)])
        rows = [m.probe_row for m in maps]

        def gathered(name: str) -> FloatArray:
            parts = [getattr(m, name)[r] for m, r in zip(maps, rows, strict=True)]
            return np.concatenate([*parts, np.zeros(0)])[order]

        key = np.concatenate([*(m.probe_key for m in maps), np.zeros(0)])
        order = np.argsort(key, kind="stable")
        owner = np.arange(len(maps)).repeat([len(r) for r in rows])[order]
        length, variance = gathered("length"), gathered("variance")
        by_length = np.argsort(length, kind="stable")
        return cls(
            maps=len(maps),
            vertices=int(first[-1]),
            key=key[order],
            owner=owner,
            tail=first[owner] + gathered("tail").astype(np.int64),
            head=first[owner] + gathered("head").astype(np.int64),
            length=length,
            variance=variance,
            sagitta=gathered("sagitta"),
            angle=gathered("angle"),
            rarity=gathered("rarity"),
            end_information=gathered("end_information"),
            length_step=length[by_length],
            worst=np.maximum.accumulate(variance[by_length]),
        )

    def worst_variance(self, length: FloatArray) -> FloatArray:
        """Upper bound of the variance [m²] of corridors that could be as long as these."""
        if not len(self.worst):
            return np.zeros(len(length))
        at = np.searchsorted(self.length_step, 2 * length, side="right") - 1
        return np.asarray(self.worst[np.maximum(at, 0)])

    def chances(self, a: Prepared, least: float, after: int = -1) -> FloatArray:
        """For each map here the evidence [bits] of the best connected set of links with map a,
        minus log2 of the number of links; -inf if all links together have less than `least`, and
        for the maps up to the index `after`."""
        best = np.full(self.maps, -np.inf)
        row, other = self._links(a, after)
        if not len(row):
            return best
        bits = length_bits(
            a.length[row] - self.length[other], a.variance[row] + self.variance[other]
        )
        bits += np.minimum(a.rarity[row], self.rarity[other])
        ends = np.minimum(a.end_information[row], self.end_information[other])
        bits = np.minimum(bits, MATCH.most_bits) + 0.5 * ends
        owner = self.owner[other]
        choice = np.log2(np.bincount(owner, minlength=self.maps) + 1.0)
        together = np.bincount(owner, np.maximum(bits, 0.0), self.maps)
        hope = np.flatnonzero((together - choice >= least)[owner])
        if len(hope):
            row, other, bits, owner = row[hope], other[hope], bits[hope], owner[hope]
            label = link_components(
                a.tail[row] * self.vertices + self.tail[other],
                a.head[row] * self.vertices + self.head[other],
                np.asarray(wrap(a.angle[row] - self.angle[other])),
            )
            np.maximum.at(best, owner, np.bincount(label, bits)[label])
        return np.asarray(best - choice)

    def _links(self, a: Prepared, after: int) -> tuple[IntArray, IntArray]:
        """Corridors of a, in one direction, and rows here that are compatible."""
        half = len(a.tail) // 2
        variance, length = a.variance[:half], a.length[:half]
        reach = MATCH.length_sigmas * np.sqrt(variance + self.worst_variance(length))
        key = a.pattern[:half] * LENGTH_SCALE + length
        row, other = windows(self.key.searchsorted(key - reach), self.key.searchsorted(key + reach))
        late = np.flatnonzero(self.owner[other] > after)
        row, other = row[late], other[late]
        d = a.length[row] - self.length[other]
        fits = d * d < MATCH.length_sigmas**2 * (a.variance[row] + self.variance[other])
        ok = np.flatnonzero(fits & (np.abs(a.sagitta[row] - self.sagitta[other]) < MATCH.gate_m))
        return row[ok], other[ok]
