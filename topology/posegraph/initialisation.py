"""Where Gauss–Newton begins: the chordal start, and the order in which poses are eliminated.

Headings enter the problem nonlinearly, as unit complex numbers z = exp(iθ). Dropping |z| = 1 makes
"z_j = z_i exp(iθ_ij) for every edge" one linear least-squares problem (Carlone, Tron, Daniilidis,
Dellaert: Initialization Techniques for 3D SLAM, ICRA 2015, §III-B; in the plane it is n complex
unknowns); its solution, scaled back to |z| = 1, is near the optimum where plain Gauss–Newton from
odometry ends in a local minimum. With headings known, positions are linear.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import SuperLU, splu

from ..se2 import FloatArray
from .graph import PoseGraph, corrected_measurement

_THIN = 1e-9
"""Information with a smaller determinant than this, as that of a correlation, may be singular."""


@dataclass(frozen=True, slots=True, eq=False)
class Skeleton:
    """What of a pose graph does not change while it is solved.

    order: (n,) poses in an order of elimination that keeps the factors sparse (minimum degree);
    fixed: (n, 3) components of poses that do not move: of one pose per connected piece where its
    frame would be free; rigid: whether that surely leaves no freedom anywhere.
    """

    order: NDArray[np.int64]
    fixed: NDArray[np.bool_]
    rigid: bool


def skeleton(graph: PoseGraph) -> Skeleton:
    """Elimination order and gauge of a graph. O(edges) and one n × n factorisation."""
    n = len(graph)
    order = np.arange(n, dtype=np.int64)
    if n > 1:
        # The fill of the 3n × 3n system follows that of the n × n graph: order the small one.
        links = _connection(graph, np.ones(len(graph.source)), np.ones(n), order)
        order = np.argsort(_factor(links, "MMD_AT_PLUS_A").perm_c).astype(np.int64)
    piece = _groups(graph, graph.information[:, 0, 0] + graph.information[:, 1, 1] > 0)
    fixed = _gauge(graph, piece)
    return Skeleton(order, fixed, _is_rigid(graph, piece, fixed))


def summed(where: NDArray[np.int64], values: NDArray[Any], size: int) -> FloatArray:
    """(size,) sums of `values` by their index `where`."""
    return np.bincount(where, values, size).astype(np.float64, copy=False)


def _groups(graph: PoseGraph, joined: NDArray[np.bool_]) -> NDArray[np.int64]:
    """(n,) connected component of every pose by the edges that are `joined` (m,)."""
    n, ends = len(graph), (graph.source[joined], graph.target[joined])
    links = sparse.csr_array((np.ones(len(ends[0])), ends), shape=(n, n))
    return connected_components(links, directed=False)[1].astype(np.int64)


def _factor(
    matrix: sparse.csc_array, ordering: Literal["NATURAL", "MMD_AT_PLUS_A"] = "NATURAL"
) -> SuperLU:
    """Factors of a Hermitian positive definite matrix, pivots taken from its diagonal."""
    return splu(matrix, permc_spec=ordering, diag_pivot_thresh=0.0, options={"SymmetricMode": True})


def _connection(
    graph: PoseGraph, coupling: NDArray[Any], anchor: FloatArray, order: NDArray[np.int64]
) -> sparse.csc_array:
    """Connection Laplacian, rows and columns in the given order of the poses.

    −coupling at (source, target), its conjugate opposite, Σ|coupling| + anchor on the diagonal.
    """
    n, i, j = len(graph), graph.source, graph.target
    size = np.abs(coupling)
    diagonal = anchor + summed(i, size, n) + summed(j, size, n)
    rank = np.empty(n, np.int64)
    rank[order] = np.arange(n)
    data = np.concatenate([-coupling, -np.conj(coupling), diagonal.astype(coupling.dtype)])
    rows = np.concatenate([rank[i], rank[j], rank])
    columns = np.concatenate([rank[j], rank[i], rank])
    return sparse.csc_array((data, (rows, columns)), shape=(n, n))


def _solved(
    matrix: sparse.csc_array, right: NDArray[Any], order: NDArray[np.int64]
) -> NDArray[Any]:
    """Solution for a right side by pose, of a matrix in elimination order."""
    out = np.empty_like(right)
    out[order] = _factor(matrix).solve(np.ascontiguousarray(right[order]))
    return out


def _gauge(graph: PoseGraph, piece: NDArray[np.int64]) -> NDArray[np.bool_]:
    """(n, 3) components of single poses that make up for a frame that is free.

    piece: (n,) numbers of the pieces that positions tie together. One may be shifted unless a
    position in it is known, and turned about the only one that is. A heading that nothing measures
    fixes nothing and is fixed itself. What else may be free (a pose that sees one landmark only)
    depends on where the poses are: the factors find out (`NormalEquations.factorise`).
    """
    n, prior, weight = len(graph), graph.priors, graph.information
    known = np.zeros((n, 3), bool)
    np.logical_or.at(known, prior.node, np.einsum("kii->ki", prior.information) > 0)
    shifts, turns = weight[:, 0, 0] + weight[:, 1, 1] > 0, weight[:, 2, 2] > 0
    measured = np.zeros(n, bool)
    measured[graph.source[shifts | turns]] = measured[graph.target[turns]] = True
    body = _groups(graph, shifts | turns) if np.any(turns & ~shifts) else piece
    fixed = np.zeros((n, 3), bool)
    fixed[:, 2] |= ~(measured | known[:, 2])
    for axis in range(2):
        fixed[_first_without(piece, known[:, axis]), axis] = True
    # A body of several pieces turns if each of them does, about a point of its own.
    anchors = summed(piece, known[:, 0] | known[:, 1], n)[piece] > 1
    stays = anchors | (known[:, 2] & measured)
    fixed[_first_without(body, stays, measured), 2] = True
    return fixed


def _is_rigid(graph: PoseGraph, piece: NDArray[np.int64], fixed: NDArray[np.bool_]) -> bool:
    """Whether edges that tell a whole pose join every pose to a fixed x, y and heading."""
    xx, xy, xt, _, yy, yt, _, _, tt = graph.information.reshape(-1, 9).T
    volume = xx * (yy * tt - yt * yt) - xy * (xy * tt - yt * xt) + xt * (xy * yt - yy * xt)
    whole = (volume > _THIN * xx * yy * tt) & (xx * yy > xy * xy)
    body = piece if whole.all() else _groups(graph, whole)
    return not any(len(_first_without(body, fixed[:, k])) for k in range(3))


def _first_without(
    group: NDArray[np.int64], has: NDArray[np.bool_], among: NDArray[np.bool_] | None = None
) -> NDArray[np.int64]:
    """First member (`among` some) of every group in which nobody `has` it."""
    lacks = summed(group, has, len(group))[group] == 0
    rows = np.flatnonzero(lacks if among is None else lacks & among)
    return rows[np.unique(group[rows], return_index=True)[1]]


def chordal_start(graph: PoseGraph, frame: Skeleton, shared: FloatArray) -> FloatArray:
    """(n, 3) poses from two linear problems, in the frame that `frame.fixed` and priors set.

    Poses without any heading information keep the heading of the first guess. Two sparse
    factorisations of size n.
    """
    measured = corrected_measurement(graph, shared)
    theta = _chordal_headings(graph, frame, measured)
    xy = _positions(graph, frame, measured, theta)
    return np.column_stack([xy, theta])


def _chordal_headings(graph: PoseGraph, frame: Skeleton, measured: FloatArray) -> FloatArray:
    n = len(graph)
    weight = graph.information[:, 2, 2]
    group = _groups(graph, weight > 0)
    prior = graph.priors
    known = summed(prior.node, prior.information[:, 2, 2], n)
    pull = np.exp(1j * prior.value[:, 2]) * prior.information[:, 2, 2]
    target = summed(prior.node, pull.real, n) + 1j * summed(prior.node, pull.imag, n)
    # One pose of every group that nothing else fixes pulls to its first guess.
    scale = float(np.mean(weight)) if len(weight) else 1.0
    pinned = frame.fixed[:, 2].copy()
    pinned[_first_without(group, pinned | (known > 0))] = True
    anchor = known + np.where(pinned, scale or 1.0, 0.0)
    target += np.where(pinned, (scale or 1.0) * np.exp(1j * graph.pose[:, 2]), 0.0)
    coupling = weight * np.exp(-1j * measured[:, 2])
    z = _solved(_connection(graph, coupling, anchor, frame.order), target, frame.order)
    return np.asarray(np.where(frame.fixed[:, 2], graph.pose[:, 2], np.angle(z)))


def _positions(
    graph: PoseGraph, frame: Skeleton, measured: FloatArray, theta: FloatArray
) -> FloatArray:
    """(n, 2) positions for known headings; every edge weighs the mean of its two directions."""
    n, i, j = len(graph), graph.source, graph.target
    weight = 0.5 * (graph.information[:, 0, 0] + graph.information[:, 1, 1])
    step = weight * np.exp(1j * theta[i]) * (measured[:, 0] + 1j * measured[:, 1])
    pull = summed(j, step.real, n) - summed(i, step.real, n)
    pull = pull + 1j * (summed(j, step.imag, n) - summed(i, step.imag, n))
    prior = graph.priors
    known = 0.5 * (prior.information[:, 0, 0] + prior.information[:, 1, 1])
    at = known * (prior.value[:, 0] + 1j * prior.value[:, 1])
    pull += summed(prior.node, at.real, n) + 1j * summed(prior.node, at.imag, n)
    # One pose of every group that nothing else fixes stays at its first guess.
    pinned = frame.fixed[:, 0] | frame.fixed[:, 1]
    anchor = summed(prior.node, known, n)
    pinned[_first_without(_groups(graph, weight > 0), pinned | (anchor > 0))] = True
    hold = np.where(pinned, 1e6 * weight.max(initial=1.0), 0.0)
    pull += hold * (graph.pose[:, 0] + 1j * graph.pose[:, 1])
    links = _connection(graph, weight, anchor + hold, frame.order)
    z = _solved(links, np.column_stack([pull.real, pull.imag]), frame.order)
    return np.where(frame.fixed[:, :2], graph.pose[:, :2], z)
