"""Marginal covariances of a solved pose graph: of single poses and of pairs of poses.

The covariance is the inverse of the normal matrix at the solution. Only the requested columns are
computed, in chunks, so that memory is bounded by the chunk.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray, IntArray
from .graph import PoseGraph, Solution
from .normal_equations import Factor, build_pattern, linearise
from .skeleton import skeleton

_CHUNK = 128
"""Poses per chunk: 3 · 128 right-hand sides are solved for at once."""


@dataclass(frozen=True, slots=True, eq=False)
class Marginals:
    """Covariances (1 sigma squared, m and rad) at a solution, from one factorisation."""

    pose: FloatArray
    factor: Factor

    @classmethod
    def of(cls, graph: PoseGraph, solution: Solution) -> Marginals:
        """Linearise and factorise at a solution, with the solution's weights of edges and
        priors."""
        pattern = build_pattern(graph, skeleton(graph))
        return cls(solution.pose, linearise(graph, pattern, solution).factorise())

    def joint(self, a: IntArray, b: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Covariances in the graph's frame: three (k, 3, 3), of poses a, of poses b, and between a
        and b.

        Vectorised over pairs in chunks of distinct second poses: the columns of the inverse that
        belong to b are solved for and read at the rows of a and b. Cost: one pair of triangular
        solves per column. Components fixed by the gauge have zero variance.
        """
        a, b = np.asarray(a, np.int64), np.asarray(b, np.int64)
        nodes = np.unique(np.concatenate([a, b]))
        variance = np.zeros((len(nodes), 3, 3))
        cross = np.zeros((len(a), 3, 3))
        row_b = np.searchsorted(nodes, b)
        order = np.argsort(row_b, kind="stable")
        starts = np.arange(0, len(nodes), _CHUNK)
        bounds = np.searchsorted(row_b[order], np.append(starts, len(nodes)))
        for chunk, first in enumerate(starts):
            chosen = nodes[first : first + _CHUNK]
            columns = self._columns(chosen)
            number = np.arange(len(chosen))
            variance[first : first + _CHUNK] = self._read(columns, chosen, number)
            pairs = order[bounds[chunk] : bounds[chunk + 1]]
            cross[pairs] = self._read(columns, a[pairs], row_b[pairs] - first)
        return variance[np.searchsorted(nodes, a)], variance[row_b], cross

    def relative(self, a: IntArray, b: IntArray) -> FloatArray:
        """(k, 3, 3) covariance of T_a_b (x, y, theta of pose b in the frame of pose a).

        Does not depend on the gauge. Poses in different connected components are not detected:
        their true covariance is infinite, and the one returned is meaningless.
        """
        var_a, var_b, cross = self.joint(a, b)
        J_a, J_b = relative_jacobians(self.pose[a], self.pose[b])
        cross_part = J_a @ cross @ J_b.transpose(0, 2, 1)
        covariance = J_a @ var_a @ J_a.transpose(0, 2, 1) + J_b @ var_b @ J_b.transpose(0, 2, 1)
        covariance = covariance + cross_part + cross_part.transpose(0, 2, 1)
        return 0.5 * (covariance + covariance.transpose(0, 2, 1))

    def _columns(self, nodes: IntArray) -> FloatArray:
        """(size, 3 · nodes) columns of the inverse; zero for fixed components."""
        variable = self.factor.pattern.variable[nodes].ravel()
        free = np.flatnonzero(variable >= 0)
        right = np.zeros((self.factor.pattern.size, len(variable)))
        right[variable[free], free] = 1.0
        return self.through(right)

    def through(self, right: FloatArray) -> FloatArray:
        """(size, k) product of the covariance of all free components with columns (size, k)."""
        product = self.factor.solve(right)
        if self.factor.border.shape[1]:
            solved = self.factor.solved_border
            product = product + solved @ np.linalg.solve(
                self.factor.schur, self.factor.border.T @ product
            )
        return product

    def _read(self, columns: FloatArray, rows: IntArray, local: IntArray) -> FloatArray:
        """(k, 3, 3) blocks at poses `rows` of columns of the chunk's `local`-th poses."""
        variable = self.factor.pattern.variable[rows]
        blocks = columns[variable[:, :, None], (3 * local)[:, None, None] + np.arange(3)]
        return np.where(variable[:, :, None] >= 0, blocks, 0.0)


def relative_jacobians(pose_a: FloatArray, pose_b: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(k, 3, 3) each: derivatives of `between(a, b)` with respect to a and to b."""
    k = len(pose_a)
    c, s = np.cos(pose_a[:, 2]), np.sin(pose_a[:, 2])
    step = pose_b - pose_a
    J_a, J_b = np.zeros((k, 3, 3)), np.zeros((k, 3, 3))
    J_b[:, 0, 0], J_b[:, 0, 1], J_b[:, 1, 0], J_b[:, 1, 1] = c, s, -s, c
    J_a[:, :2, :2] = -J_b[:, :2, :2]
    J_a[:, 0, 2] = c * step[:, 1] - s * step[:, 0]
    J_a[:, 1, 2] = -c * step[:, 0] - s * step[:, 1]
    J_b[:, 2, 2], J_a[:, 2, 2] = 1.0, -1.0
    return J_a, J_b
