"""Sampled covariances against exact ones."""

from __future__ import annotations

import numpy as np

from topobatch.topology.posegraph.graph import PoseGraph
from topobatch.topology.posegraph.marginals import Marginals
from topobatch.topology.posegraph.samples import SampledMarginals
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
