"""Columnar decoding of ROS messages with poses, in CDR (ROS 2) and ROS 1 serialization.

The offsets of all fields in such a message depend on its strings and counts only. One message is
parsed, its strings and counts become a template, and all messages of the same size with the same
bytes there are decoded at once; the others yield further templates.
"""

from __future__ import annotations

import struct
from typing import Literal, NamedTuple

import numpy as np

from ...topology.arrays import FloatArray, IntArray
from .columns import Shape, column, gather
from .messages import NAME_BYTES, Bytes, DamageError, text
from .poses import Frames, Heads, Poses, join

Kind = Literal[
    "odometry",
    "pose",
    "pose_covariance",
    "pose_array",
    "transforms",
    "foxglove_pose",
    "foxglove_poses",
]

POSE_BYTES = 56
MOST_POSES = 1024
"""Most poses of one message: of a junction 32 count, of particles there are some hundreds."""

MANY = 1024
"""Messages of one size from which on those that are alike and broken are counted together."""

COVARIANCE = 36
"""Numbers of a covariance of x, y, z and rotations about them, row by row."""
FARTHEST_M = 1e9
"""Bound of stated sigmas [m], to keep them within single precision."""
TEMPLATES = 64
"""Limit on templates per message size, and on those tried per batch."""


class _Run(NamedTuple):
    """`length` consecutive poses with one stamp and one pair of frames; covariance: whether that of
    the only one follows."""

    stamp_at: int
    frame: int
    pose_at: int
    length: int
    covariance: bool = False


class Template(NamedTuple):
    """Offsets of the fields in messages of one shape.

    size: bytes from the message's begin to the end of the last needed field; order: "<" or ">".
    """

    size: int
    shape: Shape
    runs: tuple[_Run, ...]
    order: str
    ros1: bool

    def poses(self, rows: Bytes, message: IntArray) -> Poses:
        """The poses of messages (rows) of this shape."""
        parts = [self._run(rows, message, run) for run in self.runs]
        return join(parts)

    def _run(self, rows: Bytes, message: IntArray, run: _Run) -> Poses:
        seconds_type = f"{self.order}{'u4' if self.ros1 else 'i4'}"
        stamp_ns = column(rows, seconds_type, run.stamp_at) * 10**9
        stamp_ns += column(rows, f"{self.order}u4", run.stamp_at + 4)
        span = rows[:, run.pose_at : run.pose_at + POSE_BYTES * run.length]
        value = np.ascontiguousarray(span).view(f"{self.order}f8").astype(np.float64, copy=False)
        if run.length != 1:
            message, stamp_ns = np.repeat(message, run.length), np.repeat(stamp_ns, run.length)
        frame = np.full(len(message), run.frame, np.int64)
        sigma_m = self._sigma_m(rows, run) if run.covariance else None
        value = value.reshape(-1, 7)
        return Poses(message, np.zeros_like(message), stamp_ns, frame, value, sigma_m)

    def _sigma_m(self, rows: Bytes, run: _Run) -> FloatArray:
        """(k,) stated 1 sigma of the positions [m], NaN where none is stated (0 or less)."""
        begin = run.pose_at + POSE_BYTES
        span = np.ascontiguousarray(rows[:, begin : begin + 8 * COVARIANCE])
        variance = span.view(f"{self.order}f8").astype(np.float64)[:, [0, 7]].max(axis=1)
        return np.minimum(np.sqrt(np.where(variance > 0, variance, np.nan)), FARTHEST_M)


class WireParser:
    """Parses one message and records the offsets that a template needs."""

    def __init__(self, raw: bytes | memoryview, ros1: bool) -> None:
        self._raw = raw
        self.ros1 = ros1
        self.fixed: list[tuple[int, int]] = []
        self.order = "<"
        self._base, self._widest, self.position = 0, 8, 0
        if not ros1:
            self._encapsulation()

    def _encapsulation(self) -> None:
        if len(self._raw) < 4 or self._raw[0] != 0 or self._raw[1] not in (0, 1, 6, 7):
            raise DamageError("not a CDR message")
        self.order = "<" if self._raw[1] & 1 else ">"
        self._widest = 4 if self._raw[1] >= 6 else 8
        self._base = self.position = 4
        self.fixed.append((0, 2))

    def align(self, width: int) -> None:
        """Advance to the alignment of a number of this width."""
        if not self.ros1:
            width = min(width, self._widest)
            self.position += -(self.position - self._base) % width

    def advance(self, length: int) -> int:
        """Skip bytes and return their offset; raises DamageError at the message's end."""
        at = self.position
        if at + length > len(self._raw):
            raise DamageError("a message ends too early")
        self.position += length
        return at

    def count(self) -> int:
        """A sequence length, which belongs to the shape."""
        self.align(4)
        at = self.advance(4)
        self.fixed.append((at, at + 4))
        return int(struct.unpack_from(f"{self.order}I", self._raw, at)[0])

    def string(self) -> str:
        """A string, which belongs to the shape."""
        length = self.count()
        if length > NAME_BYTES:
            raise DamageError(f"a name of {length} bytes is implausible")
        at = self.advance(length)
        if length:
            self.fixed.append((at, at + length))
        return text(bytes(self._raw[at : at + length]).rstrip(b"\0"))

    def stamp(self) -> int:
        """Offset of a time."""
        self.align(4)
        return self.advance(8)

    def header(self) -> tuple[int, str]:
        """Offset of the stamp, and the frame, of a std_msgs/Header."""
        if self.ros1:
            self.advance(4)
        return self.stamp(), self.string()

    def poses(self, count: int) -> int:
        """Offset of `count` consecutive poses."""
        if count:
            self.align(8)
        return self.advance(POSE_BYTES * count)


def parse(kind: Kind, raw: bytes, ros1: bool, frames: Frames) -> Template:
    """The template of one message; raises DamageError if it cannot be a message of this kind."""
    parser = WireParser(raw, ros1)
    runs: list[_Run] = []
    if kind == "transforms":
        for _ in range(min(parser.count(), len(raw) // POSE_BYTES + 1)):
            stamp, frame = parser.header()
            pair = frames.number(frame, parser.string())
            runs.append(_Run(stamp, pair, parser.poses(1), 1))
    else:
        stamp, frame = (
            (parser.stamp(), parser.string()) if kind.startswith("foxglove") else parser.header()
        )
        child = parser.string() if kind == "odometry" else ""
        many = kind in ("pose_array", "foxglove_poses")
        count = parser.count() if many else 1
        if count > MOST_POSES:
            raise DamageError(f"more than {MOST_POSES} poses in a message, which is the limit")
        told = kind == "pose_covariance"
        runs.append(_Run(stamp, frames.number(frame, child), parser.poses(count), count, told))
        if told:
            parser.advance(8 * COVARIANCE)
    shape = Shape.of(np.frombuffer(raw, np.uint8, parser.position), tuple(parser.fixed))
    return Template(parser.position, shape, tuple(runs), parser.order, ros1)


class WireDecoder:
    """Decodes messages of one kind in CDR or ROS 1 serialization."""

    def __init__(self, kind: Kind, ros1: bool) -> None:
        self._kind: Kind = kind
        self._ros1 = ros1
        self.frames = Frames()
        self.failed = 0
        self.reason = ""
        self._templates: dict[int, list[Template]] = {}

    def heads(self, data: Bytes, start: IntArray, size: IntArray) -> Heads | None:
        """The needed fields of the messages, if all have one known shape, else None."""
        known = self._templates.get(int(size[0]))
        if not known or not (size == size[0]).all():
            return None
        rows = gather(data, start, known[0].size)
        fits = known[0].shape.misfits(rows) is None
        return Heads(rows, known[0].poses) if fits else None

    def decode(self, data: Bytes, start: IntArray, size: IntArray) -> Poses:
        """The poses of a batch of messages. O(bytes read) with few shapes."""
        message = np.arange(len(start))
        if len(start) and (size == size[0]).all():
            parts = self._same_size(data, start, int(size[0]), message)
        else:
            # One group per size: sort once, then split where the size changes.
            order = np.argsort(size, kind="stable")
            cuts = np.flatnonzero(np.diff(size[order])) + 1
            parts = []
            for group in np.split(order, cuts) if len(order) else []:
                parts += self._same_size(data, start[group], int(size[group[0]]), message[group])
        return join(parts)

    def _same_size(self, data: Bytes, start: IntArray, size: int, message: IntArray) -> list[Poses]:
        parts = []
        known = self._templates.setdefault(size, [])
        for template in known:
            start, message, part = self._fitting(data, start, message, template)
            parts.append(part)
            if len(start) == 0:
                return parts
        fresh = True
        while len(start):
            raw = data[start[0] : start[0] + size].tobytes()
            try:
                template = parse(self._kind, raw, self._ros1, self.frames)
            except DamageError as damage:
                flood = fresh and len(start) >= MANY
                left = self._unlike(data, start, raw) if flood else np.arange(1, len(start))
                self.failed += len(start) - len(left)
                self.reason = self.reason or str(damage)
                start, message, fresh = start[left], message[left], False
                continue
            if len(known) < TEMPLATES:
                known.append(template)
                start, message, part = self._fitting(data, start, message, template)
            else:
                _, _, part = self._fitting(data, start[:1], message[:1], template)
                start, message = start[1:], message[1:]
            parts.append(part)
        if len(self._templates) > TEMPLATES * TEMPLATES:
            self._templates.clear()
        return parts

    def _unlike(self, data: Bytes, start: IntArray, raw: bytes) -> IntArray:
        """Messages that differ from those bytes and may be valid; the first one is."""
        head = np.frombuffer(raw, np.uint8)
        other = Shape.of(head, ((0, len(head)),)).misfits(gather(data, start, len(head)))
        return np.zeros(0, np.int64) if other is None else other.nonzero()[0]

    def _fitting(
        self, data: Bytes, start: IntArray, message: IntArray, template: Template
    ) -> tuple[IntArray, IntArray, Poses]:
        """The messages that do not have the template's shape, and the poses of those that do."""
        rows = gather(data, start, template.size)
        other = template.shape.misfits(rows)
        if other is None:
            return start[:0], message[:0], template.poses(rows, message)
        return start[other], message[other], template.poses(rows[~other], message[~other])
