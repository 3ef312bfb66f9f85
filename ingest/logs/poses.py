"""Poses out of messages of any type and encoding; columnar decoding of those of ROS."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Literal, NamedTuple, Protocol

import numpy as np

from ...topology.arrays import FloatArray, IntArray
from ...topology.columns import joined, take
from .columns import Shape, numbers
from .messages import Block, Bytes, DamageError
from .wire import OneByOne, TemplateDecoder, WireParser, stamps_ns

Kind = Literal[
    "odometry",
    "pose",
    "pose_covariance",
    "pose_array",
    "transforms",
    "foxglove_pose",
    "foxglove_poses",
]

WIRE_KINDS = ("odometry", "pose", "pose_covariance", "pose_array", "transforms")
"""Kinds of ROS, decoded as columns."""

NUMBERS = 7
"""Numbers of a pose: position and quaternion."""

MOST_POSES = 1024
"""Most poses of one message: of a junction 32 count, of particles there are some hundreds."""

FARTHEST_M = 1e9
"""Larger coordinates [m] are invalid: no robot's odometry goes farther."""


Row = tuple[int, int, list[tuple[float, ...]]]
"""Stamp [ns], number of the frames and poses of one junction, decoded one by one."""

FRAMES = 1024
"""Largest number of pairs of frames in one topic."""


@dataclass(slots=True, eq=False)
class Poses:
    """Poses of one channel, or of a batch of its messages, in the order of the messages.

    message: (k,) index of the message; part: (k,) index of the junction in the message, if it has
    several; log_ns, stamp_ns: (k,) its times; frame: (k,) number in the decoder's frames; pose: (k,
    7) x, y, z [m], qx, qy, qz, qw, as recorded, or (k, 3) x, y [m], theta [rad].
    """

    message: IntArray
    part: IntArray
    log_ns: IntArray
    stamp_ns: IntArray
    frame: IntArray
    pose: FloatArray

    def __len__(self) -> int:
        return len(self.message)


@dataclass(slots=True)
class Frames:
    """Pairs (frame_id, child_frame_id) of a topic, numbered; a leading slash is dropped."""

    pairs: list[tuple[str, str]] = field(default_factory=list)
    _number: dict[tuple[str, str], int] = field(default_factory=dict)

    def number(self, frame: str, child: str = "") -> int:
        """The number of a pair; raises DamageError when there are implausibly many."""
        pair = (frame.lstrip("/"), child.lstrip("/"))
        known = self._number.get(pair)
        if known is None:
            if len(self.pairs) >= FRAMES:
                raise DamageError("implausibly many frame names")
            known = self._number[pair] = len(self.pairs)
            self.pairs.append(pair)
        return known


class PoseDecoder(Protocol):
    """A `Decoder` of poses; frames: numbers of the frames met."""

    frames: Frames
    failed: int
    reason: str

    def decode(self, block: Block) -> Poses:
        """The poses of the messages of a block."""


def no_poses() -> Poses:
    """A batch without poses."""
    none = np.zeros(0, np.int64)
    return Poses(none, none, none, none, none, np.zeros((0, 7)))


def join(parts: Sequence[Poses]) -> Poses:
    """Batches over the same messages as one, in the order of the messages."""
    if not parts:
        return no_poses()
    if len(parts) == 1:
        return parts[0]
    together = joined(parts)
    return take(together, np.argsort(together.message, kind="stable"))


class _Run(NamedTuple):
    """`length` consecutive poses with one stamp and one pair of frames."""

    stamp_at: int
    frame: int
    pose_at: int
    length: int


class _Template(NamedTuple):
    """Offsets of the fields in messages of one shape; order: "<" or ">"."""

    width: int
    shape: Shape
    runs: tuple[_Run, ...]
    order: str
    ros1: bool

    def poses(self, rows: Bytes, message: IntArray, log_ns: IntArray) -> Poses:
        """The poses of messages (rows) of this shape."""
        return join([self._run(rows, message, log_ns, run) for run in self.runs])

    def _run(self, rows: Bytes, message: IntArray, log_ns: IntArray, run: _Run) -> Poses:
        stamp_ns = stamps_ns(rows, run.stamp_at, self.order, self.ros1)
        value = numbers(rows, f"{self.order}f8", run.pose_at, NUMBERS * run.length)
        value = value.reshape(-1, NUMBERS)
        if run.length != 1:
            times = message, log_ns, stamp_ns
            message, log_ns, stamp_ns = (np.repeat(column, run.length) for column in times)
        frame = np.full(len(message), run.frame, np.int64)
        return Poses(message, np.zeros_like(message), log_ns, stamp_ns, frame, value)


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
        stamp, frame = parser.header()
        child = parser.string() if kind == "odometry" else ""
        count = parser.count() if kind == "pose_array" else 1
        if count > MOST_POSES:
            raise DamageError(f"more than {MOST_POSES} poses in a message, which is the limit")
        pair = frames.number(frame, child)
        runs.append(_Run(stamp, pair, parser.doubles(NUMBERS * count), count))
    return _Template(parser.position, parser.shape, tuple(runs), parser.order, ros1)


class WireDecoder(TemplateDecoder[_Template, Poses]):
    """Decodes messages of one kind in CDR or ROS 1 serialization."""

    def __init__(self, kind: Kind, ros1: bool) -> None:
        self.frames = Frames()
        super().__init__(partial(_parsed, kind, ros1, self.frames), _Template.poses, join)


class RowDecoder(OneByOne[list[Row], Poses]):
    """Decodes poses message by message."""

    def __init__(self, parse: Callable[[bytes, Frames], list[Row]]) -> None:
        self.frames = Frames()
        super().__init__(lambda raw: parse(raw, self.frames), _poses_of_rows)


def _poses_of_rows(found: list[tuple[int, int, list[Row]]]) -> Poses:
    """One row per pose, in the order of the messages."""
    rows = [
        (number, part, log_ns, stamp_ns, frame, pose)
        for number, log_ns, junctions in found
        for part, (stamp_ns, frame, poses) in enumerate(junctions)
        for pose in poses
    ]
    if not rows:
        return no_poses()
    *about, pose = zip(*rows, strict=True)
    message, part, log_ns, stamp_ns, frame = (np.array(column, np.int64) for column in about)
    return Poses(message, part, log_ns, stamp_ns, frame, np.array(pose, np.float64))
