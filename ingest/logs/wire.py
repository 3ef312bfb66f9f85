"""Decoders of payloads: by templates in CDR (ROS 2) and ROS 1 serialization, or one by one.

The offsets of all fields in a serialized message depend on its strings and counts only. One message
is parsed, its strings and counts become a template, and all messages of the same size with the same
bytes there are decoded at once; the others yield further templates.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Generic, Protocol, TypeVar

import numpy as np

from ...topology.arrays import IntArray
from .columns import Shape, column, gather
from .messages import NAME_BYTES, OBJECT_BYTES, Block, Bytes, DamageError, text

TEMPLATES = 64
"""Limit on templates per message size, and on those tried per batch."""


class WireParser:
    """Parses one message and records the offsets that a template needs."""

    def __init__(self, raw: bytes, ros1: bool) -> None:
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
        return text(self._raw[at : at + length].rstrip(b"\0"))

    def stamp(self) -> int:
        """Offset of a time."""
        self.align(4)
        return self.advance(8)

    def header(self) -> tuple[int, str]:
        """Offset of the stamp, and the frame, of a std_msgs/Header."""
        if self.ros1:
            self.advance(4)
        return self.stamp(), self.string()

    def doubles(self, count: int) -> int:
        """Offset of `count` consecutive float64."""
        if count:
            self.align(8)
        return self.advance(8 * count)

    @property
    def shape(self) -> Shape:
        """What was parsed, as what messages of the same layout share."""
        head = np.frombuffer(self._raw, np.uint8, self.position)
        return Shape.of(head, tuple(self.fixed))


def stamps_ns(rows: Bytes, at: int, order: str, ros1: bool) -> IntArray:
    """(n,) times of messages, as rows, at one offset [ns]."""
    seconds = column(rows, f"{order}{'u4' if ros1 else 'i4'}", at)
    return seconds * 10**9 + column(rows, f"{order}u4", at + 4)


P = TypeVar("P")
Q = TypeVar("Q")


class Decoder(Generic[P]):
    """Turns payloads into `P`; what cannot be decoded is left out.

    failed: number of such messages; reason: why the first of them could not be decoded.
    """

    def __init__(self) -> None:
        self.failed = 0
        self.reason = ""

    def decode(self, block: Block) -> P:
        """What the messages of a block hold."""
        raise NotImplementedError

    def _leave_out(self, damage: DamageError) -> None:
        self.failed += 1
        self.reason = self.reason or str(damage)


class Template(Protocol):
    """The layout of messages of one size."""

    @property
    def width(self) -> int:
        """Bytes from a message's begin to the end of what is needed."""

    @property
    def shape(self) -> Shape:
        """What such messages share."""


T = TypeVar("T", bound=Template)


class TemplateDecoder(Decoder[P], Generic[T, P]):
    """Decodes messages by templates.

    parse: the template of one message, or DamageError; read: what messages (rows of `width`
    bytes) of a template hold, with their numbers and log times; join: of parts in no order.
    """

    def __init__(
        self,
        parse: Callable[[bytes], T],
        read: Callable[[T, Bytes, IntArray, IntArray], P],
        join: Callable[[list[P]], P],
    ) -> None:
        super().__init__()
        self._parse, self._read, self._join = parse, read, join
        self._templates: dict[int, list[T]] = {}

    def decode(self, block: Block) -> P:
        """What a batch of messages holds. O(bytes read) with few templates."""
        size, message = block.size, np.arange(len(block.size))
        if len(size) and (size == size[0]).all():
            return self._join(self._same_size(block, message))
        # One group per size: sort once, then split where the size changes.
        order = np.argsort(size, kind="stable")
        cuts = np.flatnonzero(np.diff(size[order])) + 1
        out: list[P] = []
        for group in np.split(order, cuts) if len(order) else []:
            out += self._same_size(block.rows(group), group)
        return self._join(out)

    def _same_size(self, block: Block, message: IntArray) -> list[P]:
        out: list[P] = []
        size = int(block.size[0])
        known = self._templates.setdefault(size, [])
        for template in known:
            block, message = self._take(block, message, template, out)
        while len(message):
            at, behind = int(block.start[0]), slice(1, None)
            try:
                template = self._parse(block.data[at : at + size].tobytes())
            except DamageError as damage:
                self._leave_out(damage)
                block, message = block.rows(behind), message[behind]
                continue
            if len(known) < TEMPLATES:
                known.append(template)
                block, message = self._take(block, message, template, out)
            else:
                self._take(block.rows(slice(0, 1)), message[:1], template, out)
                block, message = block.rows(behind), message[behind]
        if len(self._templates) > TEMPLATES * TEMPLATES:
            self._templates.clear()
        return out

    def _take(
        self, block: Block, message: IntArray, template: T, out: list[P]
    ) -> tuple[Block, IntArray]:
        """Decode the messages that have the template's shape; returns the others."""
        if len(message) == 0:
            return block, message
        rows = gather(block.data, block.start, template.width)
        other = template.shape.misfits(rows)
        if other is None:
            out.append(self._read(template, rows, message, block.log_time_ns))
            return block.rows(slice(0, 0)), message[:0]
        if not other.all():
            log_ns = block.log_time_ns[~other]
            out.append(self._read(template, rows[~other], message[~other], log_ns))
        return block.rows(other), message[other]


class OneByOne(Decoder[P], Generic[Q, P]):
    """Decodes messages one by one, for encodings without fixed offsets.

    parse: what one message holds, or DamageError; join: of contents with the numbers and log times
    of their messages, in order; longest: of the messages that are decoded [bytes].
    """

    def __init__(
        self,
        parse: Callable[[bytes], Q],
        join: Callable[[list[tuple[int, int, Q]]], P],
        longest: int = OBJECT_BYTES,
    ) -> None:
        super().__init__()
        self._parse, self._join, self._longest = parse, join, longest

    def decode(self, block: Block) -> P:
        """What a batch of messages holds."""
        found: list[tuple[int, int, Q]] = []
        for number, raw in enumerate(block.payloads()):
            try:
                if len(raw) > self._longest:
                    raise DamageError("a message is implausibly long")
                found.append((number, int(block.log_time_ns[number]), self._parse(raw)))
            except DamageError as damage:
                self._leave_out(damage)
        return self._join(found)
