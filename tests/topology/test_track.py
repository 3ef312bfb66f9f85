"""What the odometry tells about a pass."""

from __future__ import annotations

import numpy as np
import pytest

from topobatch.topology.track import track_directions, way_at

from .tracks import NORTH, WEST, track


def test_the_track_tells_where_the_robot_came_from():
    odometry, rows = track((0, 0), (8, 0), (8, 6))
    told = track_directions(odometry, odometry.time_ns[rows], odometry.pose[rows, :2])
    assert np.isnan(told.arriving[0])
    assert np.isnan(told.leaving[2])
    assert np.cos(told.arriving[1] - WEST) > 0.99
    assert told.leaving[1] == pytest.approx(NORTH)
    assert way_at(odometry, odometry.time_ns[rows]) == pytest.approx([0, 8, 14])
