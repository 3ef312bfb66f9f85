"""The summary section of an MCAP file, used only if it is complete and consistent."""

from __future__ import annotations

import struct
from typing import NamedTuple

import numpy as np

from ...topology.arrays import IntArray
from .checksum import crc32
from .columns import words
from .mcap_wire import (
    CHANNEL,
    CHUNK_INDEX,
    FOOTER,
    MAGIC,
    RECORD_HEAD,
    SCHEMA,
    STATISTICS,
    Cursor,
    Definitions,
)
from .messages import Bytes, Channel, DamageError, Survey
from .tally import NUMBERS
from .walk import mcap_records
from .windows import Window

FOOTER_BYTES = RECORD_HEAD + 20 + len(MAGIC)

SUMMARY_BYTES = 1 << 26
"""Largest summary that is read; a chunk takes about 100 bytes in it."""

_HEAD = struct.Struct("<BQ").unpack_from
_NUMBERS = struct.Struct("<HH").unpack_from
"""Channel and schema number (0 for none) at the front of a channel record."""


class McapSummary(NamedTuple):
    """The contents of a summary section.

    start: its position; definitions: its schemas and channels; channels: those whose schema it
    repeats, or without one; chunk_starts: (c,) ascending positions of chunk records; chunk_first,
    chunk_channels: (c + 1,), (k,) chunk i has the channels
    chunk_channels[chunk_first[i]:chunk_first[i + 1]]; counts: messages by channel, empty without
    statistics; checked: whether a checksum covers it; listing: its bytes, and (c,) the positions of
    the chunk indexes in them.
    """

    start: int
    definitions: Definitions
    channels: dict[int, Channel]
    chunk_starts: IntArray
    chunk_first: IntArray
    chunk_channels: IntArray
    counts: dict[int, int]
    span_ns: tuple[int, int]
    checked: bool
    listing: tuple[Bytes, IntArray]

    @property
    def describes_all(self) -> bool:
        """Whether every channel of a chunk or of the statistics is described."""
        named = set(self.counts).union(np.bincount(self.chunk_channels).nonzero()[0].tolist())
        return self.channels.keys() >= named

    def numbers(self, chunk: int) -> IntArray | None:
        """The channels of the chunk at a position of the file, None if it is not listed."""
        k = int(self.chunk_starts.searchsorted(chunk))
        if k == len(self.chunk_starts) or self.chunk_starts[k] != chunk:
            return None
        return self.chunk_channels[self.chunk_first[k] : self.chunk_first[k + 1]]

    def survey(self) -> Survey | None:
        """Counts per channel, None without statistics or with undescribed channels."""
        if not self.counts or not self.counts.keys() <= self.channels.keys():
            return None
        counts: dict[Channel, int] = {}
        for number, channel in self.channels.items():
            counts[channel] = counts.get(channel, 0) + self.counts.get(number, 0)
        return Survey(counts, *self.span_ns, self.checked)


def read_summary(window: Window) -> McapSummary | None:
    """The summary of a file, None if there is none or it is inconsistent."""
    tail = window.view(window.size - FOOTER_BYTES, FOOTER_BYTES).tobytes()
    if window.size < FOOTER_BYTES + len(MAGIC) or not tail.endswith(MAGIC):
        return None
    op, length, start, _, crc = struct.unpack_from("<BQQQI", tail)
    footer = window.size - FOOTER_BYTES
    if op != FOOTER or length != 20 or not 0 < start <= footer or footer - start > SUMMARY_BYTES:
        return None
    data = np.empty(footer - start + RECORD_HEAD + 16, np.uint8)
    window.fill(data, start)
    if crc and crc32(data.data) != crc:
        return None
    try:
        return _parse(data[: footer - start], start, checked=bool(crc))
    except DamageError:
        return None


def _parse(data: Bytes, start: int, checked: bool) -> McapSummary:
    where, stop = mcap_records(data)
    if stop != len(data):
        raise DamageError("a record is cut")
    op = data[where]
    definitions = Definitions()
    channels: dict[int, Channel] = {}
    counts: dict[int, int] = {}
    span = (0, 0)
    for at in where[(op == SCHEMA) | (op == CHANNEL) | (op == STATISTICS)].tolist():
        kind, length = _HEAD(data.data, at)
        body = data[at + RECORD_HEAD : at + RECORD_HEAD + length]
        if kind == STATISTICS:
            counts, span = _statistics(Cursor(body))
            continue
        found = definitions.tell(kind, body.tobytes())
        # A writer may repeat channels here, but not their schemas.
        if found is not None and definitions.has_schema(_NUMBERS(body.data)[1]):
            channels[found[0]] = found[1]
    starts, first, numbers, listed = _chunk_indexes(data, where[op == CHUNK_INDEX])
    if len(starts) and starts[-1] >= start:
        raise DamageError("a chunk index points behind the data")
    return McapSummary(
        start,
        definitions,
        channels,
        starts,
        first,
        numbers,
        counts,
        span,
        checked,
        listing=(data, listed),
    )


PLACE_AT, OFFSETS_AT = RECORD_HEAD + 16, RECORD_HEAD + 36
"""Offsets in a chunk index: the chunk's position, and its channels with the positions of their
message indexes."""


def _chunk_indexes(data: Bytes, where: IntArray) -> tuple[IntArray, IntArray, IntArray, IntArray]:
    """Ascending positions of the chunks, their channels as in McapSummary, and the positions of the
    chunk indexes."""
    if len(where) == 0:
        return where, np.zeros(1, np.int64), where, where
    length = words(data, "<i8", where + 1)
    if length.min() < 36 + 28:
        raise DamageError("a chunk index is cut")
    place = words(data, "<i8", where + PLACE_AT)
    size = words(data, "<u4", where + OFFSETS_AT - 4).astype(np.int64)
    if (size % 10).any() or (size > length - (36 + 28)).any() or place.min() < 0:
        raise DamageError("a chunk index contradicts itself")
    order = np.argsort(place, kind="stable")
    place, size, where = place[order], size[order], where[order]
    count = size // 10
    first = np.concatenate([[0], np.cumsum(count)])
    within = np.arange(first[-1]) - np.repeat(first[:-1], count)
    at = np.repeat(where + OFFSETS_AT, count) + 10 * within
    return place, first, words(data, "<u2", at).astype(np.int64), where


def _statistics(cursor: Cursor) -> tuple[dict[int, int], tuple[int, int]]:
    """Messages per channel, empty if inconsistent; first and last log time [ns]."""
    total = cursor.u64()
    cursor.take(2 + 4 + 4 + 4 + 4)
    span = (cursor.u64(), cursor.u64())
    per_channel = np.frombuffer(cursor.blob(), np.uint8)
    if len(per_channel) % 10 or len(per_channel) > 10 * NUMBERS:
        raise DamageError("the statistics are cut, or count more channels than there can be")
    at = 10 * np.arange(len(per_channel) // 10)
    numbers = words(per_channel, "<u2", at).tolist()
    counts = dict(zip(numbers, words(per_channel, "<u8", at + 2).tolist(), strict=True))
    return (counts if sum(counts.values()) == total else {}), span
