"""Which way a laser looks by what it saw."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from topobatch.ingest.scans.mount_yaw import ENOUGH, mount_yaw
from topobatch.ingest.scans.scan import ScanBatch
from topobatch.topology.odometry import Odometry
from topobatch.topology.se2 import compose, wrap

from .building import WHOLE_TURN, Building

HALL = Building.of((0.0, 0.0, 26.0, 3.0), (5.0, 2.9, 7.0, 9.0), (16.0, -6.0, 18.0, 0.1))
N = 3 * ENOUGH
WAY = np.column_stack(
    [np.linspace(1.5, 24.5, N), 1.4 + 0.2 * np.sin(np.linspace(0, 6, N)), np.zeros(N)]
)
TIME_NS = np.arange(N) * 300_000_000


def scans(mount: tuple[float, float, float]) -> ScanBatch:
    ranges = HALL.ranges(compose(WAY, np.array(mount)), WHOLE_TURN).astype(np.float32)
    return ScanBatch(TIME_NS, ranges, 15.0, WHOLE_TURN)


def odometry(frame: tuple[float, float, float]) -> Odometry:
    return Odometry(TIME_NS, compose(np.array(frame), WAY), np.zeros(0, np.int64))


@pytest.mark.parametrize("yaw", [-2.5, np.pi])
def test_it_is_found_wherever_the_laser_sits(yaw: float) -> None:
    found = mount_yaw(odometry((3.0, -2.0, 1.0)), [scans((0.3, -0.2, yaw))])
    assert found is not None
    assert abs(wrap(found - yaw)) < 0.03


def test_what_is_not_sure_is_not_told() -> None:
    few = scans((0.0, 0.0, 1.0))
    short = ScanBatch(few.times_ns[:ENOUGH], few.ranges_m[:ENOUGH], 15.0, WHOLE_TURN)
    assert mount_yaw(odometry((0.0, 0.0, 0.0)), [short]) is None
    # Scans of another drive: they agree with the odometry on nothing.
    mixed = few.ranges_m[np.random.default_rng(1).permutation(N)]
    assert mount_yaw(odometry((0.0, 0.0, 0.0)), [replace(few, ranges_m=mixed)]) is None
    bare = np.full_like(few.ranges_m, np.nan)
    assert mount_yaw(odometry((0.0, 0.0, 0.0)), [replace(few, ranges_m=bare)]) is None
