"""Ways that a robot can drive."""

from __future__ import annotations

import numpy as np

from topobatch.ingest.scans.open_space import OpenSpace
from topobatch.ingest.scans.ways import Drivable, drivable_way
from topobatch.topology.polyline import densely

CELL = 0.05


def corridor(*obstacles: tuple[int, int, int, int]) -> Drivable:
    """A corridor of 3 m with obstacles (row, column, row, column) in it, for a robot of 0.25 m."""
    free = np.pad(np.ones((60, 300), bool), 1)
    for a, b, c, d in obstacles:
        free[a:c, b:d] = False
    space = OpenSpace.of(free, CELL)
    return Drivable.of(space.room_m, space.all_m, 0.25, CELL)


ALONG = np.column_stack([np.arange(20, 281), np.full(261, 30)]) * CELL
REACH = np.full(len(ALONG), 1.5)


def test_an_obstacle_is_driven_round() -> None:
    drivable = corridor((20, 140, 45, 160))
    way = drivable_way(ALONG, drivable, REACH)
    assert way is not None
    points = densely(way.path, 0.01) / CELL
    # A box of 1 m: the robot keeps its radius from it, up to a cell.
    beside = np.maximum(np.abs(points - [149.5, 32]) - [10, 12.5], 0)
    assert np.hypot(*beside.T).min() * CELL > 0.2
    assert 13.05 < way.length_m < 14.5
    np.testing.assert_allclose(way.path[[0, -1]], ALONG[[0, -1]])
