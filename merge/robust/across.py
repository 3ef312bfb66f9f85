"""Evidence from all pairs of runs across two components that one of them is a copy of the other.

A single pair with little overlap may not show that it is of a copy: a difference of 3 % in size may
be the odometry's. If several runs of either component can be compared, their odometry errors are
independent, while differences between copies appear in most pairs.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from ...topology.arrays import ComplexArray, IntArray
from ...topology.se2 import compose, inverse
from ..result import Alignment, PairVerdict
from .components import Components, Pair, Refusal, agrees
from .prepare import Prepared
from .repetition import size_difference
from .settings import MATCH
from .verdict import OTHER_SIZE

LARGER_TOGETHER = Refusal(
    "all runs that can be compared together show that one is larger throughout: this may be a copy "
    "of another size"
)


COPY_TOGETHER = Refusal(
    "the pairs that can be compared together differ as copies do: this may be a copy of the place"
)


@dataclass(frozen=True, eq=False)
class Across:
    """The evidence of a batch on copies.

    prepared: the maps; places: their junctions, x + iy; verdicts: on pairs by their two maps, but
    for those that a lock names; joins: alignments by which pairs would be joined; same_place_bits:
    evidence that some of these, not tested for that before, are no copies; locked: pairs joined by
    a lock; most_sigmas: largest accepted difference in size.
    """

    prepared: Sequence[Prepared]
    places: Sequence[ComplexArray]
    verdicts: Mapping[Pair, PairVerdict]
    joins: Mapping[Pair, Alignment]
    same_place_bits: Callable[[Sequence[Pair]], Sequence[float]]
    locked: Collection[Pair]
    most_sigmas: float

    def refusal(self, components: Components, pair: Pair) -> Refusal | None:
        """Why the components of a pair must not be joined by it; None if they may.

        Evaluated only where a single pair across is larger throughout or looks like a copy. Then
        all pairs across are tested: alignments beyond chance may be copies. The evidence for a copy
        must exceed `lead_bits`, because it overrules a pair that is merged by itself.
        """
        if pair in self.locked:
            return None
        across = self._across(components, pair)
        known = {p: self.verdicts[p] for p in across if p in self.verdicts}
        larger = {p for p, v in known.items() if v.lacks == OTHER_SIZE}
        if larger:
            compared = {p: found for p, found in across.items() if p in larger or p in self.joins}
            if self._sigmas(components, pair, compared) > self.most_sigmas:
                return LARGER_TOGETHER
        of_all = {p: v.extra.get("same_place_bits") for p, v in known.items()}
        tested = {p: bits for p, bits in of_all.items() if bits is not None}
        if any(bits < 0 for bits in tested.values()):  # more like a copy than a typical one
            untested = [p for p in across if p in self.joins and p not in tested]
            if sum(tested.values()) + sum(self.same_place_bits(untested)) < -MATCH.lead_bits:
                return COPY_TOGETHER
        return None

    def _across(self, components: Components, pair: Pair) -> dict[Pair, Alignment]:
        """The alignments of pairs between the two components that place them as the pair does,
        sorted. O(pairs between the two), and of all joins together O(pairs of runs)."""
        i, j = pair
        one, two = (components.members[components.head[k]] for k in pair)
        out = {}
        for u, v in product(one, two):
            across = (min(u, v), max(u, v))
            found = self.joins.get(across)
            if found is None and across in self.verdicts:
                found = self.verdicts[across].best
            if found is None:
                continue
            T_u_j = compose(components.relative(u, i), self.joins[pair].transform)
            T_u_v = compose(T_u_j, components.relative(j, v))
            if agrees(found, T_u_v if u < v else inverse(T_u_v), self.places[across[1]]):
                out[across] = found
        return dict(sorted(out.items()))

    def _sigmas(
        self, components: Components, pair: Pair, across: Mapping[Pair, Alignment]
    ) -> float:
        """By how many standard deviations the runs of one component are larger than those of the
        other.

        Generalised least squares: each pair measures the difference with the error of its lengths
        and the scale errors of its two runs, which it shares with other pairs.
        """
        pairs = sorted(across)
        rows = [_common(*self._maps(p), across[p].matched) for p in pairs]
        differences = [size_difference(*self._maps(p), r) for p, r in zip(pairs, rows, strict=True)]
        known = [k for k, (_, variance) in enumerate(differences) if np.isfinite(variance)]
        if not known:
            return 0.0
        value, variance = np.array(differences)[known].T
        first = components.head[pair[0]]
        sign = np.array([1.0 if components.head[pairs[k][0]] == first else -1.0 for k in known])
        runs, at = np.unique(np.array(pairs)[known], return_inverse=True)
        scale = np.array([self.prepared[r].noise.scale for r in runs.tolist()])
        shared = np.zeros((len(known), len(runs)))
        at = at.reshape(-1, 2)
        shared[np.arange(len(known)), at[:, 0]] = sign * scale[at[:, 0]]
        shared[np.arange(len(known)), at[:, 1]] = -sign * scale[at[:, 1]]
        weight = np.linalg.solve(np.diag(variance) + shared @ shared.T, np.ones(len(known)))
        return float(abs(weight @ (sign * value)) / np.sqrt(weight.sum()))

    def _maps(self, pair: Pair) -> tuple[Prepared, Prepared]:
        return self.prepared[pair[0]], self.prepared[pair[1]]


def _common(a: Prepared, b: Prepared, matched: IntArray) -> IntArray:
    """(c, 2) directed rows of the corridors of two maps between matched junctions."""
    partner = np.full(len(b), -1)
    partner[matched[:, 1]] = matched[:, 0]
    tail, head = partner[b.tail], partner[b.head]
    rows = np.flatnonzero((tail >= 0) & (head >= 0) & (np.arange(len(b.tail)) < b.reverse))
    key = tail[rows] * len(a) + head[rows]
    row_a, there = a.by_ends.find(key)
    return np.column_stack([row_a[there], rows[there]])
