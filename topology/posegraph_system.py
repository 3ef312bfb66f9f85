"""The normal equations of a pose graph: assembled without loops, factorised by `splu`.

Unknowns are the free components of the poses, in elimination order, and at the border the shared
errors b. With A the sparse part and B the columns of the border, one factorisation of A serves all
(the border is a handful of dense columns that would otherwise fill the factors):

    [A  B] [x]   [g]        S = C − Bᵀ A⁻¹ B,  b = S⁻¹ (h − Bᵀ A⁻¹ g),  x = A⁻¹ (g − B b)
    [Bᵀ C] [b] = [h]
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import SuperLU, splu

from .posegraph_model import PoseGraph, corrected_measurement, edge_errors, prior_errors
from .posegraph_start import Skeleton, summed
from .se2 import FloatArray

_NONE = -1


class Point(Protocol):
    """Where to linearise: poses, shared errors, and the weights of edges and priors there."""

    @property
    def pose(self) -> FloatArray: ...  # noqa: D102
    @property
    def shared(self) -> FloatArray: ...  # noqa: D102
    @property
    def edge_weight(self) -> FloatArray: ...  # noqa: D102
    @property
    def prior_weight(self) -> FloatArray: ...  # noqa: D102


@dataclass(frozen=True, slots=True, eq=False)
class Pattern:
    """Where every product of the linearisation lands in the matrix: computed once per graph.

    variable: (n, 3) column of each pose component, -1 where it is fixed; indices, indptr: pattern
    of A (CSC); kept: which of the flat block entries land in A; slot: where those land;
    diagonal: (size,) slots of the diagonal.
    """

    variable: NDArray[np.int64]
    size: int
    indices: NDArray[np.int32]
    indptr: NDArray[np.int32]
    kept: NDArray[np.int64]
    slot: NDArray[np.int64]
    diagonal: NDArray[np.int64]


def build_pattern(graph: PoseGraph, frame: Skeleton) -> Pattern:
    """Pattern of the normal matrix. O(m log m).

    Vectorised over block entries: all (row, column) pairs of the four 3 × 3 blocks of every edge
    (and the one of every prior) in one flat array; `np.unique` of the column-major key makes the
    sorted pattern and, as its inverse, the slot of each entry.
    """
    free = ~frame.fixed[frame.order]
    variable = np.full((len(graph), 3), _NONE, np.int64)
    size = int(free.sum())
    ordered = np.full(free.shape, _NONE, np.int64)
    ordered[free] = np.arange(size)
    variable[frame.order] = ordered
    i, j, u = variable[graph.source], variable[graph.target], variable[graph.priors.node]
    blocks = ((i, i), (i, j), (j, i), (j, j), (u, u))
    rows = np.concatenate([np.repeat(a, 3, axis=1).ravel() for a, _ in blocks])
    columns = np.concatenate([np.tile(b, (1, 3)).ravel() for _, b in blocks])
    kept = np.flatnonzero((rows >= 0) & (columns >= 0))
    # The whole diagonal belongs to the pattern, so that damping always has a place to go.
    everywhere = np.arange(size)
    key = np.concatenate([columns[kept] * size + rows[kept], everywhere * (size + 1)])
    entries, slot = np.unique(key, return_inverse=True)
    indptr = np.searchsorted(entries, np.arange(size + 1) * size)
    return Pattern(
        variable,
        size,
        (entries % max(size, 1)).astype(np.int32),
        indptr.astype(np.int32),
        kept,
        slot[: len(kept)],
        slot[len(kept) :],
    )


@dataclass(frozen=True, slots=True, eq=False)
class NormalEquations:
    """Linearisation at one point: `A` data in the pattern's slots, gradient, and the border."""

    pattern: Pattern
    data: FloatArray
    gradient: FloatArray
    border: FloatArray
    border_gradient: FloatArray
    corner: FloatArray

    def factorise(self, damping: float = 0.0) -> Factor:
        """Factors of the damped system. Raises RuntimeError where it is singular."""
        data, corner, p = self.data, self.corner, self.pattern
        if damping > 0:
            data = data.copy()
            floor = 1e-9 * float(np.mean(data[p.diagonal])) if p.size else 0.0
            data[p.diagonal] += damping * (data[p.diagonal] + floor)
            corner = corner + damping * np.diag(np.diag(corner))
        matrix = sparse.csc_array((data, p.indices, p.indptr), shape=(p.size, p.size))
        lu = None
        if p.size:
            lu = splu(
                matrix,
                permc_spec="NATURAL",
                diag_pivot_thresh=0.0,
                options={"SymmetricMode": True},
            )
        solved = lu.solve(self.border) if lu is not None and self.border.size else self.border
        return Factor(p, lu, self.border, solved, corner - self.border.T @ solved)

    def step(self, factor: Factor) -> tuple[FloatArray, FloatArray]:
        """Gauss–Newton step: (n, 3) of the poses, zero where fixed, and (k,) of the border."""
        x: FloatArray = factor.solve(self.gradient)
        b: FloatArray = np.zeros(len(self.border_gradient))
        if len(b):
            right = self.border_gradient - self.border.T @ x
            b = np.asarray(np.linalg.solve(factor.schur, right), np.float64)
            x = x - factor.solved_border @ b
        out = np.zeros(self.pattern.variable.shape)
        free = self.pattern.variable >= 0
        out[free] = x[self.pattern.variable[free]]
        return out, b

    def promise(self, move: FloatArray, shift: FloatArray) -> float:
        """First-order gain of a step: gᵀ x, the fall of a quadratic cost under a full step."""
        free = self.pattern.variable >= 0
        x = np.zeros(self.pattern.size)
        x[self.pattern.variable[free]] = move[free]
        return float(self.gradient @ x + self.border_gradient @ shift)


@dataclass(frozen=True, slots=True, eq=False)
class Factor:
    """A factorised normal matrix: A by `lu` (None without unknowns), the border by its Schur."""

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


def linearise(graph: PoseGraph, pattern: Pattern, at: Point) -> NormalEquations:
    """Normal equations at a point, with information scaled by its weights.

    Vectorised over edges: Jacobians (m, 3, 3) by both ends, their products by stacked matmul,
    scattered with one `bincount` into the slots of the pattern. O(m).
    """
    pose, shared = at.pose, at.shared
    error = edge_errors(graph, pose, shared)
    J_i, J_j, J_m = edge_jacobians(graph, pose, shared)
    omega = graph.information * at.edge_weight[:, None, None]
    i_omega, j_omega = np.matmul(J_i.transpose(0, 2, 1), omega), J_j.transpose(0, 2, 1) @ omega
    cross = np.matmul(i_omega, J_j)
    information = graph.priors.information * at.prior_weight[:, None, None]
    blocks = (
        np.matmul(i_omega, J_i),
        cross,
        cross.transpose(0, 2, 1),
        np.matmul(j_omega, J_j),
        information,
    )
    flat = np.concatenate([block.reshape(-1) for block in blocks])
    data = summed(pattern.slot, flat[pattern.kept], len(pattern.indices))

    ends = (graph.source, graph.target, graph.priors.node)
    pull = (
        _times(i_omega, error),
        _times(j_omega, error),
        _times(information, prior_errors(graph, pose)),
    )
    gradient = _scatter(pattern, ends, pull)
    k = len(graph.shared)
    border, corner, slope = np.zeros((pattern.size, k)), np.zeros((k, k)), np.zeros(k)
    if k:
        J_b = np.matmul(J_m, graph.shared.sensitivity)
        for column in range(k):
            slope_b = J_b[:, :, column]
            parts = (_times(i_omega, slope_b), _times(j_omega, slope_b))
            border[:, column] = -_scatter(pattern, ends[:2], parts)
        weighted = np.matmul(omega, J_b)
        belief = 1.0 / np.square(graph.shared.sigma)
        corner = np.einsum("eik,eil->kl", J_b, weighted) + np.diag(belief)
        slope = -np.einsum("eik,ei->k", weighted, error) - belief * (shared - graph.shared.mean)
    return NormalEquations(pattern, data, gradient, border, slope, corner)


def _times(matrix: FloatArray, vector: FloatArray) -> FloatArray:
    """(k, 3, 3) times (k, 3)."""
    out: FloatArray = np.matmul(matrix, vector[:, :, None])[:, :, 0]
    return out


def _scatter(
    pattern: Pattern, nodes: tuple[NDArray[np.int64], ...], values: tuple[FloatArray, ...]
) -> FloatArray:
    """(size,) minus the sum of `values` (·, 3) at the variables of their `nodes`."""
    where = np.concatenate([pattern.variable[node].ravel() for node in nodes])
    flat = np.concatenate([value.ravel() for value in values])
    free = where >= 0
    return -summed(where[free], flat[free], pattern.size)


def edge_jacobians(
    graph: PoseGraph, pose: FloatArray, shared: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(m, 3, 3) each: derivatives of the edge errors by source pose, target pose, measurement.

    With φ = θ_i + θ_ij and Δ = R_iᵀ (t_j − t_i): ∂e/∂t_j = R(φ)ᵀ, ∂e/∂θ_i = −J R_ijᵀ Δ, where J is
    the quarter turn.
    """
    m = len(graph.source)
    T_i_j = corrected_measurement(graph, shared)
    theta = pose[graph.source, 2]
    phi = theta + T_i_j[:, 2]
    c, s = np.cos(phi), np.sin(phi)
    step = pose[graph.target] - pose[graph.source]
    J_i, J_j, J_m = np.zeros((m, 3, 3)), np.zeros((m, 3, 3)), np.zeros((m, 3, 3))
    J_j[:, 0, 0], J_j[:, 0, 1] = c, s
    J_j[:, 1, 0], J_j[:, 1, 1] = -s, c
    J_i[:, :2, :2] = -J_j[:, :2, :2]
    J_i[:, 0, 2] = c * step[:, 1] - s * step[:, 0]
    J_i[:, 1, 2] = -c * step[:, 0] - s * step[:, 1]
    J_i[:, 2, 2], J_j[:, 2, 2], J_m[:, 2, 2] = -1.0, 1.0, -1.0
    c, s = np.cos(T_i_j[:, 2]), np.sin(T_i_j[:, 2])
    J_m[:, 0, 0], J_m[:, 0, 1] = -c, -s
    J_m[:, 1, 0], J_m[:, 1, 1] = s, -c
    # ∂e/∂θ_ij = −J R_ijᵀ (Δ − t_ij): the turned error itself.
    J_m[:, 0, 2] = J_i[:, 0, 2] - (c * T_i_j[:, 1] - s * T_i_j[:, 0])
    J_m[:, 1, 2] = J_i[:, 1, 2] + (c * T_i_j[:, 0] + s * T_i_j[:, 1])
    return J_i, J_j, J_m
