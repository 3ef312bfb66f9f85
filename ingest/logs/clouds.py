"""The points of sensor_msgs/PointCloud2, whatever its fields, in CDR and ROS 1's encoding."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .foxglove import as_text, get, integer, sequence, stamp_of
from .messages import DamageError
from .wire import WireParser

FIELDS = 256
"""Most fields of a point that are believed."""

NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
"""numpy's kinds of the datatypes of sensor_msgs/PointField."""


class Cloud(NamedTuple):
    """xyz: (k, 3) float64 points [m] in the frame, not all of them finite."""

    stamp_ns: int
    frame: str
    xyz: NDArray[np.float64]


class _Layout(NamedTuple):
    """Where the points of a cloud are in its data; fields: offset and datatype by name."""

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


def object_cloud(message: Any) -> Cloud:
    """The cloud of a decoded message, by the names of its fields; raises DamageError."""
    header, data = get(message, "header"), get(message, "data")
    if not isinstance(data, np.ndarray) or data.dtype != np.uint8:
        raise DamageError("a cloud without data")
    layout = _Layout(
        integer(get(message, "height")),
        integer(get(message, "width")),
        {
            as_text(get(each, "name")): (
                integer(get(each, "offset")),
                integer(get(each, "datatype")),
            )
            for each in sequence(get(message, "fields"))[:FIELDS]
        },
        bool(get(message, "is_bigendian")),
        integer(get(message, "point_step")),
        integer(get(message, "row_step")),
    )
    frame = as_text(get(header, "frame_id")).lstrip("/")
    return Cloud(stamp_of(header), frame, _points(layout, data))


def _points(layout: _Layout, data: NDArray[np.uint8]) -> NDArray[np.float64]:
    """(k, 3) the points, row by row; raises DamageError where they do not fit into the data."""
    height, width = layout.height, layout.width
    if height * width == 0:
        return np.zeros((0, 3))
    row = layout.row_step if height > 1 else width * layout.point_step
    if row < width * layout.point_step or (height - 1) * row + width * layout.point_step > len(
        data
    ):
        raise DamageError("the points of a cloud do not fit into its data")
    out = np.empty((height, width, 3))
    for axis, name in enumerate("xyz"):
        if name not in layout.fields:
            raise DamageError(f"the points of a cloud have no {name}")
        offset, datatype = layout.fields[name]
        if datatype not in NUMBERS:
            raise DamageError("a field of a cloud has an unknown datatype")
        kind = np.dtype((">" if layout.big_endian else "<") + NUMBERS[datatype])
        if offset + kind.itemsize > layout.point_step:
            raise DamageError("a field of a cloud lies outside of its points")
        strides = (row, layout.point_step)
        with np.errstate(invalid="ignore"):
            out[..., axis] = np.ndarray((height, width), kind, data.data, offset, strides)
    return out.reshape(-1, 3)
