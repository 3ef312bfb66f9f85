"""MCAP files (https://mcap.dev/spec), chunked or not, with or without index, whole or damaged."""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import numpy as np

from ...topology.arrays import IntArray
from .channels import NUMBERS, Channels
from .chunks import HEAD_BYTES, INDEX_BYTES, Chunk, Found, Index, Scan
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
from .source import Source
from .walk import mcap_records

MAGIC = b"\x89MCAP0\r\n"
FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK = 0x02, 0x03, 0x04, 0x05, 0x06
CHUNK_INDEX, STATISTICS, DATA_END = 0x08, 0x0B, 0x0F
PRIVATE = 0x80
"""Opcodes; from PRIVATE on they are anybody's."""

_NOT_IN_CHUNKS = frozenset(range(256)) - {SCHEMA, CHANNEL, MESSAGE}

RECORD_HEAD, MESSAGE_HEAD = 9, 22
"""Bytes of a record's opcode and length, and of a message before its payload."""

FOOTER_BYTES = RECORD_HEAD + 20 + len(MAGIC)

LARGEST_RECORD = 1 << 40
"""Larger ones are damage: no file is as large."""

SUMMARY_DAMAGED = "the summary is damaged"

_RECORD = struct.Struct("<BQ").unpack_from
_CHUNK = struct.Struct("<QQQII").unpack_from
_U32, _U64 = (struct.Struct(f).unpack_from for f in ("<I", "<Q"))


class McapScan(Scan):
    """One scan of an MCAP file of any profile."""

    FIRST = len(MAGIC)
    FRONT = re.compile(rb"(?=[\x03-\x06].{5}\0\0\0)", re.DOTALL)

    def __init__(self, *parts: Any) -> None:
        super().__init__(*parts)
        self._definitions = Definitions(self._channels)

    def _record_at(self, position: int) -> Found | None:
        head = self._source.read(position, HEAD_BYTES)
        if head == MAGIC:  # the end of the file
            return Found(position + len(MAGIC))
        if len(head) < RECORD_HEAD:
            return None
        op, length = _RECORD(head)
        end = position + RECORD_HEAD + length
        if op == CHUNK:
            chunk = _chunk(head, position)
            return None if chunk is None else Found(end, chunk)
        known = 0 < op <= DATA_END or op >= PRIVATE
        least = MESSAGE_HEAD if op == MESSAGE else 0
        if not known or not least <= length < LARGEST_RECORD:
            return None
        return Found(end, loose=op not in _NOT_IN_CHUNKS)

    def _records(self, data: Bytes) -> tuple[IntArray, int]:
        return mcap_records(data, _NOT_IN_CHUNKS)

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
    """The summary of a file, None if it was written without one; raises DamageError and
    struct.error."""
    footer = source.size - FOOTER_BYTES
    tail = source.read(footer, FOOTER_BYTES) if footer >= len(MAGIC) else b""
    if not tail.endswith(MAGIC):
        raise DamageError(CUT[1])
    op, length, start, _, crc = struct.unpack_from("<BQQQI", tail)
    if (op, length, start) == (FOOTER, 20, 0):
        return None
    if op != FOOTER or length != 20 or not footer - INDEX_BYTES < start <= footer:
        raise DamageError(SUMMARY_DAMAGED)
    raw = source.read(start, footer - start + RECORD_HEAD + 16)
    data = np.frombuffer(raw, np.uint8)[: footer - start]
    where, stop = mcap_records(data)
    if (crc and checksum(raw) != crc) or stop != len(data):
        raise DamageError(SUMMARY_DAMAGED)
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
    if not (counts and apart and filled <= named <= channels.described.keys()):
        chunks = []
    return Index(channels.described, counts, (first, last), chunks, bool(crc), start)
