"""The marginal likelihood of closed runs: in closed form, and of the truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from topobatch.topology.closure.alternatives import log_marginal_likelihood
from topobatch.topology.closure.dead_reckoning import dead_reckoning, dead_reckoning_covariance
from topobatch.topology.closure.estimate import optimise
from topobatch.topology.closure.variance_components import ComponentSettings

from .walks import NOISE, grid_world, partition, record, wander

DENSITY = 0.04
"""Of places per m²."""


def test_one_identification_counts_as_its_gaussian_over_the_density_of_places():
    route = [(0, 0), (0, 1), (1, 1), (1, 0), (0, 0)]
    odometry, passes, truth = record(grid_world(2, 2), route)
    reckoning = dead_reckoning(odometry, passes, NOISE)
    apart, one = (
        log_marginal_likelihood(optimise(reckoning, place), DENSITY)
        for place in (np.arange(5), partition(truth))
    )
    cov = dead_reckoning_covariance(reckoning, np.array([0]), np.array([4]))[0]
    reading = NOISE.branch_rad**2 / passes.branches.counts[[0, 4]]
    cov += np.diag([2 * NOISE.centre_m**2] * 2 + [reading.sum()])
    gaussian = -0.5 * np.log(np.linalg.det(2 * np.pi * cov))
    # All errors are zero, so that the noise is taken to be smaller than stated.
    told = ComponentSettings().prior_freedom
    level = -0.5 * (told + 3) * (np.log(told / (told + 3)) + 1) + 0.5 * told
    expected = gaussian - np.log(DENSITY / (2 * np.pi)) + level
    assert one - apart == pytest.approx(expected, abs=0.02)


def test_positions_that_are_hardly_known_are_measured_all_the_same():
    """As of detections in millimetres: their factors measure no less than there are unknowns."""
    odometry, passes, truth = record(grid_world(2, 2), [(0, 0), (0, 1), (1, 1), (1, 0), (0, 0)])
    estimate = optimise(dead_reckoning(odometry, passes, NOISE), partition(truth))
    rough = estimate.graph.information * np.array([1e-5, 1e-5, 1]) * [[1e-5], [1e-5], [1]]
    graph = replace(estimate.graph, information=rough)
    assert np.isfinite(log_marginal_likelihood(replace(estimate, graph=graph), DENSITY))


@pytest.mark.parametrize("seed", range(2))
def test_the_truth_explains_a_walk_better_than_what_is_nearly_so(seed):
    rng = np.random.default_rng(seed)
    world = grid_world(5, 5, rng)
    odometry, passes, truth = record(world, wander(world[1], 90, rng), rng)
    reckoning, true = dead_reckoning(odometry, passes, NOISE), partition(truth)
    start = optimise(reckoning, true).pose

    def likelihood(place):
        return log_marginal_likelihood(optimise(reckoning, partition(place), start), DENSITY)

    split, two = true.copy(), true.copy()
    split[np.flatnonzero(true == np.bincount(true).argmax())[-1]] = true.max() + 1
    two[true == true[1]] = true[0]
    assert likelihood(true) > likelihood(split) > likelihood(np.arange(len(true)))
    assert likelihood(true) > likelihood(two)
