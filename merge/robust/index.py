"""An index of all maps' corridors, to screen which pairs of maps could be merged at all.

Matching begins with links: corridors of two maps of equal length, curvature and branches at their
ends. A correct alignment has many consistent ones. The index finds them for one map in all others
at once, a hundred times faster than matching the maps. Its recall on pairs that would be merged is
measured by `benchmarks/fleet.py --recall`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from ...topology.arrays import FloatArray, IntArray
from ...topology.se2 import wrap
from .branch_patterns import LENGTH_SCALE
from .links import KEY_STEP, windows
from .prepare import Prepared, length_bits
from .settings import MATCH


@dataclass(frozen=True, slots=True, eq=False)
class Asked:
    """The corridors of some maps, one direction each, concatenated: columns as in `Prepared`.

    owner: map of each; tail, head: vertices, numbered through all maps.
    """

    owner: IntArray
    tail: IntArray
    head: IntArray
    pattern: IntArray
    length: FloatArray
    variance: FloatArray
    sagitta: FloatArray
    angle: FloatArray
    rarity: FloatArray
    end_information: FloatArray

    @classmethod
    def of(cls, maps: Sequence[Prepared]) -> Asked:
        """The corridors of these maps."""
        half = [len(m.tail) // 2 for m in maps]
        first = np.cumsum([0, *(len(m) for m in maps)])
        owner = np.arange(len(maps)).repeat(half)
        parts = {
            name: np.concatenate([getattr(m, name)[:k] for m, k in zip(maps, half, strict=True)])
            for name in cls.__dataclass_fields__
            if name != "owner"
        }
        for end in ("tail", "head"):
            parts[end] = first[owner] + parts[end]
        return cls(owner, **parts)


@dataclass(frozen=True, slots=True, eq=False)
class Corridors:
    """The directed corridors of some maps, sorted by pattern of branches, then length.

    key: (k,) pattern and length as in `Prepared.probe_key`; the others in the same order. owner:
    map of each; tail, head: vertices, numbered through all maps. length_step, worst: the largest
    variance of corridors up to each length.
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
    self_information: FloatArray
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
            self_information=gathered("end_information"),
            length_step=length[by_length],
            worst=np.maximum.accumulate(variance[by_length]),
        )

    def worst_variance(self, length: FloatArray) -> FloatArray:
        """Upper bound of the variance [m²] of corridors that could be as long as these."""
        if not len(self.worst):
            return np.zeros(len(length))
        at = np.searchsorted(self.length_step, 2 * length, side="right") - 1
        return np.asarray(self.worst[np.maximum(at, 0)])

    def chances(
        self, maps: Sequence[Prepared], least: float, after: IntArray | None = None
    ) -> FloatArray:
        """(given maps, maps here) evidence [bits] of the best connected set of links of two maps,
        minus log2 of the number of links; -inf if all links together have less than `least`, and
        for maps here that do not come after the index given for the other (`after`)."""
        a = Asked.of(maps)
        best = np.full(len(maps) * self.maps, -np.inf)
        row, other = self._links(a, np.full(len(maps), -1) if after is None else after)
        if not len(row):
            return best.reshape(len(maps), self.maps)
        d = a.length[row] - self.length[other]
        bits = length_bits(d, a.variance[row] + self.variance[other])
        bits += np.minimum(a.rarity[row], self.rarity[other])
        ends = np.minimum(a.end_information[row], self.self_information[other])
        bits = np.minimum(bits, MATCH.most_bits) + 0.5 * ends
        owner = a.owner[row] * self.maps + self.owner[other]
        choice = np.log2(np.bincount(owner, minlength=len(best)) + 1.0)
        together = np.bincount(owner, np.maximum(bits, 0.0), len(best))
        hope = np.flatnonzero((together - choice >= least)[owner])
        if len(hope):
            row, other, bits, owner = row[hope], other[hope], bits[hope], owner[hope]
            theta = np.asarray(wrap(a.angle[row] - self.angle[other]))
            label = self._hanging_together(a, row, other, theta)
            total = np.bincount(label, bits)
            np.maximum.at(best, owner, total[label])
        return np.asarray(best - choice).reshape(len(maps), self.maps)

    def _links(self, a: Asked, after: IntArray) -> tuple[IntArray, IntArray]:
        """Rows of `a` and rows here that are compatible."""
        reach = MATCH.length_sigmas * np.sqrt(a.variance + self.worst_variance(a.length))
        key = a.pattern * LENGTH_SCALE + a.length
        row, other = windows(self.key.searchsorted(key - reach), self.key.searchsorted(key + reach))
        late = np.flatnonzero(self.owner[other] > after[a.owner[row]])
        row, other = row[late], other[late]
        d = a.length[row] - self.length[other]
        fits = d * d < MATCH.length_sigmas**2 * (a.variance[row] + self.variance[other])
        ok = np.flatnonzero(fits & (np.abs(a.sagitta[row] - self.sagitta[other]) < MATCH.gate_m))
        return row[ok], other[ok]

    def _hanging_together(
        self, a: Asked, row: IntArray, other: IntArray, theta: FloatArray
    ) -> IntArray:
        """(k,) connected component of every link: links are adjacent if they share both vertices
        and the rotation (as in `links.seeds`)."""
        k = len(row)
        pair = np.concatenate(
            [
                a.tail[row] * self.vertices + self.tail[other],
                a.head[row] * self.vertices + self.head[other],
            ]
        )
        key = pair * KEY_STEP + np.concatenate([theta, theta])
        order = key.argsort()
        fresh = np.zeros(2 * k, np.int64)
        fresh[1:] = np.diff(key[order]) > MATCH.turn_rad
        node = np.empty(2 * k, np.int64)
        node[order] = fresh.cumsum()
        count = int(fresh.sum()) + 1
        graph = csr_array((np.ones(k, np.int8), (node[:k], node[k:])), shape=(count, count))
        return np.asarray(connected_components(graph, directed=False)[1][node[:k]], np.int64)
