"""Which bytes of an MCAP file are a record: by its own lengths, and by the record behind it.

The length of a record says again what the lengths inside it say, save for messages, and every
record ends where another one begins. So a damaged length does not agree with what lies there: then
the head is tried with each one of its bits changed, and if none makes it whole, the next place is
looked for at which a record and another one behind it are.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...topology.arrays import IntArray
from .chunk_reader import ChunkHead
from .mcap_wire import (
    ATTACHMENT,
    CHANNEL,
    CHUNK,
    CHUNK_INDEX,
    DATA_END,
    FOOTER,
    HEADER,
    MESSAGE,
    MESSAGE_HEAD,
    MESSAGE_INDEX,
    RECORD_HEAD,
    SCHEMA,
    STATISTICS,
)
from .messages import Bytes
from .spelling import nearest

_HEAD = struct.Struct("<BQ").unpack_from
_CHUNK = struct.Struct("<QQQII").unpack_from
_U32, _U64 = (struct.Struct(f).unpack_from for f in ("<I", "<Q"))

HEAD_BYTES = 64
"""So much of a record is looked at first: of chunks and messages, all their lengths."""

CHUNK_FIXED = 32
"""Bytes of a chunk record in front of the name of its compression."""

LARGEST_RECORD = 1 << 48
"""Longest record that is believed, 256 TiB: no file is longer."""

REPAIRS = 64
"""Heads of one file that are tried bit by bit, 0.2 ms each; a file with more wrong bits is read by
its rest."""

_LAYOUTS: dict[int, tuple[int | str, ...]] = {
    HEADER: ("s", "s"),
    FOOTER: (20,),
    SCHEMA: (2, "s", "s", "s"),
    CHANNEL: (4, "s", "s", "s"),
    CHUNK: (28, "s", "l"),
    MESSAGE_INDEX: (2, "s"),
    CHUNK_INDEX: (32, "s", 8, "s", 16),
    ATTACHMENT: (16, "s", "s", "l", 4),
    0x0A: (40, "s", "s"),
    STATISTICS: (42, "s"),
    0x0C: ("s", "s"),
    0x0D: (16, "s"),
    0x0E: (17,),
    DATA_END: (4,),
}
"""Bytes of every kind of record: so many, or what a length of 32 ("s") or 64 bits ("l") says."""

COMPRESSIONS = frozenset({b"", b"zstd", b"lz4"})

IN_CHUNKS = frozenset({SCHEMA, CHANNEL, MESSAGE})
NOT_IN_CHUNKS = frozenset(range(256)) - IN_CHUNKS
OUTSIDE = frozenset({*_LAYOUTS, MESSAGE})

PRIVATE = 0x80
"""From this kind on the format leaves records to applications (https://mcap.dev/spec)."""


def chunk_head(head: bytes, position: int) -> ChunkHead:
    """The head of the sound chunk record at `position`, out of its first HEAD_BYTES."""
    start, end, size, crc, named = _CHUNK(head, RECORD_HEAD)
    data_at = RECORD_HEAD + CHUNK_FIXED + named + 8
    name = head[RECORD_HEAD + CHUNK_FIXED : RECORD_HEAD + CHUNK_FIXED + named]
    compression = nearest(name, COMPRESSIONS).decode("utf-8", "replace")
    data_size = _HEAD(head)[1] + RECORD_HEAD - data_at
    if crc.bit_count() == 1:
        # No checksum is 0; a true one of a single bit is as good as impossible.
        crc = 0
    return ChunkHead(compression, position + data_at, data_size, size, crc, start, end)


Read = Callable[[int, int], bytes]
"""Gives the bytes of a place, fewer at the end of all."""


class Heads:
    """Records in a file, or in the data of one chunk.

    read: of any place; size: of all; known: whether a channel of a number is described; file:
    whether this is a file, which does not end with its last record but with a magic.
    """

    def __init__(
        self, read: Read, size: int, known: Callable[[int], bool], *, file: bool = True
    ) -> None:
        self._read = read
        self._size = size
        self._known = known
        self._file = file
        self._kinds = OUTSIDE if file else IN_CHUNKS
        self._repairs = [REPAIRS]

    def within(self, data: Bytes) -> Heads:
        """The same for the data of a chunk of this file."""
        raw = memoryview(data.data)
        heads = Heads(lambda at, n: bytes(raw[at : at + n]), len(data), self._known, file=False)
        heads._repairs = self._repairs
        return heads

    def head(self, position: int) -> bytes:
        """The first HEAD_BYTES of a record."""
        return self._read(position, HEAD_BYTES)

    def known(self, numbers: NDArray[Any]) -> list[bool]:
        """Whether the channels of messages are described."""
        return [self._known(number) for number in numbers.tolist()]

    def end(self, position: int, head: bytes | None = None) -> int | None:
        """Where the record at `position` ends by all its lengths, None if they do not agree.

        This may be behind the end of all, where a log was cut. head: its first HEAD_BYTES, if they
        are known better.
        """
        if head is None:
            head = self._read(position, HEAD_BYTES)
        if len(head) < RECORD_HEAD:
            return None
        op, length = _HEAD(head)
        if op not in self._kinds or length >= LARGEST_RECORD:
            return None
        if op == MESSAGE:
            if length < MESSAGE_HEAD or len(head) < RECORD_HEAD + 2:
                return None
            number = head[RECORD_HEAD] | head[RECORD_HEAD + 1] << 8
            return position + RECORD_HEAD + length if self._known(number) else None
        if self._inside(position, head, _LAYOUTS[op], RECORD_HEAD + length):
            return int(position + RECORD_HEAD + length)
        return None

    def _inside(
        self, position: int, head: bytes, layout: tuple[int | str, ...], total: int
    ) -> bool:
        """Whether the lengths in a record add up to `total`; False as well if some are cut off."""
        at = RECORD_HEAD
        for part in layout:
            if isinstance(part, int):
                at += part
                continue
            width = 4 if part == "s" else 8
            if at + width <= len(head):
                raw = head[at : at + width]
            else:
                raw = self._read(position + at, width)
            if len(raw) < width or at > total:
                return False
            at += width + int.from_bytes(raw, "little")
        return at == total

    def sound(self, position: int, head: bytes | None = None) -> int | None:
        """Where the record at `position` ends if all of it is there and another one behind it."""
        if head is None:
            head = self._read(position, HEAD_BYTES)
        end = self.end(position, head)
        return end if end is not None and self._begins_behind(head, end) else None

    def _begins_behind(self, head: bytes, end: int) -> bool:
        """Whether a record begins behind another, which may describe the channel of that one."""
        if self.begins(end):
            return True
        number = head[RECORD_HEAD : RECORD_HEAD + 2]
        after = self._read(end, RECORD_HEAD + 2)
        return head[0] == CHANNEL and after[:1] == b"\x05" and after[RECORD_HEAD:] == number

    def begins(self, position: int) -> bool:
        """Whether a record begins at `position`, or all ends there, be it within a record head."""
        if position + RECORD_HEAD > self._size:
            return position <= self._size
        return self.end(position) is not None

    def repaired(self, position: int) -> bytes | None:
        """The head of the record at `position` with one change that makes it sound, or None.

        Of several the one that ends first: it takes least for its own.
        """
        head = self._read(position, HEAD_BYTES)
        if self._repairs[0] <= 0 or len(head) < RECORD_HEAD:
            return None
        self._repairs[0] -= 1
        best: bytes | None = None
        least = self._size + 1
        for patched in _changed(head):
            if best is not None and patched[0] == MESSAGE != head[0]:
                break
            end = self.end(position, patched)
            if end is None or end >= least:
                continue
            # Closer than `begins`: where a log was cut, some change of a length hits the cut.
            if self._begins_behind(patched, end) and (
                end + RECORD_HEAD <= self._size or (end == self._size and not self._file)
            ):
                best, least = patched, end
        return best

    def following(self, position: int, packed: bool = False) -> int | None:
        """Place of the next sound record at or behind `position`, None if there is none.

        packed: whether chunks are compressed; what looks like a message is then part of one.
        """
        slab = 1 << 12
        while position < self._size:
            raw = self._read(position, slab + HEAD_BYTES)
            data = np.frombuffer(raw, np.uint8)[: slab + RECORD_HEAD - 1]
            for at in self._candidates(data, position, packed):
                end = self.sound(position + at, raw[at : at + HEAD_BYTES])
                if end is not None and end <= self._size:
                    return int(position + at)
            position += slab
            slab = min(4 * slab, 1 << 20)
        return None

    def _candidates(self, data: Bytes, position: int, packed: bool) -> Iterator[int]:
        """Places in `data` at which records could begin, by kind and length alone."""
        if len(data) < RECORD_HEAD:
            return
        n = len(data) - RECORD_HEAD + 1
        likely = np.zeros(256, bool)
        kinds = self._kinds & {CHUNK, MESSAGE, SCHEMA, CHANNEL, DATA_END, MESSAGE_INDEX}
        likely[sorted(kinds - IN_CHUNKS if packed else kinds)] = True
        # No record of these kinds is longer than 2^40 bytes.
        starts = likely[data[:n]]
        for offset in (6, 7, 8):
            starts &= data[offset : offset + n] == 0
        found: Any = np.flatnonzero(starts)
        lengths: IntArray = np.ndarray((n,), "<u8", data.data, offset=1, strides=(1,))[found]
        fits = (lengths >= 4) & (lengths <= self._size - position - RECORD_HEAD - found)
        yield from found[fits].tolist()


def _changed(head: bytes) -> Iterator[bytes]:
    """A head with what may have been damaged set right: any one bit, or the size of a chunk.

    The number of a message's channel is left alone: several would do. What becomes a message by it
    comes last, since any length is that of a message.
    """
    messages = []
    for bit in range(8 * len(head)):
        changed = bytearray(head)
        changed[bit // 8] ^= 1 << bit % 8
        if changed[0] == MESSAGE and bit >= 8 * RECORD_HEAD:
            break
        if changed[0] == MESSAGE != head[0]:
            messages.append(bytes(changed))
        elif changed[0] != CHUNK or _data_size_at(changed):
            yield bytes(changed)
    size_at = _data_size_at(head)
    if head[0] == CHUNK and size_at:
        length, size = _HEAD(head)[1], _U64(head, size_at)[0]
        by_record = struct.pack("<Q", (RECORD_HEAD + length - size_at - 8) % (1 << 64))
        yield head[:size_at] + by_record + head[size_at + 8 :]
        by_data = struct.pack("<Q", (size_at + 8 + size - RECORD_HEAD) % (1 << 64))
        yield head[:1] + by_data + head[RECORD_HEAD:]
    yield from messages


def _data_size_at(head: bytes | bytearray) -> int:
    """Where a chunk says how many bytes its data take, 0 if its compression is none that exists."""
    name_at = RECORD_HEAD + CHUNK_FIXED
    if len(head) < name_at + 8:
        return 0
    end = name_at + int(_U32(head, name_at - 4)[0])
    return end if end + 8 <= len(head) and bytes(head[name_at:end]) in COMPRESSIONS else 0
