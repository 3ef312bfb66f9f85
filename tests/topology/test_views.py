"""Views as values, and their cells from counts."""

from __future__ import annotations

import numpy as np
import pytest

from topobatch.topology.views import DISC, FREE, NO_VIEWS, SIDE, UNKNOWN, WALL, Views, view_cells


def counts():
    return np.zeros((2 * SIDE, 2 * SIDE), int), np.zeros((2 * SIDE, 2 * SIDE), int)


def test_a_cell_is_a_wall_where_a_quarter_of_the_looks_hit_something():
    hit, free = counts()
    row = SIDE  # the first row above the middle
    hit[row, SIDE], free[row, SIDE] = 1, 3
    hit[row, SIDE + 2], free[row, SIDE + 2] = 1, 4  # somebody who walked by
    free[row, SIDE + 4] = 1
    cells = view_cells(hit, free)
    middle = cells[SIDE // 2, SIDE // 2 : SIDE // 2 + 4].tolist()
    assert middle == [WALL, FREE, FREE, UNKNOWN]


def test_views_end_at_their_reach_all_around():
    hit, free = counts()
    cells = view_cells(hit, free + 1)
    assert (cells[DISC] == FREE).all()
    assert (cells[~DISC] == UNKNOWN).all()


def test_views_are_checked():
    cells = np.zeros((1, SIDE, SIDE), np.uint8)
    assert len(NO_VIEWS) == 0
    with pytest.raises(ValueError, match="pose has shape"):
        Views(np.zeros(1, int), np.zeros((2, 3)), cells)
    with pytest.raises(ValueError, match="unknown, free or a wall"):
        Views(np.zeros(1, int), np.zeros((1, 3)), cells + 3)
