"""Points of clouds with any fields: sensor_msgs/PointCloud2, foxglove.PointCloud."""

from __future__ import annotations

import base64
import binascii
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...topology.arrays import FloatArray
from .foxglove import as_text, get, integer, pose_of, sequence, stamp_of, unit_quaternion
from .messages import DamageError
from .wire import WireParser

FIELDS = 256
"""Largest number of fields of a point."""

MOST_POINTS = 1 << 21
"""Largest cloud: a depth image of 1920 by 1080 pixels, or ten turns of the scanner with the most
beams. Of how many bytes it may be: `messages.MESSAGE_BYTES`."""

NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
"""numpy's kinds of the datatypes of sensor_msgs/PointField."""

FOXGLOVE_NUMBERS = {1: 2, 2: 1, 3: 4, 4: 3, 5: 6, 6: 5, 7: 7, 8: 8}
"""Datatypes of sensor_msgs/PointField by those of foxglove.PackedElementField, which begin with
the unsigned ones."""


class Cloud(NamedTuple):
    """xyz: (k, 3) float64 points in the frame [m], possibly not finite."""

    stamp_ns: int
    frame: str
    xyz: FloatArray


class _Layout(NamedTuple):
    """The layout of a cloud's data; fields: offset and datatype by name."""

    height: int
    width: int
    fields: dict[str, tuple[int, int]]
    big_endian: bool
    point_step: int
    row_step: int


def wire_cloud(raw: bytes, ros1: bool) -> Cloud:
    """The cloud of a message in CDR or ROS 1's encoding; raises DamageError."""
    parser = WireParser(raw, ros1)
    stamp_at, frame = parser.header()
    height, width, count = parser.count(), parser.count(), parser.count()
    if count > FIELDS:
        raise DamageError("a point of implausibly many fields")
    fields = {}
    for _ in range(count):
        name, offset = parser.string(), parser.count()
        fields[name] = offset, raw[parser.advance(1)]
        parser.count()
    big_endian = bool(raw[parser.advance(1)])
    layout = _Layout(height, width, fields, big_endian, parser.count(), parser.count())
    size = parser.count()
    data = np.frombuffer(raw, np.uint8)[parser.advance(size) :][:size]
    seconds, nanoseconds = np.frombuffer(raw, f"{parser.order}u4", 2, stamp_at).tolist()
    return Cloud(seconds * 10**9 + nanoseconds, frame.lstrip("/"), _points(layout, data))


def foxglove_cloud(message: Any) -> Cloud:
    """The cloud of a decoded foxglove.PointCloud, by the names of its fields; raises
    DamageError."""
    data = get(message, "data")
    if isinstance(data, str):
        try:
            data = np.frombuffer(base64.b64decode(data, validate=True), np.uint8)
        except (binascii.Error, ValueError) as error:
            raise DamageError("the data of a cloud is no base64") from error
    if not isinstance(data, np.ndarray) or data.dtype != np.uint8:
        raise DamageError("a cloud without data")
    fields = {
        as_text(get(each, "name")): (integer(get(each, "offset")), integer(get(each, "type")))
        for each in sequence(get(message, "fields"))[:FIELDS]
    }
    stride = integer(get(message, "point_stride"))
    xyz = np.zeros((0, 3))
    if len(data):
        if stride <= 0:
            raise DamageError("the points of a cloud take up no room")
        known = {name: (at, FOXGLOVE_NUMBERS.get(kind, 0)) for name, (at, kind) in fields.items()}
        xyz = _points(_Layout(1, len(data) // stride, known, False, stride, 0), data)
    pose = get(message, "pose")
    frame = as_text(get(message, "frame_id")).lstrip("/")
    return Cloud(stamp_of(message), frame, xyz if pose is None else _placed(pose_of(pose), xyz))


def _placed(pose: tuple[float, ...], xyz: FloatArray) -> FloatArray:
    """Points transformed to their frame; a pose of all zeros, protobuf's default, is the
    identity."""
    if not any(pose):
        return xyz
    if not np.isfinite(pose).all():
        raise DamageError("a pose holds numbers that are not finite")
    x, y, z, w = unit_quaternion(pose[3:])
    # v + 2 w (u × v) + 2 u × (u × v), u the vector part of the unit quaternion.
    u = np.array([x, y, z])
    with np.errstate(invalid="ignore", over="ignore"):
        aside = np.cross(u, xyz)
        xyz = xyz + 2 * (w * aside + np.cross(u, aside)) + np.array(pose[:3])
    return xyz


def _points(layout: _Layout, data: NDArray[np.uint8]) -> FloatArray:
    """(k, 3) the points, row by row; raises DamageError if they exceed the data."""
    height, width, step = layout.height, layout.width, layout.point_step
    if height * width == 0:
        return np.zeros((0, 3))
    if height * width > MOST_POINTS:
        raise DamageError(f"a cloud of {width} x {height} points is implausible")
    row = layout.row_step if height > 1 else width * step
    if row < width * step or (height - 1) * row + width * step > len(data):
        raise DamageError("the points of a cloud do not fit into its data")
    places = [_place(layout, name) for name in "xyz"]
    out = np.empty((height, width, 3))
    for axis, (offset, kind) in enumerate(places):
        with np.errstate(invalid="ignore"):
            out[..., axis] = np.ndarray((height, width), kind, data.data, offset, (row, step))
    return out.reshape(-1, 3)


def _place(layout: _Layout, name: str) -> tuple[int, np.dtype[Any]]:
    """Offset and dtype of a field in its point; raises DamageError if it is missing."""
    if name not in layout.fields:
        raise DamageError(f"the points of a cloud have no {name}")
    offset, datatype = layout.fields[name]
    if datatype not in NUMBERS:
        raise DamageError("a field of a cloud has an unknown datatype")
    kind = np.dtype((">" if layout.big_endian else "<") + NUMBERS[datatype])
    if offset + kind.itemsize > layout.point_step:
        raise DamageError("a field of a cloud lies outside of its points")
    return offset, kind
