"""Walls, specks and islands of grids, and the lattice along the walls."""

from __future__ import annotations

import numpy as np
import pytest

from topobatch.ingest.scans.open_space import OpenSpace, wall_yaw
from topobatch.ingest.scans.ways import Drivable
from topobatch.topology.se2 import wrap

CELL = 0.05


def hall(yaw: float) -> np.ndarray:
    """Free cells of a hall of 12 x 5 m, turned."""
    y, x = np.mgrid[-8:8:CELL, -8:8:CELL]
    c, s = np.cos(yaw), np.sin(yaw)
    return np.asarray((np.abs(c * x + s * y) < 6) & (np.abs(c * y - s * x) < 2.5))


@pytest.mark.parametrize("yaw", [0.3, np.pi / 4])
@pytest.mark.parametrize("cells", [1, 2])
def test_the_direction_of_walls(yaw: float, cells: int) -> None:
    free = hall(yaw)[::cells, ::cells]
    found = wall_yaw(free, np.zeros_like(free), cells * CELL)
    assert abs(wrap(4 * (found - yaw))) / 4 < np.radians(1)


def test_what_stands_in_the_way() -> None:
    """A speck, a pillar of 0.5 m, and two desks that no robot fits between, 2.4 m together."""
    free = np.pad(np.ones((100, 200), bool), 1)
    free[20, 20] = False
    free[45:55, 45:55] = False
    free[45:65, 100:120] = False
    free[45:65, 127:148] = False
    space = OpenSpace.of(free, CELL)
    assert space.all_m[20, 20] == 0
    assert space.room_m[20, 20] > 0.9
    assert space.room_m[50, 50] == 0
    clearance_m = space.clearance_m(0.25, 2.0)
    assert clearance_m[50, 50] > 2.0
    assert clearance_m[50, 110] == 0
    drivable = Drivable.of(space.room_m, space.all_m, 0.25, CELL).cells
    assert not drivable[20, 20]
    assert not drivable[50, 57]
    assert drivable[50, 61]
    assert not drivable[50, 123]
