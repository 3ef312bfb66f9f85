"""Components of runs: pairs joined in order of their evidence, unless cycles or copies contradict.

A single pair with little overlap may not show that it is of a copy: a difference of 3 % in size may
be the odometry's. If several runs of either component can be compared, their odometry errors are
independent, while differences between copies appear in most pairs.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.spatial import cKDTree

from ...topology.arrays import FloatArray, IntArray
from ...topology.se2 import compose, inverse, wrap
from ..result import Alignment, PairVerdict
from .alignment import Candidate, moved
from .prepare import Prepared, as_points
from .repetition import size_sigmas
from .settings import MATCH
from .verdict import OTHER_SIZE

Pair = tuple[int, int]


class Components:
    """A partition of runs 0 … n - 1, with a pose of each run in its component's frame.

    head: (n,) the run that names the component of each; members: runs by head; pose: (n, 3); never:
    pairs of runs i < j that must stay in different components. Changed by `join`.
    """

    def __init__(self, n: int, never: Iterable[Pair]) -> None:
        self.head = list(range(n))
        self.members: dict[int, list[int]] = {i: [i] for i in range(n)}
        self.pose = np.zeros((n, 3))
        self.never = frozenset((min(p), max(p)) for p in never)

    def together(self, i: int, j: int) -> bool:
        """Whether runs i and j are in one component."""
        return self.head[i] == self.head[j]

    def relative(self, i: int, j: int) -> FloatArray:
        """T_i_j of two runs of one component."""
        return compose(inverse(self.pose[i]), self.pose[j])

    def forbidden(self, i: int, j: int) -> Pair | None:
        """A `never` pair that joining i and j would bring together, if any."""
        for x in self.members[self.head[i]] if self.never else ():
            for y in self.members[self.head[j]]:
                pair = (min(x, y), max(x, y))
                if pair in self.never:
                    return pair
        return None

    def join(self, i: int, j: int, T_i_j: FloatArray) -> None:
        """Merge the components of i and j into one frame."""
        target, other = self.head[i], self.head[j]
        if len(self.members[target]) < len(self.members[other]):
            self.join(j, i, inverse(T_i_j))
            return
        move = compose(compose(self.pose[i], T_i_j), inverse(self.pose[j]))
        runs = self.members.pop(other)
        self.pose[runs] = compose(move, self.pose[runs])
        self.members[target] += runs
        for run in runs:
            self.head[run] = target


@dataclass(frozen=True, slots=True)
class Refusal:
    """Why a pair was not joined despite its evidence. advice: what settles it."""

    reason: str
    advice: str | None = None


ELSEWHERE = Refusal(
    "other runs, matched with more evidence or locked, place the two differently: this match is "
    "set aside"
)


def as_alignment(c: Candidate) -> Alignment:
    """A candidate as the alignment by which two runs are joined."""
    return Alignment(c.transform, c.bits, np.column_stack([c.a, c.b]), c.rmse_m)


def agrees(alignment: Alignment, T_a_b: FloatArray, b: Prepared) -> bool:
    """Whether an alignment places b as T_a_b does, within the drift of chained transforms.

    The two are compared at the centroid of the matched junctions, or of all, where views alone
    match and the overlap may lie anywhere in b.
    """
    middle = b.z.mean() if len(b) else np.complex128(0)
    centre, reach = middle, float(np.abs(b.z - middle).max(initial=0.0))
    matched = b.z[alignment.matched[:, 1]]
    if len(matched):
        centre = matched.mean()
        reach = abs(complex(centre - middle))
    by_alignment, by_pose = (moved(T, centre) for T in (alignment.transform, T_a_b))
    gap = abs(complex(by_alignment - by_pose))
    turn = abs(float(wrap(alignment.transform[2] - T_a_b[2])))
    return gap < MATCH.place_m + MATCH.drift_per_m * reach and turn < MATCH.turn_rad


def join_all(
    components: Components,
    strongest_first: Sequence[Pair],
    best: Mapping[Pair, Alignment],
    maps: Sequence[Prepared],
    *,
    refusal: Callable[[Components, Pair], Refusal | None] = lambda components, pair: None,
) -> dict[Pair, Refusal]:
    """Join pairs in order of strength. Returns the pairs that were refused, with the reason.

    best: alignment of each pair; refusal: further objections to joining the components of a pair. A
    pair that closes a cycle must agree with the stronger pairs around it. Else it is refused.
    """
    refused: dict[Pair, Refusal] = {}
    for i, j in strongest_first:
        alignment = best[i, j]
        if components.together(i, j):
            if not agrees(alignment, components.relative(i, j), maps[j]):
                refused[i, j] = ELSEWHERE
            continue
        kept_apart = components.forbidden(i, j)
        if kept_apart is not None:
            x, y = (maps[k].run for k in kept_apart)
            refused[i, j] = Refusal(
                f"joining them would bring {x} and {y} together, which are locked apart",
                f"if {x} and {y} share places after all, clear their lock",
            )
            continue
        if (other := refusal(components, (i, j))) is not None:
            refused[i, j] = other
            continue
        components.join(i, j, alignment.transform)
    return refused


def overlapping_pairs(components: Components, maps: Sequence[Prepared]) -> list[Pair]:
    """Pairs i < j of one component with at least `MATCH.fewest` junctions within `MATCH.place_m` of
    each other in the component's frame."""
    pairs: list[Pair] = []
    for members in components.members.values():
        if len(members) < 2:
            continue
        runs = sorted(members)
        placed = [moved(components.pose[k], maps[k].z) for k in runs]
        owner = np.arange(len(runs)).repeat([len(z) for z in placed])
        near = cKDTree(as_points(np.concatenate(placed))).query_pairs(
            MATCH.place_m, output_type="ndarray"
        )
        runs_of_points = np.sort(owner[near], axis=1)
        distinct, count = np.unique(
            runs_of_points[runs_of_points[:, 0] < runs_of_points[:, 1]], axis=0, return_counts=True
        )
        pairs += [(runs[i], runs[j]) for i, j in distinct[count >= MATCH.fewest].tolist()]
    return sorted(pairs)


LARGER_TOGETHER = Refusal(
    "all runs that can be compared together show that one is larger throughout: this may be a copy "
    "of another size"
)


COPY_TOGETHER = Refusal(
    "the pairs that can be compared together differ as copies do: this may be a copy of the place"
)


@dataclass(frozen=True, eq=False)
class Across:
    """The test for copies of two components, by all pairs of runs between them.

    prepared: the maps; verdicts: on pairs by their two maps, without those that a lock names;
    joins: alignments by which pairs would be joined; same_place_bits: gives the evidence that pairs
    of these are no copies; locked: pairs joined by a lock; most_sigmas: largest accepted difference
    in size.
    """

    prepared: Sequence[Prepared]
    verdicts: Mapping[Pair, PairVerdict]
    joins: Mapping[Pair, Alignment]
    same_place_bits: Callable[[Sequence[Pair]], Sequence[float]]
    locked: Collection[Pair]
    most_sigmas: float

    def refusal(self, components: Components, pair: Pair) -> Refusal | None:
        """Why the components of a pair must not be joined by it; None if they may.

        Only where a single pair between them differs in size or resembles a copy, all pairs are
        tested. The evidence for a copy must exceed `lead_bits`: it overrules a merged pair.
        """
        if pair in self.locked:
            return None
        agreeing = self._agreeing_pairs(components, pair)
        verdicts = {p: self.verdicts[p] for p in agreeing if p in self.verdicts}
        larger = {p for p, v in verdicts.items() if v.lacks == OTHER_SIZE}
        if larger:
            compared = {p: found for p, found in agreeing.items() if p in larger or p in self.joins}
            if self._size_sigmas(components, pair, compared) > self.most_sigmas:
                return LARGER_TOGETHER
        same_place = {p: v.same_place_bits for p, v in verdicts.items()}
        tested = {p: bits for p, bits in same_place.items() if np.isfinite(bits)}
        if any(bits < 0 for bits in tested.values()):  # more like a copy than a typical one
            untested = [p for p in agreeing if p in self.joins and p not in tested]
            if sum(tested.values()) + sum(self.same_place_bits(untested)) < -MATCH.lead_bits:
                return COPY_TOGETHER
        return None

    def _agreeing_pairs(self, components: Components, pair: Pair) -> dict[Pair, Alignment]:
        """The alignments of pairs between the two components that agree with that of the pair,
        sorted. O(pairs between the two), over all joins O(pairs of runs)."""
        i, j = pair
        runs_a, runs_b = (components.members[components.head[k]] for k in pair)
        agreeing = {}
        for u, v in product(runs_a, runs_b):
            row = (min(u, v), max(u, v))
            alignment = self.joins.get(row)
            if alignment is None and row in self.verdicts:
                alignment = self.verdicts[row].best
            if alignment is None:
                continue
            T_u_j = compose(components.relative(u, i), self.joins[pair].transform)
            T_u_v = compose(T_u_j, components.relative(j, v))
            if agrees(alignment, T_u_v if u < v else inverse(T_u_v), self.prepared[row[1]]):
                agreeing[row] = alignment
        return dict(sorted(agreeing.items()))

    def _size_sigmas(
        self, components: Components, pair: Pair, alignments: Mapping[Pair, Alignment]
    ) -> float:
        """The difference in size of two components, in standard deviations."""
        first, oriented = components.head[pair[0]], []
        for (i, j), alignment in sorted(alignments.items()):
            a, b = self.prepared[i], self.prepared[j]
            corridors = _common_corridors(a, b, alignment.matched)
            is_first = components.head[i] == first
            oriented.append((a, b, corridors) if is_first else (b, a, corridors[:, ::-1]))
        return size_sigmas(oriented)


def _common_corridors(a: Prepared, b: Prepared, matched: IntArray) -> IntArray:
    """(c, 2) directed rows of the corridors of two maps between matched junctions."""
    partner = np.full(len(b), -1)
    partner[matched[:, 1]] = matched[:, 0]
    tail, head = partner[b.tail], partner[b.head]
    rows_b = np.flatnonzero((tail >= 0) & (head >= 0) & (np.arange(len(b.tail)) < b.reverse))
    key = tail[rows_b] * len(a) + head[rows_b]
    rows_a, found = a.by_ends.find(key)
    return np.column_stack([rows_a[found], rows_b[found]])
