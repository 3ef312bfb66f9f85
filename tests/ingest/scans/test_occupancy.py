"""Fine grids of what keyframes saw."""

from __future__ import annotations

import numpy as np
import pytest

from topobatch.ingest.run_scans import Occupancy
from topobatch.ingest.scans.keyframes import join, keyframes
from topobatch.ingest.scans.matching import posed
from topobatch.ingest.scans.scan import ScanBatch
from topobatch.topology.columns import take
from topobatch.topology.se2 import compose

from .building import WHOLE_TURN, Building, drive

ROOM = Building.of((-3, -2, 3, 2))


def frames(odometry):
    ranges = ROOM.ranges(odometry.pose, WHOLE_TURN).astype(np.float32)
    batch = ScanBatch(odometry.time_ns, ranges, 0.0, WHOLE_TURN)
    return join(list(keyframes(posed(odometry, [batch]))))


@pytest.mark.parametrize("T", [(0.0, 0.0, 0.0), (7.0, -4.0, np.pi / 2)])
def test_walls_lie_where_they_are(T) -> None:
    seen = frames(drive((-2.0, 0.5), (2.0, 0.5)))
    cast = Occupancy(0.05)
    assert cast.grid("map") is None
    for half in (slice(0, 5), slice(5, None)):  # of two runs
        rows = np.arange(len(seen))[half]
        some = take(seen, rows)
        cast.add(some, compose(np.array(T), some.odometry))
    grid = cast.grid("map")
    assert (grid.frame, grid.resolution_m) == ("map", 0.05)
    wall = ~grid.free & ~grid.unknown
    size = np.array(wall.shape[::-1]) * 0.05
    middle = np.array(grid.origin[:2]) + size / 2
    assert size == pytest.approx((6, 4) if T[2] == 0 else (4, 6), abs=0.2)
    assert middle == pytest.approx(T[:2], abs=0.1)
    assert grid.free.sum() * 0.05**2 == pytest.approx(24, rel=0.05)
    y, x = np.nonzero(wall)
    edge = np.minimum(np.minimum(x, wall.shape[1] - 1 - x), np.minimum(y, wall.shape[0] - 1 - y))
    assert edge.max() <= 2  # nothing stands in the room
    assert wall.sum() > 0.9 * 20 / 0.05
