"""Decodes blocks and keeps, per channel, the poses of its messages as columns."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from ...topology.arrays import BoolArray, FloatArray
from ...topology.columns import joined, take
from ...topology.errors import LogError
from ...topology.se2 import yaw_from_quaternion
from .foxglove import object_reader, object_rows
from .inflate import unpacked
from .messages import UNWANTED, Block, Channel, DamageError
from .poses import FARTHEST_M, WIRE_KINDS, PoseDecoder, Poses, RowDecoder, WireDecoder, no_poses
from .schema import is_usual
from .topics import POSE_KINDS

DENSE = 64
"""From so many messages in a block on, they are decoded in place; fewer are collected first. With 8
in place of 64, reading takes up to 1.3 times as long (benchmarks/reading_numbers.py)."""

PENDING_BYTES = 1 << 20
"""Small messages are collected up to this size before they are decoded."""

MOST_KEPT, BYTES_PER_POSE = 1 << 19, 40
"""Most poses of a topic that are kept in space, and bytes of a log for each further one: kept and
sorted they take some 400 bytes, a message with four of them and its odometry far more than 160."""

MOST_SINKS = 1 << 12
"""Most channels of one log that are kept: with few messages, one takes some 25 kB."""


def decoder_for(channel: Channel) -> PoseDecoder:
    """The decoder for a channel of one of the known types; raises DamageError if there is none."""
    kind = POSE_KINDS.get(channel.type_name)
    if kind in WIRE_KINDS and channel.encoding in ("cdr", "ros1") and is_usual(channel):
        return WireDecoder(kind, channel.encoding == "ros1")
    read = object_reader(channel)
    return RowDecoder(lambda raw, frames: object_rows(read(raw), frames))


def usable_poses(value: FloatArray) -> tuple[BoolArray, BoolArray]:
    """(k,) which poses (k, 7) have finite, plausible numbers, and which of these an orientation."""
    finite = np.asarray((np.abs(value) <= FARTHEST_M).all(axis=1))  # NaN compares as false
    turn = value[:, 3:] if finite.all() else np.where(finite[:, None], value[:, 3:], 0.0)
    # Far below any unit quaternion, far above what rounding leaves of a zero one.
    return finite, np.asarray(np.einsum("ki,ki->k", turn, turn) > 1e-12)


def in_plane(value: FloatArray) -> FloatArray:
    """(k, 3) x, y and the heading of the x axis, of poses (k, 7) in space."""
    out = np.empty((len(value), 3))
    out[:, :2] = value[:, :2]
    out[:, 2] = yaw_from_quaternion(*value[:, 3:].T)
    return out


@dataclass(slots=True)
class Sink:
    """The poses of one channel.

    whole: whether poses are kept in space, instead of the plane; most: of these; messages: number
    processed; failed: messages that do not decode; not_finite, zero_quaternion: poses left out;
    empty: messages without any pose.
    """

    channel: Channel
    decoder: PoseDecoder
    whole: bool = False
    most: int = MOST_KEPT
    messages: int = 0
    not_finite: int = 0
    zero_quaternion: int = 0
    undecoded: int = 0
    empty: int = 0
    _kept: int = 0
    _parts: list[Poses] = field(default_factory=list)
    _pending: list[bytes] = field(default_factory=list)
    _pending_ns: list[int] = field(default_factory=list)
    _pending_bytes: int = 0

    @property
    def failed(self) -> int:
        """Messages that could not be decoded."""
        return self.undecoded + self.decoder.failed

    @property
    def reason(self) -> str:
        """Why the first of them could not be."""
        full = f"more than {self.most} poses, which is the limit" if self._kept >= self.most else ""
        return self.decoder.reason or full

    def add(self, block: Block) -> None:
        """Process the messages of a block: many in place, few when enough are collected."""
        if self.whole and self._kept >= self.most:
            self.messages += len(block.start)
            self.undecoded += len(block.start)
            return
        for part, failed in unpacked(block, self.channel.encoding):
            self.messages += failed
            self.undecoded += failed
            if len(part.start) >= DENSE:
                self.flush()
                self._decode(part)
                continue
            self._pending += part.payloads()
            self._pending_ns += part.log_time_ns.tolist()
            self._pending_bytes += int(part.size.sum())
            if self._pending_bytes >= PENDING_BYTES:
                self.flush()

    def columns(self) -> Poses:
        """All poses; the sink is empty afterwards, so that they are held once."""
        self.flush()
        parts, self._parts = self._parts, []
        return joined(parts) if parts else no_poses()

    def flush(self) -> None:
        """Decode what was collected."""
        if self._pending:
            block = Block.of(0, np.array(self._pending_ns, np.int64), self._pending)
            self._pending, self._pending_ns, self._pending_bytes = [], [], 0
            self._decode(block)

    def _decode(self, block: Block) -> None:
        """Append the poses of further messages."""
        failed = self.decoder.failed
        decoded = self.decoder.decode(block)
        # Messages are numbered in their order, so that each change of the number is a message.
        changes = np.count_nonzero(decoded.message[1:] != decoded.message[:-1])
        with_poses = int(changes) + (len(decoded) > 0)
        self.empty += len(block.start) - (self.decoder.failed - failed) - with_poses
        poses = self._usable(decoded)
        poses.message = poses.message + self.messages
        if not self.whole:
            poses.pose = in_plane(poses.pose)
        self._parts.append(poses)
        self._kept += len(poses)
        self.messages += len(block.start)

    def _usable(self, poses: Poses) -> Poses:
        """The poses with finite numbers and an orientation; the others are counted."""
        finite, turned = usable_poses(poses.pose)
        self.not_finite += int((~finite).sum())
        self.zero_quaternion += int((finite & ~turned).sum())
        return poses if turned.all() else take(poses, turned)


class Intake:
    """Decides by channel what is kept, and keeps it."""

    def __init__(
        self,
        accept: Callable[[Channel], bool],
        decoder: Callable[[Channel], PoseDecoder] = decoder_for,
        whole: Callable[[Channel], bool] = lambda channel: False,
    ) -> None:
        self._accept = accept
        self._decoder = decoder
        self._whole = whole
        self.most = MOST_KEPT
        self.sinks: list[Sink] = []
        self.refused: dict[Channel, str] = {}
        self._number: dict[Channel, int] = {}

    def expect(self, size: int) -> None:
        """Keep no more poses than a log of this size [bytes] is to take memory for."""
        self.most = MOST_KEPT + size // BYTES_PER_POSE

    def want(self, channel: Channel) -> int:
        """Sink number of a channel, UNWANTED for one that is not kept."""
        known = self._number.get(channel)
        if known is not None:
            return known
        number = UNWANTED
        if self._accept(channel):
            try:
                if len(self.sinks) == MOST_SINKS:
                    raise DamageError(f"more than {MOST_SINKS} topics, which is the limit")
                decoder = self._decoder(channel)
                self.sinks.append(Sink(channel, decoder, self._whole(channel), self.most))
                number = len(self.sinks) - 1
            except DamageError as damage:
                self.refused[channel] = str(damage)
        self._number[channel] = number
        return number

    def take(self, block: Block) -> None:
        """Process the messages of a block."""
        self.sinks[block.sink].add(block)

    def of_topic(self, topic: str) -> list[Sink]:
        """The sinks that hold messages of a topic."""
        found = [sink for sink in self.sinks if sink.channel.topic == topic]
        for sink in found:
            sink.flush()
        return [sink for sink in found if sink.messages]

    def check(self, topic: str, log: str) -> None:
        """Raise LogError if the topic's messages could not be decoded at all."""
        for channel, reason in sorted(self.refused.items()):
            if channel.topic == topic and not self.of_topic(topic):
                raise LogError(f"{log}: {topic} cannot be decoded: {reason}")
