"""Pieces of a broken odometry, laid side by side."""

from __future__ import annotations

import numpy as np

from topobatch.topology.closure.dead_reckoning import dead_reckoning
from topobatch.topology.closure.estimate import set_apart
from topobatch.topology.closure.incremental import full_closure

from .walks import NOISE, grid_world, record


def test_pieces_of_a_broken_odometry_stay_apart():
    rng = np.random.default_rng(12)
    world = grid_world(3, 3, rng)
    route = [(0, 0), (0, 1), (1, 1), (1, 0), (0, 0), (0, 1), (1, 1), (1, 0), (0, 0)]
    odometry, passes, _ = record(world, route, rng, breaks_before=(5,))
    reckoning = dead_reckoning(odometry, passes, NOISE)
    closed = full_closure(reckoning)
    assert set(closed.place[:5]).isdisjoint(closed.place[5:])
    assert closed.place[0] == closed.place[4]
    estimate = set_apart(reckoning, closed.place, closed.estimate)
    left, right = estimate.xy[closed.place[:5]], estimate.xy[closed.place[5:]]
    assert left[:, 0].max() < right[:, 0].min()
    # Moved, not bent.
    np.testing.assert_allclose(
        np.diff(estimate.xy[closed.place[5:]], axis=0),
        np.diff(closed.estimate.xy[closed.place[5:]], axis=0),
        atol=1e-9,
    )
