"""Pieces of a broken odometry, laid side by side."""

from __future__ import annotations

import numpy as np

from topobatch.topology.closure.dead_reckoning import make_walk
from topobatch.topology.closure.incremental import full_closure
from topobatch.topology.closure.pieces import set_apart

from .walks import NOISE, grid_world, record


def test_pieces_of_a_broken_odometry_stay_apart():
    rng = np.random.default_rng(12)
    world = grid_world(3, 3, rng)
    route = [(0, 0), (0, 1), (1, 1), (1, 0), (0, 0), (0, 1), (1, 1), (1, 0), (0, 0)]
    odometry, passes, _ = record(world, route, rng, breaks_before=(5,))
    walk = make_walk(odometry, passes, NOISE)
    closed = full_closure(walk)
    assert set(closed.place[:5]).isdisjoint(closed.place[5:])
    assert closed.place[0] == closed.place[4]
    layout = set_apart(walk, closed.place, closed.layout)
    left, right = layout.xy[closed.place[:5]], layout.xy[closed.place[5:]]
    assert left[:, 0].max() < right[:, 0].min()
    # Moved, not bent.
    np.testing.assert_allclose(
        np.diff(layout.xy[closed.place[5:]], axis=0),
        np.diff(closed.layout.xy[closed.place[5:]], axis=0),
        atol=1e-9,
    )
