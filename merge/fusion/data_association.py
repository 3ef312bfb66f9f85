"""Vertices of different runs that lie on each other once their maps share a frame.

No pair of maps need have matched them: a corner that only one run knew when it met the second, a
match too small to count alone. They are fused when each is the other's nearest, near enough, their
branches fit and the corridors around them bear it out; whatever is doubtful stays apart.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.cluster.hierarchy import DisjointSet
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from ...topology.arrays import BoolArray, ComplexArray, FloatArray, IntArray
from ...topology.matching.branches import mutual_nearest, unit_headings
from ...topology.passes import NO_BRANCH
from .joint_graph import pass_counts
from .vertex_partition import Groups, Pool


@dataclass(frozen=True, slots=True)
class CoincidenceSettings:
    """When two vertices that nothing matched are still one place."""

    gate_m: float = 0.5
    """Distance allowed beside a place that several runs share …"""
    gate_per_m: float = 0.04
    """… and how it grows with the way driven from there …"""
    max_gate_m: float = 1.5
    """… up to this."""
    lead: float = 1.6
    """The next candidate must be further away by this factor."""
    branch_gate_rad: float = 0.45
    """Branches fit within this angle."""
    spare_branches: int = 1
    """Branches that either vertex may have and the other not."""
    length_m: float = 0.5
    """Corridors agree in length within this …"""
    length_share: float = 0.06
    """… plus this share of it."""
    min_chain: int = 3
    """Runs that were not matched with each other coincide in at least so many joined places, or in
    so many within `gate_m`."""
    rounds: int = 4
    """Rounds of "fuse what coincides, optimise again"."""


COINCIDENCE = CoincidenceSettings()


@dataclass(frozen=True, slots=True)
class _Leg:
    """A corridor seen from one row: the row at its other end and its length."""

    far: int
    length: float


class _Surroundings:
    """Branches and corridors of every row of a pool, in the component's frame."""

    def __init__(self, pool: Pool, pose: FloatArray, label: IntArray) -> None:
        self.label = label
        self.units: list[ComplexArray] = []
        self.legs: list[dict[int, _Leg]] = [{} for _ in range(len(pool))]
        for m in pool.maps:
            first = pool.first[m.run]
            self.units += [unit_headings(m.branches[v] + pose[first + v, 2]) for v in range(len(m))]
            columns = (m.source, m.source_branch, m.target, m.target_branch, m.length)
            for s, i, t, j, length in zip(*(c.tolist() for c in columns), strict=True):
                if NO_BRANCH not in {i, j}:
                    self.legs[first + s][i] = _Leg(first + t, length)
                    self.legs[first + t][j] = _Leg(first + s, length)

    def partners(self, u: int, v: int, gate_rad: float) -> list[tuple[int, int]]:
        """Mutually nearest branches of two rows within a gate."""
        pairs = mutual_nearest(self.units[u][None], self.units[v][None], float(np.cos(gate_rad)))
        i = pairs.paired[0].nonzero()[0]
        return list(zip(i.tolist(), pairs.nearest[0, i].tolist(), strict=True))


def coincident(
    pool: Pool, groups: Groups, pose: FloatArray, matched: Iterable[tuple[str, str]] = ()
) -> list[tuple[int, int]]:
    """Pairs of rows whose groups are one place, nearest first.

    pose: (n, 3) of every row in the component's frame; matched: pairs of runs with an accepted
    match. Two runs that were matched need no further support than their position; others need a
    corridor that leads both to a place they share, or several places, joined alike or very near. A
    corridor that leaves both by the same branch and differs in length speaks against.
    """
    label = groups.labels()
    around = _Surroundings(pool, pose, label)
    candidates = _candidates(pool, label, pose, around)
    direct = {frozenset(pair) for pair in matched}
    runs = [frozenset(r) for r in _runs_of(pool, label)]
    names = [m.run for m in pool.maps]
    chains = _Chains([(u, v) for u, v, _ in candidates], around)
    fair = [(u, v, distance) for u, v, distance in candidates if not chains.contradicted(u, v)]
    between = [
        {frozenset((names[r], names[s])) for r in runs[label[u]] for s in runs[label[v]]}
        for u, v, _ in fair
    ]
    near = Counter(
        pair
        for (_, _, distance), pairs in zip(fair, between, strict=True)
        if distance <= COINCIDENCE.gate_m
        for pair in pairs
    )
    often = direct | {pair for pair, count in near.items() if count >= COINCIDENCE.min_chain}
    return [
        (u, v)
        for (u, v, _), pairs in zip(fair, between, strict=True)
        if pairs & often or chains.anchored(u, v) or chains.size(u, v) >= COINCIDENCE.min_chain
    ]


class _Chains:
    """Candidate pairs joined by corridors that agree, and what speaks for and against each."""

    def __init__(self, candidates: list[tuple[int, int]], around: _Surroundings) -> None:
        self._around = around
        self._place = {}
        for k, (u, v) in enumerate(candidates):
            label = around.label
            self._place[(int(label[u]), int(label[v]))] = k
            self._place[(int(label[v]), int(label[u]))] = k
        self._number = {pair: k for k, pair in enumerate(candidates)}
        self._joined = DisjointSet(range(len(candidates)))
        for pair, k in self._number.items():
            for far in self._agreeing(*pair):
                if far in self._place:
                    self._joined.merge(k, self._place[far])

    def size(self, u: int, v: int) -> int:
        """Candidate pairs in the chain of this one."""
        return self._joined.subset_size(self._number[u, v])

    def anchored(self, u: int, v: int) -> bool:
        """Whether an agreeing corridor leads both to one place that is already shared."""
        return any(x == y for x, y in self._agreeing(u, v))

    def contradicted(self, u: int, v: int) -> bool:
        """Whether more corridors disagree than agree."""
        good = len(self._agreeing(u, v))
        return len(self._both_driven(u, v)) - good > good

    def _both_driven(self, u: int, v: int) -> list[tuple[_Leg, _Leg]]:
        around = self._around
        pairs = around.partners(u, v, COINCIDENCE.branch_gate_rad)
        both = ((around.legs[u].get(i), around.legs[v].get(j)) for i, j in pairs)
        return [(x, y) for x, y in both if x is not None and y is not None]

    def _agreeing(self, u: int, v: int) -> list[tuple[int, int]]:
        """Places at the far ends of corridors that leave both rows alike and agree in length."""
        s, label = COINCIDENCE, self._around.label
        return [
            (int(label[x.far]), int(label[y.far]))
            for x, y in self._both_driven(u, v)
            if abs(x.length - y.length) <= s.length_m + s.length_share * min(x.length, y.length)
        ]


def _candidates(
    pool: Pool, label: IntArray, pose: FloatArray, around: _Surroundings
) -> list[tuple[int, int, float]]:
    """Rows of places that no run has both of, clearly each other's nearest, branches fitting; and
    the distances [m] of the places."""
    visits = pass_counts(pool)
    best = np.lexsort((np.arange(len(pool)), -visits, label))
    speaker = best[np.searchsorted(label[best], np.arange(int(label.max(initial=-1)) + 1))]
    if len(speaker) < 2:
        return []
    weight = np.bincount(label)
    centre = np.stack([np.bincount(label, pose[:, k]) / weight for k in (0, 1)], axis=-1)
    gate = _gates(pool, label)
    pairs = cKDTree(centre).query_pairs(
        COINCIDENCE.max_gate_m * COINCIDENCE.lead, output_type="ndarray"
    )
    runs = _runs_of(pool, label)
    apart = np.array([runs[i].isdisjoint(runs[j]) for i, j in pairs.tolist()], bool)
    u, v = pairs[apart].T if len(pairs) else (np.zeros(0, np.int64),) * 2
    distance = np.hypot(*(centre[u] - centre[v]).T)
    clear = _clearly_nearest(u, v, distance, len(centre), COINCIDENCE.lead)
    keep = np.flatnonzero(clear & (distance <= np.maximum(gate[u], gate[v])))
    order = keep[np.lexsort((v[keep], u[keep], distance[keep]))]
    rows = [(int(speaker[u[k]]), int(speaker[v[k]]), float(distance[k])) for k in order]
    return [(r, s, d) for r, s, d in rows if _branches_fit(around, r, s)]


def _branches_fit(around: _Surroundings, u: int, v: int) -> bool:
    """Whether all but a few branches of two rows point the same ways."""
    pairs = len(around.partners(u, v, COINCIDENCE.branch_gate_rad))
    lone = max(len(around.units[u]), len(around.units[v])) - pairs
    return lone <= COINCIDENCE.spare_branches and (pairs > 0 or lone == 0)


def _runs_of(pool: Pool, label: IntArray) -> list[set[int]]:
    runs: list[set[int]] = [set() for _ in range(int(label.max(initial=-1)) + 1)]
    for place, run in zip(label.tolist(), pool.run.tolist(), strict=True):
        runs[place].add(run)
    return runs


def _gates(pool: Pool, label: IntArray) -> FloatArray:
    """(places,) distance allowed at each place, from the way to the nearest shared one."""
    count = int(label.max()) + 1
    ends = np.concatenate(
        [np.stack([m.source, m.target]) + pool.first[m.run] for m in pool.maps], axis=1
    )
    length = np.concatenate([m.length for m in pool.maps])
    u, v = label[ends]
    # Parallel corridors would add up in a sparse matrix: keep the shortest.
    low, high = np.minimum(u, v), np.maximum(u, v)
    order = np.lexsort((length, high, low))
    _, once = np.unique(low[order] * count + high[order], return_index=True)
    rows = order[once]
    graph = coo_array((length[rows], (low[rows], high[rows])), (count, count)).tocsr()
    shared = np.flatnonzero(np.bincount(label) > 1)
    if len(shared) == 0:
        return np.full(count, COINCIDENCE.gate_m)
    way = dijkstra(graph, directed=False, indices=shared, min_only=True)
    reach = np.where(np.isfinite(way), COINCIDENCE.gate_m + COINCIDENCE.gate_per_m * way, np.inf)
    return np.minimum(reach, COINCIDENCE.max_gate_m)


def _clearly_nearest(
    u: IntArray, v: IntArray, distance: FloatArray, count: int, lead: float
) -> BoolArray:
    """Pairs of which each is the other's nearest, with the next candidates clearly further."""
    best, second = np.full(count, np.inf), np.full(count, np.inf)
    for k in np.argsort(distance, kind="stable").tolist():
        for end in (u[k], v[k]):
            if np.isinf(best[end]):
                best[end] = distance[k]
            elif np.isinf(second[end]):
                second[end] = distance[k]
    first = (distance <= best[u]) & (distance <= best[v])
    rival = np.minimum(second[u], second[v])
    return np.asarray(first & (rival >= lead * np.maximum(distance, 1e-9)))
