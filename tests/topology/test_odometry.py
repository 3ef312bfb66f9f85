"""Odometry is checked at birth; breaks and jumps."""

from __future__ import annotations

import numpy as np
import pytest

from topobatch.topology.odometry import Odometry


def test_odometry_interpolates_through_the_cut_of_the_angle():
    track = Odometry(
        np.array([0, 10, 20]),
        np.array([[0, 0, 3.0], [1, 0, -3.0], [2, 1, -2.0]]),
        np.zeros(0, np.int64),
    )
    pose = track.at(np.array([5, 15, -5, 99]))
    assert abs(pose[0, 2]) == pytest.approx(np.pi)
    np.testing.assert_allclose(pose[1], [1.5, 0.5, -2.5])
    np.testing.assert_allclose(pose[2], [0, 0, 3.0])
    np.testing.assert_allclose(pose[3], [2, 1, -2.0])
    np.testing.assert_allclose(track.turn_rad, [0, 2 * np.pi - 6, 1.0])


def test_odometry_cuts_are_breaks_and_jumps():
    track = Odometry(
        np.arange(9),
        np.zeros((9, 3)),
        np.array([2, 7]),
        jumps=np.array([4, 7]),
        jump_sigma=np.ones((2, 2)),
        jump_other=np.zeros((2, 3)),
    )
    assert track.cuts.tolist() == [2, 4, 7]


@pytest.mark.parametrize("times", [[0, 0, 1], [0, 2, 1]])
def test_odometry_times_must_ascend(times):
    with pytest.raises(ValueError, match="ascend"):
        Odometry(np.array(times), np.zeros((3, 3)), np.zeros(0, np.int64))
