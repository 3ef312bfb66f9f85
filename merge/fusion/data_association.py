"""Data association by position: vertices of different runs that coincide in a component's frame.

Not all of these were matched by a pair of maps: a match may be too small to be accepted, or two
runs may be placed through others only. Two vertices are fused if each is the other's nearest within
a gate, their branches fit and the corridors around them agree; doubtful ones are kept apart.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from ...topology.arrays import BoolArray, ComplexArray, FloatArray, IntArray
from ...topology.matching.branches import mutual_nearest, unit_headings
from ...topology.matching.likelihood import LIKELIHOOD
from ...topology.passes import NO_BRANCH
from .edges import CORRIDOR
from .joint_graph import pass_counts
from .vertex_partition import Groups, Pool


@dataclass(frozen=True, slots=True)
class CoincidenceSettings:
    """When two unmatched vertices are one place."""

    gate_m: float = 2 * LIKELIHOOD.gate_m
    """Gate on the distance. Tried: .9 and 1.5 fuse the same places in 23 merges, .5 one place fewer
    in two of them."""
    lead: float = 1.6
    """Least ratio of the second nearest candidate's distance to the nearest one's."""
    spare_branches: int = 1
    """Number of unpaired branches allowed."""
    min_chain: int = 3
    """Least number of coincident places within `LIKELIHOOD.gate_m` of two unmatched runs."""


COINCIDENCE = CoincidenceSettings()


class _Surroundings:
    """units: branches of every row of a pool in the component's frame, as unit numbers; lengths: of
    the corridors of every row, by branch [m]."""

    def __init__(self, pool: Pool, pose: FloatArray) -> None:
        self.units: list[ComplexArray] = []
        self.lengths: list[dict[int, float]] = [{} for _ in range(len(pool))]
        for m in pool.maps:
            first = pool.first[m.run]
            self.units += [unit_headings(m.branches[v] + pose[first + v, 2]) for v in range(len(m))]
            columns = (m.source, m.source_branch, m.target, m.target_branch, m.length)
            for s, i, t, j, length in zip(*(c.tolist() for c in columns), strict=True):
                if NO_BRANCH not in {i, j}:
                    self.lengths[first + s][i] = length
                    self.lengths[first + t][j] = length

    def partners(self, u: int, v: int) -> list[tuple[int, int]]:
        """Mutually nearest branches of two rows, within a gate."""
        pairs = mutual_nearest(self.units[u][None], self.units[v][None])
        i = pairs.paired[0].nonzero()[0]
        return list(zip(i.tolist(), pairs.nearest[0, i].tolist(), strict=True))

    def contradicted(self, u: int, v: int) -> bool:
        """Whether more corridors by paired branches disagree in length than agree."""
        pairs = self.partners(u, v)
        lengths = [(self.lengths[u].get(i), self.lengths[v].get(j)) for i, j in pairs]
        agreements = [
            abs(x - y) <= CORRIDOR.allowed_m(min(x, y))
            for x, y in lengths
            if x is not None and y is not None
        ]
        return 2 * sum(agreements) < len(agreements)


def coincident(
    pool: Pool, groups: Groups, pose: FloatArray, matched: Iterable[tuple[str, str]] = ()
) -> list[tuple[int, int]]:
    """Pairs of rows whose groups are one place, nearest first.

    pose: (n, 3) of every row in the component's frame; matched: pairs of runs with an accepted
    match. For two matched runs coincidence is enough, others need several coincident places within
    `LIKELIHOOD.gate_m`. A pair with more disagreeing than agreeing corridors is rejected. (Tried:
    also fusing pairs with a corridor from both to a place that they share, and chains of pairs that
    agreeing corridors connect. Of 23 merges of up to 8 runs it changes none.)
    """
    label = groups.labels()
    around = _Surroundings(pool, pose)
    candidates = _candidates(pool, label, pose, around)
    likely = [c for c in candidates if not around.contradicted(*c[:2])]
    runs, names = _runs_of(pool, label), [m.run for m in pool.maps]
    run_pairs = [
        {frozenset((names[r], names[s])) for r in runs[label[u]] for s in runs[label[v]]}
        for u, v, _ in likely
    ]
    near = Counter(
        pair
        for (_, _, distance), pairs in zip(likely, run_pairs, strict=True)
        if distance <= LIKELIHOOD.gate_m
        for pair in pairs
    )
    allowed = {frozenset(pair) for pair in matched}
    allowed |= {pair for pair, count in near.items() if count >= COINCIDENCE.min_chain}
    return [(u, v) for (u, v, _), pairs in zip(likely, run_pairs, strict=True) if pairs & allowed]


def _candidates(
    pool: Pool, label: IntArray, pose: FloatArray, around: _Surroundings
) -> list[tuple[int, int, float]]:
    """Pairs of places that share no run, are each other's nearest by a margin, and whose branches
    fit, nearest first: for both the row with most passes, and their distance [m].

    label: (n,) place of each row; pose: (n, 3).
    """
    by_passes = np.lexsort((-pass_counts(pool), label))
    most_passed = by_passes[np.unique(label[by_passes], return_index=True)[1]]
    if len(most_passed) < 2:
        return []
    size = np.bincount(label)
    centre = np.stack([np.bincount(label, pose[:, k]) / size for k in (0, 1)], axis=-1)
    pairs = cKDTree(centre).query_pairs(
        COINCIDENCE.gate_m * COINCIDENCE.lead, output_type="ndarray"
    )
    runs = _runs_of(pool, label)
    disjoint = np.array([runs[i].isdisjoint(runs[j]) for i, j in pairs.tolist()], bool)
    u, v = pairs[disjoint].T
    distance = np.hypot(*(centre[u] - centre[v]).T)
    is_clear = _clearly_nearest(u, v, distance, len(centre), COINCIDENCE.lead)
    chosen = np.flatnonzero(is_clear & (distance <= COINCIDENCE.gate_m))
    order = chosen[np.lexsort((v[chosen], u[chosen], distance[chosen]))]
    one, other = most_passed[u[order]].tolist(), most_passed[v[order]].tolist()
    rows = zip(one, other, distance[order].tolist(), strict=True)
    return [(r, s, d) for r, s, d in rows if _branches_fit(around, r, s)]


def _branches_fit(surroundings: _Surroundings, u: int, v: int) -> bool:
    """Whether at most `spare_branches` branches are unpaired, and one is paired, if any."""
    pairs = len(surroundings.partners(u, v))
    unpaired = max(len(surroundings.units[u]), len(surroundings.units[v])) - pairs
    return unpaired <= COINCIDENCE.spare_branches and (pairs > 0 or unpaired == 0)


def _runs_of(pool: Pool, label: IntArray) -> list[set[int]]:
    """For each place the runs that saw it. label: (n,) place of each row."""
    runs: list[set[int]] = [set() for _ in range(int(label.max(initial=-1)) + 1)]
    for place, run in zip(label.tolist(), pool.run.tolist(), strict=True):
        runs[place].add(run)
    return runs


def _clearly_nearest(
    u: IntArray, v: IntArray, distance: FloatArray, count: int, lead: float
) -> BoolArray:
    """Pairs that are each other's nearest, with the second nearest `lead` times as far."""
    best, second = np.full(count, np.inf), np.full(count, np.inf)
    for k in np.argsort(distance, kind="stable").tolist():
        for end in (u[k], v[k]):
            if np.isinf(best[end]):
                best[end] = distance[k]
            elif np.isinf(second[end]):
                second[end] = distance[k]
    mutual = (distance <= best[u]) & (distance <= best[v])
    second_nearest = np.minimum(second[u], second[v])
    return np.asarray(mutual & (second_nearest >= lead * np.maximum(distance, 1e-9)))
