"""Corridors led round walls that their paths cross."""

from dataclasses import replace

import numpy as np

from topobatch.topology.polyline import densely, way_of
from topobatch.topology.run import Grid
from topobatch.viz.exports.free_ways import ASIDE_M, led_round

CELL_M = 0.1


def walled(*boxes: tuple[float, float, float, float]) -> Grid:
    """20 by 20 m around the origin, with walls in boxes (left, low, right, high)."""
    free = np.ones((200, 200), bool)
    for box in boxes:
        left, low, right, high = np.rint((np.array(box) + 10) / CELL_M).astype(int)
        free[low:high, left:right] = False
    return Grid(free, np.zeros_like(free), CELL_M, (-10.0, -10.0, 0.0), "odom")


def test_a_path_through_a_pillar_goes_round_it_and_the_others_stay(make_map) -> None:
    topomap = make_map("run")
    straight = np.array([(-5.0, 0.0), (5.0, 0.0)])
    topomap = replace(topomap, paths=(straight, *topomap.paths[1:]))
    clear, *_ = led_round(topomap, walled((-0.4, -0.4, 0.4, 0.2))).paths
    assert np.array_equal(clear[[0, -1]], straight)
    points = densely(clear, CELL_M / 2)
    assert not np.any((np.abs(points[:, 0]) < 0.4) & (points[:, 1] > -0.4) & (points[:, 1] < 0.2))
    assert points[:, 1].max() < ASIDE_M
    assert way_of(clear)[-1] < 11


def test_a_closed_door_is_passed_where_the_path_passes_it(make_map) -> None:
    topomap = make_map("run")
    straight = np.array([(-5.0, 0.0), (5.0, 0.0)])
    topomap = replace(topomap, paths=(straight, *topomap.paths[1:]))
    shut = led_round(topomap, walled((-0.1, -5.0, 0.1, 5.0)))
    assert np.array_equal(shut.paths[0], straight)
