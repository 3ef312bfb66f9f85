"""Takes blocks in and keeps, per channel, the poses of its messages as columns."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...topology.errors import LogError
from ...topology.se2 import yaw_from_quaternion
from .columns import words
from .foxglove import RowDecoder, json_rows, object_rows, protobuf_rows
from .inflate import ZSTD_MAGIC, inflate_message
from .messages import LATEST_NS, UNWANTED, Block, Bytes, Channel, DamageError, Ints
from .poses import PoseDecoder, Poses
from .schema import as_expected, object_decoder
from .topics import JUNCTION_KINDS, ODOMETRY_KINDS
from .wire import WireDecoder

DENSE = 64
"""From so many messages in a block on, they are decoded in place; fewer are gathered first."""

PENDING_BYTES = 1 << 20

FARTHEST = 1e9
"""No robot's odometry goes farther [m]; what does is taken for a broken number."""

_MAGIC = int.from_bytes(ZSTD_MAGIC, "little")


def decoder_for(channel: Channel) -> PoseDecoder:
    """The decoder for a channel of one of the known types; raises DamageError if there is none."""
    kind = ODOMETRY_KINDS[channel.type_name][1] if channel.type_name in ODOMETRY_KINDS else None
    kind = kind or JUNCTION_KINDS.get(channel.type_name)
    if kind is not None and channel.encoding in ("cdr", "ros1") and as_expected(channel, kind):
        return WireDecoder(kind, channel.encoding == "ros1")
    if channel.encoding in ("cdr", "ros1"):
        decode = object_decoder(channel)
        return RowDecoder(lambda raw, frames: object_rows(decode(raw), frames))
    if channel.encoding == "json":
        return RowDecoder(json_rows)
    if channel.encoding == "protobuf" and channel.type_name.startswith("foxglove."):
        return RowDecoder(protobuf_rows)
    raise DamageError(f"messages are encoded as {channel.encoding[:40]!r}, which is not known")


@dataclass(slots=True)
class PoseColumns:
    """Poses of one channel: one row per pose, in the order of the log.

    message: number of the message; part: of the junction in it; log_ns, stamp_ns: its times;
    frame: number of the frames; pose: x, y [m], theta [rad].
    """

    message: Ints
    part: Ints
    log_ns: Ints
    stamp_ns: Ints
    frame: Ints
    pose: NDArray[np.float64]


def no_columns() -> PoseColumns:
    """Columns without a row."""
    none = np.zeros(0, np.int64)
    return PoseColumns(none, none, none, none, none, np.zeros((0, 3)))


@dataclass(slots=True)
class Sink:
    """Everything read from one channel.

    messages: taken in; failed: messages that do not decode; not_finite, zero_quaternion: poses
    left out; empty: messages without any pose.
    """

    channel: Channel
    decoder: PoseDecoder
    messages: int = 0
    not_finite: int = 0
    zero_quaternion: int = 0
    undecoded: int = 0
    empty: int = 0
    _pieces: list[tuple[NDArray[Any], ...]] = field(default_factory=list)
    _pending: list[bytes] = field(default_factory=list)
    _pending_ns: list[int] = field(default_factory=list)
    _pending_bytes: int = 0

    @property
    def failed(self) -> int:
        """Messages that could not be decoded."""
        return self.undecoded + self.decoder.failed

    def add(self, data: Bytes, log_ns: Ints, start: Ints, size: Ints) -> None:
        """Take in messages that lie in `data`."""
        if self.channel.encoding == "cdr" and self._packed(data, start, size).any():
            self._unpack(data, log_ns, start, size)
        elif len(start) >= DENSE:
            self.flush()
            self._decode(data, log_ns, start, size)
        else:
            raw = data.data
            ends = (start + size).tolist()
            self._pending += [bytes(raw[a:b]) for a, b in zip(start.tolist(), ends, strict=True)]
            self._pending_bytes += int(size.sum())
            self._pending_ns += log_ns.tolist()
        if self._pending_bytes >= PENDING_BYTES:
            self.flush()

    def columns(self) -> PoseColumns:
        """All poses; the sink is empty afterwards, so that they are held once."""
        self.flush()
        pieces, self._pieces = self._pieces, []
        if not pieces:
            return no_columns()
        columns = [list(column) for column in zip(*pieces, strict=True)]
        del pieces
        out = []
        while columns:
            out.append(np.concatenate(columns.pop(0)))
        return PoseColumns(*out)

    def _packed(self, data: Bytes, start: Ints, size: Ints) -> NDArray[np.bool_]:
        """Which payloads are zstd streams: ROS 2 compresses messages one by one if asked to."""
        packed = size >= 9
        if packed.all():
            return np.asarray(words(data, "<u4", start) == _MAGIC)
        packed[packed] = words(data, "<u4", start[packed]) == _MAGIC
        return packed

    def _unpack(self, data: Bytes, log_ns: Ints, start: Ints, size: Ints) -> None:
        packed = self._packed(data, start, size)
        for k, (at, length) in enumerate(zip(start.tolist(), size.tolist(), strict=True)):
            payload = data[at : at + length].tobytes()
            try:
                self._keep(inflate_message(payload) if packed[k] else payload)
            except DamageError:
                self.messages += 1
                self.undecoded += 1
                continue
            self._pending_ns.append(int(log_ns[k]))
            if self._pending_bytes >= PENDING_BYTES:
                self.flush()

    def _keep(self, payload: bytes) -> None:
        self._pending.append(payload)
        self._pending_bytes += len(payload)

    def flush(self) -> None:
        """Decode what was only gathered so far."""
        if not self._pending:
            return
        size = np.fromiter(map(len, self._pending), np.int64, len(self._pending))
        data = np.frombuffer(b"".join(self._pending), np.uint8)
        log_ns = np.array(self._pending_ns, np.int64)
        self._pending, self._pending_ns, self._pending_bytes = [], [], 0
        self._decode(data, log_ns, np.cumsum(size) - size, size)

    def _decode(self, data: Bytes, log_ns: Ints, start: Ints, size: Ints) -> None:
        failed = self.decoder.failed
        decoded = self.decoder.decode(data, start, size)
        failed = self.decoder.failed - failed
        # Messages are numbered in their order, so that each change of the number is a message.
        changes = np.count_nonzero(decoded.message[1:] != decoded.message[:-1])
        told = int(changes) + (len(decoded.message) > 0)
        self.empty += len(start) - failed - told
        poses = self._usable(decoded)
        x, y, _, qx, qy, qz, qw = poses.value.T
        self._pieces.append(
            (
                (poses.message + self.messages).astype(np.int32),
                poses.part.astype(np.uint16),
                log_ns[poses.message],
                poses.stamp_ns,
                poses.frame.astype(np.int16),
                np.stack([x, y, yaw_from_quaternion(qx, qy, qz, qw)], axis=1),
            )
        )
        self.messages += len(start)

    def _usable(self, poses: Poses) -> Poses:
        """The poses with finite numbers and an orientation; the others are counted."""
        # NaN compares as false, so that it is never inside.
        inside = np.abs(poses.value) <= FARTHEST
        if not inside.all():
            finite = np.asarray(inside.all(axis=1))
            self.not_finite += int((~finite).sum())
            poses = poses.rows(finite)
        # Far below any unit quaternion, far above what rounding leaves of a zero one.
        rotation = poses.value[:, 3:]
        turned = np.asarray(np.einsum("ij,ij->i", rotation, rotation) > 1e-12)
        if not turned.all():
            self.zero_quaternion += int((~turned).sum())
            poses = poses.rows(turned)
        return poses


class Intake:
    """Decides by channel what is kept, and keeps it."""

    def __init__(
        self,
        accept: Callable[[Channel], bool],
        decoder: Callable[[Channel], PoseDecoder] = decoder_for,
    ) -> None:
        self._accept = accept
        self._decoder = decoder
        self.sinks: list[Sink] = []
        self.refused: dict[Channel, str] = {}
        self._number: dict[Channel, int] = {}

    def want(self, channel: Channel) -> int:
        """Sink number of a channel, UNWANTED for one that is not kept."""
        known = self._number.get(channel)
        if known is not None:
            return known
        number = UNWANTED
        if self._accept(channel):
            try:
                self.sinks.append(Sink(channel, self._decoder(channel)))
                number = len(self.sinks) - 1
            except DamageError as damage:
                self.refused[channel] = str(damage)
        self._number[channel] = number
        return number

    def take(self, block: Block) -> None:
        """Take in the messages of a block."""
        log_ns = np.clip(block.log_time_ns, 0, LATEST_NS - 1)
        first = int(block.sink[0])
        if (block.sink == first).all():
            self.sinks[first].add(block.data, log_ns, block.start, block.size)
            return
        for number in np.flatnonzero(np.bincount(block.sink)).tolist():
            rows = np.flatnonzero(block.sink == number)
            self.sinks[number].add(block.data, log_ns[rows], block.start[rows], block.size[rows])

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
