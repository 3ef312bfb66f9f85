"""Odometry that is in another unit is refused, with the topic and what was found."""

from __future__ import annotations

import numpy as np
import pytest

from topobatch.ingest.odometry.reading import check_plausible
from topobatch.topology.errors import LogError
from topobatch.topology.odometry import Odometry


def check(x_m, step_s: float, breaks=()) -> str:
    pose = np.column_stack([x_m, np.zeros(len(x_m)), np.zeros(len(x_m))])
    time_ns = (np.arange(len(x_m)) * step_s * 1e9).astype(np.int64)
    odometry = Odometry(time_ns, pose, np.array(breaks, np.int64))
    return check_plausible(odometry, "/odom", "log")


def test_millimetres_are_too_fast() -> None:
    with pytest.raises(LogError, match="log: /odom moves at 500 m/s"):
        check(10.0 * np.arange(50), 0.02)
    assert "as fast as a car" in check(1.0 * np.arange(50), 0.02)


def test_what_else_it_may_be_is_told() -> None:
    two_robots = np.where(np.arange(50) % 2, 16.0, 0.0) + 0.01 * np.arange(50)
    with pytest.raises(LogError, match=r"in metres; else stamps .* or two robots share the topic"):
        check(two_robots, 0.02)


@pytest.mark.parametrize(
    ("m_per_s", "doubted"), [(0.7, False), (15, False), (35, True), (70, True)]
)
def test_centimetres_are_doubted(m_per_s: float, doubted: bool) -> None:
    x_m = m_per_s * 0.05 * np.maximum(np.arange(100) - 60, 0)
    assert ("in centimetres? Expected: metres" in check(x_m, 0.05)) == doubted


def test_a_drive_of_a_continent_is_too_wide_and_two_frames_are_none() -> None:
    far = np.array([0.0, 1.0, 2e6, 2e6 + 1])
    with pytest.raises(LogError, match="spans 2000 km"):
        check(far, 1e6)
    check(far, 1e6, breaks=[2])
