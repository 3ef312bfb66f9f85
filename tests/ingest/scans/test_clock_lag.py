"""Scans that are stamped late, or early."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from topobatch.ingest.scans.detection import detect
from topobatch.ingest.scans.turns import LaggingError, OtherClockError, clock_lag
from topobatch.topology.odometry import Odometry
from topobatch.topology.se2 import wrap

from .building import RING, biased, drive, scans

ROUND = drive(
    *((8, 0), (10, 0), (10, 3), (10, 0), (13, 0), (10, 0), (10, 2), (10, 0), (7, 0), (10, 0))
)
SECOND = 10**9


def lag(odometry: Odometry, late_s: float, seen: Odometry = ROUND) -> float:
    """What is found where what was `seen` is stamped so late."""
    time_ns = seen.time_ns + np.int64(late_s * SECOND)
    piece = np.zeros(len(seen), np.int64)
    return clock_lag(odometry, time_ns, seen.pose, piece)


@pytest.mark.parametrize("late_s", [-0.3, 0.93])
def test_the_lag_is_found_whatever_the_odometry_gets_wrong(late_s: float) -> None:
    assert lag(ROUND, late_s) == pytest.approx(late_s, abs=0.02)
    assert lag(biased(ROUND, 0.05, 1.1), late_s) == pytest.approx(late_s, abs=0.02)


@pytest.mark.parametrize(("late_s", "told"), [(2.5, "2.5 s late"), (-4.0, "4.0 s early")])
def test_another_clock_is_told(late_s: float, told: str) -> None:
    for odometry in (ROUND, biased(ROUND, 0.05, 1.1)):
        with pytest.raises(OtherClockError, match=f"stamped some {told}"):
            lag(odometry, late_s)


def test_another_drive_shows_no_lag() -> None:
    random = np.random.default_rng(4)
    for _ in range(20):
        turn = ROUND.turn_rad[random.permutation(len(ROUND))]
        pose = np.column_stack([ROUND.pose[:, :2], wrap(np.cumsum(turn))])
        with pytest.raises(OtherClockError) as caught:
            lag(replace(ROUND, pose=pose), 0.0)
        assert "stamped" not in str(caught.value)


def test_detection_stops_at_scans_that_lag_unless_stamps_are_taken_as_they_are() -> None:
    seen = scans(RING, ROUND)
    late = replace(seen, times_ns=seen.times_ns + SECOND // 2)
    with pytest.raises(LaggingError, match=r"as the odometry does, 0\.5\d s late") as told:
        detect(ROUND, [late])
    assert told.value.lag_s == pytest.approx(0.5, abs=0.05)
    assert len(detect(ROUND, [late], may_lag=False).odometry) > 0
    shifted = replace(ROUND, time_ns=ROUND.time_ns + SECOND // 2)
    assert detect(shifted, [late]).statistics.searched == 0
