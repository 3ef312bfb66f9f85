from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from topobatch.topology.topomap import TopoMap
from topobatch.viz.drawing import (
    extent,
    ribbons,
    thinned,
)


def test_a_map_reaches_as_far_as_its_corridors(make_map: Callable[..., TopoMap]) -> None:
    topomap = make_map("r")
    beside = np.array([topomap.xy[2], (20.0, 12.0), topomap.xy[4]])
    bulging = replace(topomap, paths=(*topomap.paths[:4], beside))
    assert extent(bulging).max(axis=0).tolist() == [20.0, 12.0]


def test_a_ribbon_keeps_its_distance_round_a_corner() -> None:
    path = np.array([(0.0, 0.0), (5.0, 0.0), (5.0, 0.0), (5.0, 5.0)])
    left, right = ribbons([path, path], np.array([0.5, -0.5]))
    assert left == pytest.approx(np.array([(0.0, 0.5), (4.5, 0.5), (4.5, 5.0)]))
    assert right == pytest.approx(np.array([(0.0, -0.5), (5.5, -0.5), (5.5, 5.0)]))


def test_a_ribbon_throws_no_spikes_where_the_path_turns_back() -> None:
    path = np.array([(0.0, 0.0), (5.0, 0.0), (0.0, 0.01)])
    (beside,) = ribbons([path], np.array([0.5]))
    assert np.abs(beside - path).max() <= 1.0 + 1e-9


def test_thinning_keeps_the_ends_and_the_spacing() -> None:
    xy = np.stack([np.linspace(0, 10, 1001), np.zeros(1001)], axis=-1)
    rows = thinned(xy, 0.5)
    assert rows[0] == 0
    assert rows[-1] == 1000
    assert 20 <= len(rows) <= 22
    assert thinned(np.zeros((500, 2)), 0.5).tolist() == [0, 499]
