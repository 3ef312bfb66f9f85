"""Placements that views propose."""

from dataclasses import replace

import numpy as np

from topobatch.merge.robust.view_evidence import repeats
from topobatch.merge.robust.view_search import ANGLES, _rotations, pictured, placements
from topobatch.topology.se2 import apply, compose, wrap

from .rooms import line, views_of, walls_of

T_B_WORLD = (5.0, -3.0, 2.0)


def test_the_true_placement_comes_first() -> None:
    walls = walls_of(1)
    a = views_of(walls, line((5, 20), (35, 20)))
    b = views_of(walls, line((20, 5), (20, 35)), T_B_WORLD)
    found = placements(pictured(a), pictured(b))
    there = apply(T_B_WORLD, np.array([20.0, 20.0]))
    assert np.hypot(*(apply(found[0], there) - [20.0, 20.0])) < 1.0
    assert abs(wrap(found[0, 2] + 2.0)) < 0.05


def test_a_stretch_that_furniture_misleads_is_turned_as_the_others_are() -> None:
    walls = walls_of(1)
    a = pictured(views_of(walls, line((5, 20), (35, 20))))
    b = pictured(views_of(walls, line((5, 20), (35, 20)), T_B_WORLD))
    first, *_ = b.stretches
    (turn,) = _rotations(a, b, first)
    aside = ANGLES // 3  # 30 degrees
    misled = replace(first, directions=np.roll(first.directions, aside))
    wrong, right = _rotations(a, b, misled)
    quarter = np.pi / 2
    assert (
        abs((wrong - turn + aside * quarter / ANGLES + quarter / 2) % quarter - quarter / 2) < 0.04
    )
    assert abs((right - turn + quarter / 2) % quarter - quarter / 2) < 0.04


def test_a_map_of_hardly_a_wall_is_searched_without_stretches() -> None:
    bare = pictured(views_of(np.array([[18.0, 20.0, 19.0, 20.0]]), line((15, 19), (22, 19), 3)))
    b = pictured(views_of(walls_of(1), line((5, 20), (35, 20))))
    assert not bare.stretches
    assert not bare.local_directions.any()
    assert placements(bare, b).shape[1] == 3


def test_a_map_larger_than_a_square_is_searched_in_several() -> None:
    near, far = walls_of(1, (60.0, 30.0)), walls_of(2, (60.0, 30.0))
    copies = [near + np.array([x, y] * 2) for x, y in ((0.0, 0.0), (500.0, 70.0))]
    world = np.concatenate([*copies, far + np.array([250.0, 400.0] * 2)])
    starts = ((5.0, 15.0), (505.0, 85.0), (255.0, 415.0))
    way = np.concatenate([line((x, y), (x + 50, y), 25) for x, y in starts])
    large = views_of(world, way)
    assert len(pictured(large).squares) > 1
    other = views_of(far, line((8, 16), (48, 16), 20), T_B_WORLD)
    first, *_ = placements(pictured(large), pictured(other))
    off = compose(np.array([-250.0, -400.0, 0.0]), compose(first, T_B_WORLD))
    assert np.hypot(*off[:2]) < 0.5
    assert repeats(large).size > 5
