"""Elimination order and gauge of a pose graph, constant while it is solved."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

from ..arrays import BoolArray, FloatArray, IntArray
from ..connected import connected
from .graph import PoseGraph


@dataclass(frozen=True, slots=True, eq=False)
class Skeleton:
    """order: (n,) poses in an elimination order that keeps the factors sparse (minimum degree);
    fixed: (n, 3) pose components that are held fixed, of one pose per connected component whose
    frame would be free."""

    order: IntArray
    fixed: BoolArray


def skeleton(graph: PoseGraph) -> Skeleton:
    """Elimination order and gauge of a graph. O(edges) and one n × n factorisation."""
    n = len(graph)
    order = np.arange(n, dtype=np.int64)
    if n > 1:
        # The fill of the 3n × 3n system follows that of the n × n graph: order the small one.
        i, j, links = graph.source, graph.target, -np.ones(len(graph.source))
        degree = 1.0 + np.bincount(i, minlength=n) + np.bincount(j, minlength=n)
        ends = np.concatenate([i, j, order]), np.concatenate([j, i, order])
        laplacian = sparse.csc_array((np.concatenate([links, links, degree]), ends), shape=(n, n))
        factors = splu(
            laplacian,
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )
        order = np.argsort(factors.perm_c).astype(np.int64)
    component = _groups(graph, graph.information[:, 0, 0] + graph.information[:, 1, 1] > 0)
    return Skeleton(order, _gauge(graph, component))


def summed(where: IntArray, values: NDArray[Any], size: int) -> FloatArray:
    """(size,) sums of `values` grouped by their index `where`."""
    return np.bincount(where, values, size).astype(np.float64, copy=False)


def _groups(graph: PoseGraph, joined: BoolArray) -> IntArray:
    """(n,) connected component of every pose by the edges that are `joined` (m,)."""
    return connected(graph.source[joined], graph.target[joined], len(graph))


def _gauge(graph: PoseGraph, component: IntArray) -> BoolArray:
    """(n, 3) components of single poses to hold fixed so that no frame is free.

    piece: (n,) connected component of each pose by edges with position information. A component can
    be shifted unless a position in it is known, and turned about the only known one. A heading that
    nothing measures is fixed itself. Other freedoms (e.g. a pose that sees a single landmark)
    depend on the poses and are found in the factors (`NormalEquations.factorise`).
    """
    n, prior, weight = len(graph), graph.priors, graph.information
    has_prior = np.zeros((n, 3), bool)
    np.logical_or.at(has_prior, prior.node, np.einsum("kii->ki", prior.information) > 0)
    shifts, turns = weight[:, 0, 0] + weight[:, 1, 1] > 0, weight[:, 2, 2] > 0
    measured = np.zeros(n, bool)
    measured[graph.source[shifts | turns]] = measured[graph.target[turns]] = True
    body = _groups(graph, shifts | turns) if np.any(turns & ~shifts) else component
    fixed = np.zeros((n, 3), bool)
    fixed[:, 2] |= ~(measured | has_prior[:, 2])
    for axis in range(2):
        fixed[_first_without(component, has_prior[:, axis]), axis] = True
    # A body of several pieces can turn if each piece can, about a point of its own.
    anchors = summed(component, has_prior[:, 0] | has_prior[:, 1], n)[component] > 1
    is_held = anchors | (has_prior[:, 2] & measured)
    fixed[_first_without(body, is_held, measured), 2] = True
    return fixed


def _first_without(group: IntArray, has: BoolArray, among: BoolArray | None = None) -> IntArray:
    """First member (of those in `among`) of every group in which no member `has` the property."""
    lacks = summed(group, has, len(group))[group] == 0
    rows = np.flatnonzero(lacks if among is None else lacks & among)
    return rows[np.unique(group[rows], return_index=True)[1]]
