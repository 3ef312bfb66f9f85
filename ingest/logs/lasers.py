"""Planar scans out of messages of any type and encoding, and out of point clouds.

The layout of a LaserScan depends on its frame's name and its number of beams, so that those of one
laser are decoded as columns.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import chain, zip_longest
from typing import Any, NamedTuple

import numpy as np

from ...topology.arrays import Float32Array, IntArray
from ...topology.se2 import yaw_from_quaternion
from .clouds import Cloud, foxglove_cloud, wire_cloud
from .columns import Shape, numbers
from .foxglove import (
    LONGEST_LIST,
    as_text,
    get,
    object_reader,
    pose_of,
    real,
    stamp_of,
    unit_quaternion,
)
from .inflate import PIECE_BYTES, unpacked
from .messages import MESSAGE_BYTES, OBJECT_BYTES, Block, Bytes, Channel, DamageError
from .schema import is_usual
from .topics import JUNCTIONS
from .wire import Decoder, OneByOne, TemplateDecoder, WireParser, stamps_ns

ECHOES_BYTES = 1 << 20
"""Longest scan of several echoes: each beam becomes an object; those of scanners have 40 kB."""

ABOUT = ("angle_min", "angle_max", "angle_increment", "time_increment", "scan_time")
ABOUT_BYTES = 4 * (len(ABOUT) + 2)
"""The numbers about a scan: those, and range_min and range_max."""


class Geometry(NamedTuple):
    """Common parameters of a laser's scans.

    frame: name without a leading slash; angle_min, angle_increment [rad]; time_increment: between
    two beams [s]; range_min, range_max [m]; angle_max: of the last beam, as stated; pose: x, y, yaw
    of the scan in its frame; level: angles are in the robot's orientation, seen from above, so that
    only the frame's position is used.
    """

    frame: str
    angle_min: float
    angle_increment: float
    time_increment: float = 0.0
    range_min: float = 0.0
    range_max: float = float("inf")
    angle_max: float = float("nan")
    pose: tuple[float, float, float] = (0.0, 0.0, 0.0)
    level: bool = False


class RawScans(NamedTuple):
    """Scans of one geometry and number of beams, as recorded.

    message: (n,) index of the message in its batch; log_ns, stamp_ns: (n,) its times; ranges_m: (n,
    m) float32 as in the message; blind: beams without a range give no information, as in a slice of
    a cloud.
    """

    message: IntArray
    log_ns: IntArray
    stamp_ns: IntArray
    ranges_m: Float32Array
    geometry: Geometry
    blind: bool = False

    def rows(self, which: IntArray | slice) -> RawScans:
        """Some of the scans."""
        return self._replace(
            message=self.message[which],
            log_ns=self.log_ns[which],
            stamp_ns=self.stamp_ns[which],
            ranges_m=self.ranges_m[which],
        )


def one_scan(stamp_ns: int, ranges_m: Float32Array, geometry: Geometry) -> RawScans:
    """One scan of ranges (m,); its message and log time are added where they are known."""
    unknown = np.zeros(1, np.int64)
    return RawScans(unknown, unknown, np.array([stamp_ns], np.int64), ranges_m[None], geometry)


def _checked_beams(count: int) -> int:
    """The number of beams; raises DamageError if it is not plausible."""
    if count > LONGEST_LIST:
        raise DamageError(f"a scan of {count} beams is implausible")
    return count


# As columns


class _Template(NamedTuple):
    """The layout of scans of one shape and size; see `wire.Template`."""

    width: int
    shape: Shape
    order: str
    ros1: bool
    frame: str
    stamp_at: int
    about_at: int
    beams: int

    @classmethod
    def of(cls, ros1: bool, raw: bytes) -> _Template:
        """The template of one LaserScan; raises DamageError if it cannot be one."""
        parser = WireParser(raw, ros1)
        stamp_at, frame = parser.header()
        parser.align(4)
        about_at = parser.advance(ABOUT_BYTES)
        beams = _checked_beams(parser.count())
        shape = parser.shape
        parser.advance(4 * beams)
        frame = frame.lstrip("/")
        return cls(parser.position, shape, parser.order, ros1, frame, stamp_at, about_at, beams)

    def scans(self, rows: Bytes, message: IntArray, log_ns: IntArray) -> list[RawScans]:
        """The scans of messages (rows) of this shape, by geometry."""
        stamp_ns = stamps_ns(rows, self.stamp_at, self.order, self.ros1)
        kind = f"{self.order}f4"
        about = numbers(rows, kind, self.about_at, ABOUT_BYTES // 4)
        ranges = numbers(rows, kind, self.width - 4 * self.beams, self.beams)
        return [
            RawScans(message, log_ns, stamp_ns, ranges, _geometry(self.frame, stated)).rows(which)
            for which, stated in _alike(about)
        ]


def _alike(about: Float32Array) -> list[tuple[IntArray, list[float]]]:
    """Rows grouped by equal values, with these: in nearly every log all of them. The time of a
    scan, which some drivers measure, serves for nothing."""
    bits = np.ascontiguousarray(np.delete(about, ABOUT.index("scan_time"), axis=1)).view(np.uint32)
    if (bits == bits[:1]).all():
        return [(np.arange(len(about)), about[0].tolist())] if len(about) else []
    _, first, group = np.unique(bits, axis=0, return_index=True, return_inverse=True)
    return [
        (np.flatnonzero(group.ravel() == k), about[row].tolist())
        for k, row in enumerate(first.tolist())
    ]


def _geometry(frame: str, about: list[float]) -> Geometry:
    angle_min, angle_max, angle_increment, time_increment, _, range_min, range_max = about
    return Geometry(
        frame, angle_min, angle_increment, time_increment, range_min, range_max, angle_max
    )


def _in_order(parts: Sequence[RawScans]) -> list[RawScans]:
    """The scans in the order of their messages: one by one, if they are of several kinds."""
    if len(parts) < 2:
        return list(parts)
    single = [part.rows(slice(k, k + 1)) for part in parts for k in range(len(part.message))]
    return sorted(single, key=lambda scan: int(scan.message[0]))


# One by one


def _numbered(found: list[tuple[int, int, RawScans]]) -> list[RawScans]:
    """The scans of single messages, with the numbers and log times of these."""
    return _in_order(
        [
            scan._replace(message=np.array([number]), log_ns=np.array([log_ns]))
            for number, log_ns, scan in found
        ]
    )


def object_scan(message: Any) -> RawScans:
    """A decoded scan by the names of its fields; raises DamageError.

    Supports sensor_msgs/LaserScan (`angle_min`), foxglove.LaserScan (`start_angle`), and multi-echo
    scans, of which the strongest echo of each beam counts.
    """
    header = get(message, "header")
    source = message if header is None else header
    stamp, frame = stamp_of(source), as_text(get(source, "frame_id")).lstrip("/")
    ranges = _ranges(get(message, "ranges"), get(message, "intensities"))
    if get(message, "start_angle") is not None:
        first, last = (real(get(message, name)) for name in ("start_angle", "end_angle"))
        step = (last - first) / max(len(ranges) - 1, 1)
        pose = get(message, "pose")
        placed = (0.0, 0.0, 0.0) if pose is None else _in_plane(pose_of(pose))
        geometry = Geometry(frame, first, step, angle_max=last, pose=placed)
        return one_scan(stamp, ranges, geometry)
    geometry = Geometry(
        frame,
        real(get(message, "angle_min")),
        real(get(message, "angle_increment")),
        _or(get(message, "time_increment"), 0.0),
        _or(get(message, "range_min"), 0.0),
        _or(get(message, "range_max"), float("inf")),
        _or(get(message, "angle_max"), float("nan")),
    )
    return one_scan(stamp, ranges, geometry)


def _in_plane(pose: tuple[float, ...]) -> tuple[float, float, float]:
    """x, y, yaw of a pose; a zero quaternion, protobuf's default, is the identity."""
    x, y, _, *turn = pose
    if not np.isfinite(pose).all():
        raise DamageError("a pose holds numbers that are not finite")
    return x, y, float(yaw_from_quaternion(*unit_quaternion(tuple(turn))))


def _or(value: Any, otherwise: float) -> float:
    return otherwise if value is None else real(value)


def _ranges(value: Any, strengths: Any) -> Float32Array:
    """(m,) ranges; null in JSON is no range. Values too large become inf."""
    if value is None or isinstance(value, str) or not hasattr(value, "__len__"):
        raise DamageError("a list of ranges is missing")
    _checked_beams(len(value))
    if not (isinstance(value, np.ndarray) and value.dtype.kind in "fiu"):
        powers = strengths if isinstance(strengths, list) else []
        pairs = zip_longest(value, powers[: len(value)])
        value = np.array([_range(*pair) for pair in pairs], np.float64)
    with np.errstate(over="ignore"):
        return np.asarray(value).astype(np.float32)


def _range(value: Any, strength: Any) -> float:
    """Of multiple echoes the strongest if intensities are recorded (dust, rain and glass return
    little), else the first."""
    echoes = get(value, "echoes")
    if echoes is not None:
        powers = get(strength, "echoes")
        best = 0
        if powers is not None and len(powers) == len(echoes) > 1:
            # Compared one by one, so that an intensity that is not a number is never the largest.
            best = max(range(len(powers)), key=lambda k: powers[k])
        value = echoes[best] if len(echoes) else None
    return float("nan") if value is None else real(value)


# Channels

Slicer = Callable[[Cloud], RawScans]

ScanDecoder = Decoder[list[RawScans]]


def scan_decoder(channel: Channel, slicer: Slicer) -> ScanDecoder:
    """The decoder for a channel of scans or point clouds; raises DamageError if there is none.

    slicer: makes a scan of a cloud.
    """
    serialized, ros1 = channel.encoding in ("cdr", "ros1"), channel.encoding == "ros1"
    scan = channel.type_name == "sensor_msgs/msg/LaserScan"
    if serialized and scan and is_usual(channel):
        template = partial(_Template.of, ros1)
        return TemplateDecoder(template, _Template.scans, lambda parts: _in_order([*chain(*parts)]))
    if serialized and channel.type_name == "sensor_msgs/msg/PointCloud2":
        return OneByOne(lambda raw: slicer(wire_cloud(raw, ros1)), _numbered, MESSAGE_BYTES)
    read = object_reader(channel)
    if channel.type_name in JUNCTIONS["cloud"].types:
        return OneByOne(lambda raw: slicer(foxglove_cloud(read(raw))), _numbered)
    many = channel.type_name == "sensor_msgs/msg/MultiEchoLaserScan"
    return OneByOne(
        lambda raw: object_scan(read(raw)), _numbered, ECHOES_BYTES if many else OBJECT_BYTES
    )


class ScanIntake:
    """Decodes the blocks of one channel. messages: their number; failed: those that could not be
    decoded."""

    def __init__(self, channel: Channel, slicer: Slicer) -> None:
        self._decoder = scan_decoder(channel, slicer)
        self._encoding = channel.encoding
        self._unpacked = 0
        self.messages = 0

    @property
    def failed(self) -> int:
        """Number of messages that could not be decoded."""
        return self._decoder.failed + self._unpacked

    @property
    def reason(self) -> str:
        """Why the first of these could not be decoded."""
        return self._decoder.reason

    def take(self, block: Block) -> Iterator[RawScans]:
        """The scans of a block, in order."""
        self.messages += len(block.start)
        # Cut where the bytes so far fill another slice.
        filled = (np.cumsum(block.size) - block.size) // PIECE_BYTES
        for rows in np.split(np.arange(len(filled)), np.flatnonzero(np.diff(filled)) + 1):
            part = block.rows(rows)
            for plain, failed in unpacked(part, self._encoding):
                self._unpacked += failed
                yield from self._decoder.decode(plain)
