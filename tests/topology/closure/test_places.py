"""Tables of places."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from topobatch.topology.closure.dead_reckoning import dead_reckoning
from topobatch.topology.closure.places import tabulate
from topobatch.topology.passes import NO_BRANCH

from .walks import NOISE, grid_world, partition, record, wander


def test_ways_by_branches_that_only_the_track_shows_are_known():
    """One exit is not reported, and all entries are."""
    rng = np.random.default_rng(3)
    world = grid_world(4, 4, rng)
    odometry, passes, truth = record(world, wander(world[1], 40, rng), rng)
    reckoning = dead_reckoning(odometry, passes, NOISE)
    k = 20
    assert passes.exit[k] != NO_BRANCH
    assert np.isfinite(reckoning.leaving[k])
    assert not np.any((passes.entry == NO_BRANCH) & np.isfinite(reckoning.arriving))
    hidden = replace(passes, exit=np.where(np.arange(len(passes)) == k, NO_BRANCH, passes.exit))
    tried = [
        tabulate(replace(reckoning, passes=p), partition(truth), np.zeros(len(passes))).tried.sum()
        for p in (passes, hidden)
    ]
    assert tried[0] == tried[1]
