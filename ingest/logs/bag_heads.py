"""Validation and repair of ROS 1 record headers, by their fields and by the record that follows.

A record names its fields, so that random data rarely look like one; but the length of its data is
stated nowhere else, and is only confirmed by the record that follows. If no record follows, the
header is tried with each single bit flipped; if none works, the next record is searched for.
"""

from __future__ import annotations

import re
from collections.abc import Callable

from .bag_wire import (
    BAG_HEADER,
    CHUNK,
    CHUNK_INFO,
    CONNECTION,
    HEADER_BYTES,
    INDEX,
    INDEX_ENTRY,
    MESSAGE,
    U32,
    Fields,
    Record,
    fields_of,
    number,
    op_of,
)
from .messages import SCHEMA_BYTES, Bytes, DamageError
from .spelling import nearest

HEAD_BYTES = 256
"""Bytes of a record that are examined first and repaired bit by bit: all lengths of most
connections."""

REPAIRS = 64
"""Headers per file that are repaired bit by bit, 2 ms each; of a file with more wrong bits the rest
is read."""

COMPRESSIONS = frozenset({b"none", b"bz2", b"lz4"})

_FIELDS: dict[int, dict[bytes, int]] = {
    MESSAGE: {b"conn": 4, b"time": 8},
    BAG_HEADER: {b"index_pos": 8, b"conn_count": 4, b"chunk_count": 4},
    INDEX: {b"ver": 4, b"conn": 4, b"count": 4},
    CHUNK: {b"size": 4},
    CHUNK_INFO: {b"ver": 4, b"chunk_pos": 8, b"start_time": 8, b"end_time": 8, b"count": 4},
    CONNECTION: {b"conn": 4},
}
"""Numbers that a record of every kind has, and their bytes."""

_ITEMS = {INDEX: INDEX_ENTRY, CHUNK_INFO: 8}
"""Bytes of the data per item that the field `count` counts."""

_NAMES = b"|".join(
    sorted({b"op", b"compression", b"topic"}.union(*(fields for fields in _FIELDS.values())))
)
_START = re.compile(
    rb"(?=[\x00-\xff]{2}\x00\x00[\x00-\xff]{2}\x00\x00(?:" + _NAMES + rb")=)", re.DOTALL
)
"""The front of a header: its length, and a field's length and name."""

IN_CHUNKS = frozenset({MESSAGE, CONNECTION})

Read = Callable[[int, int], bytes]
"""Gives the bytes of a place, fewer at the end of all."""


class BagHeads:
    """Records in a bag, or in the data of one chunk. read: reads at any position; size: total
    bytes."""

    def __init__(self, read: Read, size: int, *, file: bool = True) -> None:
        self._read = read
        self._size = size
        self._file = file
        self._kinds = frozenset(_FIELDS) if file else IN_CHUNKS
        self._repairs = [REPAIRS]

    def within(self, data: Bytes) -> BagHeads:
        """The same for the data of a chunk of this file."""
        raw = memoryview(data.data)
        heads = BagHeads(lambda at, n: bytes(raw[at : at + n]), len(data), file=False)
        heads._repairs = self._repairs
        return heads

    def record(self, position: int, head: bytes | None = None) -> Record | None:
        """The record at `position`, None if its fields are not those of its kind.

        Its data may extend beyond the end, if a log was truncated. head: its first HEAD_BYTES, if
        they were repaired.
        """
        if head is None:
            head = self._read(position, HEAD_BYTES)
        if len(head) < 8:
            return None
        size = U32(head)[0]
        if not 0 < size <= HEADER_BYTES:
            return None
        if size + 8 > len(head):
            head += self._read(position + len(head), size + 8 - len(head))
            if size + 8 > len(head):
                return None
        try:
            fields = fields_of(head[4 : 4 + size])
            op = op_of(fields)
            record = Record(fields, op, position + 8 + size, U32(head, 4 + size)[0])
            return record if op in self._kinds and self._fits(record, head[8 + size :]) else None
        except DamageError:
            return None

    def _fits(self, record: Record, front: bytes) -> bool:
        """Whether a record has the fields of its kind; raises DamageError if a number is missing.

        front: of its data, as far as it is known.
        """
        fields = record.fields
        for name, size in _FIELDS[record.op].items():
            number(fields, name, size)
        if record.op in _ITEMS:
            return number(fields, b"count") * _ITEMS[record.op] == record.data_size
        if record.op == CHUNK:
            # A name that is misspelt is there, but not as `compression`.
            named = b"compression" in fields or fields.keys() == {b"op", b"size"}
            return named and compression_of(fields) in COMPRESSIONS
        if record.op == CONNECTION and record.end <= self._size:
            if record.data_size > 2 * SCHEMA_BYTES:
                return True
            front = front[: record.data_size]
            more = record.data_size - len(front)
            described = front + self._read(record.data_at + len(front), more)
            return b"type" in fields_of(described)
        return True

    def begins(self, position: int) -> bool:
        """Whether a record begins at `position`, or the data end there, possibly within a record
        header."""
        if position + HEAD_BYTES > self._size:
            return position == self._size or (position < self._size and self._cut_head(position))
        return self.record(position) is not None

    def _cut_head(self, position: int) -> bool:
        """Whether the last bytes are a record, or the front of one."""
        if self.record(position) is not None:
            return True
        head = self._read(position, HEAD_BYTES)
        return self._file and (len(head) < 8 or U32(head)[0] + 8 > len(head))

    def repaired(self, position: int) -> bytes | None:
        """The header of the record at `position` with one bit flipped that makes it sound, or None.

        Of several the one with the earliest end, as the most conservative.
        """
        head = self._read(position, HEAD_BYTES)
        if self._repairs[0] <= 0 or len(head) < 8:
            return None
        self._repairs[0] -= 1
        best: bytes | None = None
        least = self._size + 1
        # The header is the longest part; where its own length is wrong, the fields tell.
        for bit in range(8 * len(head)):
            changed = bytearray(head)
            changed[bit // 8] ^= 1 << bit % 8
            patched = bytes(changed)
            record = self.record(position, patched)
            if record is None or record.end >= least or not _named(record.fields):
                continue
            if record.end == self._size or self.record(record.end) is not None:
                best, least = patched, record.end
        return best

    def following(self, position: int, packed: bool = False) -> int | None:
        """Position of the next sound record at or behind `position`, None if there is none.

        packed: whether chunks are compressed; what looks like a message is then part of one.
        """
        slab = 1 << 12
        while position < self._size:
            raw = self._read(position, slab + HEAD_BYTES)
            for match in _START.finditer(raw, 0, slab + 24):
                at = match.start()
                if at >= slab:
                    break
                record = self.record(position + at, raw[at : at + HEAD_BYTES])
                if record is None or record.end > self._size or (packed and record.op in IN_CHUNKS):
                    continue
                if self.begins(record.end):
                    return position + at
            position += slab
            slab = min(4 * slab, 1 << 20)
        return None


def _named(fields: Fields) -> bool:
    """Whether the fields of a header have names; a wrong length takes in what is behind it."""
    return all(name.isascii() and name.decode().isidentifier() for name in fields)


def compression_of(fields: Fields) -> bytes:
    """The compression of a chunk, with at most one wrong bit in the name repaired."""
    return nearest(fields.get(b"compression", b"none"), COMPRESSIONS)
