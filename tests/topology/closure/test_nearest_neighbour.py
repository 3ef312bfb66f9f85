"""The gated closure, by position alone."""

from __future__ import annotations

import numpy as np

from topobatch.topology.closure.dead_reckoning import dead_reckoning
from topobatch.topology.closure.incremental import RoundSettings
from topobatch.topology.closure.nearest_neighbour import gated_closure

from .walks import NOISE, grid_world, record, wander


def test_the_gated_closure_is_honest_and_finds_less():
    rng = np.random.default_rng(11)
    world = grid_world(5, 5, rng)
    odometry, passes, truth = record(world, wander(world[1], 80, rng), rng)
    closed = gated_closure(dead_reckoning(odometry, passes, NOISE), RoundSettings())
    place, asked = closed.place, closed.identifications
    groups = [{truth[i] for i in np.flatnonzero(place == k)} for k in range(place.max() + 1)]
    assert all(len(group) == 1 for group in groups)
    assert len(set(truth)) <= len(groups) < len(truth)
    assert any(q.accepted for q in asked)
