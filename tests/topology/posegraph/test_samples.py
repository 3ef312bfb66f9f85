"""Sampled covariances against exact ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from topobatch.topology.posegraph.graph import PoseGraph
from topobatch.topology.posegraph.marginals import Marginals
from topobatch.topology.posegraph.samples import (
    MOST_DRAWN,
    SampledMarginals,
    of_unit_variance,
    square_root,
    white,
)
from topobatch.topology.posegraph.solve import solve


def ring(n: int) -> PoseGraph:
    """A ring of poses, whose edges bend more and more."""
    turn = 2 * np.pi / n
    pose = np.column_stack([np.cumsum(np.cos(turn * np.arange(n))), np.zeros(n), np.zeros(n)])
    step = np.tile([1.0, 0.0, turn], (n, 1))
    ends = np.arange(n), (np.arange(n) + 1) % n
    information = np.tile(np.diag([400.0, 400.0, 900.0]), (n, 1, 1))
    return PoseGraph(pose, *ends, step, information, swing=np.linspace(0.0, 0.5, n))


def test_covariances_are_the_exact_ones_to_what_a_sample_tells() -> None:
    graph = ring(12)
    solution = solve(graph)
    exact, count = Marginals.of(graph, solution), 4000
    sampled = SampledMarginals.of(graph, solution, count)
    a, b = np.array([0, 0, 3]), np.array([1, 6, 8])
    want, found = exact.relative(a, b), sampled.relative(a, b)
    scale = np.sqrt(np.einsum("kii,kjj->kij", want, want))
    assert np.abs((found - want) / scale).max() < 4 * np.sqrt(2 / count)
    assert np.array_equal(found, SampledMarginals.of(graph, solution, count).relative(a, b))


def test_samples_do_not_hang_on_rounding() -> None:
    """Edges that know x as well as y have no axes of their own: rounding would choose them."""
    graph = ring(12)
    last = 1e-12 * np.array([[0, 1, 0], [1, 0, 0], [0, 0, 0]])
    rounded = replace(graph, information=graph.information + last)
    one, other = (SampledMarginals.of(g, solve(graph)).error for g in (graph, rounded))
    np.testing.assert_allclose(one, other, rtol=0, atol=1e-12)


def test_the_root_of_singular_information_is_symmetric() -> None:
    tells = np.array([[3.0, 4.0, 0.0]])
    information = tells[:, :, None] * tells[:, None, :]
    root = square_root(information)
    np.testing.assert_allclose(root, information / 5, atol=1e-12)


def test_errors_of_the_edges_alone_may_be_stated() -> None:
    graph = ring(12)
    solution, sigma = solve(graph), np.tile([1 / 20, 1 / 20, 1 / 30], (12, 1))
    a, b = np.array([0, 0, 3]), np.array([1, 6, 8])
    usual = SampledMarginals.of(graph, solution, outliers=False)
    half = usual.by_edges(0.5 * sigma)
    np.testing.assert_allclose(half.relative(a, b), 0.25 * usual.relative(a, b), atol=1e-12)
    np.testing.assert_allclose(half.edge_residual, 0.5 * usual.edge_residual, atol=1e-9)


def test_white_noise_is_the_same_however_much_was_drawn_before() -> None:
    for size in (30, 3000, 8, MOST_DRAWN + 1):
        rng = np.random.default_rng(5)
        first, second = white(5, [(size // 2, 2), (3,)])
        assert np.array_equal(first, rng.standard_normal((size // 2, 2)))
        assert np.array_equal(second, rng.standard_normal(3))


def test_noise_of_unit_variance_has_it_in_every_row() -> None:
    (drawn,) = white(5, [(7, 2, 64)])
    scaled = of_unit_variance(drawn)
    assert np.ptp(np.mean(drawn**2, axis=-1)) > 0.1
    np.testing.assert_allclose(np.mean(scaled**2, axis=-1), 1.0, rtol=1e-12)
    np.testing.assert_allclose(scaled / drawn, (scaled / drawn)[..., :1].repeat(64, axis=-1))
