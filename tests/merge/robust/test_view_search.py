"""Placements that views propose."""

import numpy as np

from topobatch.merge.robust.view_search import pictured, placements
from topobatch.topology.se2 import apply, wrap

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
