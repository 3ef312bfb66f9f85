"""Tables of what the passes by each place saw."""

from __future__ import annotations

import numpy as np
import pytest

from topobatch.topology.closure.dead_reckoning import dead_reckoning
from topobatch.topology.closure.places import NOWHERE, tabulate

from .walks import NOISE, grid_world, partition, record


def test_tables_of_places():
    world = grid_world(2, 2)
    route = [(0, 0), (0, 1), (0, 0), (0, 1), (1, 1)]
    odometry, passes, truth = record(world, route)
    reckoning = dead_reckoning(odometry, passes, NOISE)
    place = partition(truth)
    places = tabulate(reckoning, place, np.zeros(len(passes)), 0.35)
    assert places.visits.tolist() == [2, 2, 1]
    east = int(np.nanargmin(np.abs(places.heading[0])))
    assert places.next_place[0, east] == 1
    assert places.driven[0, east] == places.tried[0, east] == 3
    assert places.length[0, east] == pytest.approx(5.0)
    assert (places.next_place[0] == NOWHERE).sum() == places.heading.shape[1] - 1
