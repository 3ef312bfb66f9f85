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
from topobatch.topology.se2 import between, compose, fit_rigid, wrap


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
        residuals,
        np.concatenate([np.zeros(k), start[~fixed]]),
        xtol=1e-12,
        ftol=1e-14,
        gtol=1e-12,
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


def test_result_moves_with_the_frame() -> None:
    graph, _ = loop_graph(0)
    T = np.array([12.0, -7.0, 2.5])
    moved = replace(graph, pose=compose(T, graph.pose))
    here, there = solve(graph), solve(moved)
    assert there.chi2 == pytest.approx(here.chi2, rel=1e-9)
    np.testing.assert_allclose(there.pose[:, :2], compose(T, here.pose)[:, :2], atol=1e-5)
    np.testing.assert_allclose(wrap(there.pose[:, 2] - here.pose[:, 2] - T[2]), 0, atol=1e-6)


def test_result_does_not_depend_on_numbering_or_direction() -> None:
    graph, _ = loop_graph(0)
    rng = np.random.default_rng(0)
    new_of_old, edges = rng.permutation(len(graph)), rng.permutation(len(graph.source))
    pose = np.empty_like(graph.pose)
    pose[new_of_old] = graph.pose
    shuffled = PoseGraph(
        pose,
        new_of_old[graph.source][edges],
        new_of_old[graph.target][edges],
        graph.measurement[edges],
        graph.information[edges],
    )
    here, there = solve(graph), solve(shuffled)
    assert there.chi2 == pytest.approx(here.chi2, rel=1e-7)
    # Another first pose is held: compare after the best fit.
    T = fit_rigid(here.pose[:, :2], there.pose[new_of_old][:, :2])
    aligned = compose(T, there.pose[new_of_old])
    np.testing.assert_allclose(aligned[:, :2], here.pose[:, :2], atol=1e-4)


def test_headings_known_from_outside_set_the_frame() -> None:
    """A rectilinear world: priors turn the graph, positions stay free and start at the first."""
    graph, truth = loop_graph(5)
    turned = wrap(truth[:, 2] + 0.7)
    every = np.arange(len(graph))
    known = replace(graph, priors=Priors.headings(every, turned, 1e-3))
    solution = solve(known)
    assert solution.converged
    assert np.abs(wrap(solution.pose[:, 2] - turned)).max() < 0.02
    np.testing.assert_allclose(solution.pose[0, :2], graph.pose[0, :2])
    fixed = first_fixed(len(graph))
    fixed[0, 2] = False
    _, cost = oracle(known, solution.pose, fixed)
    assert solution.cost == pytest.approx(cost, rel=1e-6)


def test_a_wrong_heading_under_a_kernel_does_little() -> None:
    graph, truth = loop_graph(6, noise=0.1)
    every = np.arange(len(graph))
    value = truth[:, 2].copy()
    value[10] += 0.8
    plain = Priors.headings(every, value, 0.02)
    robust = Priors.headings(every, value, 0.02, np.full(len(graph), 2.0))
    off = [
        np.abs(wrap(solve(replace(graph, priors=p)).pose[10, 2] - truth[10, 2]))
        for p in (plain, robust)
    ]
    assert off[1] < 0.1 * off[0]
    assert solve(replace(graph, priors=robust)).prior_weight[10] < 0.05


def test_point_landmarks_fix_the_poses_that_see_them() -> None:
    """A landmark is a pose with edges that tell no heading."""
    rng = np.random.default_rng(0)
    graph, truth = loop_graph(8, loops=0, noise=0.5)
    n = len(graph)
    marks = rng.uniform(-5, 5, (4, 2)) + truth[::8, :2].mean(axis=0)
    source, target = np.repeat(np.arange(n), 4), np.tile(np.arange(n, n + 4), n)
    mark_pose = np.column_stack([marks, np.zeros(4)])
    seen = between(truth[source], mark_pose[target - n])
    seen[:, 2] = 0.0
    seen[:, :2] += rng.normal(0, 0.02, (len(seen), 2))
    tells = np.zeros((len(seen), 3, 3))
    tells[:, 0, 0] = tells[:, 1, 1] = 1 / 0.02**2
    whole = PoseGraph(
        np.concatenate([graph.pose, np.zeros((4, 3))]),
        np.concatenate([graph.source, source]),
        np.concatenate([graph.target, target]),
        np.concatenate([graph.measurement, seen]),
        np.concatenate([graph.information, tells]),
    )
    solution = solve(whole)
    assert solution.converged
    T = fit_rigid(truth[:, :2], solution.pose[:n, :2])
    np.testing.assert_allclose(compose(T, solution.pose)[n:, :2], marks, atol=0.03)
    np.testing.assert_array_equal(solution.pose[n:, 2], 0)


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


def test_relative_covariance_does_not_depend_on_the_gauge() -> None:
    graph, _ = loop_graph(11)
    T = np.array([3.0, -2.0, 1.0])
    order = np.roll(np.arange(len(graph)), 7)
    pose = np.empty_like(graph.pose)
    pose[order] = compose(T, graph.pose)
    other = PoseGraph(
        pose, order[graph.source], order[graph.target], graph.measurement, graph.information
    )
    a, b = np.array([2, 20, 28]), np.array([17, 21, 0])
    here = Marginals.of(graph, solve(graph)).relative(a, b)
    there = Marginals.of(other, solve(other)).relative(order[a], order[b])
    np.testing.assert_allclose(here, there, rtol=1e-3, atol=1e-9)


@pytest.mark.parametrize("n", [0, 1, 3])
def test_graphs_without_edges_are_their_own_solution(n: int) -> None:
    nothing = np.zeros(0, np.int64)
    pose = np.arange(3.0 * n).reshape(n, 3) / 10
    graph = PoseGraph(pose, nothing, nothing, np.zeros((0, 3)), np.zeros((0, 3, 3)))
    solution = solve(graph)
    np.testing.assert_allclose(solution.pose, pose)
    assert solution.chi2 == 0
    assert solution.converged


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
