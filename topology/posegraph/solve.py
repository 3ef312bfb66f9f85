"""Least-squares pose graphs in the plane.

    graph = PoseGraph(pose, source, target, measurement, information)
    solution = solve(graph)
    solution.pose, solution.chi2
    Marginals.of(graph, solution).relative(a, b)      # covariance of pose b seen from pose a

`solve` is Gauss–Newton from the poses of the graph, with Levenberg–Marquardt damping only where a
full step would raise the cost.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..arrays import FloatArray
from ..se2 import wrap
from .graph import PoseGraph, Solution, edge_errors, prior_errors, squared
from .normal_equations import Factor, NormalEquations, build_pattern, linearise
from .skeleton import skeleton


@dataclass(frozen=True, slots=True)
class SolverSettings:
    """Iteration and convergence of `solve`."""

    max_iterations: int = 50
    relative_tolerance: float = 1e-7
    """Converged when the cost exceeds its minimum by less than this share of it, or by less than
    `absolute_tolerance`."""
    absolute_tolerance: float = 1e-9
    """Converged when the cost exceeds its minimum by less than this, in units of χ²."""
    first_damping: float = 1e-4
    """Damping, relative to the diagonal, after the first rejected step."""
    patience: int = 2
    """Number of consecutive full steps that may raise the cost before the solver returns to the
    best point."""


def solve(graph: PoseGraph, settings: SolverSettings = SolverSettings()) -> Solution:
    """Maximum-likelihood poses, starting from those of the graph, in the frame of the priors.

    Disconnected components are solved together, each relative to its first pose. Complexity: a few
    sparse factorisations of size 3n; 1,700 poses and 2,500 edges take about 30 ms. Never raises on
    a hard graph: check `converged` and `chi2`.
    """
    return _Problem(graph).minimise(settings)


class _Damping:
    """Levenberg–Marquardt damping, relative to the diagonal, by the gain ratio of steps (Nielsen,
    IMM-REP-1999-05, § 4.1)."""

    def __init__(self, first: float) -> None:
        self.now, self._last, self._first, self._growth = 0.0, 0.0, first, 2.0

    def adapt(self, gained: float, promised: float) -> None:
        """Update after an accepted step, from its actual and its promised decrease of the cost."""
        if self.now > 0 and gained < 0.5 * promised:
            self.tighten()
        elif gained > 0.75 * promised:
            self.now, self._last, self._growth = 0.3 * self.now, 0.3 * self._last, 2.0
            if self.now < 1e-3 * self._first:
                self.now = 0.0

    def tighten(self) -> None:
        """Increase after a rejected step, faster for each rejection in a row."""
        self.now = self._last = max(self._first, self._growth * max(self.now, self._last))
        self._growth *= 2.0


class _Problem:
    """A graph with all that stays constant between iterations."""

    def __init__(self, graph: PoseGraph) -> None:
        self.graph = graph
        self.frame = skeleton(graph)
        self.pattern = build_pattern(graph, self.frame)

    def minimise(self, settings: SolverSettings) -> Solution:
        """Gauss–Newton with a watchdog (Chamberlain, Powell, Lemaréchal, Pedersen 1982).

        A full step may raise the cost if a few more full steps then end below the best point so
        far, which is the way into a narrow curved valley. Otherwise return to the best point and
        damp.
        """
        best = current = self._evaluate(np.array(self.graph.pose), np.zeros(len(self.graph.shared)))
        damping = _Damping(settings.first_damping)
        rises, iterations = 0, 0
        while iterations < settings.max_iterations:
            system = linearise(self.graph, self.pattern, current)
            tolerance = settings.relative_tolerance * best.cost + settings.absolute_tolerance
            iterations, undamped = iterations + 1, damping.now == 0
            moved, promised = self._step(system, system.factorise(damping.now), current)
            if undamped and current is best and promised <= tolerance:
                end = moved if moved.cost <= best.cost else best
                return replace(end, iterations=iterations, converged=True)
            if moved.cost <= best.cost:
                damping.adapt(best.cost - moved.cost, promised)
                if promised <= tolerance:
                    damping.now = 0.0  # short steps promise little: test with a full one
                current = best = moved
                rises = 0 if undamped else rises
            elif undamped and rises < settings.patience and np.isfinite(moved.cost):
                current, rises = moved, rises + 1
            else:
                current, rises = best, settings.patience
                damping.tighten()
        return replace(best, iterations=iterations)

    def _step(
        self, system: NormalEquations, factor: Factor, current: Solution
    ) -> tuple[Solution, float]:
        """The end of a step, and the decrease of the cost that it would bring if the cost were
        quadratic."""
        pose_step, shared_step = system.step(factor)
        pose = current.pose + pose_step
        pose[:, 2] = np.where(self.frame.fixed[:, 2], pose[:, 2], wrap(pose[:, 2]))
        moved = self._evaluate(pose, current.shared + shared_step)
        return moved, system.promise(pose_step, shared_step)

    def _evaluate(self, pose: FloatArray, shared: FloatArray) -> Solution:
        graph = self.graph
        edge_chi2 = squared(edge_errors(graph, pose, shared), graph.information)
        prior_chi2 = squared(prior_errors(graph, pose), graph.priors.information)
        edge_cost, edge_weight = _cauchy(edge_chi2, graph.kernel)
        prior_cost, prior_weight = _cauchy(prior_chi2, graph.priors.kernel)
        shared_cost = np.square(shared / graph.shared.sigma).sum()
        cost = float(edge_cost.sum() + prior_cost.sum() + shared_cost)
        return Solution(
            pose,
            shared,
            float(edge_chi2.sum()),
            cost,
            edge_chi2,
            edge_weight,
            prior_weight,
            0,
            False,
        )


def _cauchy(chi2: FloatArray, width: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Cost c² log(1 + χ²/c²) and its weight 1 / (1 + χ²/c²); χ² and 1 for an infinite width."""
    square = np.square(width)
    ratio = chi2 / square
    no_kernel = np.isinf(width)
    cost = np.where(no_kernel, chi2, np.where(no_kernel, 1.0, square) * np.log1p(ratio))
    return cost, 1.0 / (1.0 + ratio)
