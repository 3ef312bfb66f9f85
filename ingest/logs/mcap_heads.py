"""Validation of MCAP record heads by their redundant lengths and by the record that follows.

Except for messages, a record's length follows from the lengths inside it, and every record ends
where another begins. If a length is inconsistent, the head is tried with each one of its bits
flipped; if that does not help, the walk continues at the next position with two consecutive valid
records.
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
"""Bytes of a record read at first: they hold all lengths of chunks and messages."""

CHUNK_FIXED = 32
"""Bytes of a chunk record before the name of its compression."""

LARGEST_RECORD = 1 << 48
"""Upper limit of a record's length, 256 TiB."""

REPAIRS = 64
"""Limit on heads of one file that are repaired, 0.2 ms each; beyond it damage is skipped."""

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
"""Fields of every kind of record: a number of bytes, or a length of 32 ("s") or 64 bits ("l") with
its content."""

COMPRESSIONS = frozenset({b"", b"zstd", b"lz4"})

IN_CHUNKS = frozenset({SCHEMA, CHANNEL, MESSAGE})
NOT_IN_CHUNKS = frozenset(range(256)) - IN_CHUNKS
OUTSIDE = frozenset({*_LAYOUTS, MESSAGE})

PRIVATE = 0x80
"""Opcodes from this one on are private to applications (https://mcap.dev/spec)."""


def chunk_head(head: bytes, position: int) -> ChunkHead:
    """The head of the valid chunk record at `position`, from its first HEAD_BYTES."""
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
"""Returns the bytes at (position, length), fewer at the end."""


class Heads:
    """Records in a file, or in the data of one chunk.

    read: bytes of any position; size: total; known: whether a channel number is described; file:
    whether this is a file, which ends with a magic rather than with its last record.
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
        """For each channel number of messages whether it is described."""
        return [self._known(number) for number in numbers.tolist()]

    def end(self, position: int, head: bytes | None = None) -> int | None:
        """End of the record at `position` if all its lengths agree, else None.

        It may lie behind the end of a truncated log. head: the record's corrected first HEAD_BYTES.
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
        """Whether the lengths in a record add up to `total`; False if some are cut off."""
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
        """End of the record at `position` if it is complete and followed by another one."""
        if head is None:
            head = self._read(position, HEAD_BYTES)
        end = self.end(position, head)
        return end if end is not None and self._begins_behind(head, end) else None

    def _begins_behind(self, head: bytes, end: int) -> bool:
        """Whether a record begins at `end`; it may be the channel of the one before."""
        if self.begins(end):
            return True
        number = head[RECORD_HEAD : RECORD_HEAD + 2]
        after = self._read(end, RECORD_HEAD + 2)
        return head[0] == CHANNEL and after[:1] == b"\x05" and after[RECORD_HEAD:] == number

    def begins(self, position: int) -> bool:
        """Whether a record begins at `position`, or the data end there, possibly within a record
        head."""
        if position + RECORD_HEAD > self._size:
            return position <= self._size
        return self.end(position) is not None

    def repaired(self, position: int) -> bytes | None:
        """The head of the record at `position` with the one change that makes it valid, None if
        none does.

        Of several changes, the one with the shortest record.
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
        """Position of the next valid record at or after `position`, None if there is none.

        packed: chunks are compressed, so that apparent messages are parts of chunks.
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
        """Positions in `data` at which a record is possible by opcode and length."""
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
    """A head with each single bit flipped, or with the size of its chunk corrected.

    The channel of a message is not changed, since several would be possible. Changes that make a
    message come last, since any length is possible for it.
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
    """Offset of a chunk's data size, 0 if its compression is unknown."""
    name_at = RECORD_HEAD + CHUNK_FIXED
    if len(head) < name_at + 8:
        return 0
    end = name_at + int(_U32(head, name_at - 4)[0])
    return end if end + 8 <= len(head) and bytes(head[name_at:end]) in COMPRESSIONS else 0
