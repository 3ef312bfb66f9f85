"""The summary section of an MCAP file, believed only where it is whole and consistent."""

from __future__ import annotations

import struct
from typing import NamedTuple

import numpy as np

from .checksum import crc32
from .mcap_wire import (
    CHANNEL,
    CHUNK_INDEX,
    FOOTER,
    MAGIC,
    RECORD_HEAD,
    SCHEMA,
    STATISTICS,
    Cursor,
    Schema,
    channel_of,
    schema_of,
)
from .messages import Bytes, Channel, DamageError, FileWindow, Ints, Survey

FOOTER_BYTES = RECORD_HEAD + 20 + len(MAGIC)

SUMMARY_BYTES = 1 << 27
"""Largest summary that is read: a chunk takes about 100 bytes in it."""

_HEAD = struct.Struct("<BQ").unpack_from
_NUMBERS = struct.Struct("<HH").unpack_from
"""Numbers of a channel and of its schema, 0 for none, at the front of a channel record."""


class McapSummary(NamedTuple):
    """What the end of a file says about it.

    start: where the summary begins; channels: those whose schema it repeats as well, or that have
    none; chunk_starts: (c,) ascending places of the chunk records; counts: messages per channel
    number, empty where there are no statistics; checked: whether a checksum vouches for all this.
    """

    start: int
    schemas: dict[int, Schema]
    channels: dict[int, Channel]
    chunk_starts: Ints
    chunk_channels: dict[int, frozenset[int]]
    counts: dict[int, int]
    span_ns: tuple[int, int]
    checked: bool

    @property
    def describes_all(self) -> bool:
        """Whether every channel that any chunk or the statistics name is described."""
        return self.channels.keys() >= set(self.counts).union(*self.chunk_channels.values())

    def survey(self) -> Survey | None:
        """Counts per channel, None where statistics or the channels they count are missing."""
        if not self.counts or not self.counts.keys() <= self.channels.keys():
            return None
        counts: dict[Channel, int] = {}
        for number, channel in self.channels.items():
            counts[channel] = counts.get(channel, 0) + self.counts.get(number, 0)
        return Survey(counts, *self.span_ns)


def read_summary(window: FileWindow) -> McapSummary | None:
    """The summary of a file, None where there is none or something in it is wrong."""
    tail = window.view(window.size - FOOTER_BYTES, FOOTER_BYTES).tobytes()
    if window.size < FOOTER_BYTES + len(MAGIC) or not tail.endswith(MAGIC):
        return None
    op, length, start, _, crc = struct.unpack_from("<BQQQI", tail)
    footer = window.size - FOOTER_BYTES
    if op != FOOTER or length != 20 or not 0 < start <= footer or footer - start > SUMMARY_BYTES:
        return None
    data = window.view(start, footer - start + RECORD_HEAD + 16)
    if crc and crc32(data.data) != crc:
        return None
    try:
        return _parse(data[: footer - start], start, checked=bool(crc))
    except DamageError:
        return None


def _parse(data: Bytes, start: int, checked: bool) -> McapSummary:
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    chunks: dict[int, frozenset[int]] = {}
    counts: dict[int, int] = {}
    span = (0, 0)
    position = 0
    while position < len(data):
        if len(data) - position < RECORD_HEAD:
            raise DamageError("a record head is cut")
        op, length = _HEAD(data.data, position)
        body = data[position + RECORD_HEAD : position + RECORD_HEAD + length]
        if len(body) != length:
            raise DamageError("a record is cut")
        if op == SCHEMA:
            number, schema = schema_of(Cursor(body))
            schemas[number] = schema
        elif op == CHANNEL:
            number, channel = channel_of(Cursor(body), schemas)
            # A writer may repeat channels here, but not their schemas.
            if _NUMBERS(body.data)[1] in (0, *schemas):
                channels[number] = channel
        elif op == CHUNK_INDEX:
            place, numbers = _chunk_index(Cursor(body))
            chunks[place] = numbers
        elif op == STATISTICS:
            counts, span = _statistics(Cursor(body))
        position += RECORD_HEAD + length
    starts = np.array(sorted(chunks), np.int64)
    if len(starts) and starts[-1] >= start:
        raise DamageError("a chunk index points behind the data")
    return McapSummary(start, schemas, channels, starts, chunks, counts, span, checked)


def _chunk_index(cursor: Cursor) -> tuple[int, frozenset[int]]:
    cursor.take(16)
    place = cursor.u64()
    cursor.take(8)
    offsets = cursor.blob()
    if len(offsets) % 10:
        raise DamageError("a chunk index is cut")
    numbers = np.ndarray((len(offsets) // 10,), "<u2", offsets, strides=(10,)).tolist()
    if place >= 1 << 62:
        raise DamageError("a chunk index points nowhere")
    return place, frozenset(numbers)


def _statistics(cursor: Cursor) -> tuple[dict[int, int], tuple[int, int]]:
    cursor.take(8 + 2 + 4 + 4 + 4 + 4)
    span = (cursor.u64(), cursor.u64())
    per_channel = Cursor(np.frombuffer(cursor.blob(), np.uint8))
    counts = {}
    while per_channel.left:
        number = per_channel.u16()
        counts[number] = min(per_channel.u64(), 1 << 62)
    return counts, span
