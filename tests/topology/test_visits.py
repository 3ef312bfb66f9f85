"""The track between two visits, drawn in the map."""

from __future__ import annotations

import numpy as np

from topobatch.topology.visits import Visits, draw_track

from .tracks import track


def test_the_track_meets_the_vertices_at_both_ends_and_is_turned_with_them():
    odometry, rows = track((0, 0), (8, 0), (8, 6))
    when = odometry.time_ns[rows]
    # In the map all is turned by a quarter, and the last vertex lies half a metre farther.
    xy = np.array([[10.0, 0.0], [10.0, 8.0], [3.5, 8.0]])
    pose = np.column_stack([xy, np.full(3, np.pi / 2)])
    visits = Visits(
        when, np.arange(3), np.ones(3, bool), pose, odometry.pose[rows, :2], np.zeros(3, int)
    )
    drawn = draw_track(odometry, visits, xy, np.array([0, 1]), 0.5)
    first, second = (slice(*drawn.offsets[k : k + 2]) for k in (0, 1))
    np.testing.assert_allclose(drawn.xy[first][[0, -1]], xy[:2], atol=1e-9)
    np.testing.assert_allclose(drawn.xy[second][[0, -1]], xy[1:], atol=1e-9)
    # What is left at the end is spread along the way: half of it in the middle.
    middle = (second.start + second.stop - 1) // 2 - second.start
    np.testing.assert_allclose(drawn.xy[second][middle], [6.75, 8.0], atol=1e-9)
    assert np.diff(drawn.way[first]).max() <= 0.5 + 1e-9
    np.testing.assert_allclose(drawn.turn, np.pi / 2)
