"""Clusters of hypotheses that place one map over the other alike (§3.2).

Distance between two transforms: mean squared displacement, between the one and the other, of the
vertices that either hypothesis matches, and of points one corridor's length around them, so that a
rotation counts at a single vertex too. In metres squared, like the errors it is compared with.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.spatial import cKDTree

from ...topology.arrays import FloatArray, IntArray
from ...topology.connected import connected
from ...topology.se2 import apply
from .hypotheses import Hypotheses
from .registration import Weights, fit_groups


@dataclass(frozen=True, slots=True)
class ClusterSettings:
    """Thresholds of clustering in transform space."""

    error_factor: float = 3.0
    """The threshold is this many times the largest mean squared error of a hypothesis (§5)."""
    floor_m: float = 0.1
    """Transforms this close are always in one cluster: exact hypotheses have no error to set a
    threshold."""
    lever_m: float = 5.0
    """Distance around a matched vertex at which a rotation counts: a typical corridor."""
    weights: Weights = "equal"
    """Weights of matched vertices in the transforms of clusters (§3.1)."""
    iterative: bool = False
    """Reassign hypotheses by their metric error under a cluster's transform (§5)."""
    rounds: int = 10
    """Most rounds of reassignment."""
    largest_dense: int = 3000
    """On general angles, with more hypotheses than this, those of one vertex are left out."""


DEFAULT_CLUSTERS = ClusterSettings()


@dataclass(frozen=True, slots=True, eq=False)
class Clusters:
    """C clusters in order of quality (§3.2): vertices, then error, then the largest hypothesis.

    of: (H,) cluster of each hypothesis, -1 if it was left out; transform: (C, 3) T_a_b over all
    pairs of the cluster; vertices: (C,) matched vertex pairs; hypotheses: (C,); largest: (C,)
    vertices of its largest hypothesis; squared_error: (C,) total squared distance of the pairs
    under the cluster's transform [m²]; threshold: the squared distance used [m²].
    """

    of: IntArray
    transform: FloatArray
    vertices: IntArray
    hypotheses: IntArray
    largest: IntArray
    squared_error: FloatArray
    threshold: float

    def __len__(self) -> int:
        return len(self.vertices)


def cluster(
    h: Hypotheses, xy: tuple[FloatArray, FloatArray], settings: ClusterSettings = DEFAULT_CLUSTERS
) -> Clusters:
    """Cluster hypotheses by complete linkage: any two of a cluster are within the threshold.

    xy: positions (n, 2) of a's vertices and of b's [m]. O(H log H) in the hypotheses of a
    rectilinear world, O(H²) on general angles.
    """
    kept = np.arange(len(h))
    if not h.rectilinear and len(h) > settings.largest_dense:
        kept = np.flatnonzero(h.size > 1)[: settings.largest_dense]
    largest = float(h.error[kept].max(initial=0.0))
    threshold = max(settings.floor_m**2, settings.error_factor * largest)
    of = np.full(len(h), -1, np.int64)
    of[kept] = _complete_linkage(h, kept, xy[1], threshold, settings)
    if settings.iterative:
        of = _readmitted(h, of, xy, threshold, settings)
    return _ranked(h, of, xy, threshold, settings)


def _complete_linkage(
    h: Hypotheses, kept: IntArray, xy_b: FloatArray, threshold: float, settings: ClusterSettings
) -> IntArray:
    """(kept,) cluster of each hypothesis."""
    # Strategy: complete linkage never joins across components of the graph of pairs within the
    # threshold, so scipy's linkage runs on each of these (mostly tiny) components alone.
    i, j = _near_pairs(h, kept, xy_b, threshold, settings)
    part = connected(i, j, len(kept))
    order = np.argsort(part, kind="stable")
    first = np.searchsorted(part[order], np.arange(int(part.max(initial=-1)) + 2))
    out = np.zeros(len(kept), np.int64)
    out[order] = np.arange(len(kept))  # alone, unless the linkage below says otherwise
    for k in np.flatnonzero(np.diff(first) > 1).tolist():
        low, rows = first[k], order[first[k] : first[k + 1]]
        if len(rows) == 2:
            out[rows] = low
        else:
            distance = transform_distances(h, kept[rows], xy_b, settings.lever_m)
            tree = linkage(distance[np.triu_indices(len(rows), 1)], method="complete")
            out[rows] = low + fcluster(tree, threshold, criterion="distance") - 1
    return out


def _near_pairs(
    h: Hypotheses, kept: IntArray, xy_b: FloatArray, threshold: float, settings: ClusterSettings
) -> tuple[IntArray, IntArray]:
    """Pairs of hypotheses within the threshold, as positions in `kept`."""
    if not h.rectilinear:
        distance = transform_distances(h, kept, xy_b, settings.lever_m)
        i, j = np.nonzero(distance <= threshold)
        return i[i < j], j[i < j]
    # Equal rotations move every point alike: translations in a tree, the rotations far apart.
    turn = np.unique(np.rint(h.transform[kept, 2] * 1e6), return_inverse=True)[1]
    reach = np.sqrt(threshold)
    apart = 2 * reach + 1.0
    tree = cKDTree(np.column_stack([h.transform[kept, :2], turn * apart]))
    pairs = tree.query_pairs(reach, output_type="ndarray")
    return pairs[:, 0], pairs[:, 1]


def transform_distances(
    h: Hypotheses, rows: IntArray, xy_b: FloatArray, lever_m: float
) -> FloatArray:
    """(k, k) mean squared displacement [m²] between the transforms of hypotheses.

    Strategy: with points as complex numbers T(p) = u p + t, so the mean of |Δu p + Δt|² over points
    is |Δu|² M2 + 2 Re(conj(Δt) Δu M1) + |Δt|²: the moments of both point sets suffice.
    """
    z = xy_b[h.vertex_b] @ np.array([1.0, 1j])
    count = h.size[rows].astype(np.float64)
    first = np.bincount(h.of, z.real, len(h)) + 1j * np.bincount(h.of, z.imag, len(h))
    second = np.bincount(h.of, np.abs(z) ** 2, len(h))
    # Moments about the centroid of all points: far from the origin they would lose digits.
    middle = z.mean() if len(z) else 0.0
    second = second - 2 * (np.conj(middle) * first).real + h.size * np.abs(middle) ** 2
    first = first - h.size * middle
    m1, m2 = first[rows], second[rows]
    u = np.exp(1j * h.transform[rows, 2])
    t = h.transform[rows, :2] @ np.array([1.0, 1j]) + u * middle
    du, dt = u[:, None] - u[None, :], t[:, None] - t[None, :]
    n = count[:, None] + count[None, :]
    mean1, mean2 = (m1[:, None] + m1[None, :]) / n, (m2[:, None] + m2[None, :]) / n
    turn = np.abs(du) ** 2
    out = turn * (mean2 + lever_m**2) + 2 * (np.conj(dt) * du * mean1).real + np.abs(dt) ** 2
    if h.rectilinear:  # the four rotations are four spaces (§3.3)
        out = np.where(turn > 1e-6, np.inf, out)
    return np.asarray(np.maximum(out, 0.0))


def _readmitted(
    h: Hypotheses,
    of: IntArray,
    xy: tuple[FloatArray, FloatArray],
    threshold: float,
    settings: ClusterSettings,
) -> IntArray:
    """(H,) clusters after moving hypotheses to the largest cluster under whose transform their own
    error is small (§5).

    As in iterative closest point: transforms are estimated again after every round, until nothing
    changes. A hypothesis leaves its cluster only for a larger one, so that the rounds terminate.
    """
    rectilinear_turn = np.rint(h.transform[:, 2] * 1e9)  # equal rotations only, where exact
    for _ in range(settings.rounds):
        clusters = _ranked(h, of, xy, threshold, settings)
        of = clusters.of.copy()
        for c in range(len(clusters)):
            T = clusters.transform[c]
            residual = xy[0][h.vertex_a] - apply(T, xy[1][h.vertex_b])
            error = np.bincount(h.of, (residual**2).sum(axis=1), len(h)) / h.size
            turn = np.abs(np.exp(1j * h.transform[:, 2]) - np.exp(1j * T[2])) * settings.lever_m
            fits = (error <= threshold) & (
                rectilinear_turn == np.rint(T[2] * 1e9)
                if h.rectilinear
                else (turn**2 <= threshold) | (h.size > 1)
            )
            smaller = (of > c) | (of < 0)
            of = np.where(fits & smaller, c, of)
        if np.array_equal(of, clusters.of):
            break
    return of


def _ranked(
    h: Hypotheses,
    of: IntArray,
    xy: tuple[FloatArray, FloatArray],
    threshold: float,
    settings: ClusterSettings,
) -> Clusters:
    """Clusters with their transforms and errors, numbered by decreasing quality."""
    kept = np.flatnonzero(of >= 0)
    labels, compact = np.unique(of[kept], return_inverse=True)
    count = len(labels)
    number = np.full(len(h), -1, np.int64)
    number[kept] = compact
    pairs = np.flatnonzero(number[h.of] >= 0)
    group = number[h.of[pairs]]
    p, q = xy[0][h.vertex_a[pairs]], xy[1][h.vertex_b[pairs]]
    size = np.bincount(group, minlength=count)
    turn = np.angle(
        np.bincount(compact, h.size[kept] * np.cos(h.transform[kept, 2]), count)
        + 1j * np.bincount(compact, h.size[kept] * np.sin(h.transform[kept, 2]), count)
    )
    free = (_spread(q, group, count) > 1e-6) & (not h.rectilinear)
    transform = fit_groups(p, q, group, turn, free=free, weights=settings.weights)
    residual = p - apply(transform[group], q) if count else p
    squared = np.bincount(group, (residual**2).sum(axis=1), count)
    largest = np.zeros(count, np.int64)
    np.maximum.at(largest, compact, h.size[kept])
    first = np.full(count, len(h), np.int64)
    np.minimum.at(first, compact, kept)
    order = np.lexsort((first, -largest, np.round(squared, 9), -size))
    number[kept] = np.argsort(order)[compact]
    return Clusters(
        of=number,
        transform=transform[order],
        vertices=size[order],
        hypotheses=np.bincount(compact, minlength=count)[order],
        largest=largest[order],
        squared_error=np.asarray(squared[order], np.float64),
        threshold=threshold,
    )


def _spread(xy: FloatArray, group: IntArray, count: int) -> FloatArray:
    """(count,) extent of the points of each group."""
    low, high = np.full((count, 2), np.inf), np.full((count, 2), -np.inf)
    np.minimum.at(low, group, xy)
    np.maximum.at(high, group, xy)
    return np.asarray((high - low).max(axis=1))
