"""Columnar decoding of ROS messages with poses."""

from __future__ import annotations

from functools import partial
from typing import Literal, NamedTuple

import numpy as np

from ...topology.arrays import FloatArray, IntArray
from .columns import Shape
from .messages import Bytes, DamageError
from .poses import Frames, Poses, join
from .wire import TemplateDecoder, WireParser, stamps_ns

Kind = Literal[
    "odometry",
    "pose",
    "pose_covariance",
    "pose_array",
    "transforms",
    "foxglove_pose",
    "foxglove_poses",
]

NUMBERS = 7
"""Numbers of a pose: position and quaternion."""

MOST_POSES = 1024
"""Most poses of one message: of a junction 32 count, of particles there are some hundreds."""

COVARIANCE = 36
"""Numbers of a covariance of x, y, z and rotations about them, row by row."""

FARTHEST_M = 1e9
"""Bound of stated sigmas [m], to keep them within single precision."""


class _Run(NamedTuple):
    """`length` consecutive poses with one stamp and one pair of frames; covariance: whether that of
    the only one follows."""

    stamp_at: int
    frame: int
    pose_at: int
    length: int
    covariance: bool = False


class _Template(NamedTuple):
    """Offsets of the fields in messages of one shape; order: "<" or ">"."""

    width: int
    shape: Shape
    runs: tuple[_Run, ...]
    order: str
    ros1: bool

    def parts(self, rows: Bytes, message: IntArray) -> list[Poses]:
        """The poses of messages (rows) of this shape."""
        return [self._run(rows, message, run) for run in self.runs]

    def _run(self, rows: Bytes, message: IntArray, run: _Run) -> Poses:
        stamp_ns = stamps_ns(rows, run.stamp_at, self.order, self.ros1)
        value = self._numbers(rows, run.pose_at, NUMBERS * run.length).reshape(-1, NUMBERS)
        sigma_m = None
        if run.length != 1:
            message, stamp_ns = np.repeat(message, run.length), np.repeat(stamp_ns, run.length)
        elif run.covariance:
            sigma_m = self._sigma_m(rows, run.pose_at + 8 * NUMBERS)
        frame = np.full(len(message), run.frame, np.int64)
        return Poses(message, np.zeros_like(message), stamp_ns, frame, value, sigma_m)

    def _numbers(self, rows: Bytes, at: int, count: int) -> FloatArray:
        """(n, count) float64 at one offset of every row."""
        span = np.ascontiguousarray(rows[:, at : at + 8 * count])
        return span.view(f"{self.order}f8").astype(np.float64, copy=False)

    def _sigma_m(self, rows: Bytes, at: int) -> FloatArray:
        """(k,) stated 1 sigma of the positions [m], NaN where none is stated (0 or less)."""
        variance = self._numbers(rows, at, COVARIANCE)[:, [0, 7]].max(axis=1)
        return np.minimum(np.sqrt(np.where(variance > 0, variance, np.nan)), FARTHEST_M)


def _parsed(kind: Kind, ros1: bool, frames: Frames, raw: bytes) -> _Template:
    """The template of one message; raises DamageError if it cannot be a message of this kind."""
    parser = WireParser(raw, ros1)
    runs: list[_Run] = []
    if kind == "transforms":
        for _ in range(min(parser.count(), len(raw) // (8 * NUMBERS) + 1)):
            stamp, frame = parser.header()
            pair = frames.number(frame, parser.string())
            runs.append(_Run(stamp, pair, parser.doubles(NUMBERS), 1))
    else:
        stamp, frame = (
            (parser.stamp(), parser.string()) if kind.startswith("foxglove") else parser.header()
        )
        child = parser.string() if kind == "odometry" else ""
        many = kind in ("pose_array", "foxglove_poses")
        count = parser.count() if many else 1
        if count > MOST_POSES:
            raise DamageError(f"more than {MOST_POSES} poses in a message, which is the limit")
        stated = kind == "pose_covariance"
        pair = frames.number(frame, child)
        runs.append(_Run(stamp, pair, parser.doubles(NUMBERS * count), count, stated))
        if stated:
            parser.doubles(COVARIANCE)
    return _Template(parser.position, parser.shape, tuple(runs), parser.order, ros1)


class WireDecoder(TemplateDecoder[_Template, Poses]):
    """Decodes messages of one kind in CDR or ROS 1 serialization."""

    def __init__(self, kind: Kind, ros1: bool) -> None:
        self.frames = Frames()
        super().__init__(partial(_parsed, kind, ros1, self.frames), _Template.parts)

    def decode(self, data: Bytes, start: IntArray, size: IntArray) -> Poses:
        """The poses of a batch of messages."""
        return join(self.parts(data, start, size))
