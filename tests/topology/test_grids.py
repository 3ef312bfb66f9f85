"""Grids cropped, moved to other frames, and laid over each other."""

import numpy as np
import pytest

from topobatch.topology.grids import cropped, layered, resampled
from topobatch.topology.run import Grid
from topobatch.topology.se2 import apply, inverse

from .floors import floor

SOME = floor(2)[100:220, 150:350]


def grid(wall, *, cell_m=0.1, origin=(0.0, 0.0, 0.0), unknown=None):
    unknown = np.zeros(wall.shape, bool) if unknown is None else unknown
    return Grid(~wall & ~unknown, unknown, cell_m, origin, "a")


def moved_to(T):
    return lambda xy: np.tile(T, (len(xy), 1))


def test_what_is_not_known_is_cropped() -> None:
    unknown = np.ones(SOME.shape, bool)
    unknown[10:20, 30:50] = False
    kept = cropped(grid(SOME, origin=(1.0, 2.0, np.pi / 2), unknown=unknown))
    assert kept.free.shape == (10, 20)
    assert np.array_equal(kept.free, ~SOME[10:20, 30:50])
    assert kept.origin == pytest.approx((0.0, 5.0, np.pi / 2))
    assert cropped(grid(SOME, unknown=np.ones(SOME.shape, bool))) is None


@pytest.mark.parametrize("turn", [0.3, 1.0, -2.2])
def test_a_turned_grid_shows_the_same_cells_without_holes(turn) -> None:
    T = np.array([3.3, -1.7, turn])
    there = resampled(grid(SOME), moved_to(T), 0.1, "b")
    row, column = np.indices(there.free.shape)
    own = (np.stack([column, row], axis=-1) + 0.5) * 0.1 + there.origin[:2]
    x, y = np.moveaxis(apply(inverse(T), own) / 0.1, -1, 0)
    inside = (x > 1) & (y > 1) & (x < SOME.shape[1] - 1) & (y < SOME.shape[0] - 1)
    assert not there.unknown[inside].any()
    truth = SOME[y[inside].astype(int), x[inside].astype(int)]
    # Cells cut by the edge of a wall may go either way.
    assert (truth != (~there.free[inside])).mean() < 0.06
    outside = (x < -1) | (y < -1) | (x > SOME.shape[1] + 1) | (y > SOME.shape[0] + 1)
    assert there.unknown[outside].all()


def test_the_first_grid_that_knows_a_cell_tells_what_it_is() -> None:
    wall = np.ones((4, 6), bool)
    unknown = np.zeros((4, 6), bool)
    unknown[:, 3:] = True
    first = grid(wall, unknown=unknown)
    second = grid(~wall, origin=(0.1, 0.2, 0.0))
    both = layered([first, second])
    assert both.free.shape == (6, 7)
    assert both.origin == (0.0, 0.0, 0.0)
    walls = ~both.free & ~both.unknown
    assert walls[:4, :3].all()
    assert walls.sum() == 12
    assert both.free[2:, 3:].all()
    assert both.free[4:, 1:].all()
    assert both.free.sum() == 24 - 2 * 2
    assert both.unknown.sum() == 42 - 12 - 20
    assert layered([]) is None
