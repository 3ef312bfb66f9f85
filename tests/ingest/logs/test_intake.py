"""Messages of a channel become columns; what cannot be used is counted."""

from __future__ import annotations

from types import ModuleType

import numpy as np

from topobatch.ingest.logs.intake import Intake
from topobatch.ingest.logs.messages import Block, Channel


def taken(logs: ModuleType, messages: list, *more: bytes):
    """The sink that took the messages, and further payloads."""
    store = logs.store_of(False)
    raw = [*(logs.payload(m, "cdr", store) for m in messages), *more]
    size = np.array([len(one) for one in raw], np.int64)
    channel = Channel(messages[0].topic, messages[0].type_name, "cdr")
    intake = Intake(lambda _: True)
    number = intake.want(channel)
    data = np.frombuffer(b"".join(raw), np.uint8)
    intake.take(Block(data, number, np.arange(len(raw)), np.cumsum(size) - size, size))
    (sink,) = intake.of_topic(channel.topic)
    return sink


def test_poses_that_are_none_and_messages_that_are_none_are_counted(logs: ModuleType) -> None:
    odometry = [m for m in logs.drive(20, 30) if m.topic == "/odom"]
    nowhere, unturned = (0.0, float("nan"), 0.0, 0.0, 0.0, 0.0, 1.0), (1.0, 2.0, *[0.0] * 5)
    bad = [m for pose in (nowhere, unturned) for m in logs.relabelled(odometry[:2], poses=(pose,))]
    sink = taken(logs, odometry + bad, b"\0\1\0\0short")
    assert (sink.messages, sink.not_finite, sink.zero_quaternion, sink.failed) == (25, 2, 2, 1)
    columns = sink.columns()
    assert columns.message.tolist() == list(range(20))
    assert columns.stamp_ns.tolist() == [m.stamp_ns for m in odometry]
    np.testing.assert_allclose(columns.pose[:, 0], [m.poses[0][0] for m in odometry])
