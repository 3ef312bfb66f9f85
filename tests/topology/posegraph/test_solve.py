"""The pose graph against truth, an oracle, and its own invariances."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from topobatch.topology.posegraph.graph import (
    PoseGraph,
    Priors,
    SharedErrors,
    edge_errors,
    prior_errors,
)
from topobatch.topology.posegraph.marginals import Marginals
from topobatch.topology.posegraph.solve import solve
from topobatch.topology.se2 import between, compose, wrap


def loop_graph(
    seed: int, n: int = 30, loops: int = 15, noise: float = 1.0
) -> tuple[PoseGraph, np.ndarray]:
    """A random walk with loops, noisy measurements, full information matrices; and the truth."""
    rng = np.random.default_rng(seed)
    steps = np.column_stack(
        [rng.uniform(0.5, 2, n - 1), rng.normal(0, 0.3, (n - 1)), rng.normal(0, 0.9, n - 1)]
    )
    truth = np.zeros((n, 3))
    for k in range(n - 1):
        truth[k + 1] = compose(truth[k], steps[k])
    a = rng.integers(0, n - 2, loops)
    b = np.minimum(a + 2 + rng.integers(0, n, loops), n - 1)
    source, target = np.concatenate([np.arange(n - 1), a]), np.concatenate([np.arange(1, n), b])
    half = rng.normal(size=(len(source), 3, 3))
    information = half @ half.transpose(0, 2, 1) + 3 * np.eye(3)
    information *= (
        np.array([20.0, 20.0, 40.0])[:, None] ** 0.5 * np.array([20.0, 20.0, 40.0]) ** 0.5
    )
    exact = between(truth[source], truth[target])
    spread = np.linalg.cholesky(np.linalg.inv(information))
    error = (spread @ rng.normal(size=(len(source), 3, 1)))[:, :, 0] * noise
    measurement = compose(exact, error)
    start = np.zeros((n, 3))
    for k in range(n - 1):
        start[k + 1] = compose(start[k], measurement[k])
    return PoseGraph(start, source, target, measurement, information), truth


def straight_sensitivity(T_i_j: np.ndarray, heading_gain: np.ndarray) -> np.ndarray:
    """(m, 3) derivative of a leg's T_i_j [(m, 3)] by a heading error that grows along the leg.

    heading_gain: (m,) what the error adds to the heading of the whole leg (Δs for a bias per
    metre, Δθ for one per radian). Half of it turns the chord, as if the leg were driven evenly;
    exact sums over the odometry rows are better where they are at hand (`ingest.calibration`).
    """
    x, y = T_i_j[:, 0], T_i_j[:, 1]
    return np.stack([-0.5 * y * heading_gain, 0.5 * x * heading_gain, heading_gain], axis=-1)


def oracle(graph: PoseGraph, start: np.ndarray, fixed: np.ndarray) -> tuple[np.ndarray, float]:
    """Poses and cost by scipy's general solver, with dense numeric Jacobians."""
    root = np.linalg.cholesky(graph.information + 1e-15 * np.eye(3)).transpose(0, 2, 1)
    prior_root = np.sqrt(np.einsum("kii->ki", graph.priors.information))
    k = len(graph.shared)

    def residuals(x: np.ndarray) -> np.ndarray:
        pose = start.copy()
        pose[~fixed] = x[k:]
        error = edge_errors(graph, pose, x[:k])
        belief = x[:k] / graph.shared.sigma
        whole = (root @ error[:, :, None]).ravel()
        return np.concatenate([whole, (prior_root * prior_errors(graph, pose)).ravel(), belief])

    found = least_squares(
        residuals, np.concatenate([np.zeros(k), start[~fixed]]), xtol=1e-12, ftol=1e-14, gtol=1e-12
    )
    pose = start.copy()
    pose[~fixed] = found.x[k:]
    return pose, float(2 * found.cost)


def first_fixed(n: int) -> np.ndarray:
    fixed = np.zeros((n, 3), bool)
    fixed[0] = True
    return fixed


def test_exact_measurements_give_the_truth() -> None:
    graph, truth = loop_graph(3, noise=0.0)
    off = np.random.default_rng(0).normal(0, 0.2, graph.pose[1:].shape)
    start = np.concatenate([graph.pose[:1], graph.pose[1:] + off])
    solution = solve(replace(graph, pose=start))
    assert solution.converged
    assert solution.chi2 < 1e-12
    np.testing.assert_allclose(solution.pose[:, :2], truth[:, :2], atol=1e-7)


def test_truth_lies_within_the_covariance() -> None:
    """Normalised errors of relative poses over many noise draws follow χ² with 3 d.o.f."""
    scores = []
    for draw in range(40):
        graph, truth = loop_graph(draw, n=15, loops=8, noise=0.3)
        graph = replace(graph, information=graph.information / 0.3**2)
        solution = solve(graph)
        covariance = Marginals.of(graph, solution).relative(np.array([2]), np.array([12]))[0]
        error = between(solution.pose[2], solution.pose[12]) - between(truth[2], truth[12])
        error[2] = wrap(error[2])
        scores.append(error @ np.linalg.solve(covariance, error))
    # Mean 3, standard error sqrt(6 / 40).
    assert abs(np.mean(scores) - 3) < 4 * np.sqrt(6 / 40)


def test_a_shared_heading_bias_is_found() -> None:
    graph, _ = loop_graph(9, n=30, loops=30, noise=0.2)
    odometry = np.arange(len(graph.source)) < len(graph) - 1
    way = np.where(odometry, np.hypot(graph.measurement[:, 0], graph.measurement[:, 1]), 0.0)
    sensitivity = straight_sensitivity(graph.measurement, way)[:, :, None]
    spoiled = replace(
        graph,
        measurement=graph.measurement - sensitivity[:, :, 0] * 0.05,
        shared=SharedErrors(sensitivity, np.array([0.1])),
    )
    solution = solve(spoiled)
    assert solution.converged
    sigma = np.sqrt(np.linalg.inv(Marginals.of(spoiled, solution).factor.schur)[0, 0])
    assert abs(solution.shared[0] - 0.05) < 4 * sigma
    assert sigma < 0.01
    _, cost = oracle(spoiled, solution.pose, first_fixed(len(graph)))
    assert solution.cost == pytest.approx(cost, rel=1e-6)


def test_marginals_equal_the_dense_inverse() -> None:
    graph, _ = loop_graph(10, n=12, loops=6)
    way = np.hypot(graph.measurement[:, 0], graph.measurement[:, 1])
    sensitivity = straight_sensitivity(graph.measurement, way)[:, :, None]
    graph = replace(graph, shared=SharedErrors(sensitivity, np.array([0.01])))
    solution = solve(graph)
    # Dense information over (pose 1.., b) from numeric Jacobians of the errors.
    root = np.linalg.cholesky(graph.information).transpose(0, 2, 1)

    def residuals(x: np.ndarray) -> np.ndarray:
        pose = np.concatenate([solution.pose[:1], x[:-1].reshape(-1, 3)])
        error = (root @ edge_errors(graph, pose, x[-1:])[:, :, None]).ravel()
        return np.append(error, x[-1] / 0.01)

    x = np.append(solution.pose[1:].ravel(), solution.shared)
    jacobian = np.column_stack(
        [(residuals(x + d) - residuals(x - d)) / 2e-6 for d in 1e-6 * np.eye(len(x))]
    )
    dense = np.linalg.inv(jacobian.T @ jacobian)
    marginals = Marginals.of(graph, solution)
    a, b = np.array([3, 5, 9, 0]), np.array([7, 5, 1, 4])
    var_a, var_b, cross = marginals.joint(a, b)
    for k in range(3):
        at_a, at_b = slice(3 * a[k] - 3, 3 * a[k]), slice(3 * b[k] - 3, 3 * b[k])
        np.testing.assert_allclose(var_a[k], dense[at_a, at_a], rtol=1e-4, atol=1e-9)
        np.testing.assert_allclose(var_b[k], dense[at_b, at_b], rtol=1e-4, atol=1e-9)
        np.testing.assert_allclose(cross[k], dense[at_a, at_b], rtol=1e-4, atol=1e-9)
    assert not var_a[3].any()
    assert not cross[3].any()
    shared = np.linalg.inv(marginals.factor.schur)
    np.testing.assert_allclose(shared[0, 0], dense[-1, -1], rtol=1e-4)
    np.testing.assert_allclose(marginals.relative(a[1:2], b[1:2]), 0, atol=1e-9)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"target": np.array([0, 9])}, "does not exist"),
        ({"target": np.array([0, 2])}, "itself"),
        ({"measurement": np.full((2, 3), np.nan)}, "not finite"),
        ({"information": np.tile(-np.eye(3), (2, 1, 1))}, "negative"),
        ({"information": np.triu(np.ones((2, 3, 3)))}, "symmetric"),
        ({"kernel": np.array([1.0, 0.0])}, "positive"),
        ({"priors": Priors.headings(np.array([7]), np.zeros(1), 1.0)}, "does not exist"),
        ({"shared": SharedErrors(np.zeros((5, 3, 1)), np.ones(1))}, "per edge"),
    ],
)
def test_what_does_not_fit_is_refused(change: dict[str, object], message: str) -> None:
    good: dict[str, object] = {
        "pose": np.zeros((3, 3)),
        "source": np.array([1, 2]),
        "target": np.array([0, 1]),
        "measurement": np.zeros((2, 3)),
        "information": np.tile(np.eye(3), (2, 1, 1)),
    }
    PoseGraph(**good)
    with pytest.raises(ValueError, match=message):
        PoseGraph(**(good | change))
