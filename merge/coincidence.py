"""Vertices of different runs that lie on each other once their maps share a frame.

No pair of maps need have matched them: a corner that only one run knew when it met the second, a
match too small to count alone. They are fused when each is the other's nearest, near enough, and
their branches fit; whatever is doubtful stays apart.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from ..topology.se2 import wrap
from .identity import Groups, Pool
from .joint import branch_headings

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


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


DEFAULT_COINCIDENCE = CoincidenceSettings()


def coincident(
    pool: Pool,
    groups: Groups,
    pose: FloatArray,
    settings: CoincidenceSettings = DEFAULT_COINCIDENCE,
) -> list[tuple[int, int]]:
    """Pairs of rows whose groups are one place, nearest pairs first; rows are groups' heads."""
    label = groups.labels()
    heads = np.unique([groups.head(r) for r in range(len(pool))])
    if len(heads) < 2:
        return []
    centre = _means(label, pose[:, :2])[label[heads]]
    gate = _gates(pool, label, settings)[label[heads]]
    u, v = cKDTree(centre).query_pairs(settings.max_gate_m * settings.lead, output_type="ndarray").T
    runs = _runs_of(pool, label)
    apart = np.array(
        [not (runs[label[heads[i]]] & runs[label[heads[j]]]) for i, j in zip(u, v, strict=True)],
        bool,
    )
    u, v = u[apart], v[apart]
    distance = np.hypot(*(centre[u] - centre[v]).T)
    clear = _clearly_nearest(u, v, distance, len(heads), settings.lead)
    near = distance <= np.maximum(gate[u], gate[v])
    fit = _branches_fit(pool, heads[u], heads[v], pose, settings)
    keep = np.flatnonzero(clear & near & fit)
    order = keep[np.lexsort((v[keep], u[keep], distance[keep]))]
    return [(int(heads[u[k]]), int(heads[v[k]])) for k in order]


def _means(label: IntArray, xy: FloatArray) -> FloatArray:
    count = np.bincount(label)
    return np.stack([np.bincount(label, xy[:, k]) / count for k in (0, 1)], axis=-1)


def _runs_of(pool: Pool, label: IntArray) -> list[set[int]]:
    runs: list[set[int]] = [set() for _ in range(int(label.max()) + 1)]
    for place, run in zip(label.tolist(), pool.run.tolist(), strict=True):
        runs[place].add(run)
    return runs


def _gates(pool: Pool, label: IntArray, settings: CoincidenceSettings) -> FloatArray:
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
        return np.full(count, settings.gate_m)
    way = dijkstra(graph, directed=False, indices=shared, min_only=True)
    reach = np.where(np.isfinite(way), settings.gate_m + settings.gate_per_m * way, np.inf)
    return np.minimum(reach, settings.max_gate_m)


def _clearly_nearest(
    u: IntArray, v: IntArray, distance: FloatArray, count: int, lead: float
) -> NDArray[np.bool_]:
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


def _branches_fit(
    pool: Pool, u: IntArray, v: IntArray, pose: FloatArray, settings: CoincidenceSettings
) -> NDArray[np.bool_]:
    """Whether the branches of two rows point the same ways in the component's frame."""
    heading = branch_headings(pool)
    if heading.shape[1] == 0 or len(u) == 0:
        return np.ones(len(u), bool)
    ha, hb = heading[u] + pose[u, 2:], heading[v] + pose[v, 2:]
    off = np.abs(wrap(ha[:, :, None] - hb[:, None, :]))
    off = np.where(np.isnan(off), np.inf, off)
    hit = off <= settings.branch_gate_rad
    lone_a = (~hit.any(axis=2) & ~np.isnan(ha)).sum(axis=1)
    lone_b = (~hit.any(axis=1) & ~np.isnan(hb)).sum(axis=1)
    spare = settings.spare_branches
    return np.asarray(hit.any(axis=(1, 2)) & (lone_a <= spare) & (lone_b <= spare))
