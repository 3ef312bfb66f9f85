"""Covariances of many pairs of poses at once, from samples.

Exact covariances (`marginals.py`) cost three solves per pose. A fixed number of samples of the
whole solution costs one solve per sample, whatever the number of pairs, and estimates a variance
with a relative standard error of √(2 / count), which suffices for gating candidates.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from ..arrays import FloatArray, IntArray
from .graph import PoseGraph, Solution
from .marginals import relative_jacobians
from .normal_equations import (
    Factor,
    Pattern,
    build_pattern,
    linearise,
    measurement_jacobian,
    pose_jacobians,
)
from .skeleton import skeleton


@dataclass(frozen=True, slots=True, eq=False)
class _Linearised:
    """A graph linearised and factorised at its solution.

    J_i, J_j, J_b: derivatives of the edge errors with respect to source pose, target pose and
    shared errors; root, root_known: square roots R of the information of edges and priors, with the
    weights of the solution, so that Rᵀ e is white; push, push_known: sparse maps from white errors
    of edges and priors to the gradient.
    """

    graph: PoseGraph
    pattern: Pattern
    factor: Factor
    J_i: FloatArray
    J_j: FloatArray
    J_b: FloatArray
    root: FloatArray
    root_known: FloatArray
    push: sparse.csr_array[np.float64]
    push_known: sparse.csr_array[np.float64]

    @classmethod
    def of(cls, graph: PoseGraph, solution: Solution) -> _Linearised:
        """Linearise at `solution`."""
        pattern = build_pattern(graph, skeleton(graph))
        factor = linearise(graph, pattern, solution).factorise()
        J_i, J_j = pose_jacobians(graph, solution.pose, solution.shared)
        J_m = measurement_jacobian(graph, solution.pose, solution.shared)
        root = square_root(graph.information * solution.edge_weight[:, None, None])
        root_known = square_root(graph.priors.information * solution.prior_weight[:, None, None])
        push = _scattered(pattern, graph.source, J_i.transpose(0, 2, 1) @ root)
        push = push + _scattered(pattern, graph.target, J_j.transpose(0, 2, 1) @ root)
        return cls(
            graph=graph,
            pattern=pattern,
            factor=factor,
            J_i=J_i,
            J_j=J_j,
            J_b=J_m @ graph.shared.sensitivity,
            root=root,
            root_known=root_known,
            push=push,
            push_known=_scattered(pattern, graph.priors.node, root_known),
        )

    def moved(
        self, z: FloatArray, z_known: FloatArray, z_shared: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Changes of the solution, (n, 3, count) of the poses and (k, count) of the shared errors,
        that white errors of edges (3 m, count), priors (3 u, count) and shared errors (k, count)
        cause."""
        factor, shared = self.factor, self.graph.shared
        x = factor.solve(np.asarray(self.push @ z + self.push_known @ z_known))
        b = np.zeros(z_shared.shape)
        if len(shared):
            slope = (self.root.transpose(0, 2, 1) @ self.J_b).reshape(-1, len(shared)).T @ z
            slope = slope + z_shared / shared.sigma[:, None]
            b[:] = np.linalg.solve(factor.schur, slope - factor.border.T @ x)
            x = x - factor.solved_border @ b
        error = np.zeros((*self.pattern.variable.shape, z.shape[1]))
        free = self.pattern.variable >= 0
        error[free] = x[self.pattern.variable[free]]
        return error, b


@dataclass(frozen=True, eq=False)
class SampledMarginals:
    """Samples of the posterior of a solved pose graph.

    pose: (n, 3) of the solution; error: (n, 3, count) sampled errors of the poses [m, m, rad];
    shared: (k, count) sampled errors of the shared errors.
    """

    pose: FloatArray
    error: FloatArray
    shared: FloatArray
    _system: _Linearised
    _z: FloatArray
    _z_known: FloatArray

    @property
    def factor(self) -> Factor:
        """The factors of the normal matrix at the solution."""
        return self._system.factor

    @cached_property
    def edge_residual(self) -> FloatArray:
        """(m, 3, count) sampled residuals of the edges after solving, in sigmas (Rᵀ e, R from
        `square_root`). 0 for an edge that no other measurement checks; the mean square is the
        edge's redundancy."""
        system, graph = self._system, self._system.graph
        error = system.J_i @ self.error[graph.source] + system.J_j @ self.error[graph.target]
        if len(self.shared):
            error = error + system.J_b @ self.shared
        return self._z.reshape(error.shape) - system.root.transpose(0, 2, 1) @ error

    @cached_property
    def prior_residual(self) -> FloatArray:
        """(u, 3, count) the same for the priors."""
        system, count = self._system, self.error.shape[2]
        error = system.root_known.transpose(0, 2, 1) @ self.error[system.graph.priors.node]
        return self._z_known.reshape(-1, 3, count) - error

    @classmethod
    def of(cls, graph: PoseGraph, solution: Solution, count: int = 64) -> SampledMarginals:
        """Sample the linearised posterior by solving for perturbed measurements.

        With H = Jᵀ Ω J and white z, H⁻¹ Jᵀ Ω^½ z has the covariance H⁻¹. The noise is the same at
        every call. One factorisation and `count` solves. A measurement with weight w at the
        solution is taken to be an outlier with information w Ω.
        """
        system = _Linearised.of(graph, solution)
        sizes = (3 * len(graph.source), 3 * len(graph.priors), len(graph.shared))
        z, z_known, z_shared = white(20040, [(size, count) for size in sizes])
        error, shared = system.moved(z, z_known, z_shared)
        return cls(np.asarray(solution.pose), error, shared, system, z, z_known)

    def relative(self, a: IntArray, b: IntArray) -> FloatArray:
        """(k, 3, 3) sample covariance of T_a_b, with a relative standard error of √(2 / count);
        compare `Marginals.relative`."""
        J_a, J_b = relative_jacobians(self.pose[a], self.pose[b])
        error = J_a @ self.error[a] + J_b @ self.error[b]
        return np.asarray(error @ error.transpose(0, 2, 1) / self.error.shape[2])


def white(seed: int, shapes: Sequence[tuple[int, ...]]) -> list[FloatArray]:
    """Arrays of white noise, consecutive parts of one stream that is the same at every call."""
    rng = np.random.default_rng(seed)
    return [rng.standard_normal(shape) for shape in shapes]


def of_unit_variance(noise: FloatArray) -> FloatArray:
    """White noise (…, s), scaled so that the mean square of its s samples is 1.

    The noise is the same for every map, so that its sampling error does not average out over maps:
    unscaled, the variance of a number estimated by 256 samples is off by up to 20 %, and that of
    the first 20 places by 3 % in the mean.
    """
    return np.asarray(noise / np.sqrt(np.mean(noise**2, axis=-1, keepdims=True)))


def square_root(information: FloatArray) -> FloatArray:
    """(k, 3, 3) symmetric R with R Rᵀ = information, also where that is singular.

    It is unique and continuous, unlike a root in the axes of the information: where these are
    nearly equal, rounding would turn them, and with them the samples.
    """
    values, vectors = np.linalg.eigh(information)
    roots = np.sqrt(np.maximum(values, 0.0))[:, None, :]
    return np.asarray((vectors * roots) @ vectors.transpose(0, 2, 1))


def _scattered(
    pattern: Pattern, node: IntArray, blocks: FloatArray
) -> sparse.csr_array[np.float64]:
    """(size, 3 k) sparse matrix with the (k, 3, 3) blocks in the rows of their nodes' variables."""
    variable = pattern.variable[node]
    rows = np.repeat(variable, 3, axis=1).ravel()
    columns = np.repeat(np.arange(3 * len(node)).reshape(-1, 3), 3, axis=0).ravel()
    is_free = rows >= 0
    shape = (pattern.size, 3 * len(node))
    return sparse.csr_array(
        (blocks.ravel()[is_free], (rows[is_free], columns[is_free])), shape=shape
    )
