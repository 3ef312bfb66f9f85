"""Grids of what keyframes saw."""

from __future__ import annotations

import numpy as np
import pytest

from topobatch.ingest.scans.grid import looks
from topobatch.ingest.scans.keyframes import join, keyframes
from topobatch.ingest.scans.matching import posed
from topobatch.ingest.scans.scan import ScanBatch
from topobatch.topology.odometry import Odometry

from .building import WHOLE_TURN, Building

ROOM = Building.of((-3, -3, 3, 3))
MIDDLE = np.zeros((6, 3))
TIME_NS = np.arange(1, 7) * 10**9


@pytest.mark.parametrize(("blind", "free"), [(6, False), (5, True), (0, True)])
def test_beams_without_an_echo_are_free_as_far_as_walls_beside_them_unless_they_never_have_one(
    blind: int, free: bool
) -> None:
    ranges = ROOM.ranges(MIDDLE, WHOLE_TURN).astype(np.float32)
    ranges[:blind, 100:130] = np.nan
    turned = MIDDLE + np.arange(6)[:, None] * (0, 0, 0.2)  # each of them is a keyframe
    odometry = Odometry(TIME_NS, turned, np.zeros(0, np.int64))
    batch = ScanBatch(TIME_NS, ranges, 8.0, WHOLE_TURN)
    frames = join(list(keyframes(posed(odometry, [batch]))))
    seen = looks(frames, MIDDLE)
    assert len(seen.corner) == 6
    ahead = np.round([2 * np.cos(WHOLE_TURN[115]) / 0.1, 2 * np.sin(WHOLE_TURN[115]) / 0.1])
    x, y = ahead.astype(int) + seen.free.shape[1] // 2
    assert (seen.free[:, y, x] == free).all()
    # What was never blanked is told all the same.
    assert seen.free[:, -y, -x].all()
