"""MCAP files (https://mcap.dev/spec), chunked or not, with or without index, whole or damaged."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import numpy as np

from ...topology.arrays import IntArray
from .channels import NUMBERS, Channels
from .chunks import RECORD_BYTES, Chunk, Index, Read, Scan
from .columns import column, gather, words
from .inflate import checksum
from .messages import (
    CUT,
    SCHEMA_BYTES,
    UNREADABLE,
    Block,
    Bytes,
    Channel,
    DamageError,
    Findings,
    normal_topic,
    normal_type,
    text,
)
from .source import LEAST_BYTES, SLAB_BYTES, Source
from .walk import mcap_records

MAGIC = b"\x89MCAP0\r\n"
FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK = 0x02, 0x03, 0x04, 0x05, 0x06
MESSAGE_INDEX, CHUNK_INDEX, STATISTICS, DATA_END = 0x07, 0x08, 0x0B, 0x0F
PRIVATE = 0x80
"""Opcodes; from PRIVATE on they are anybody's."""

_NOT_IN_CHUNKS = frozenset(range(256)) - {SCHEMA, CHANNEL, MESSAGE}

_FIXED = {FOOTER: 20, DATA_END: 4, 0x0E: 17}
"""Records of fixed length."""

RECORD_HEAD, MESSAGE_HEAD = 9, 22
"""Bytes of a record's opcode and length, and of a message before its payload."""

HEAD_BYTES = 64
"""Bytes of a record that are looked at first: they hold all lengths of chunks and messages."""

FOOTER_BYTES = RECORD_HEAD + 20 + len(MAGIC)

SUMMARY_BYTES = 1 << 26
"""Largest summary that is read; a chunk takes about 100 bytes in it."""

LARGEST_MESSAGE, LARGEST_RECORD = 1 << 32, 1 << 40
"""Larger ones are damage: lengths in ROS messages have 32 bits."""

CHAIN = 3
"""Records in a row that have to be plausible where reading goes on after damage."""

_RECORD = struct.Struct("<BQ").unpack_from
_CHUNK = struct.Struct("<QQQII").unpack_from
_U32, _U64 = (struct.Struct(f).unpack_from for f in ("<I", "<Q"))

_KNOWN = np.array([0 < op <= DATA_END or op >= PRIVATE for op in range(256)])
"""Which opcodes a record may have."""


class McapScan(Scan):
    """One scan of an MCAP file of any profile."""

    def __init__(self, *parts: Any) -> None:
        super().__init__(*parts)
        self._definitions = Definitions(self._channels)

    def all(self) -> Iterator[Chunk]:
        """All chunks, and runs of records outside of them."""
        read, position, stop = self._source.read, len(MAGIC), self._source.size
        window = LEAST_BYTES
        if read(0, position) != MAGIC:
            self.findings.note("the file does not begin with the MCAP magic")
        while position + RECORD_HEAD <= stop:
            head = read(position, HEAD_BYTES)
            op, length = _RECORD(head)
            end = position + RECORD_HEAD + length
            chunk = _chunk(head, position) if op == CHUNK else None
            if chunk is not None and end > stop:
                yield chunk._replace(packed=stop - chunk.at, cut=True)
                return
            if end > stop or not _plausible(head):
                position = self._around_damage(position, stop)
                continue
            if op not in _NOT_IN_CHUNKS:
                if length < RECORD_BYTES:
                    data = np.frombuffer(read(position, max(window, end - position)), np.uint8)
                    end = position + mcap_records(data, _NOT_IN_CHUNKS)[1]
                    window = min(max(4 * (end - position), LEAST_BYTES), SLAB_BYTES)
                chunk = Chunk("", position, end - position, end - position)
            if chunk is not None:
                yield chunk
            elif op == FOOTER and end + len(MAGIC) == stop:
                if self._index is None and _U64(head, RECORD_HEAD)[0]:
                    self.findings.note("the summary is damaged")
                return
            position = end
        self.findings.faults[CUT] = 1

    front = RECORD_HEAD

    def _starts(self, raw: bytes, most: int) -> list[int]:
        data = np.frombuffer(raw, np.uint8)
        count = max(min(len(raw) - RECORD_HEAD + 1, most), 0)
        at = _KNOWN[data[:count]].nonzero()[0]
        length = words(data, "<u8", at + 1).clip(max=LARGEST_RECORD).astype(int)
        behind = at + RECORD_HEAD + length
        follows = (behind >= len(raw)) | _KNOWN[data[np.minimum(behind, len(raw) - 1)]]
        found: list[int] = at[follows & (behind <= most)].tolist()
        return found

    def _leads_on(self, read: Read, position: int, stop: int) -> bool:
        for _ in range(CHAIN):
            head = read(position, HEAD_BYTES)
            if not _plausible(head):
                return False
            position += RECORD_HEAD + int(_RECORD(head)[1])
            if position >= stop:
                return position == stop
        return True

    def _chunk_at(self, position: int) -> Chunk | None:
        head = self._source.read(position, HEAD_BYTES)
        return _chunk(head, position) if head[:1] == bytes([CHUNK]) else None

    def _records(self, data: Bytes) -> tuple[IntArray, int]:
        return mcap_records(data, _NOT_IN_CHUNKS)

    def _record_size(self, data: Bytes) -> int:
        if len(data) < RECORD_HEAD or int(data[0]) in _NOT_IN_CHUNKS:
            return 0
        return RECORD_HEAD + int(_RECORD(data.data)[1])

    def _blocks(self, data: Bytes, where: IntArray) -> Iterator[Block]:
        is_message = data[where] == MESSAGE
        damaged = self._definitions.read(data, where[~is_message]) if len(where) else 0
        where = where[is_message]
        length = words(data, "<i8", where + 1)
        damaged += int(length[length < MESSAGE_HEAD].sum())
        if damaged:
            self._fault(*UNREADABLE, damaged)
        where = where[length >= MESSAGE_HEAD]
        if len(where) == 0:
            return
        heads = gather(data, where, RECORD_HEAD + 14)
        size = column(heads, "<i8", 1) - MESSAGE_HEAD
        number = column(heads, "<u2", RECORD_HEAD)
        log_time = column(heads, "<i8", RECORD_HEAD + 6)
        start = where + (RECORD_HEAD + MESSAGE_HEAD)
        for sink, rows in self._channels.met(number, log_time):
            yield Block(data, sink, log_time[rows], start[rows], size[rows])


def _plausible(head: bytes) -> bool:
    """Whether a record may begin with these bytes, up to HEAD_BYTES of them."""
    if len(head) < RECORD_HEAD:
        return False
    op, length = _RECORD(head)
    if op == CHUNK:
        return _chunk(head, 0) is not None
    if op in _FIXED:
        return bool(length == _FIXED[op])
    if op == MESSAGE:
        return bool(MESSAGE_HEAD <= length < LARGEST_MESSAGE)
    if op == MESSAGE_INDEX:
        return len(head) >= RECORD_HEAD + 6 and bool(_U32(head, RECORD_HEAD + 2)[0] + 6 == length)
    return bool(_KNOWN[op] and length < LARGEST_RECORD)


def _chunk(head: bytes, position: int) -> Chunk | None:
    """The chunk whose record begins with `head`, None if its lengths contradict each other."""
    fixed = RECORD_HEAD + 32
    if len(head) < fixed:
        return None
    _, length = _RECORD(head)
    _, _, size, crc, named = _CHUNK(head, RECORD_HEAD)
    data_at = fixed + named + 8
    if data_at > len(head):
        return None
    (packed,) = _U64(head, data_at - 8)
    if data_at + packed != RECORD_HEAD + length or size >= LARGEST_RECORD:
        return None
    return Chunk(text(head[fixed : fixed + named]), position + data_at, packed, size, crc)


# Schemas and channels


class Definitions:
    """The schemas and channels of one file as they are read; writers repeat them in every chunk.

    Of every number the first description that can be read counts.
    """

    def __init__(self, channels: Channels) -> None:
        self._channels = channels
        self._schemas: dict[int, tuple[str, str, bytes]] = {0: ("", "", b"")}
        self._known = np.zeros(2 * NUMBERS, bool)

    def read(self, data: Bytes, where: IntArray) -> int:
        """Read the new ones among records at `where`; returns the bytes of those that cannot be
        read."""
        where = where[where + RECORD_HEAD + 2 <= len(data)]
        number = words(data, "<u2", where + RECORD_HEAD) + NUMBERS * (data[where] == SCHEMA)
        first = np.unique(number, return_index=True)[1]
        fresh = np.sort(first[~self._known[number[first]]])
        damaged = 0
        for place, key in zip(where[fresh].tolist(), number[fresh].tolist(), strict=True):
            op, length = _RECORD(data.data, place)
            body = data[place + RECORD_HEAD : place + RECORD_HEAD + length].tobytes()
            try:
                self._known[key] = self._add(op, body)
            except (DamageError, struct.error):
                damaged += len(body)
        return damaged

    def _add(self, op: int, body: bytes) -> bool:
        """Read a schema, or a channel if its schema is known."""
        if op == SCHEMA:
            name, encoding, definition = _strings(body, 2, 3)
            if len(definition) > SCHEMA_BYTES or not self._channels.has_room(len(definition)):
                definition = b""
            self._schemas[_number(body)] = normal_type(text(name)), text(encoding), definition
            return True
        topic, encoding = _strings(body, 4, 2)
        schema = self._schemas.get(_number(body[2:]))
        if schema is None:
            return False
        type_name, kind, text_of = schema
        channel = Channel(normal_topic(text(topic)), type_name, text(encoding), text_of, kind)
        self._channels.describe(_number(body), channel)
        return True


def _number(body: bytes) -> int:
    return int.from_bytes(body[:2], "little")


def _strings(body: bytes, at: int, count: int) -> list[bytes]:
    """Strings with their lengths in front of them; raises DamageError."""
    out = []
    for _ in range(count):
        (size,) = _U32(body, at)
        if at + 4 + size > len(body):
            raise DamageError("a record ends too early")
        out.append(body[at + 4 : at + 4 + size])
        at += 4 + size
    return out


# The summary


def read_summary(source: Source) -> Index | None:
    """The summary of a file, None if there is none; raises DamageError and struct.error."""
    footer = source.size - FOOTER_BYTES
    tail = source.read(footer, FOOTER_BYTES) if footer >= len(MAGIC) else b""
    if not tail.endswith(MAGIC):
        return None
    op, length, start, _, crc = struct.unpack_from("<BQQQI", tail)
    if op != FOOTER or length != 20 or not 0 < start <= footer or footer - start > SUMMARY_BYTES:
        return None
    raw = source.read(start, footer - start + RECORD_HEAD + 16)
    if crc and checksum(raw) != crc:
        return None
    data = np.frombuffer(raw, np.uint8)[: footer - start]
    where, stop = mcap_records(data)
    if stop != len(data):
        return None
    op = data[where]
    channels = Channels(lambda _: 0, Findings())
    Definitions(channels).read(data, where[(op == SCHEMA) | (op == CHANNEL)])
    counts: dict[int, int] = {}
    total, first, last = 0, 0, 0
    for at in (where[op == STATISTICS] + RECORD_HEAD).tolist():
        total, first, last, size = struct.unpack_from("<Q18xQQI", raw, at)
        counts = dict(struct.iter_unpack("<HQ", raw[at + 46 : at + 46 + size]))
    if sum(counts.values()) != total:
        counts = {}
    kinds: dict[frozenset[int], frozenset[int]] = {}  # few, of a million chunks
    chunks = []
    for at in where[op == CHUNK_INDEX].tolist():
        begin, size, listed = struct.unpack_from("<QQI", raw, at + RECORD_HEAD + 16)
        pairs = raw[at + RECORD_HEAD + 36 : at + RECORD_HEAD + 36 + listed]
        held = frozenset(number for number, _ in struct.iter_unpack("<HQ", pairs))
        chunks.append((begin, begin + size, kinds.setdefault(held, held)))
    chunks.sort(key=lambda chunk: chunk[0])
    named = frozenset[int]().union(*kinds)
    filled = {number for number, count in counts.items() if count}
    apart = all(end <= begin for (_, end, _), (begin, _, _) in pairwise(chunks))
    apart &= all(begin < end <= start for begin, end, _ in chunks)
    sound = chunks and counts and apart and filled <= named <= channels.described.keys()
    distrusted = "" if sound else "its index is incomplete or contradicts itself"
    return Index(channels.described, counts, (first, last), chunks, distrusted, bool(crc), start)
