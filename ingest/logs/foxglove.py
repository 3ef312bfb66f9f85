"""Messages as objects: of Foxglove's protobuf and JSON, and JSON copies of ROS messages.

Protobuf becomes what JSON would give, so that one reading by the names of fields serves for both,
and for what rosbags decodes.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from math import hypot
from typing import Any

import numpy as np

from .messages import LATEST_NS, Channel, DamageError, text
from .poses import Frames, Row
from .schema import object_decoder

LONGEST_LIST = 1 << 16
"""Longest list in one message that is decoded as objects, and most beams of a scan: laser scanners
have hundreds or thousands."""

# Protobuf

Fields = Mapping[int, tuple[str, Any]]
"""Fields of a protobuf message by number: name, and a kind of `_KINDS`, the fields of a message, or
a list of these: any number of such messages."""

_KINDS: Mapping[str, tuple[int, Callable[[Any], Any], Any]] = {
    "int": (0, int, 0),
    "double": (1, lambda raw: struct.unpack("<d", raw)[0], 0.0),
    "fixed32": (5, lambda raw: int.from_bytes(raw, "little"), 0),
    "text": (2, lambda raw: raw.decode("utf-8", "replace"), ""),
    "bytes": (2, lambda raw: np.frombuffer(raw, np.uint8), np.zeros(0, np.uint8)),
}
"""Wire type, reader and default of the kinds; "doubles" are any number of them, packed or not."""

_VECTOR: Fields = {1: ("x", "double"), 2: ("y", "double"), 3: ("z", "double")}
_QUATERNION: Fields = {**_VECTOR, 4: ("w", "double")}
_TIME: Fields = {1: ("sec", "int"), 2: ("nanosec", "int")}
_POSE: Fields = {1: ("position", _VECTOR), 2: ("orientation", _QUATERNION)}
_HEADER: Fields = {1: ("timestamp", _TIME), 2: ("frame_id", "text")}
_TRANSFORM: Fields = {
    1: ("timestamp", _TIME),
    2: ("parent_frame_id", "text"),
    3: ("child_frame_id", "text"),
    4: ("translation", _VECTOR),
    5: ("rotation", _QUATERNION),
}
_ELEMENT: Fields = {1: ("name", "text"), 2: ("offset", "fixed32"), 3: ("type", "int")}

PROTOBUF: Mapping[str, Fields] = {
    "foxglove.PoseInFrame": {**_HEADER, 3: ("pose", _POSE)},
    "foxglove.PosesInFrame": {**_HEADER, 3: ("poses", [_POSE])},
    "foxglove.FrameTransform": _TRANSFORM,
    "foxglove.FrameTransforms": {1: ("transforms", [_TRANSFORM])},
    "foxglove.LaserScan": {
        **_HEADER,
        3: ("pose", _POSE),
        4: ("start_angle", "double"),
        5: ("end_angle", "double"),
        6: ("ranges", "doubles"),
    },
    "foxglove.PointCloud": {
        **_HEADER,
        3: ("pose", _POSE),
        4: ("point_stride", "fixed32"),
        5: ("fields", [_ELEMENT]),
        6: ("data", "bytes"),
    },
}


def protobuf_object(fields: Fields, raw: bytes) -> dict[str, Any]:
    """A protobuf message of these fields by their names; what is missing is 0 or empty. Raises
    DamageError."""
    out = {name: _default(kind) for name, kind in fields.values()}
    for number, wire, value in _protobuf_fields(raw):
        name, kind = fields.get(number, ("", ""))
        if kind == "doubles" and wire in (1, 2):
            out[name] += value
        elif isinstance(kind, str) and kind in _KINDS and wire == _KINDS[kind][0]:
            out[name] = _KINDS[kind][1](value)
        elif isinstance(kind, list) and wire == 2:
            if len(out[name]) == LONGEST_LIST:
                raise DamageError("a list is implausibly long")
            out[name].append(protobuf_object(kind[0], value))
        elif isinstance(kind, dict) and wire == 2:
            out[name] = protobuf_object(kind, value)
    for name, kind in fields.values():
        if kind == "doubles":
            if len(out[name]) % 8:
                raise DamageError("a list of numbers is cut short")
            out[name] = np.frombuffer(bytes(out[name]), "<f8")
    return out


def _default(kind: Any) -> Any:
    if isinstance(kind, str):
        return bytearray() if kind == "doubles" else _KINDS[kind][2]
    return [] if isinstance(kind, list) else protobuf_object(kind, b"")


def _protobuf_fields(raw: bytes) -> Iterator[tuple[int, int, Any]]:
    """Numbers, wire types and values of a message's fields: whole numbers of type 0, else bytes."""
    position = 0
    while position < len(raw):
        tag, position = _varint(raw, position)
        field, wire = tag >> 3, tag & 7
        if wire == 0:
            value, position = _varint(raw, position)
            yield field, wire, value
            continue
        if wire == 2:
            length, position = _varint(raw, position)
        elif wire in (1, 5):
            length = 8 if wire == 1 else 4
        else:
            raise DamageError("not a protobuf message")
        if length > len(raw) - position:
            raise DamageError("a message ends too early")
        yield field, wire, raw[position : position + length]
        position += length


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


# Objects


def object_reader(channel: Channel) -> Callable[[bytes], Any]:
    """A function from payload to message object, by the encoding of a channel; raises DamageError
    if there is none."""
    if channel.encoding in ("cdr", "ros1"):
        return object_decoder(channel)
    if channel.encoding == "json":
        return load_json
    if channel.encoding == "protobuf" and channel.type_name in PROTOBUF:
        return partial(protobuf_object, PROTOBUF[channel.type_name])
    raise DamageError(f"messages are encoded as {channel.encoding[:40]!r}, which is not known")


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
    if not isinstance(value, list | tuple) or len(value) > LONGEST_LIST:
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
