"""The marginal likelihood of closed runs: in closed form, and of the truth."""

from __future__ import annotations

import numpy as np
import pytest

from topobatch.topology.closure.alternatives import log_marginal_likelihood
from topobatch.topology.closure.dead_reckoning import dead_reckoning
from topobatch.topology.closure.estimate import optimise

from .walks import NOISE, grid_world, partition, record, wander

DENSITY = 0.04
"""Of places per m²."""


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
