"""Components of runs: pairs joined in order of their evidence, with consistency checks of
cycles."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from ...topology.arrays import ComplexArray, FloatArray
from ...topology.se2 import compose, inverse, wrap
from ..result import Alignment
from .alignment import Candidate
from .settings import MATCH

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

    def size(self, head: int) -> int:
        """Number of runs of a component."""
        return len(self.members[head])

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
    x, y, theta = pose.tolist()
    return np.asarray(np.exp(1j * theta) * z + (x + 1j * y))
