"""Fused places: branches and kind of a junction from several visits by several runs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...topology.arrays import FloatArray, IntArray
from ...topology.matching.branches import mutual_nearest
from ...topology.passes import NO_BRANCH
from ...topology.ragged import parted
from ...topology.se2 import wrap
from .joint_graph import pass_counts
from .vertex_partition import Pool

MIN_BRANCH_SHARE = 0.3
"""Least share of the passes that saw a branch, if it was never driven."""


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """A fused vertex.

    rows: its members in the pool; headings: (d,) branches in the component's frame [rad],
    ascending; branch_of: for each row, the fused branch of each of its branches, NO_BRANCH for
    dropped ones; kind: by most passes.
    """

    rows: list[int]
    headings: FloatArray
    branch_of: dict[int, IntArray]
    kind: str


@dataclass(frozen=True, slots=True)
class _BranchReading:
    """A branch of one row, in the component's frame [rad]; weight: passes over variance."""

    heading: float
    weight: float
    row: int
    branch: int


def fused_places(pool: Pool, label: IntArray, pose: FloatArray) -> list[Place]:
    """The places of a pool, in the order of their labels. pose: (n, 3) of every row."""
    order = np.argsort(label, kind="stable")
    rows = parted(order, np.bincount(label).tolist())
    visits, driven = pass_counts(pool), _driven(pool)
    degree = [d for m in pool.maps for d in m.degree.tolist()]
    places = []
    for members in (r.tolist() for r in rows):
        clusters = _clusters(pool, members, pose, visits)
        kept = _confirmed(clusters, members, visits, driven)
        means = np.array([_mean(c) for c in kept])
        order = np.argsort(means, kind="stable")
        branch_of = {r: np.full(degree[r], NO_BRANCH, np.int64) for r in members}
        for position, k in enumerate(order.tolist()):
            for s in kept[k]:
                branch_of[s.row][s.branch] = position
        places.append(Place(members, means[order], branch_of, _kind(pool, members, visits)))
    return places


def fused_branches(places: Sequence[Place]) -> list[IntArray]:
    """`Place.branch_of` of all places, as a list by row of the pool."""
    branch_of = {row: fused for place in places for row, fused in place.branch_of.items()}
    return [branch_of[row] for row in range(len(branch_of))]


def _driven(pool: Pool) -> list[set[int]]:
    """For each row the branches that a corridor leaves by."""
    driven: list[set[int]] = [set() for _ in range(len(pool))]
    for m in pool.maps:
        first = pool.first[m.run]
        for vertex, branch in ((m.source, m.source_branch), (m.target, m.target_branch)):
            for v, i in zip(vertex.tolist(), branch.tolist(), strict=True):
                if i != NO_BRANCH:
                    driven[first + v].add(i)
    return driven


def _clusters(
    pool: Pool, rows: list[int], pose: FloatArray, visits: IntArray
) -> list[list[_BranchReading]]:
    """Clusters of the branches of all rows of a place.

    Rows are taken by number of passes; each branch is added to the cluster that it is mutually
    nearest to, or starts a new one.
    """
    clusters: list[list[_BranchReading]] = []
    for row in sorted(rows, key=lambda r: (-int(visits[r]), r)):
        m = pool.maps[int(pool.run[row])]
        headings = wrap(m.branches[int(pool.vertex[row])] + pose[row, 2])
        weight = float(visits[row]) / max(m.noise.branch_rad, 1e-3) ** 2
        centres = np.array([_mean(c) for c in clusters])
        new_units, cluster_units = (np.exp(1j * angles)[None] for angles in (headings, centres))
        pairs = mutual_nearest(new_units, cluster_units)
        paired, nearest = pairs.paired[0], pairs.nearest[0]
        for branch, heading in enumerate(headings.tolist()):
            sighting = _BranchReading(heading, weight, row, branch)
            if paired[branch]:
                clusters[nearest[branch]].append(sighting)
            else:
                clusters.append([sighting])
    return clusters


def _confirmed(
    clusters: list[list[_BranchReading]], rows: list[int], visits: IntArray, driven: list[set[int]]
) -> list[list[_BranchReading]]:
    """Clusters with a branch that was driven, or that enough passes saw."""
    enough = MIN_BRANCH_SHARE * float(visits[rows].sum())
    return [
        c
        for c in clusters
        if any(s.branch in driven[s.row] for s in c)
        or float(visits[[s.row for s in c]].sum()) >= enough
    ]


def _mean(cluster: list[_BranchReading]) -> float:
    """Circular mean heading, weighted by inverse variance (§4)."""
    if len(cluster) == 1:
        return cluster[0].heading
    weight = np.array([s.weight for s in cluster])
    return float(np.angle(weight @ np.exp(1j * np.array([s.heading for s in cluster]))))


def _kind(pool: Pool, rows: list[int], visits: IntArray) -> str:
    """The kind by most passes; in a tie that of the first run."""
    count: Counter[str] = Counter()
    for row in rows:
        count[pool.maps[int(pool.run[row])].kind[int(pool.vertex[row])]] += int(visits[row])
    return max(count, key=lambda kind: count[kind])
