"""How far dead reckoning may be off."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from topobatch.topology.closure.dead_reckoning import dead_reckoning, relative_covariance

from .walks import NOISE, grid_world, record


def test_dead_reckoning_covariance_is_that_of_many_drives():
    world = grid_world(4, 4)
    route = [(0, 0), (0, 1), (1, 1), (1, 2), (2, 2), (2, 1)]
    ends = []
    for seed in range(400):
        rng = np.random.default_rng(seed)
        _, passes, _ = record(world, route, rng, noise=replace(NOISE, centre_m=0.0))
        ends.append(passes.centre[-1] - passes.centre[0])
    odometry, passes, _ = record(world, route)
    quiet = dead_reckoning(odometry, passes, NOISE)
    expected = relative_covariance(quiet, np.array([0]), np.array([5]))[0]
    # The model lets positions walk sideways as much as along; the drive does not.
    slack = NOISE.along_m_per_sqrt_m**2 * quiet.leg.sum()
    found = np.cov(np.array(ends).T)
    assert np.all(np.abs(found - expected[:2, :2]) < 0.25 * np.trace(expected[:2, :2]) + slack)
