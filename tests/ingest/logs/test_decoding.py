"""Columnar decoding against rosbags' decoder, message by message; hostile definitions."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from topobatch.ingest.logs.columns import Growing
from topobatch.ingest.logs.messages import Channel, DamageError
from topobatch.ingest.logs.pose_wire import WireDecoder
from topobatch.ingest.logs.schema import as_expected, object_decoder
from topobatch.ingest.logs.walk import bag_records, mcap_records

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
    found = decoder.decode(np.frombuffer(joined, np.uint8), start, size)
    assert decoder.failed == 0
    assert len(found.message) == len(expected)
    rows = zip(found.message, found.stamp_ns, found.frame, found.value, strict=True)
    for (message, stamp, frame, value), want in zip(rows, expected, strict=True):
        assert (message, stamp, decoder.frames.pairs[frame]) == want[:3]
        assert value.tobytes() == np.array(want[3]).tobytes()


def test_a_message_that_is_cut_is_counted(logs):
    store = logs.store_of(False)
    whole = [logs.payload(m, "cdr", store) for m in logs.drive(5)]
    raw = [whole[0], whole[1][:90], whole[2], whole[3][:3], b""]
    size = np.array([len(p) for p in raw])
    decoder = WireDecoder("odometry", False)
    found = decoder.decode(np.frombuffer(b"".join(raw), np.uint8), np.cumsum(size) - size, size)
    assert found.message.tolist() == [0, 2]
    assert decoder.failed == 3


@given(st.lists(st.integers(0, 40), max_size=60), st.binary(max_size=12))
@settings(max_examples=100)
def test_strides_find_the_records_that_a_loop_finds(sizes, tail):
    for repeat in (1, 70):
        lengths = [size for size in sizes for _ in range(repeat)]
        mcap = b"".join(b"\x05" + n.to_bytes(8, "little") + b"x" * n for n in lengths)
        bag = b"".join(
            (1 + n % 3).to_bytes(4, "little")
            + b"h" * (1 + n % 3)
            + n.to_bytes(4, "little")
            + b"x" * n
            for n in lengths
        )
        for records, raw, head in (
            (mcap_records, mcap, [9 + n for n in lengths]),
            (bag_records, bag, [9 + n % 3 + n for n in lengths]),
        ):
            data = np.frombuffer(raw, np.uint8)
            places, stop = records(data)
            assert places.tolist() == (np.cumsum(head) - head).tolist()
            assert stop == len(raw)
            # Whatever follows, the places lie inside and end where the last record does.
            places, stop = records(np.frombuffer(raw + tail, np.uint8))
            assert len(places) >= len(lengths)
            assert len(raw) <= stop <= len(raw) + len(tail)


@pytest.mark.parametrize(
    ("definition", "expected"),
    [
        ("float64 x", False),
        ("x/Loop a\n" + "=" * 80 + "\nMSG: x/Loop\nx/Loop a", False),
        ("", True),
        ("std_msgs/Header header\nPose[] poses", True),
        ("\x00\xff# nothing", True),
    ],
)
def test_definitions_that_say_otherwise_are_believed_and_broken_ones_are_not(definition, expected):
    channel = Channel("/t", "nav_msgs/msg/Odometry", "cdr", definition.encode(), "ros2msg")
    assert as_expected(channel, "odometry") is expected


def test_the_definitions_of_ros_are_as_expected(logs):
    for ros1 in (False, True):
        store = logs.store_of(ros1)
        for kind, type_name in types_of(logs).items():
            text, _ = store.generate_msgdef(type_name, ros_version=1 if ros1 else 2)
            encoding, form = ("ros1", "ros1msg") if ros1 else ("cdr", "ros2msg")
            channel = Channel("/t", type_name, encoding, text.encode(), form)
            assert as_expected(channel, kind)


@pytest.mark.parametrize(
    "definition",
    [
        "Loop a\n" + "=" * 80 + "\nMSG: x/Loop\nx/Loop a",
        "float64[4000000000] a",
        "(" * 5000,
        "int32 a\n" * 5000,
        "\n".join(f"T{k} a\n{'=' * 80}\nMSG: x/T{k}" for k in range(300)),
        "int32 X=" + "9" * 10_000,
    ],
)
@pytest.mark.parametrize("form", ["ros2msg", "ros2idl"])
def test_hostile_definitions_are_refused(definition, form):
    channel = Channel("/t", "x/msg/T", "cdr", definition.encode(), form)

    def decode():
        object_decoder(channel)(bytes(64))

    with pytest.raises(DamageError):
        decode()


def test_a_growing_column_keeps_its_rows_in_order(monkeypatch):
    monkeypatch.setattr(Growing, "ROOMS", (3, 8))
    rng = np.random.default_rng(1)
    for kind, width in (("i4", None), ("f8", 3)):
        column = Growing(kind, width)
        parts = [rng.integers(0, 99, (n, *([width] if width else []))) for n in (2, 0, 5, 1, 40)]
        for part in parts:
            column.add(part)
        taken = column.taken()
        assert taken.dtype == kind
        assert taken.tolist() == np.concatenate(parts).tolist()
        assert len(column.taken()) == 0
