"""MCAP files: a walk over their records that needs no index, survives damage and checks CRCs."""

from __future__ import annotations

import functools
import struct
from collections.abc import Callable, Iterator, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .ahead import Ahead
from .checksum import crc32
from .columns import words
from .inflate import SLOW, inflate, inflate_part, keep_freed_memory
from .mcap_summary import McapSummary, read_summary
from .mcap_wire import (
    ATTACHMENT,
    CHANNEL,
    CHUNK,
    DATA_END,
    FOOTER,
    MAGIC,
    MESSAGE,
    MESSAGE_HEAD,
    MESSAGE_INDEX,
    RECORD_HEAD,
    SCHEMA,
    Cursor,
    channel_of,
    schema_of,
)
from .messages import (
    UNWANTED,
    Block,
    Bytes,
    DamageError,
    FileWindow,
    Findings,
    Ints,
    Progress,
    Survey,
    Walking,
    Want,
)
from .tally import UNKNOWN, Tally
from .walk import mcap_listed, mcap_records

_HEAD = struct.Struct("<BQ").unpack_from

_NOT_MESSAGES = frozenset(range(256)) - {MESSAGE, SCHEMA, CHANNEL}

LOG_TIME_AT = 15
"""Place of the log time in a message record; the channel's number stands behind the head."""

INDEX_HEAD = 6
_INDEX = struct.Struct("<HI").unpack_from
"""Channel and bytes of a message index record."""

SLAB_BYTES = 1 << 20
"""How much of an unchunked file is walked at a time."""

LARGEST_RECORD = 1 << 32
"""A record outside a chunk that claims more is taken for damage, not for a record."""


class _ChunkHead(NamedTuple):
    """The fixed part of a chunk record; `data_at` and `data_size` are the place of its records.

    start_ns, end_ns: of its messages; the C++ writer lets a chunk that holds none start at the
    largest time and end at 0.
    """

    start_ns: int
    end_ns: int
    size: int
    crc: int
    compression: str
    data_at: int
    data_size: int


class _Chunk(NamedTuple):
    """A chunk read ahead.

    counts, offsets: what the index records behind it say, per channel and of all of them.
    """

    head: _ChunkHead
    needed: bool
    counts: dict[int, int]
    offsets: list[Ints]


_NO_HEAD = _ChunkHead(0, 0, 0, 0, "", 0, 0)


def _no_head() -> bytes:
    raise DamageError("a chunk header contradicts itself")


def _inflated(head: _ChunkHead, read: Callable[[int, int], Bytes | bytes]) -> bytes:
    """The records of a compressed chunk; raises DamageError. For any thread if `read` is."""
    data = inflate(head.compression, read(head.data_at, head.data_size), head.size)
    _check(head, data)
    return data


def _plain(head: _ChunkHead, window: FileWindow) -> Bytes:
    """The records of a chunk that is not compressed, in the window; raises DamageError."""
    if head.size != head.data_size:
        raise DamageError("a chunk does not have its declared size")
    data = window.view(head.data_at, head.data_size)
    _check(head, data)
    return data


def _check(head: _ChunkHead, data: Bytes | bytes) -> None:
    if head.crc and crc32(data) != head.crc:
        raise DamageError("checksum (CRC) is wrong")


class McapFile:
    """One MCAP file, chunked or not, with or without summary, of any profile."""

    format = "mcap"

    def __init__(self, path: Path) -> None:
        self.path = path

    @cached_property
    def summary(self) -> McapSummary | None:
        """The summary section if it is there, whole and its checksum is right."""
        with FileWindow(self.path) as window:
            return read_summary(window)

    def survey(self, exact: bool = False) -> Survey | None:
        """Counts from the statistics record of a sound summary."""
        return self.summary.survey() if self.summary is not None else None

    def blocks(
        self, want: Want, findings: Findings, progress: Progress | None = None
    ) -> Iterator[Block]:
        """Walk the file once. O(bytes); memory: one chunk, compressed and inflated."""
        with FileWindow(self.path, progress) as window:
            yield from _Walk(window, want, findings, self.summary).run()
            window.passed(window.size)


class _Walk:
    """One pass over a file."""

    def __init__(
        self, window: FileWindow, want: Want, findings: Findings, summary: McapSummary | None
    ) -> None:
        self._window = window
        self._findings = findings
        self._summary = summary
        self._schemas = dict(summary.schemas) if summary is not None else {}
        self._tally = Tally(want, findings, summary.channels if summary is not None else {})
        self._ahead: Ahead[_Chunk] = Ahead()
        # What is not described there may be described in a chunk of nothing but images.
        self._index_serves = summary is not None and summary.checked and summary.describes_all
        self._outside_chunks = False

    def run(self) -> Iterator[Block]:
        """All blocks from the first record to the footer, the end, or the last readable place."""
        if self._window.view(0, len(MAGIC)).tobytes() != MAGIC:
            self._findings.note("the file does not begin with the MCAP magic")
        keep_freed_memory()
        with self._ahead:
            complete = yield from self._records()
        self._findings.truncated |= not complete
        self._tally.finish(self._summary.counts if self._summary is not None else {})

    def _records(self) -> Walking:
        """Go through the records outside chunks; returns 1 if the footer was reached."""
        window, position = self._window, len(MAGIC)
        complete = 0
        while position + RECORD_HEAD <= window.size:
            op, length = _HEAD(window.view(position, RECORD_HEAD).data)
            end = position + RECORD_HEAD + length
            if op == FOOTER and length == 20 and end + len(MAGIC) == window.size:
                complete = 1
                if self._summary is None and Cursor(window.view(position + RECORD_HEAD, 8)).u64():
                    self._findings.note("the summary is damaged")
                break
            if op == CHUNK and end <= window.size and _plausible(op, length):
                self._read_ahead(position, length)
                yield from self._caught_up()
            elif op == MESSAGE_INDEX and end <= window.size:
                self._indexed(position, length)
            else:
                yield from self._caught_up(everything=True)
                if not _plausible(op, length) or end > window.size:
                    position = yield from self._around_damage(position, op, end)
                    continue
                if op in (MESSAGE, SCHEMA, CHANNEL):
                    position = yield from self._slab(position)
                    continue
                if op == DATA_END:
                    self._check_data(position, length)
            position = end
            window.passed(position)
        yield from self._caught_up(everything=True)
        return complete

    # Records outside chunks

    def _slab(self, position: int) -> Walking:
        """Messages outside chunks, up to the next record of another kind; returns its place."""
        _, length = _HEAD(self._window.view(position, RECORD_HEAD).data)
        data = self._window.view(position, max(SLAB_BYTES, RECORD_HEAD + length))
        # The first record is whole and of a right kind: it always gets on.
        stop = max(mcap_records(data, _NOT_MESSAGES)[1], RECORD_HEAD + length)
        yield from self._messages(data[:stop])
        self._outside_chunks = True
        self._window.passed(position + stop)
        return int(position + stop)

    def _check_data(self, position: int, length: int) -> None:
        """Compare the checksum of all data, which is all that messages outside chunks have."""
        crc = Cursor(self._window.view(position + RECORD_HEAD, min(length, 4)))
        expected = crc.u32() if length >= 4 else 0
        if not expected or not self._outside_chunks:
            return
        found = 0
        for at in range(0, position, SLAB_BYTES):
            data = self._window.view(at, min(SLAB_BYTES, position - at))
            found = crc32(data.data, found)
        if found != expected:
            self._findings.note("the checksum (CRC) of the messages outside chunks is wrong")

    def _around_damage(self, position: int, op: int, end: int) -> Walking:
        """Save what a cut chunk holds, or find the next readable record; returns its place."""
        window = self._window
        if op == CHUNK and end > window.size:
            head = self._chunk_head(position, end - position - RECORD_HEAD)
            if head is not None:
                self._findings.truncated = True
                data = window.view(head.data_at, head.data_size)
                part = (
                    data[: head.size]
                    if head.compression == ""
                    else np.frombuffer(inflate_part(head.compression, data, head.size), np.uint8)
                )
                _, whole = mcap_records(part)
                yield from self._messages(part[:whole])
                return window.size
        found = self._next_record(position + 1)
        if found is None or found <= position:
            if _plausible(op, end - position - RECORD_HEAD):
                self._findings.truncated = True
            else:
                self._findings.unreadable_bytes += window.size - position
            return window.size
        self._findings.unreadable_bytes += found - position
        return found

    def _next_record(self, position: int) -> int | None:
        """Place of the next believable record at or after `position`, None if there is none."""
        if self._summary is not None:
            starts = self._summary.chunk_starts
            at = int(np.searchsorted(starts, position))
            if at < len(starts):
                return int(starts[at])
            if len(starts) and position <= self._summary.start:
                return self._summary.start
        window = self._window
        while position < window.size:
            data = window.view(position, SLAB_BYTES + 64)
            for candidate in _candidates(data):
                if self._believable(position + int(candidate)):
                    return position + int(candidate)
                data = window.view(position, SLAB_BYTES + 64)
            position += SLAB_BYTES
            window.passed(position)
        return None

    def _believable(self, position: int) -> bool:
        """Whether a record at `position` is followed by a record, and fits what is known."""
        window = self._window
        op, length = _HEAD(window.view(position, RECORD_HEAD).data)
        end = position + RECORD_HEAD + length
        if op == CHUNK:
            return self._chunk_head(position, length) is not None
        if op == MESSAGE:
            number = int.from_bytes(window.view(position + RECORD_HEAD, 2).tobytes(), "little")
            if self._tally.sink(number) == UNKNOWN or end > window.size:
                return False
        follower = window.view(end, RECORD_HEAD)
        if len(follower) < RECORD_HEAD:
            return bool(end == window.size)
        op, length = _HEAD(follower.data)
        return _plausible(op, length) and bool(end + length <= window.size)

    # Chunks

    def _chunk_head(self, position: int, length: int) -> _ChunkHead | None:
        """The head of the chunk record at `position`, None if it contradicts itself."""
        at = position + RECORD_HEAD
        cursor = Cursor(self._window.view(at, min(length, 256)))
        try:
            start, end, size, crc = cursor.u64(), cursor.u64(), cursor.u64(), cursor.u32()
            compression = cursor.string()
            data_size = cursor.u64()
        except DamageError:
            return None
        if cursor.position + data_size != length:
            return None
        return _ChunkHead(start, end, size, crc, compression, at + cursor.position, data_size)

    def _read_ahead(self, position: int, length: int) -> None:
        """Have a chunk that is slow to inflate begun on another thread; others wait their turn."""
        head = self._chunk_head(position, length)
        if head is None:
            self._ahead.put(_Chunk(_NO_HEAD, True, {}, []), _no_head)
        elif not self._needed(position):
            self._ahead.put(_Chunk(head, False, {}, []), None)
        elif head.compression == "":
            read = functools.partial(_plain, head, self._window)
            self._ahead.put(_Chunk(head, True, {}, []), read)
        elif head.compression in SLOW:
            task = functools.partial(_inflated, head, self._window.copy)
            self._ahead.begin(_Chunk(head, True, {}, []), task, head.data_size + head.size)
        else:
            inline = functools.partial(_inflated, head, self._window.view)
            self._ahead.put(_Chunk(head, True, {}, []), inline)

    def _needed(self, position: int) -> bool:
        """Whether a chunk may hold wanted messages; only a checked index is trusted to deny it."""
        if self._summary is None or not self._index_serves:
            return True
        numbers = self._summary.chunk_channels.get(position)
        return not numbers or any(self._tally.sink(n) != UNWANTED for n in numbers)

    def _indexed(self, position: int, length: int) -> None:
        """Remember how many messages the index record behind a chunk lists, and where."""
        chunk = self._ahead.last
        if length < INDEX_HEAD or chunk is None:
            return
        # Each entry takes 16 bytes and stands for a message record of a good 31.
        listing = chunk.needed and length <= chunk.head.size
        body = self._window.view(position + RECORD_HEAD, length if listing else INDEX_HEAD)
        number, size = _INDEX(body.data)
        if size + INDEX_HEAD == length:
            chunk.counts[number] = size // 16
            if listing and len(chunk.counts) > len(chunk.offsets):
                entries = body[INDEX_HEAD : INDEX_HEAD + size // 16 * 16].view("<u8")
                chunk.offsets.append(entries[1::2].astype(np.int64))

    def _caught_up(self, everything: bool = False) -> Iterator[Block]:
        """Messages of the chunks read ahead; of the last one only when its index has been met."""
        for chunk, task in self._ahead.due(everything):
            if task is None:
                for number, count in chunk.counts.items():
                    self._tally.passed(number, count)
                if chunk.head.start_ns <= chunk.head.end_ns:
                    self._findings.span(chunk.head.start_ns, chunk.head.end_ns)
                continue
            try:
                data = np.frombuffer(task(), np.uint8)
            except DamageError as damage:
                self._damaged(str(damage), chunk.counts)
                continue
            yield from self._messages(data, chunk.offsets)

    def _damaged(self, reason: str, counts: dict[int, int]) -> None:
        """Count a chunk that cannot be used, and its messages if its index tells their number."""
        self._findings.damaged_chunks[reason] += 1
        for number, count in counts.items():
            self._tally.lost(number, count)

    # Messages

    def _messages(self, data: Bytes, offsets: Sequence[Ints] = ()) -> Iterator[Block]:
        """The wanted messages in a run of records; offsets: where an index says they are."""
        positions, size = self._positions(data, offsets)
        if len(positions) == 0:
            return
        number = words(data, "<u2", positions + RECORD_HEAD)
        log_time = words(data, "<i8", positions + LOG_TIME_AT)
        start = positions + (RECORD_HEAD + MESSAGE_HEAD)
        for sink, rows in self._tally.met(number, log_time):
            yield Block(data, sink, log_time[rows], start[rows], size[rows])

    def _positions(self, data: Bytes, offsets: Sequence[Ints]) -> tuple[Ints, Ints]:
        """Places and payload sizes of the message records in `data`.

        Schemas and channels met are taken in. Records that call themselves messages but are
        shorter than a message's head are left out.
        """
        where = mcap_listed(data, np.concatenate(offsets)) if offsets else None
        if where is None:
            where, stop = mcap_records(data)
            self._findings.unreadable_bytes += len(data) - stop
        is_message = data[where] == MESSAGE
        if not is_message.all():
            for place in where[~is_message].tolist():
                self._definition(data, place)
            where = where[is_message]
        size = words(data, "<i8", where + 1) - MESSAGE_HEAD
        if len(size) and size.min() < 0:
            self._findings.unreadable_bytes += RECORD_HEAD * int((size < 0).sum())
            where, size = where[size >= 0], size[size >= 0]
        return where, size

    def _definition(self, data: Bytes, place: int) -> None:
        """Take in a schema or channel record."""
        op, length = _HEAD(data.data, place)
        body = data[place + RECORD_HEAD : place + RECORD_HEAD + length]
        try:
            if op == SCHEMA:
                number, schema = schema_of(Cursor(body))
                self._schemas[number] = schema
            elif op == CHANNEL:
                number, channel = channel_of(Cursor(body), self._schemas)
                self._tally.describe(number, channel)
            elif op == 0 or op < 0x80:
                raise DamageError("unexpected record")
        except DamageError:
            self._findings.unreadable_bytes += RECORD_HEAD + length


def _plausible(op: int, length: int) -> bool:
    """Whether a record head can be one: an opcode of the format or a private one, a sane length."""
    if op == MESSAGE:
        return MESSAGE_HEAD <= length < LARGEST_RECORD
    return (0 < op <= DATA_END or op >= 0x80) and length < (
        1 << 48 if op == ATTACHMENT else 1 << 40
    )


def _candidates(data: Bytes) -> Ints:
    """Places in `data` at which a record could begin, by opcode and a length below 2^32."""
    if len(data) < RECORD_HEAD:
        return np.zeros(0, np.int64)
    n = len(data) - RECORD_HEAD + 1
    op = data[:n]
    starts = (op == CHUNK) | (op == MESSAGE) | (op == SCHEMA) | (op == CHANNEL) | (op == DATA_END)
    for offset in (5, 6, 7, 8):
        starts &= data[offset : offset + n] == 0
    found: Any = np.flatnonzero(starts)
    lengths = np.ndarray((n,), "<u8", data.data, offset=1, strides=(1,))[found]
    return np.asarray(found[lengths >= 2], np.int64)
