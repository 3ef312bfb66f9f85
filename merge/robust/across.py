"""Evidence from all pairs of runs across two components that one of them is a copy of the other.

A single pair with little overlap may not show that it is of a copy: a difference of 3 % in size may
be the odometry's. If several runs of either component can be compared, their odometry errors are
independent, while differences between copies appear in most pairs.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...topology.arrays import ComplexArray, IntArray
from ...topology.se2 import compose, inverse
from ..result import Alignment
from .components import Components, Pair, Refusal, agrees
from .prepare import Prepared
from .repetition import size_difference
from .settings import MATCH

LARGER_TOGETHER = Refusal(
    "all runs that can be compared together show that one is larger throughout: this may be a copy "
    "of another size"
)


COPY_TOGETHER = Refusal(
    "the pairs that can be compared together differ as copies do: this may be a copy of the place"
)


class _ByRun:
    """Alignments of pairs, indexed by their runs: few pairs lie across two components, and a large
    batch has too many to search through for each join."""

    def __init__(self, alignments: Mapping[Pair, Alignment]) -> None:
        self.alignments = alignments
        self._pairs: dict[int, list[Pair]] = defaultdict(list)
        for pair in alignments:
            for run in pair:
                self._pairs[run].append(pair)

    def between(self, components: Components, pair: Pair) -> list[Pair]:
        """The pairs between the two components of a pair, sorted. O(pairs of the smaller one)."""
        few, many = sorted((components.head[k] for k in pair), key=components.size)
        return sorted(
            (x, y)
            for run in components.members[few]
            for x, y in self._pairs.get(run, ())
            if components.head[y if run == x else x] == many
        )


@dataclass(frozen=True, eq=False)
class Across:
    """The evidence of a batch on copies.

    prepared: the maps; places: their junctions, x + iy; joins: alignments by which pairs would be
    joined; other: alignments of pairs rejected because one map is larger; tested: alignments of
    pairs that were tested for being a copy, with the evidence that they are not [bits];
    same_place_bits: runs that test for some of the other `joins`; locked: pairs joined by a lock;
    most_sigmas: largest accepted difference in size.
    """

    prepared: Sequence[Prepared]
    places: Sequence[ComplexArray]
    joins: Mapping[Pair, Alignment]
    other: Mapping[Pair, Alignment]
    tested: Mapping[Pair, tuple[Alignment, float]]
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
        if across := dict(self._across(components, pair, self._other_size)):
            across |= self._across(components, pair, self._joined)
            if self._sigmas(components, pair, across) > self.most_sigmas:
                return LARGER_TOGETHER
        if any(self._across(components, pair, self._copies)):
            bits = {p: self.tested[p][1] for p, _ in self._across(components, pair, self._tested)}
            joined = (p for p, _ in self._across(components, pair, self._joined))
            untested = [p for p in joined if p not in bits]
            if sum(bits.values()) + sum(self.same_place_bits(untested)) < -MATCH.lead_bits:
                return COPY_TOGETHER
        return None

    @cached_property
    def _other_size(self) -> _ByRun:
        return _ByRun(self.other)

    @cached_property
    def _joined(self) -> _ByRun:
        return _ByRun(self.joins)

    @cached_property
    def _tested(self) -> _ByRun:
        return _ByRun({pair: found for pair, (found, _) in self.tested.items()})

    @cached_property
    def _copies(self) -> _ByRun:
        """Those of pairs that look more like copies than typical copies do."""
        return _ByRun({pair: found for pair, (found, bits) in self.tested.items() if bits < 0})

    def _across(
        self, components: Components, pair: Pair, known: _ByRun
    ) -> Iterator[tuple[Pair, Alignment]]:
        """Alignments between the two components that place them as the pair does."""
        i, j = pair
        one = components.head[i]
        for x, y in known.between(components, pair):
            found = known.alignments[x, y]
            u, v = (x, y) if components.head[x] == one else (y, x)
            T_u_j = compose(components.relative(u, i), self.joins[pair].transform)
            T_u_v = compose(T_u_j, components.relative(j, v))
            if agrees(found, T_u_v if u == x else inverse(T_u_v), self.places[y]):
                yield (x, y), found

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
