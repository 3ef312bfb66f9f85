"""What calls itself converged is a minimum, on random graphs of every kind the solver takes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares

from topobatch.topology.posegraph.graph import (
    PoseGraph,
    Priors,
    SharedErrors,
    edge_errors,
    prior_errors,
)
from topobatch.topology.posegraph.solve import Solution, solve
from topobatch.topology.se2 import between, compose


def piece(rng: np.random.Generator, poses: int, loops: int, marks: int, noise: float) -> PoseGraph:
    """A walk with loops; some edges tell no position, no heading or nothing; point landmarks."""
    truth = np.zeros((poses, 3))
    truth[0] = rng.normal(0, 3, 3)
    for k in range(poses - 1):
        truth[k + 1] = compose(truth[k], rng.normal([1.2, 0, 0], [0.4, 0.3, 0.9]))
    place = np.column_stack([rng.uniform(-5, 5, (marks, 2)), np.zeros(marks)])
    truth = np.concatenate([truth, place])
    a, b = rng.integers(0, poses, (2, loops))
    who, which = np.nonzero(rng.random((poses, marks)) < 0.5)
    source = np.concatenate([np.arange(poses - 1), a[a != b], who])
    target = np.concatenate([np.arange(1, poses), b[a != b], which + poses])
    m = len(source)
    half = rng.normal(size=(m, 3, 3))
    information = (half @ half.transpose(0, 2, 1) + np.eye(3)) * 10 ** rng.uniform(0, 3)
    told = np.ones((m, 3))
    told[rng.random(m) < 0.05] = [0, 0, 1]
    told[(rng.random(m) < 0.05) | (target >= poses)] = [1, 1, 0]
    told[rng.random(m) < 0.03] = 0
    information *= told[:, :, None] * told[:, None, :]
    measurement = compose(between(truth[source], truth[target]), rng.normal(0, noise / 10, (m, 3)))
    return PoseGraph(truth, source, target, measurement, information)


@st.composite
def graphs(draw: st.DrawFn) -> PoseGraph:
    """Several pieces with landmarks, priors, kernels and shared errors."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    noise = draw(st.sampled_from([0.0, 0.3, 1.0, 3.0]))
    sizes = st.tuples(st.integers(1, 9), st.integers(0, 8), st.integers(0, 3))
    parts = [piece(rng, *size, noise) for size in draw(st.lists(sizes, min_size=1, max_size=3))]
    first = np.cumsum([0] + [len(part) for part in parts])
    pose = np.concatenate([part.pose for part in parts])
    n, m = len(pose), sum(len(part.source) for part in parts)
    k, u = draw(st.integers(0, 2)), draw(st.integers(0, 3))
    half = rng.normal(size=(u, 3, 3)) * (rng.random((u, 3, 1)) < 0.6)  # often singular
    node = rng.integers(0, n, u)
    kernel, shared = draw(st.booleans()), rng.normal(0, 1, (m, 3, k))
    return PoseGraph(
        pose + rng.normal(0, draw(st.sampled_from([0.0, 0.3])), (n, 3)),
        np.concatenate([part.source + at for part, at in zip(parts, first, strict=False)]),
        np.concatenate([part.target + at for part, at in zip(parts, first, strict=False)]),
        np.concatenate([part.measurement for part in parts]),
        np.concatenate([part.information for part in parts]),
        np.where(kernel & (rng.random(m) < 0.5), rng.uniform(1, 4, m), np.inf),
        Priors(
            node,
            pose[node] + rng.normal(0, 0.2 * noise, (u, 3)),
            half.transpose(0, 2, 1) @ half * 30,
            np.where(rng.random(u) < 0.5, 2.0, np.inf),
        ),
        SharedErrors(shared, rng.uniform(0.01, 1, k)),
        # What tells no turn has an error of turn of any size: half a circle is a step in the cost.
        0.5 * (np.concatenate([part.information for part in parts])[:, 2, 2] > 0),
    )


def whitened(error: np.ndarray, information: np.ndarray, width: np.ndarray) -> np.ndarray:
    """Residuals whose squares add up to the (robust) cost."""
    values, vectors = np.linalg.eigh(information)
    root = np.sqrt(np.maximum(values, 0))[:, :, None] * vectors.transpose(0, 2, 1)
    plain = (root @ error[:, :, None])[:, :, 0]
    ratio = np.square(plain).sum(axis=1) / np.square(width)
    shrink = np.sqrt(np.log1p(ratio) / np.where(ratio > 0, ratio, 1.0))
    return (plain * np.where(ratio > 1e-12, shrink, 1.0)[:, None]).ravel()


class Problem:
    """The cost as a function of everything that may move, written without the solver."""

    def __init__(self, graph: PoseGraph, solution: Solution) -> None:
        self.graph = graph
        self.found = np.concatenate([solution.pose.ravel(), solution.shared])

    def residuals(self, x: np.ndarray) -> np.ndarray:
        graph, count = self.graph, self.graph.pose.size
        pose, shared = x[:count].reshape(-1, 3), x[count:]
        return np.concatenate(
            [
                whitened(edge_errors(graph, pose, shared), graph.information, graph.kernel),
                whitened(prior_errors(graph, pose), graph.priors.information, graph.priors.kernel),
                shared / graph.shared.sigma,
            ]
        )

    def cost(self, x: np.ndarray) -> float:
        return float(np.square(self.residuals(x)).sum())

    def slope(self) -> tuple[np.ndarray, np.ndarray]:
        """Gradient of the cost by central differences, and the curvature of each coordinate."""
        steps = 1e-6 * np.eye(len(self.found))
        pairs = [(self.residuals(self.found + d), self.residuals(self.found - d)) for d in steps]
        gradient = [(np.square(up).sum() - np.square(down).sum()) / 2e-6 for up, down in pairs]
        curvature = [2 * np.square((up - down) / 2e-6).sum() for up, down in pairs]
        return np.array(gradient), np.array(curvature)


@given(graphs())
@settings(max_examples=10, derandomize=True)
def test_what_is_called_converged_is_a_minimum(graph: PoseGraph) -> None:
    solution = solve(graph)
    problem = Problem(graph, solution)
    cost = problem.cost(problem.found)
    assert solution.cost == pytest.approx(cost, rel=1e-6, abs=1e-9)
    if not solution.converged or len(problem.found) == 0:
        return
    # What a step along one coordinate could gain: g² / 2h. The solver promises 1e-7 of the cost.
    gradient, curvature = problem.slope()
    told = curvature > 0
    gain = gradient[told] ** 2 / (2 * curvature[told])
    noise = 1e-15 * cost / 1e-6  # of the differences
    floor = noise**2 / (2 * curvature[told])
    assert np.all(gain <= 1e-5 * cost + 1e-8 + floor)
    # A general solver that begins there finds nothing better.
    better = least_squares(
        problem.residuals, problem.found, xtol=1e-14, ftol=1e-14, gtol=1e-14, max_nfev=20
    )
    assert 2 * better.cost >= cost * (1 - 1e-5) - 1e-7


def test_most_graphs_converge() -> None:
    """Random graphs with moderate noise: that few fail keeps the promise above from being empty."""
    converged = []

    @given(graphs())
    @settings(max_examples=60, derandomize=True, database=None)
    def collect(graph: PoseGraph) -> None:
        converged.append(solve(graph).converged)

    collect()
    assert np.mean(converged) > 0.95


def free_graph(noise: float) -> PoseGraph:
    """A ring that sees landmarks."""
    rng = np.random.default_rng(3)
    graph = piece(rng, 12, 6, 4, 0.3)
    return replace(graph, measurement=graph.measurement * (1 + noise * rng.normal(size=(1, 3))))


def test_a_free_frame_stays_where_it_begins() -> None:
    """Rounding does not move what nothing measures: the last digit of the input moves no pose."""
    one, other = free_graph(0.0), free_graph(1e-14)
    here, there = solve(one), solve(other)
    assert here.converged
    np.testing.assert_allclose(here.pose, there.pose, rtol=0, atol=1e-9)
    np.testing.assert_allclose(here.pose[0], one.pose[0], rtol=0, atol=0)
