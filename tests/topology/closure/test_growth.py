"""What corridors around two places tell of their being one."""

from __future__ import annotations

import numpy as np

from topobatch.topology.closure.branches import align, branches_of
from topobatch.topology.closure.dead_reckoning import dead_reckoning
from topobatch.topology.closure.estimate import optimise
from topobatch.topology.closure.evidence import background
from topobatch.topology.closure.growth import MapState, grow
from topobatch.topology.closure.places import tabulate

from .walks import NOISE, grid_world, partition, record, wander


def test_corridors_tell_the_same_place_from_the_next_one():
    rng = np.random.default_rng(33)
    world = grid_world(6, 6, rng)
    odometry, passes, truth = record(world, wander(world[1], 150, rng), rng)
    reckoning = dead_reckoning(odometry, passes, NOISE)
    estimate = optimise(reckoning, partition(truth))
    alone = np.arange(len(passes))  # every pass as a place of its own, where it was
    places = tabulate(reckoning, alone, estimate.pose[:, 2])
    common = background(reckoning, reckoning.noise)
    branches = branches_of(places, common)
    state = MapState(reckoning, places, estimate.pose[:, :2], common, branches)
    apart = np.abs(np.array(truth)[:, None] - np.array(truth)).sum(axis=2)
    same, next_ = (
        grow(state, a, b, align(branches, a, b, turn_sigma=np.full(len(a), 0.05)))
        for a, b in (np.nonzero(np.triu(apart == step, 1)) for step in (0, 1))
    )
    (gain, loss), (next_gain, next_loss) = same, next_
    assert not loss.any()
    assert np.mean(gain > 0) > 0.85  # the others have no driven corridor in common
    assert np.mean(next_loss > 0) > 0.6
    assert gain.mean() > 3 * next_gain.mean()
