"""Components of runs: pairs joined in order of their evidence, consistent round cycles and with
copies.

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

from ...topology.arrays import ComplexArray, FloatArray, IntArray
from ...topology.se2 import compose, inverse, wrap
from ..result import Alignment, PairVerdict
from .alignment import Candidate
from .prepare import Prepared
from .repetition import size_difference
from .settings import MATCH
from .verdict import OTHER_SIZE

Pair = tuple[int, int]


class Components:
    """A partition of runs 0 … n - 1 with a pose of each run in its component's frame.

    Grows by `join`; runs named in `never` pairs are kept in different components.
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
        """The `never` pair that joining i and j would bring together, if any."""
        for x in self.members[self.head[i]] if self.never else ():
            for y in self.members[self.head[j]]:
                pair = (min(x, y), max(x, y))
                if pair in self.never:
                    return pair
        return None

    def join(self, i: int, j: int, T_i_j: FloatArray) -> None:
        """Merge the components of i and j into one frame."""
        into, gone = self.head[i], self.head[j]
        if len(self.members[into]) < len(self.members[gone]):
            self.join(j, i, inverse(T_i_j))
            return
        move = compose(compose(self.pose[i], T_i_j), inverse(self.pose[j]))
        runs = self.members.pop(gone)
        self.pose[runs] = compose(move, self.pose[runs])
        self.members[into] += runs
        for run in runs:
            self.head[run] = into


@dataclass(frozen=True, slots=True)
class Refusal:
    """Why a pair was not joined in spite of its evidence; advice: what would settle it, if that is
    not another recording."""

    reason: str
    advice: str | None = None


ELSEWHERE = Refusal(
    "other runs, matched with more evidence or locked, place the two differently: this match is "
    "set aside"
)


def as_alignment(c: Candidate) -> Alignment:
    """The candidate as the alignment by which two runs are joined."""
    return Alignment(c.transform, c.bits, np.column_stack([c.a, c.b]), c.rmse_m)


def agrees(found: Alignment, T_a_b: FloatArray, b: ComplexArray) -> bool:
    """Whether an alignment places b as T_a_b does, within the drift of chained transforms.

    b: (n,) junctions of b, x + iy [m]. Where views alone match, the overlap may lie anywhere in b.
    """
    centre = b.mean() if len(b) else np.complex128(0)
    middle, reach = centre, float(np.abs(b - centre).max(initial=0.0))
    matched = b[found.matched[:, 1]]
    if len(matched):
        middle = matched.mean()
        reach = abs(complex(middle - centre))
    here, there = (_laid(T, middle) for T in (found.transform, T_a_b))
    gap = abs(complex(here - there))
    turn = abs(float(wrap(found.transform[2] - T_a_b[2])))
    return gap < MATCH.place_m + MATCH.drift_per_m * reach and turn < MATCH.turn_rad


def join_all(
    components: Components,
    strongest_first: Sequence[Pair],
    best: Mapping[Pair, Alignment],
    places: Sequence[ComplexArray],
    runs: Sequence[str],
    *,
    refusal: Callable[[Components, Pair], Refusal | None] = lambda components, pair: None,
) -> dict[Pair, Refusal]:
    """Join pairs in order of strength. Returns the pairs that were refused, with the reason.

    places: of every run its junctions (x + iy); refusal: further objections to joining the
    components of a pair. A pair that closes a cycle must place its runs as the stronger pairs
    around the cycle do; in a contradiction the weakest link, which comes last, is refused.
    """
    refused: dict[Pair, Refusal] = {}
    for i, j in strongest_first:
        alignment = best[i, j]
        if components.together(i, j):
            if not agrees(alignment, components.relative(i, j), places[j]):
                refused[i, j] = ELSEWHERE
            continue
        kept_apart = components.forbidden(i, j)
        if kept_apart is not None:
            x, y = (runs[k] for k in kept_apart)
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


def lying_over(components: Components, places: Sequence[ComplexArray]) -> list[Pair]:
    """Pairs i < j of one component with at least `MATCH.fewest` junctions within `MATCH.place_m` of
    each other in the component's frame. places: of every run its junctions (x + iy)."""
    out: list[Pair] = []
    for members in components.members.values():
        if len(members) < 2:
            continue
        runs = sorted(members)
        laid = [_laid(components.pose[k], places[k]) for k in runs]
        owner = np.arange(len(runs)).repeat([len(z) for z in laid])
        near = cKDTree(np.concatenate(laid).view(np.float64).reshape(-1, 2)).query_pairs(
            MATCH.place_m, output_type="ndarray"
        )
        both = np.sort(owner[near], axis=1)
        pair, shared = np.unique(both[both[:, 0] < both[:, 1]], axis=0, return_counts=True)
        out += [(runs[i], runs[j]) for i, j in pair[shared >= MATCH.fewest].tolist()]
    return sorted(out)


def _laid(pose: FloatArray, z: ComplexArray | np.complex128) -> ComplexArray:
    """Points z, x + iy [m], moved by a pose (3,)."""
    x, y, theta = pose.tolist()
    return np.asarray(np.exp(1j * theta) * z + (x + 1j * y))


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
        of_all = {p: v.same_place_bits for p, v in known.items()}
        tested = {p: bits for p, bits in of_all.items() if np.isfinite(bits)}
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
        rows = [_common_corridors(*self._maps(p), across[p].matched) for p in pairs]
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


def _common_corridors(a: Prepared, b: Prepared, matched: IntArray) -> IntArray:
    """(c, 2) directed rows of the corridors of two maps between matched junctions."""
    partner = np.full(len(b), -1)
    partner[matched[:, 1]] = matched[:, 0]
    tail, head = partner[b.tail], partner[b.head]
    rows = np.flatnonzero((tail >= 0) & (head >= 0) & (np.arange(len(b.tail)) < b.reverse))
    key = tail[rows] * len(a) + head[rows]
    row_a, there = a.by_ends.find(key)
    return np.column_stack([row_a[there], rows[there]])
