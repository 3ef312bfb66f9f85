"""Decoding planar scans message by message: Foxglove's protobuf and JSON, and other encodings."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...topology.arrays import Float32Array, IntArray
from ...topology.se2 import yaw_from_quaternion
from .foxglove import (
    OneByOne,
    as_text,
    get,
    load_json,
    pose_of,
    protobuf_fields,
    protobuf_pose,
    protobuf_time,
    real,
    stamp_of,
    unit_quaternion,
)
from .messages import Bytes, DamageError, text
from .scan_rows import Geometry, RawScans, checked_beams, one_scan


class ObjectScanDecoder(OneByOne[RawScans]):
    """Decodes scans one by one, for encodings without fixed offsets."""

    def decode(self, data: Bytes, start: IntArray, size: IntArray) -> list[RawScans]:
        """The scans of a batch of messages; consecutive ones of one geometry are joined."""
        return _together(
            [
                scan._replace(message=np.array([number], np.int64))
                for number, scan in self.parsed(data, start, size)
            ]
        )


def _together(found: list[RawScans]) -> list[RawScans]:
    """Consecutive scans of one geometry joined."""
    out: list[list[RawScans]] = []
    for scan in found:
        last = out[-1][0] if out else None
        # Compared as text, since geometries may hold NaN.
        if (
            last is not None
            and repr(last.geometry) == repr(scan.geometry)
            and last.ranges_m.shape == scan.ranges_m.shape
            and last.blind == scan.blind
        ):
            out[-1].append(scan)
        else:
            out.append([scan])
    return [
        RawScans(
            np.concatenate([scan.message for scan in group]),
            np.concatenate([scan.stamp_ns for scan in group]),
            np.concatenate([scan.ranges_m for scan in group]),
            group[0].geometry,
            group[0].blind,
        )
        for group in out
    ]


# foxglove.LaserScan {1: timestamp, 2: frame_id, 3: pose, 4: start_angle, 5: end_angle, 6: repeated
# double ranges, 7: repeated double intensities}


def protobuf_scan(raw: bytes) -> RawScans:
    """A foxglove.LaserScan; raises DamageError."""
    stamp, frame, pose = 0, "", (0.0, 0.0, 0.0)
    angles = [0.0, 0.0]
    packed: list[bytes] = []
    for field, value in protobuf_fields(raw):
        if field == 1 and isinstance(value, bytes):
            stamp = protobuf_time(value)
        elif field == 2 and isinstance(value, bytes):
            frame = text(value)
        elif field == 3 and isinstance(value, bytes):
            pose = _in_plane(protobuf_pose(value))
        elif field in (4, 5) and isinstance(value, float):
            angles[field - 4] = value
        elif field == 6 and isinstance(value, bytes):
            packed.append(value)
        elif field == 6 and isinstance(value, float):
            packed.append(np.float64(value).tobytes())
            checked_beams(len(packed))
    joined = b"".join(packed)
    if len(joined) % 8:
        raise DamageError("a list of ranges is cut short")
    return _between(stamp, frame, angles, np.frombuffer(joined, "<f8"), pose)


def _in_plane(pose: tuple[float, ...]) -> tuple[float, float, float]:
    """x, y, yaw of a pose; a zero quaternion, protobuf's default, is the identity."""
    x, y, _, *turn = pose
    if not np.isfinite(pose).all():
        raise DamageError("a pose holds numbers that are not finite")
    return x, y, float(yaw_from_quaternion(*unit_quaternion(tuple(turn))))


def _between(
    stamp: int,
    frame: str,
    angles: list[float],
    ranges: Any,
    pose: tuple[float, float, float],
) -> RawScans:
    """A scan with beams evenly spaced between two angles."""
    beams = checked_beams(len(ranges))
    step = (angles[1] - angles[0]) / max(beams - 1, 1)
    geometry = Geometry(frame.lstrip("/"), angles[0], step, angle_max=angles[1], pose=pose)
    return one_scan(stamp, _single(ranges), geometry)


def _single(ranges: Any) -> Float32Array:
    """Ranges as float32; values too large become inf."""
    with np.errstate(over="ignore"):
        return np.asarray(ranges).astype(np.float32)


def json_scan(raw: bytes) -> RawScans:
    """A scan in JSON, with the field names of Foxglove or ROS; raises DamageError."""
    return object_scan(load_json(raw))


def object_scan(message: Any) -> RawScans:
    """A decoded scan by the names of its fields; raises DamageError.

    Supports sensor_msgs/LaserScan (`angle_min`), foxglove.LaserScan (`start_angle`), and multi-echo
    scans.
    """
    header = get(message, "header")
    source = message if header is None else header
    stamp, frame = stamp_of(source), as_text(get(source, "frame_id"))
    ranges = _ranges(get(message, "ranges"))
    if get(message, "start_angle") is not None:
        angles = [real(get(message, name)) for name in ("start_angle", "end_angle")]
        pose = get(message, "pose")
        placed = (0.0, 0.0, 0.0) if pose is None else _in_plane(pose_of(pose))
        return _between(stamp, frame, angles, ranges, placed)
    geometry = Geometry(
        frame.lstrip("/"),
        real(get(message, "angle_min")),
        real(get(message, "angle_increment")),
        _or(get(message, "time_increment"), 0.0),
        _or(get(message, "range_min"), 0.0),
        _or(get(message, "range_max"), float("inf")),
        _or(get(message, "angle_max"), float("nan")),
    )
    return one_scan(stamp, ranges, geometry)


def _or(value: Any, otherwise: float) -> float:
    return otherwise if value is None else real(value)


def _ranges(value: Any) -> Float32Array:
    """(m,) ranges, of multiple echoes the first; null in JSON is no range."""
    if value is None or isinstance(value, str) or not hasattr(value, "__len__"):
        raise DamageError("a list of ranges is missing")
    checked_beams(len(value))
    if isinstance(value, np.ndarray) and value.dtype.kind in "fiu":
        return _single(value)
    return _single(np.array([_range(each) for each in value], np.float64))


def _range(value: Any) -> float:
    echoes = get(value, "echoes")
    if echoes is not None:
        value = echoes[0] if len(echoes) else None
    return float("nan") if value is None else real(value)
