"""How far dead reckoning may be off."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from topobatch.topology.closure.dead_reckoning import (
    dead_reckoning,
    dead_reckoning_covariance,
    relative_covariance,
    scale_noise,
)
from topobatch.topology.closure.estimate import optimise

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
    more = dead_reckoning_covariance(quiet, np.array([0]), np.array([5]))[0]
    assert np.all(np.linalg.eigvalsh(more - expected) > -1e-12)


def test_a_jump_adds_its_own_uncertainty_and_keeps_it():
    world = grid_world(4, 4)
    route = [(0, 0), (0, 1), (1, 1), (1, 2), (2, 2), (2, 1)]
    odometry, passes, _ = record(world, route)
    row = int(np.searchsorted(odometry.time_ns, passes.time_ns[3])) - 15
    jumping = replace(
        odometry,
        jumps=np.array([row]),
        jump_sigma=np.array([[0.4, 0.3]]),
        jump_other=np.zeros((1, 3)),
    )
    quiet, reckoning = (
        dead_reckoning(odometry, passes, NOISE),
        dead_reckoning(jumping, passes, NOISE),
    )
    first, second = np.array([0, 0, 3]), np.array([2, 5, 5])
    more = relative_covariance(reckoning, first, second) - relative_covariance(quiet, first, second)
    np.testing.assert_allclose(more[[0, 2]], 0.0, atol=1e-12)
    arm = passes.centre[5] - odometry.pose[row, :2]
    turned = np.array([-arm[1], arm[0], 1.0])
    np.testing.assert_allclose(
        more[1], 0.3**2 * np.outer(turned, turned) + 0.4**2 * np.diag([1, 1, 0]), atol=1e-12
    )
    # However loud the rest is taken to be, the jump is as large as it is.
    for factor in (0.35, 4.0):
        again = relative_covariance(scale_noise(reckoning, factor), first, second)
        again -= relative_covariance(scale_noise(quiet, factor), first, second)
        np.testing.assert_allclose(again, more, atol=1e-12)
    assert np.flatnonzero(np.isnan(reckoning.leg)).tolist() == [
        2
    ]  # no corridor is known by its length
    estimate = optimise(reckoning, np.arange(len(reckoning)))
    found = estimate.relative_covariance(np.array([2]), np.array([3]))[0]
    np.testing.assert_allclose(found, relative_covariance(reckoning, [2], [3])[0], atol=1e-3)


def test_a_reset_to_a_far_frame_changes_no_covariance():
    odometry, passes, _ = record(grid_world(4, 4), [(0, 0), (0, 1), (1, 1), (1, 2), (2, 2), (2, 1)])
    row = int(np.searchsorted(odometry.time_ns, passes.time_ns[3])) - 15

    def reset(away_m):
        pose, centre = odometry.pose.copy(), passes.centre.copy()
        pose[row:, :2] += away_m
        centre[3:] += away_m
        broken = replace(odometry, pose=pose, breaks=np.array([row]))
        reckoning = dead_reckoning(broken, replace(passes, centre=centre), NOISE)
        return dead_reckoning_covariance(reckoning, np.array([0, 3]), np.array([2, 5]))

    np.testing.assert_allclose(reset(1e9), reset(0.0), atol=1e-6)
