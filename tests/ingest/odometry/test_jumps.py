"""Jumps of the odometry: found in the run's own motion, told from resets, driven on over."""

from __future__ import annotations

import numpy as np
import pytest

from topobatch.ingest.odometry.track import sane_track
from topobatch.topology.se2 import between, compose, wrap

SECOND = 10**9


def drive(n=4000, hz=20.0, seed=0):
    """A drive with turns on the spot every 10 s, 0.8 m/s and 1 rad/s, with the noise of wheels."""
    rng = np.random.default_rng(seed)
    second = np.arange(n) / hz
    turning = second % 10 > 10 - np.pi / 2
    way = np.where(turning, 0.0, 0.8 / hz) + rng.normal(0, 0.002, n) * ~turning
    turn = np.where(turning, 1.0 / hz, 0.0) + rng.normal(0, 0.002, n)
    heading = np.concatenate([[0.3], 0.3 + np.cumsum(turn)])[:n]
    step = np.column_stack([way * np.cos(heading), way * np.sin(heading)])
    xy = np.array([5.0, 3.0]) + np.concatenate([np.zeros((1, 2)), np.cumsum(step, axis=0)])[:n]
    time = 1_700_000_000 * SECOND + np.round(second * SECOND).astype(np.int64)
    return time, np.column_stack([xy, wrap(heading)])


def jumped(pose, row, jump):
    """The poses with the odometry's frame jumping before a row, seen from the robot."""
    out = pose.copy()
    out[row:] = compose(compose(pose[row], jump), between(pose[row], pose[row:]))
    return out


def read(time, pose):
    track = sane_track(time.copy(), pose.copy(), "odom", "base_link")
    return track.odometry, track


@pytest.mark.parametrize("row", [1990])
@pytest.mark.parametrize(
    "jump", [(0.1, 0.0, 0.0), (0.0, -0.1, 0.0), (0.0, 0.0, 0.1), (-0.3, 0.36, 0.8), (1.0, 0.0, 3.0)]
)
def test_a_jump_is_found_and_driven_on_over(row, jump):
    time, pose = drive()
    odometry, track = read(time, jumped(pose, row, jump))
    assert odometry.jumps.tolist() == [row]
    assert odometry.breaks.tolist() == []
    np.testing.assert_allclose(odometry.pose[:row], pose[:row])
    assert np.abs(odometry.pose[row:, :2] - pose[row:, :2]).max() < 0.4  # 5 mm or 5 mrad, far off
    sigma_m, sigma_rad = odometry.jump_sigma[0]
    assert np.hypot(*jump[:2]) <= sigma_m + 0.06
    assert sigma_m <= np.hypot(*jump[:2]) + 0.06
    assert min(abs(jump[2]), 1.8) <= sigma_rad + 0.01
    seen = compose(between(pose[row - 1], pose[row]), jump)
    np.testing.assert_allclose(odometry.jump_other[0], seen, atol=1e-9)
    assert track.warnings[0].startswith("odometry jumps once (")


def test_an_odometry_that_runs_well_has_no_jumps():
    for hz in (5.0, 10.0, 20.0, 50.0):
        time, pose = drive(hz=hz)
        odometry, track = read(time, pose)
        assert track.warnings == ()
        assert odometry.pose.tolist() == pose.tolist()
        assert len(odometry.jumps) == 0


def test_a_silence_is_driven_through():
    time, pose = drive()
    keep = np.ones(len(time), bool)
    keep[900:940] = keep[2150:2300] = False
    odometry, _ = read(time[keep], pose[keep])
    assert len(odometry.cuts) == 0


def test_back_to_the_origin_or_to_the_begin_is_a_reset():
    time, pose = drive()
    for home in (np.zeros(3), pose[0]):
        again = pose.copy()
        again[2500:] = compose(home, between(pose[2500], pose[2500:]))
        odometry, track = read(time, again)
        assert odometry.breaks.tolist() == [2500]
        assert len(odometry.jumps) == 0
        assert "odometry is reset once" in track.warnings[0]
        assert "the chain is split there" in track.warnings[0]
