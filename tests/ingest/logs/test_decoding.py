"""Columnar decoding against rosbags' decoder, message by message; hostile definitions."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from topobatch.ingest.logs.messages import Block, Channel
from topobatch.ingest.logs.poses import WireDecoder
from topobatch.ingest.logs.schema import is_usual

NAMES = st.sampled_from(["odom", "/odom", "base_link", "a", "", "robot/odom", "ü" * 5])
NUMBERS = st.floats(allow_nan=False, width=64)
POSES = st.lists(st.tuples(*[NUMBERS] * 7), min_size=0, max_size=3)
KINDS = {"odometry": 1, "pose": 1, "pose_array": 3, "transforms": 3}


def types_of(logs):
    return {
        "odometry": logs.ODOMETRY,
        "pose": logs.POSE_STAMPED,
        "pose_array": logs.POSE_ARRAY,
        "transforms": logs.TF,
    }


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("encoding", ["little", "big", "ros1"])
@given(data=st.data())
@settings(max_examples=12)
def test_columns_equal_the_library_bit_for_bit(logs, kind, encoding, data):
    ros1 = encoding == "ros1"
    store, type_name = logs.store_of(ros1), types_of(logs)[kind]
    payloads, expected = [], []
    for number in range(data.draw(st.integers(1, 8))):
        poses = data.draw(POSES)
        poses = (poses or [(0.0,) * 7])[:1] if KINDS[kind] == 1 else poses
        stamp = data.draw(st.integers(0, (1 << 31) - 1)) * 10**9 + 7 * number
        message = logs.Message(
            "/t", type_name, 0, stamp, data.draw(NAMES), data.draw(NAMES), tuple(poses)
        )
        value = logs.ros_object(message, store, ros1)
        payloads.append(
            bytes(
                store.serialize_ros1(value, type_name)
                if ros1
                else store.serialize_cdr(value, type_name, little_endian=encoding == "little")
            )
        )
        pair = (
            message.frame.lstrip("/"),
            message.child.lstrip("/") if kind in ("odometry", "transforms") else "",
        )
        expected += [(number, stamp, pair, tuple(pose)) for pose in poses]
    decoder = WireDecoder(kind, ros1)
    # Between the messages stands what may stand between them in a log: anything.
    joined = b"\xff".join(payloads)
    size = np.array([len(p) for p in payloads])
    start = np.cumsum(size + 1) - size - 1
    found = decoder.decode(Block(np.frombuffer(joined, np.uint8), 0, 7 * start, start, size))
    assert decoder.failed == 0
    assert len(found.message) == len(expected)
    rows = zip(found.message, found.stamp_ns, found.frame, found.pose, strict=True)
    for (message, stamp, frame, value), want in zip(rows, expected, strict=True):
        assert (message, stamp, decoder.frames.pairs[frame]) == want[:3]
        assert value.tobytes() == np.array(want[3]).tobytes()


@pytest.mark.parametrize(
    ("definition", "expected"),
    [
        ("float64 x", False),
        ("x/Loop a\n" + "=" * 80 + "\nMSG: x/Loop\nx/Loop a", True),
        ("", True),
        ("std_msgs/Header header\nPose[] poses", True),
        ("\x00\xff# nothing", True),
    ],
)
def test_definitions_that_say_otherwise_are_believed_and_broken_ones_are_not(definition, expected):
    channel = Channel("/t", "nav_msgs/msg/Odometry", "cdr", definition.encode(), "ros2msg")
    assert is_usual(channel) is expected
