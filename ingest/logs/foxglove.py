"""Poses in Foxglove's protobuf and JSON encodings, and in JSON copies of ROS messages."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable, Iterator
from math import hypot
from typing import Any, Generic, TypeVar

import numpy as np

from ...topology.arrays import IntArray
from .messages import LATEST_NS, MESSAGE_BYTES, Bytes, DamageError, text
from .poses import Frames, Poses, Row, join, no_poses

POSES = 1 << 16
"""Largest number of poses of one message decoded one by one."""


T = TypeVar("T")


class OneByOne(Generic[T]):
    """Decodes messages one by one, for encodings without fixed places.

    parse: raises DamageError for a message that cannot be decoded; failed: the number of these;
    reason: of the first of them.
    """

    LONGEST = MESSAGE_BYTES

    def __init__(self, parse: Callable[[Any], T]) -> None:
        self._parse = parse
        self.failed = 0
        self.reason = ""

    def _parsed(self, message: Bytes) -> T:
        return self._parse(message.tobytes())

    def parsed(self, data: Bytes, start: IntArray, size: IntArray) -> Iterator[tuple[int, T]]:
        """Number and content of every message of a batch that can be decoded."""
        for number, (at, length) in enumerate(zip(start.tolist(), size.tolist(), strict=True)):
            try:
                if length > self.LONGEST:
                    raise DamageError("a message is implausibly long")
                content = self._parsed(data[at : at + length])
            except DamageError as damage:
                self.failed += 1
                self.reason = self.reason or str(damage)
                continue
            yield number, content


class RowDecoder(OneByOne[list[Row]]):
    """Decodes poses message by message."""

    def __init__(self, parse: Callable[[bytes, Frames], list[Row]]) -> None:
        self.frames = Frames()
        super().__init__(lambda raw: parse(raw, self.frames))

    def decode(self, data: Bytes, start: IntArray, size: IntArray) -> Poses:
        """The poses of a batch of messages."""
        parts = [
            _poses(number, part, row)
            for number, rows in self.parsed(data, start, size)
            for part, row in enumerate(rows)
            if row[2]
        ]
        return join(parts) if parts else no_poses()


def _poses(number: int, part: int, row: Row) -> Poses:
    stamp, frame, values = row
    count = len(values)
    return Poses(
        np.full(count, number),
        np.full(count, part),
        np.full(count, stamp),
        np.full(count, frame),
        np.array(values, np.float64).reshape(count, 7),
    )


# Protobuf: foxglove.PoseInFrame {1: timestamp, 2: frame_id, 3: pose}, foxglove.PosesInFrame
# {1: timestamp, 2: frame_id, 3: repeated pose}, Pose {1: position, 2: orientation}; vectors and
# quaternions are doubles numbered from 1 on.


def protobuf_rows(raw: bytes, frames: Frames) -> list[Row]:
    """The poses of a foxglove.PoseInFrame or PosesInFrame; raises DamageError."""
    stamp, frame = 0, ""
    poses: list[tuple[float, ...]] = []
    for field, value in protobuf_fields(raw):
        if field == 1 and isinstance(value, bytes):
            stamp = protobuf_time(value)
        elif field == 2 and isinstance(value, bytes):
            frame = text(value)
        elif field == 3 and isinstance(value, bytes):
            if len(poses) == POSES:
                raise DamageError("implausibly many poses")
            poses.append(protobuf_pose(value))
    return [(stamp, frames.number(frame), poses)]


def protobuf_time(raw: bytes) -> int:
    """Nanoseconds of a google.protobuf.Timestamp {1: seconds, 2: nanos}; raises DamageError."""
    parts = {n: v for n, v in protobuf_fields(raw) if isinstance(v, int)}
    return _bounded(parts.get(1, 0) * 10**9 + parts.get(2, 0))


# foxglove.FrameTransform {1: timestamp, 2: parent_frame_id, 3: child_frame_id, 4: translation,
# 5: rotation}, foxglove.FrameTransforms {1: repeated FrameTransform}.


def protobuf_transform(raw: bytes, frames: Frames) -> list[Row]:
    """The transform of a foxglove.FrameTransform; raises DamageError."""
    parts = {n: v for n, v in protobuf_fields(raw) if isinstance(v, bytes)}
    pair = frames.number(text(parts.get(2, b"")), text(parts.get(3, b"")))
    return [(0, pair, [_doubles(parts.get(4, b""), 3) + _doubles(parts.get(5, b""), 4)])]


def protobuf_transforms(raw: bytes, frames: Frames) -> list[Row]:
    """The transforms of a foxglove.FrameTransforms; raises DamageError."""
    each = [
        value for number, value in protobuf_fields(raw) if number == 1 and isinstance(value, bytes)
    ]
    if len(each) > POSES:
        raise DamageError("implausibly many transforms")
    return [row for value in each for row in protobuf_transform(value, frames)]


def protobuf_pose(raw: bytes) -> tuple[float, ...]:
    """The seven numbers of a foxglove.Pose; raises DamageError."""
    parts = {n: v for n, v in protobuf_fields(raw) if isinstance(v, bytes)}
    return _doubles(parts.get(1, b""), 3) + _doubles(parts.get(2, b""), 4)


def unit_quaternion(turn: tuple[float, ...]) -> tuple[float, ...]:
    """x, y, z, w of a pose at unit length; zeros, protobuf's default, are the identity.

    Raises DamageError if they are a million times off unit length.
    """
    if not any(turn):
        return 0.0, 0.0, 0.0, 1.0
    length = hypot(*turn)
    if not 1e-6 < length < 1e6:
        raise DamageError("a pose holds a quaternion of implausible length")
    return tuple(q / length for q in turn)


def _doubles(raw: bytes, count: int) -> tuple[float, ...]:
    found = {n: v for n, v in protobuf_fields(raw) if isinstance(v, float)}
    return tuple(found.get(n + 1, 0.0) for n in range(count))


def protobuf_fields(raw: bytes) -> Iterator[tuple[int, int | float | bytes]]:
    """Numbers and values of a protobuf message's fields."""
    position = 0
    while position < len(raw):
        tag, position = _varint(raw, position)
        field, wire = tag >> 3, tag & 7
        if wire == 0:
            value, position = _varint(raw, position)
            yield field, value
            continue
        if wire == 2:
            length, position = _varint(raw, position)
        elif wire in (1, 5):
            length = 8 if wire == 1 else 4
        else:
            raise DamageError("not a protobuf message")
        if length > len(raw) - position:
            raise DamageError("a message ends too early")
        piece = raw[position : position + length]
        position += length
        if wire == 2:
            yield field, piece
        else:
            yield field, struct.unpack("<d" if wire == 1 else "<f", piece)[0]


def _varint(raw: bytes, position: int) -> tuple[int, int]:
    value = 0
    for shift in range(0, 70, 7):
        if position >= len(raw):
            raise DamageError("a message ends too early")
        byte = raw[position]
        position += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, position
    raise DamageError("not a protobuf message")


def _bounded(ns: int) -> int:
    """A time between 1970 and 2116; raises DamageError."""
    if not 0 <= ns < LATEST_NS:
        raise DamageError("a time is out of range")
    return ns


# JSON


def load_json(raw: bytes | str) -> Any:
    """A parsed JSON document; raises DamageError, also for implausible nesting."""
    try:
        return json.loads(raw)
    except (ValueError, RecursionError) as error:
        raise DamageError("not a JSON message") from error


def json_rows(raw: bytes, frames: Frames) -> list[Row]:
    """Poses of a JSON message with Foxglove's or ROS's field names; raises DamageError."""
    return object_rows(load_json(raw), frames)


def object_rows(message: Any, frames: Frames) -> list[Row]:
    """Poses of a decoded message, by the names of its fields; raises DamageError.

    Knows headers (`header.stamp`, `timestamp`), `pose`, `pose.pose`, `poses`, `transforms`, and
    Foxglove's transforms (`parent_frame_id`).
    """
    if get(message, "parent_frame_id") is not None:
        return [_transform_row(message, frames)]
    transforms = get(message, "transforms")
    if transforms is not None:
        return [_transform_row(item, frames) for item in sequence(transforms)]
    header = get(message, "header")
    source = message if header is None else header
    child = as_text(get(message, "child_frame_id"))
    frame = frames.number(as_text(get(source, "frame_id")), child)
    poses = get(message, "poses")
    if poses is None:
        pose = get(message, "pose")
        inner = get(pose, "pose")
        return [(stamp_of(source), frame, [pose_of(pose if inner is None else inner)])]
    return [(stamp_of(source), frame, [pose_of(pose) for pose in sequence(poses)])]


def _transform_row(item: Any, frames: Frames) -> Row:
    header = get(item, "header")
    parent = get(header, "frame_id")
    if parent is None:
        parent = get(item, "parent_frame_id")
    pair = frames.number(as_text(parent), as_text(get(item, "child_frame_id")))
    transform = get(item, "transform")
    transform = item if transform is None else transform
    value = vector(get(transform, "translation"), "xyz") + vector(
        get(transform, "rotation"), "xyzw"
    )
    return stamp_of(item if header is None else header), pair, [value]


def get(message: Any, name: str) -> Any:
    """A member of a decoded message, None if it is missing."""
    if isinstance(message, dict):
        return message.get(name)
    return None if name.startswith("_") else getattr(message, name, None)


def sequence(value: Any) -> list[Any]:
    """A list of bounded length; raises DamageError."""
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if not isinstance(value, list | tuple) or len(value) > POSES:
        raise DamageError("not a list of plausible length")
    return list(value)


def as_text(value: Any) -> str:
    """A name, empty if it is not text."""
    return text(value.encode("utf-8", "replace")) if isinstance(value, str) else ""


def stamp_of(header: Any) -> int:
    """Time of a header [ns]: `stamp` or `timestamp`, 0 if missing.

    They are seconds and nanoseconds, or a number of seconds.
    """
    stamp = get(header, "stamp")
    if stamp is None:
        stamp = get(header, "timestamp")
    if stamp is None:
        return 0
    if isinstance(stamp, int | float):
        if 0 <= stamp < LATEST_NS / 1e9:
            return _bounded(round(stamp * 1e9))
        raise DamageError(f"{real(stamp):g} is no number of seconds")
    for seconds, nanoseconds in (("sec", "nanosec"), ("sec", "nsec"), ("secs", "nsecs")):
        whole, part = get(stamp, seconds), get(stamp, nanoseconds)
        if whole is not None and part is not None:
            return _bounded(integer(whole) * 10**9 + integer(part))
    raise DamageError("a time is neither seconds and nanoseconds nor a number of seconds")


def integer(value: Any) -> int:
    """A whole number, which JSON may write as 7.0; raises DamageError."""
    if isinstance(value, float) and value.is_integer():
        return int(value)
    if isinstance(value, bool) or not isinstance(value, int | np.integer):
        raise DamageError("a whole number is missing")
    return int(value)


def real(value: Any) -> float:
    """A number as float64; raises DamageError."""
    if isinstance(value, bool) or not isinstance(value, int | float | np.number):
        raise DamageError("a number is missing")
    try:
        return float(value)
    except OverflowError as error:
        raise DamageError("a number is out of range") from error


def vector(value: Any, names: str) -> tuple[float, ...]:
    """The members x, y, … of a value; raises DamageError."""
    return tuple(real(get(value, name)) for name in names)


def pose_of(pose: Any) -> tuple[float, ...]:
    """The seven numbers of a pose; raises DamageError."""
    return vector(get(pose, "position"), "xyz") + vector(get(pose, "orientation"), "xyzw")
