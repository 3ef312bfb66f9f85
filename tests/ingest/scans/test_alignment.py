"""Scans matched where the odometry leads astray."""

from __future__ import annotations

import numpy as np
import pytest

from topobatch.ingest.scans import alignment
from topobatch.ingest.scans.alignment import AlignmentSettings, Steps, match_steps
from topobatch.ingest.scans.association import Swept

from .building import WHOLE_TURN, Building


def test_what_is_searched_for_in_parts_is_found_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    """Memory follows the part, and no pair hangs on the others."""
    room = Building.of((0.0, 0.0, 7.0, 4.0), (3.0, 3.9, 4.5, 9.0))
    turned = np.array([0.0, 0.5, 0.0, 0.45, 0.9, 0.95])
    pose = np.array([(2.0 + 0.1 * k, 1.5, turn) for k, turn in enumerate(turned)])
    ranges = room.ranges(pose, WHOLE_TURN)
    along = np.stack([np.cos(WHOLE_TURN), np.sin(WHOLE_TURN)], axis=-1)
    xy = (ranges[..., None] * along).astype(np.float32)
    step = np.full(len(pose), WHOLE_TURN[1] - WHOLE_TURN[0])
    scans = Swept.of(xy, np.full(len(pose), WHOLE_TURN[0]), step)
    first = np.arange(1, len(pose))
    # The odometry says that the robot went straight on.
    straight = Steps(np.tile([0.1, 0.0, 0.0], (5, 1)), np.tile(np.diag([1e4, 1e4, 1e4]), (5, 1, 1)))
    found = match_steps(scans, (first, first - 1), straight, AlignmentSettings())
    assert found.searched.any()
    monkeypatch.setattr(alignment, "MOST_POINTS", 1)
    again = match_steps(scans, (first, first - 1), straight, AlignmentSettings())
    assert again.motion.tobytes() == found.motion.tobytes()
    assert (again.searched == found.searched).all()
    assert np.abs(found.motion[found.searched, 2] - np.diff(turned)[found.searched]).max() < 0.05
