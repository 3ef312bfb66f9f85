"""Scans out of blocks of messages."""

from __future__ import annotations

from types import ModuleType

import numpy as np

from topobatch.ingest.logs.lasers import ScanIntake
from topobatch.ingest.logs.messages import Block, Channel


def test_messages_that_ros_2_compressed_one_by_one(sensors: ModuleType) -> None:
    import zstandard

    definition, _ = sensors.ROS2.generate_msgdef(sensors.SCAN, ros_version=2)
    channel = Channel("/scan", sensors.SCAN, "cdr", definition.encode(), "ros2msg")
    plain = [sensors.scan([1.0 + k, 2, 3, 4, 5]) for k in range(3)]
    bomb = zstandard.ZstdCompressor().compress(bytes(1 << 25))
    payloads = [*(zstandard.ZstdCompressor().compress(p) for p in plain), bomb]
    intake = ScanIntake(channel, lambda _: None)  # type: ignore[arg-type,return-value]
    size = np.array([len(p) for p in payloads], np.int64)
    data = np.frombuffer(b"".join(payloads), np.uint8)
    block = Block(data, 0, np.arange(4, dtype=np.int64), np.cumsum(size) - size, size)
    found = list(intake.take(block))
    assert [row[0] for raw in found for row in raw.ranges_m.tolist()] == [1, 2, 3]
    assert (intake.messages, intake.failed) == (4, 1)
