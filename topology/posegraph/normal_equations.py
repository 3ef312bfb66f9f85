"""The normal equations of a pose graph: assembled without loops, factorised by `splu`.

The unknowns are the free components of the poses, in elimination order, bordered by the shared
errors b. With A the sparse part and B the columns of the border, A alone is factorised, because the
few dense columns of the border would fill the factors; b follows from the Schur complement S:

    [A  B] [x]   [g]        S = C − Bᵀ A⁻¹ B,  b = S⁻¹ (h − Bᵀ A⁻¹ g),  x = A⁻¹ (g − B b)
    [Bᵀ C] [b] = [h]
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import SuperLU, splu

from ..arrays import FloatArray, IntArray
from ..se2 import turned_axes
from .graph import PoseGraph, Solution, corrected_measurement, edge_errors, prior_errors
from .skeleton import Skeleton, summed

_FIXED = -1
"""Index of a pose component that is not a variable."""

_LOADING = 1e-14
"""Relative load on the diagonal: larger than the rounding error of a pivot, so that a zero pivot
does not spoil the following ones, and far smaller than any information."""

_FREE = 1e-12
"""A pivot smaller than this share of its diagonal carries no information: its variable is
determined by the ones before it, up to rounding. In chains of thousands of poses pivots stay above
1e-8 (CSAIL: 3e-8)."""


@dataclass(frozen=True, slots=True, eq=False)
class Pattern:
    """Sparsity pattern of the normal matrix, computed once per graph.

    variable: (n, 3) column of each pose component, -1 where it is fixed; indices, indptr: pattern
    of A (CSC); slot: (4 m + u, 9) index into A's data of every entry of each 3 × 3 block, one past
    the end for fixed components; diagonal: (size,) indices of the diagonal.
    """

    variable: IntArray
    size: int
    indices: NDArray[np.int32]
    indptr: NDArray[np.int32]
    slot: IntArray
    diagonal: IntArray


def build_pattern(graph: PoseGraph, frame: Skeleton) -> Pattern:
    """Pattern of the normal matrix. O(m log m).

    The 3 × 3 blocks are sorted, not their entries: `np.unique` of the (column, row) keys of blocks,
    renumbered in elimination order, gives the block pattern and the block that each contribution
    falls in; entries of a block column of height h lie h apart, so their places follow. Fixed
    components are cut out of the finished pattern.
    """
    n, m = len(graph), len(graph.source)
    rank = np.empty(n, np.int64)
    rank[frame.order] = np.arange(n)
    i, j, u = rank[graph.source], rank[graph.target], rank[graph.priors.node]
    nodes = np.arange(n)
    # The whole diagonal belongs to the pattern, so that damping always has a place to go.
    rows = np.concatenate([i, i, j, j, u, nodes])
    columns = np.concatenate([i, j, i, j, u, nodes])
    blocks, block_of = np.unique(columns * n + rows, return_inverse=True)
    block_row, block_column = blocks % max(n, 1), blocks // max(n, 1)
    height = np.bincount(block_column, minlength=n)
    first = np.concatenate([[0], np.cumsum(height)[:-1]]).astype(np.int64)
    # Entry (r, c) of a block: column c of its block column, then the blocks above it, then r.
    base = 9 * first[block_column] + 3 * (np.arange(len(blocks)) - first[block_column])
    stride = 3 * height[block_column]
    r, c = np.repeat(np.arange(3), 3), np.tile(np.arange(3), 3)
    position = base[:, None] + c * stride[:, None] + r
    free = (~frame.fixed[frame.order]).ravel()
    number = np.where(free, np.cumsum(free) - 1, _FIXED)
    row_of, column_of = np.empty((2, 9 * len(blocks)), np.int64)
    row_of[position] = 3 * block_row[:, None] + r
    column_of[position] = 3 * block_column[:, None] + c
    is_free = free[row_of] & free[column_of]
    new_position = np.cumsum(is_free) - 1
    size = int(free.sum())
    per_column = np.bincount(number[column_of[is_free]], minlength=size)
    # Contributions to fixed components go to one slot behind the last, which is dropped.
    slot = np.where(is_free, new_position, int(is_free.sum()))[position]
    variable = np.empty((n, 3), np.int64)
    variable[frame.order] = number.reshape(n, 3)
    diagonal = slot[block_of[4 * m + len(u) :]][:, [0, 4, 8]].ravel()
    return Pattern(
        variable,
        size,
        number[row_of[is_free]].astype(np.int32),
        np.concatenate([[0], np.cumsum(per_column)]).astype(np.int32),
        slot[block_of[: 4 * m + len(u)]],
        diagonal[free],
    )


@dataclass(frozen=True, slots=True, eq=False)
class NormalEquations:
    """The normal equations at one point: data of A in the pattern's order, gradient, and border.

    belief: (k,) 1 / σ² of the shared errors, included in `corner`.
    """

    pattern: Pattern
    data: FloatArray
    gradient: FloatArray
    border: FloatArray
    border_gradient: FloatArray
    corner: FloatArray
    belief: FloatArray

    def factorise(self, damping: float = 0.0) -> Factor:
        """Factors of the damped system, positive definite for any graph.

        A direction without information has a pivot that is zero up to rounding, of either sign, and
        a step along it would be noise. The variable of such a pivot is held fixed; the system is
        consistent, so that the other variables keep their solution.
        """
        p = self.pattern
        diagonal = self.data[p.diagonal]
        scale = np.where(diagonal > 0, diagonal, 1.0)
        loading = np.where(diagonal > 0, damping + _LOADING, 1.0) * scale
        lu = self._factored(loading) if p.size else None
        if lu is not None and damping < _FREE:
            free = lu.U.diagonal() <= _FREE * scale
            if free.any():
                lu = self._factored(loading + np.where(free, scale, 0.0))
        solved = lu.solve(self.border) if lu is not None and self.border.size else self.border
        corner = self.corner + damping * np.diag(np.diag(self.corner))
        return Factor(p, lu, self.border, solved, self._schur(corner - self.border.T @ solved))

    def _factored(self, loading: FloatArray) -> SuperLU:
        """LU factors of A with (size,) `loading` added to its diagonal; pivots are taken from the
        diagonal."""
        data, p = self.data.copy(), self.pattern
        data[p.diagonal] += loading
        matrix = sparse.csc_array((data, p.indices, p.indptr), shape=(p.size, p.size))
        return splu(
            matrix, permc_spec="NATURAL", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
        )

    def _schur(self, schur: FloatArray) -> FloatArray:
        """The Schur complement S with eigenvalues no smaller than the prior information of b
        allows: rounding can make them smaller."""
        sigma = 1.0 / np.sqrt(self.belief)
        scaled = sigma[:, None] * (0.5 * (schur + schur.T)) * sigma
        if not len(schur) or np.linalg.eigvalsh(scaled)[0] >= 1:
            return schur
        values, vectors = np.linalg.eigh(scaled)
        root = vectors / sigma[:, None]
        return np.asarray((root * np.maximum(values, 1.0)) @ root.T)

    def step(self, factor: Factor) -> tuple[FloatArray, FloatArray]:
        """Gauss–Newton step: (n, 3) of the poses, zero where fixed, and (k,) of the border."""
        x: FloatArray = factor.solve(self.gradient)
        b: FloatArray = np.zeros(len(self.border_gradient))
        if len(b):
            right = self.border_gradient - factor.border.T @ x
            b = np.asarray(np.linalg.solve(factor.schur, right), np.float64)
            x = x - factor.solved_border @ b
        step = np.zeros(self.pattern.variable.shape)
        free = self.pattern.variable >= 0
        step[free] = x[self.pattern.variable[free]]
        return step, b

    def promise(self, move: FloatArray, shift: FloatArray) -> float:
        """gᵀ x: the decrease of the cost under a full step if the cost were quadratic."""
        free = self.pattern.variable >= 0
        x = np.zeros(self.pattern.size)
        x[self.pattern.variable[free]] = move[free]
        # Plain sums: a threaded dot product would wake threads for microseconds of work.
        return float((self.gradient * x).sum() + (self.border_gradient * shift).sum())


@dataclass(frozen=True, slots=True, eq=False)
class Factor:
    """Factors of a normal matrix: `lu` of A (None without unknowns), Schur complement of the
    border."""

    pattern: Pattern
    lu: SuperLU | None
    border: FloatArray
    solved_border: FloatArray
    schur: FloatArray

    def solve(self, right: FloatArray) -> FloatArray:
        """A⁻¹ right; (size,) or (size, k)."""
        if self.lu is None:
            return right
        return np.asarray(self.lu.solve(np.ascontiguousarray(right)), np.float64)

    def log_determinant(self) -> float:
        """ln of the determinant of the whole matrix, border included."""
        sparse_part = 0.0 if self.lu is None else float(np.log(self.lu.U.diagonal()).sum())
        return sparse_part + float(np.linalg.slogdet(self.schur)[1])


def linearise(graph: PoseGraph, pattern: Pattern, at: Solution) -> NormalEquations:
    """Normal equations at a point, with information scaled by the weights there. O(m).

    With e the errors of the edges, J their derivatives and Ω their information, the blocks are
    H_ij = J_iᵀ Ω J_j, the gradients −J_iᵀ Ω e; one `bincount` adds them up in the slots of the
    pattern.
    """
    pose, shared = at.pose, at.shared
    error = edge_errors(graph, pose, shared)
    information = graph.information * at.edge_weight[:, None, None]
    known_information = graph.priors.information * at.prior_weight[:, None, None]
    jacobians = pose_jacobians(graph, pose, shared)
    weighted = [information @ J for J in jacobians]
    blocks = [J.transpose(0, 2, 1) @ weighted_J for J in jacobians for weighted_J in weighted]
    entries = np.concatenate([*blocks, known_information]).ravel()
    data = summed(pattern.slot.ravel(), entries, len(pattern.indices) + 1)[:-1]

    ends = (graph.source, graph.target, graph.priors.node)
    pulls = [np.einsum("eij,ei->ej", weighted_J, error) for weighted_J in weighted]
    known = np.einsum("eij,ej->ei", known_information, prior_errors(graph, pose))
    gradient = _scatter(pattern, ends, (*pulls, known))
    k = len(graph.shared)
    border, corner, slope = np.zeros((pattern.size, k)), np.zeros((k, k)), np.zeros(k)
    belief = 1.0 / np.square(graph.shared.sigma)
    if k:
        J_b = measurement_jacobian(graph, pose, shared) @ graph.shared.sensitivity
        crossed = [weighted_J.transpose(0, 2, 1) @ J_b for weighted_J in weighted]
        for column in range(k):
            both = (crossed[0][:, :, column], crossed[1][:, :, column])
            border[:, column] = -_scatter(pattern, ends[:2], both)
        weighted_b = information @ J_b
        corner = np.einsum("eik,eil->kl", J_b, weighted_b) + np.diag(belief)
        slope = -np.einsum("eik,ei->k", weighted_b, error) - belief * shared
    return NormalEquations(pattern, data, gradient, border, slope, corner, belief)


def _scatter(
    pattern: Pattern, nodes: tuple[IntArray, ...], values: tuple[FloatArray, ...]
) -> FloatArray:
    """(size,) minus the sum of `values` (·, 3) at the variables of their `nodes`."""
    where = np.concatenate([pattern.variable[node].ravel() for node in nodes])
    flat = np.concatenate([value.ravel() for value in values])
    free = where >= 0
    return -summed(where[free], flat[free], pattern.size)


def pose_jacobians(
    graph: PoseGraph, pose: FloatArray, shared: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(m, 3, 3) each: derivatives of the edge errors by source pose and target pose.

    With B = diag(R(φ)ᵀ, 1), φ = θ_i + θ_ij + s e_θ, and s the swing: J_j = B [I, −s J(t_j − t_i);
    0, 1] and J_i = −B [I, (1 − s) J(t_j − t_i); 0, 1].
    """
    T_i_j, error = corrected_measurement(graph, shared), edge_errors(graph, pose, shared)
    x, y, _ = (pose[graph.target] - pose[graph.source]).T
    J_j = turned_axes(-(pose[graph.source, 2] + T_i_j[:, 2] + graph.swing * error[:, 2]))
    J_i = -J_j
    lever = J_i[:, :2, 0] * -y[:, None] + J_i[:, :2, 1] * x[:, None]
    J_i[:, :2, 2] = (1 - graph.swing)[:, None] * lever
    J_j[:, :2, 2] = graph.swing[:, None] * lever
    return J_i, J_j


def measurement_jacobian(graph: PoseGraph, pose: FloatArray, shared: FloatArray) -> FloatArray:
    """(m, 3, 3) derivative of the edge errors with respect to the measurement: −diag(R_ijᵀ, 1), −J
    e_xy and, for the swing s, s J (e_xy + R_ijᵀ t_ij)."""
    T_i_j = corrected_measurement(graph, shared)
    error = edge_errors(graph, pose, shared)
    c, s = np.cos(T_i_j[:, 2]), np.sin(T_i_j[:, 2])
    x, y = T_i_j[:, :2].T
    jacobian = np.zeros((len(c), 3, 3))
    jacobian[:, 0, 0], jacobian[:, 0, 1] = -c, -s
    jacobian[:, 1, 0], jacobian[:, 1, 1] = s, -c
    jacobian[:, 0, 2] = error[:, 1] - graph.swing * (error[:, 1] + c * y - s * x)
    jacobian[:, 1, 2] = -error[:, 0] + graph.swing * (error[:, 0] + c * x + s * y)
    jacobian[:, 2, 2] = -1.0
    return jacobian
