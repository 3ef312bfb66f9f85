"""The chordal start: where graphs whose poses are known badly, or not at all, begin to be solved.

Headings enter the problem nonlinearly, as unit complex numbers z = exp(iθ). Dropping |z| = 1 makes
"z_j = z_i exp(iθ_ij) for every edge" one linear least-squares problem (Carlone, Tron, Daniilidis,
Dellaert: Initialization Techniques for 3D SLAM, ICRA 2015, §III-B; in the plane it is n complex
unknowns); its solution, scaled back to |z| = 1, is near the optimum where plain Gauss–Newton from
odometry ends in a local minimum. With headings known, positions are linear.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

from topobatch.topology.arrays import FloatArray
from topobatch.topology.posegraph import solve as solver
from topobatch.topology.posegraph.graph import PoseGraph, corrected_measurement
from topobatch.topology.posegraph.skeleton import (
    Skeleton,
    _first_without,
    _groups,
    skeleton,
    summed,
)
from topobatch.topology.posegraph.solve import Solution


def solve(graph: PoseGraph) -> Solution:
    """`topobatch.topology.posegraph.solve.solve` from the chordal start."""
    if len(graph) == 0:
        return solver.solve(graph)
    start = chordal_start(graph, skeleton(graph), np.zeros(len(graph.shared)))
    return solver.solve(replace(graph, pose=start))


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
    out[order] = splu(
        matrix, permc_spec="NATURAL", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
    ).solve(np.ascontiguousarray(right[order]))
    return out


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
