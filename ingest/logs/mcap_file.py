"""MCAP files: a walk over their records that needs no index, survives damage and checks CRCs."""

from __future__ import annotations

import functools
import struct
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .ahead import Ahead
from .checksum import agrees, crc32
from .columns import words
from .inflate import (
    SLOW,
    WHOLE_BYTES,
    Allowance,
    WrongSizeError,
    inflate,
    inflate_anyhow,
    inflate_part,
    keep_freed_memory,
    pieces,
)
from .mcap_heads import HEAD_BYTES, IN_CHUNKS, OUTSIDE, ChunkHead, Heads, chunk_head
from .mcap_mend import mended, trusted
from .mcap_small import RUN, SMALL_BYTES, joined, small_chunks
from .mcap_summary import McapSummary, read_summary
from .mcap_wire import (
    CHANNEL,
    CHUNK,
    DATA_END,
    FOOTER,
    HEADER,
    MAGIC,
    MESSAGE,
    MESSAGE_HEAD,
    MESSAGE_INDEX,
    RECORD_HEAD,
    SCHEMA,
    Cursor,
    Definitions,
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
from .split import RECORD_BYTES, Large, whole_records
from .tally import UNKNOWN, Tally
from .walk import mcap_listed, mcap_records

_HEAD = struct.Struct("<BQ").unpack_from

NOT_IN_CHUNKS = frozenset(range(256)) - IN_CHUNKS
_NO_RECORD = frozenset({0})

LOG_TIME_AT = 15
"""Place of the log time in a message record; the channel's number stands behind the head."""

INDEX_HEAD = 6
_INDEX = struct.Struct("<HI").unpack_from
"""Channel and bytes of a message index record."""

SLAB_BYTES = 1 << 20
"""How much of an unchunked file is walked at a time."""


LARGEST_MESSAGE = 1 << 32
"""A message that claims more is taken for damage."""

PRIVATE = 0x80
"""Kinds of records from here on are anybody's."""

TRIED_STARTS = 64
"""So many chunks of an index are looked for before the index is given up."""

PATIENCE = 1000
"""So many damaged chunks are looked at closely; a file with more is an attack."""


class _Chunk(NamedTuple):
    """A chunk read ahead.

    position: of its record; counts, offsets: what the index records behind it say, per channel and
    of all of them.
    """

    position: int
    head: ChunkHead
    needed: bool
    counts: dict[int, int]
    offsets: list[Ints]


def _inflated(head: ChunkHead, read: Callable[[int, int], Bytes | bytes]) -> bytes:
    """The records of a compressed chunk; raises DamageError. For any thread if `read` is."""
    data = inflate(head.compression, read(head.data_at, head.data_size), head.size)
    _check(head, data)
    return data


def _plain(head: ChunkHead, window: FileWindow) -> Bytes:
    """The records of a chunk that is not compressed, in the window; raises DamageError."""
    data = window.view(head.data_at, head.data_size)
    _check(head, data)
    return data


def _check(head: ChunkHead, data: Bytes | bytes) -> None:
    if head.crc and not agrees(crc32(data), head.crc):
        raise _WrongChecksumError


def _check_records(head: ChunkHead, data: Bytes) -> None:
    """Without a checksum, records that fill the data tell that a declared size is wrong."""
    if not head.crc and (len(data) == 0 or mcap_records(data, _NO_RECORD)[1] != len(data)):
        raise WrongSizeError


class _WrongChecksumError(DamageError):
    def __init__(self) -> None:
        super().__init__("checksum (CRC) is wrong")


def _damaged_task(reason: str) -> Callable[[], bytes]:
    def task() -> bytes:
        raise DamageError(reason)

    return task


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
        self._definitions = summary.definitions if summary is not None else Definitions()
        self._tally = Tally(want, findings, summary.channels if summary is not None else {})
        self._heads = Heads(window.copy, window.size, self._known)
        self._ahead: Ahead[_Chunk] = Ahead()
        self._allowance = Allowance()
        self._small_run = 0
        self._packed = False
        self._chunked = False
        self._ended = False
        self._patience = PATIENCE
        # What is not described there may be described in a chunk of nothing but images.
        self._index_serves = summary is not None and summary.checked and summary.describes_all

    def _known(self, number: int) -> bool:
        return self._tally.sink(number) != UNKNOWN

    def run(self) -> Iterator[Block]:
        """All blocks from the first record to the footer, the end, or the last readable place."""
        if self._window.view(0, len(MAGIC)).tobytes() != MAGIC:
            self._findings.note("the file does not begin with the MCAP magic")
        keep_freed_memory()
        with self._ahead:
            complete = yield from self._records()
            yield from self._caught_up(everything=True)
        self._findings.truncated |= not complete
        self._tally.finish(self._summary.counts if self._summary is not None else {})

    def _records(self) -> Walking:
        """Go through the records outside chunks; returns 1 if the footer was reached."""
        window, position = self._window, len(MAGIC)
        while position + RECORD_HEAD <= window.size:
            head = window.view(position, HEAD_BYTES).tobytes()
            end = self._heads.end(position, head)
            if end is None and self._adopted(position, head):
                end = self._heads.end(position, head)
            if end is None or end > window.size:
                position = yield from self._around_damage(position, end)
                continue
            if head[0] == MESSAGE:
                head = self._told_apart(position, head)
            if head[0] == FOOTER and end + len(MAGIC) == window.size:
                if self._summary is None and Cursor(window.view(position + RECORD_HEAD, 8)).u64():
                    self._findings.note("the summary is damaged")
                return 1
            position = yield from self._record(position, head, end)
            window.passed(position)
        return 0

    def _adopted(self, position: int, head: bytes) -> bool:
        """Whether a message's channel is known after all, with a wrong bit in its number."""
        if head[0] != MESSAGE or len(head) < RECORD_HEAD + 2:
            return False
        behind = self._window.copy(position + RECORD_HEAD + _HEAD(head)[1], RECORD_HEAD + 2)
        number = head[RECORD_HEAD : RECORD_HEAD + 2]
        alike = behind[:1] == head[:1] and behind[RECORD_HEAD:] == number
        whole = alike or self._heads.begins(position + RECORD_HEAD + _HEAD(head)[1])
        return whole and self._tally.adopt(np.frombuffer(number * (1 + alike), "<u2"))

    def _told_apart(self, position: int, head: bytes) -> bytes:
        """The head of what looks like a message, and may be another record but for one bit.

        Any bytes are a message. But where there are chunks there are indexes, and in front is the
        header.
        """
        ops = (MESSAGE_INDEX,) if self._chunked else ()
        if position == len(MAGIC):
            ops = (HEADER,)
        for op in ops:
            other = bytes([op]) + head[1:]
            if self._heads.end(position, other) is not None:
                self._findings.repaired += 1
                return other
        return head

    def _record(self, position: int, head: bytes, end: int) -> Walking:
        """Take in a sound record outside chunks, or several; returns where to go on."""
        op = head[0]
        if op == CHUNK:
            return (yield from self._chunk(position, chunk_head(head, position), end))
        if op == MESSAGE_INDEX:
            if end - position <= WHOLE_BYTES:
                self._indexed(self._window, position, end - position)
        elif op in IN_CHUNKS:
            yield from self._caught_up(everything=True)
            return (yield from self._slab(position, end))
        elif op == DATA_END:
            yield from self._caught_up(everything=True)
            self._check_data(position)
            self._ended = True
        return end

    # Records outside chunks

    def _slab(self, position: int, end: int) -> Walking:
        """Messages outside chunks, up to the next record of another kind; returns its place."""
        if end - position > RECORD_BYTES:
            self._too_large(self._window.view(position, HEAD_BYTES))
            return end
        data = self._window.view(position, max(SLAB_BYTES, end - position))
        where, stop = mcap_records(data, NOT_IN_CHUNKS)
        self._define(data, where)
        if not self._heads.begins(position + stop):
            where, stop = trusted(self._heads, data, where, stop, position)
            if stop == 0:
                return (yield from self._around_damage(position, None))
        yield from self._messages(data[:stop])
        self._window.passed(position + stop)
        return int(position + stop)

    def _check_data(self, position: int) -> None:
        """Compare the checksum of all data, where one is given."""
        expected = Cursor(self._window.view(position + RECORD_HEAD, 4)).u32()
        if not expected:
            return
        found = 0
        for at in range(0, position, SLAB_BYTES):
            data = self._window.view(at, min(SLAB_BYTES, position - at))
            found = crc32(data.data, found)
        if not agrees(found, expected):
            self._findings.note("the checksum (CRC) of the data section is wrong")

    def _too_large(self, head: Bytes) -> None:
        """Count a record that is too large to be looked at, by its first bytes."""
        if head[0] == MESSAGE:
            number = int(head[RECORD_HEAD]) | int(head[RECORD_HEAD + 1]) << 8
            if self._tally.sink(number) == UNWANTED:
                self._tally.passed(number, 1)
                return
            self._tally.lost(number, 1)
        self._findings.too_large += 1

    # Damage

    def _around_damage(self, position: int, end: int | None) -> Walking:
        """Go on at a place where no sound record is: repair its head, or find the next one.

        end: where the record ends, if only the file's end is in front of it. Returns a place.
        """
        yield from self._caught_up(everything=True)
        window = self._window
        head = self._heads.repaired(position)
        if head is not None:
            self._findings.repaired += 1
            return (yield from self._repaired(position, head))
        op, length = _HEAD(window.view(position, RECORD_HEAD).data)
        behind = position + RECORD_HEAD + length
        if op not in OUTSIDE and behind < window.size and self._heads.begins(behind):
            # A kind of record that is private, or newer than this reader.
            if op < PRIVATE:
                self._findings.unreadable_bytes += RECORD_HEAD + length
            return int(behind)
        found = self._next_record(position + 1)
        whole = self._heads.end(position) if end is None and op in IN_CHUNKS else None
        if whole is not None and whole <= (window.size if found is None else found):
            # Whole after all: what is behind it is broken in more than one bit.
            yield from self._messages(window.view(position, whole - position))
            position = whole
            if position == found:
                return position
            op = 0
        if found is not None:
            self._findings.unreadable_bytes += found - position
            number = int.from_bytes(window.copy(position + RECORD_HEAD, 2), "little")
            if op == MESSAGE and self._known(number):
                self._tally.lost(number, 1)
            return found
        if end is None and not _plausible(op, length):
            self._findings.unreadable_bytes += window.size - position
            return window.size
        self._findings.truncated = True
        if end is not None and op == CHUNK:
            yield from self._cut_chunk(chunk_head(window.copy(position, HEAD_BYTES), position))
        return window.size

    def _repaired(self, position: int, head: bytes) -> Walking:
        """Take in the one record whose head was set right; returns where it ends."""
        end = self._heads.end(position, head)
        assert end is not None
        if head[0] not in IN_CHUNKS and head[0] != MESSAGE_INDEX:
            return (yield from self._record(position, head, end))
        if end - position > RECORD_BYTES:
            self._too_large(np.frombuffer(head, np.uint8))
            return end
        record = self._window.view(position, end - position).copy()
        record[: len(head)] = np.frombuffer(head, np.uint8)[: len(record)]
        if head[0] == MESSAGE_INDEX:
            self._indexed(record, 0, len(record))
        else:
            yield from self._messages(record)
        return end

    def _cut_chunk(self, head: ChunkHead) -> Iterator[Block]:
        """What is left of the last chunk of a file that was cut."""
        data = self._window.view(head.data_at, min(head.data_size, WHOLE_BYTES))
        if head.compression:
            part = inflate_part(head.compression, data, min(head.size, WHOLE_BYTES))
            data = np.frombuffer(part, np.uint8)
        _, whole = mcap_records(data, _NO_RECORD)
        yield from self._messages(data[:whole])

    def _next_record(self, position: int) -> int | None:
        """Place of the next believable record at or after `position`, None if there is none."""
        if self._summary is not None:
            starts = self._summary.chunk_starts
            for start in starts[np.searchsorted(starts, position) :][:TRIED_STARTS].tolist():
                if self._heads.sound(start) is not None:
                    return int(start)
            if len(starts) and starts[-1] < position <= self._summary.start:
                return self._summary.start
        return self._heads.following(position, self._packed)

    # Chunks

    def _chunk(self, position: int, head: ChunkHead, end: int) -> Walking:
        """Queue a chunk, or take many small ones at once; returns where to go on."""
        if head.compression == "" and head.size != head.data_size:
            # How large the data are is told by the record as well.
            head = head._replace(size=head.data_size)
            self._findings.repaired += 1
        self._packed |= head.compression != ""
        self._chunked = True
        small = max(head.size, head.data_size) <= SMALL_BYTES
        self._small_run = self._small_run + 1 if small else 0
        if self._small_run > RUN:
            yield from self._caught_up(everything=True)
            stop = yield from self._small_chunks(position)
            if stop > position:
                return stop
        self._queue(_Chunk(position, head, self._needed(position), {}, []))
        yield from self._caught_up()
        return end

    def _queue(self, chunk: _Chunk) -> None:
        """Have a chunk that is slow to inflate begun on another thread; others wait their turn."""
        head = chunk.head
        if not chunk.needed or max(head.size, head.data_size) > WHOLE_BYTES:
            self._ahead.put(chunk, None)
        elif head.compression == "":
            self._ahead.put(chunk, functools.partial(_plain, head, self._window))
        else:
            try:
                self._allowance.take(head.compression, head.data_size, head.size)
            except DamageError as damage:
                self._ahead.put(chunk, _damaged_task(str(damage)))
                return
            if head.compression in SLOW:
                task = functools.partial(_inflated, head, self._window.copy)
                self._ahead.begin(chunk, task, head.data_size + head.size)
            else:
                self._ahead.put(chunk, functools.partial(_inflated, head, self._window.view))

    def _small_chunks(self, position: int) -> Walking:
        """The messages of small chunks one behind the other; returns where they end."""
        batch = small_chunks(self._window.view(position, SLAB_BYTES), self._patience > 0)
        data = joined(batch.data)
        if mcap_records(data, NOT_IN_CHUNKS)[1] == len(data):
            yield from self._messages(data)
        else:
            for records in batch.data:
                yield from self._messages(np.frombuffer(records, np.uint8))
        for failed in batch.failed[: len(batch.failed) - batch.open]:
            self._damaged(failed.reason, failed.counts)
        self._count_lost(joined(batch.unlisted))
        if batch.open:
            # The index behind it may go on.
            last = batch.failed[-1]
            chunk = _Chunk(position, _NO_HEAD, True, last.counts, [])
            self._ahead.put(chunk, _damaged_task(last.reason))
        self._window.passed(position + batch.stop)
        return position + batch.stop

    def _count_lost(self, data: Bytes) -> None:
        """Count the messages of damaged chunks without an index, as far as they can be seen."""
        where, _ = mcap_records(data, NOT_IN_CHUNKS)
        self._findings.lost_at_least |= len(where) > 0
        where = where[data[where] == MESSAGE]
        counts = np.bincount(words(data, "<u2", where + RECORD_HEAD))
        for number in counts.nonzero()[0].tolist():
            if self._known(number):
                self._tally.lost(number, int(counts[number]))

    def _needed(self, position: int) -> bool:
        """Whether a chunk may hold wanted messages; only a checked index is trusted to deny it."""
        if self._summary is None or not self._index_serves:
            return True
        numbers = self._summary.numbers(position)
        if numbers is None or len(numbers) == 0:
            return True
        return any(self._tally.sink(n) != UNWANTED for n in numbers.tolist())

    def _indexed(self, source: FileWindow | Bytes, position: int, size: int) -> None:
        """Remember how many messages the index record behind a chunk lists, and where."""
        chunk = self._ahead.last
        if chunk is None:
            return
        # Each entry takes 16 bytes and stands for a message record of a good 31.
        listing = chunk.needed and size - RECORD_HEAD <= chunk.head.size
        begin = position + RECORD_HEAD
        length = size - RECORD_HEAD if listing else INDEX_HEAD
        body = (
            source[begin : begin + length]
            if isinstance(source, np.ndarray)
            else source.view(begin, length)
        )
        number, entries = _INDEX(body.data)
        chunk.counts[number] = entries // 16
        if listing and len(chunk.counts) > len(chunk.offsets):
            places = body[INDEX_HEAD : INDEX_HEAD + entries // 16 * 16].view("<u8")
            chunk.offsets.append(places[1::2].astype(np.int64))

    def _caught_up(self, everything: bool = False) -> Iterator[Block]:
        """Messages of the chunks read ahead; of the last one only when its index has been met."""
        for chunk, task in self._ahead.due(everything):
            if not chunk.needed and self._passed_over(chunk):
                continue
            try:
                if task is None:
                    yield from self._large(chunk)
                    continue
                data = np.frombuffer(task(), np.uint8)
            except DamageError as damage:
                rescued = self._rescued(chunk, damage)
                if rescued is None:
                    continue
                data = rescued
            yield from self._messages(data, chunk.offsets)

    def _passed_over(self, chunk: _Chunk) -> bool:
        """Count the messages of a chunk of no need, if its index lists what the summary does."""
        assert self._summary is not None
        numbers = self._summary.numbers(chunk.position)
        if numbers is None or set(numbers.tolist()) != chunk.counts.keys():
            return False
        for number, count in chunk.counts.items():
            self._tally.passed(number, count)
        if chunk.head.start_ns <= chunk.head.end_ns:
            self._findings.span(chunk.head.start_ns, chunk.head.end_ns)
        return True

    def _rescued(self, chunk: _Chunk, damage: DamageError) -> Bytes | None:
        """The records of a chunk of which only the declared size is wrong; else None, counted."""
        self._patience -= 1
        head = chunk.head
        if isinstance(damage, WrongSizeError) and head.compression and self._patience >= 0:
            try:
                packed = self._window.view(head.data_at, head.data_size)
                raw = inflate_anyhow(head.compression, packed, self._allowance)
                data = np.frombuffer(raw, np.uint8)
                _check(head, data)
                _check_records(head, data)
            except DamageError as further:
                damage = further
            else:
                self._findings.repaired += 1
                return data
        self._damaged(str(damage), chunk.counts or self._census(chunk))
        return None

    def _census(self, chunk: _Chunk) -> dict[int, int]:
        """How many messages a damaged chunk without index held, as far as its records tell.

        Channels that are described nowhere else are taken from it as well.
        """
        head = chunk.head
        if self._patience < 0 or head.data_size > WHOLE_BYTES:
            return {}
        data = self._window.view(head.data_at, head.data_size)
        if head.compression:
            data = np.frombuffer(inflate_part(head.compression, data), np.uint8)
            # What a broken stream gives may end early, or be wrong where heads of records are.
            self._findings.lost_at_least = True
        found = mended(data, self._heads.within(data), self._define_more)
        where = found.where[found.data[found.where] == MESSAGE]
        first = self._tally.first(words(found.data, "<u2", where + RECORD_HEAD))
        size = words(found.data, "<i8", where + 1) - MESSAGE_HEAD
        where = where[self._without_descriptions(found.data, where, size, first)]
        numbers = words(found.data, "<u2", where + RECORD_HEAD).tolist() + found.lost
        counts = Counter(numbers).items()
        return {n: c for n, c in counts if not head.compression or self._known(n)}

    def _large(self, chunk: _Chunk) -> Iterator[Block]:
        """The messages of a chunk too large for the memory; it is checked before any is used."""
        head = chunk.head
        found = crc = 0
        if head.compression or head.crc:
            for piece in self._pieces(head, self._allowance):
                found += len(piece)
                crc = crc32(piece, crc) if head.crc else 0
            if head.crc and not agrees(crc, head.crc):
                raise _WrongChecksumError
        if (found or head.data_size) != head.size:
            if not head.crc:
                raise WrongSizeError
            self._findings.repaired += 1
        for part in whole_records(self._pieces(head, None), _in_chunks, _record_length):
            if isinstance(part, Large):
                self._too_large(part.head)
            else:
                yield from self._messages(part)

    def _pieces(self, head: ChunkHead, allowance: Allowance | None) -> Iterator[bytes]:
        """What a chunk inflates to, piece by piece; counted against the allowance if given."""
        at, end = head.data_at, head.data_at + head.data_size

        def read(size: int) -> bytes:
            nonlocal at
            data = self._window.copy(at, min(size, end - at))
            at += len(data)
            return data

        stream = pieces(head.compression, read)
        if allowance is None:
            return stream
        return allowance.counted(head.compression, head.data_size, stream)

    def _damaged(self, reason: str, counts: dict[int, int]) -> None:
        """Count a chunk that cannot be used, and its messages if its index tells their number."""
        self._findings.damaged_chunks[reason] += 1
        for number, count in counts.items():
            self._tally.lost(number, count)

    # Messages

    def _messages(self, data: Bytes, offsets: Sequence[Ints] = ()) -> Iterator[Block]:
        """The wanted messages in a run of records; offsets: where an index says they are."""
        data, where = self._walked(data, offsets)
        positions, size = self._sizes(data, where)
        if len(positions) == 0:
            return
        number = words(data, "<u2", positions + RECORD_HEAD)
        first = self._tally.first(number, again=self._ended)
        if first:
            kept = self._without_descriptions(data, positions, size, first)
            self._findings.repaired += int((~kept).sum())
            number, positions, size = (a[kept] for a in (number, positions, size))
        self._tally.adopt(number)
        if len(number) == 0:
            return
        log_time = words(data, "<i8", positions + LOG_TIME_AT)
        start = positions + (RECORD_HEAD + MESSAGE_HEAD)
        for sink, rows in self._tally.met(number, log_time):
            yield Block(data, sink, log_time[rows], start[rows], size[rows])

    def _without_descriptions(
        self, data: Bytes, positions: Ints, size: Ints, asked: Sequence[int]
    ) -> NDArray[np.bool_]:
        """Which messages are none that describe their channel but for one bit, which are taken in.

        asked: which may be; descriptions stand in front of the first message, and behind the data.
        """
        heads, kept = self._heads.within(data), np.ones(len(positions), bool)
        for k in asked:
            place = int(positions[k])
            channel = bytes([CHANNEL]) + heads.head(place)[1:]
            if heads.end(place, channel) is not None:
                kept[k] = False
                record = data[place : place + RECORD_HEAD + MESSAGE_HEAD + int(size[k])].copy()
                record[0] = CHANNEL
                self._define(record, np.zeros(1, np.int64))
        return kept

    def _walked(self, data: Bytes, offsets: Sequence[Ints]) -> tuple[Bytes, Ints]:
        """The places of the records in `data`, which is mended first where it is broken.

        Schemas and channels met are taken in.
        """
        where = mcap_listed(data, np.concatenate(offsets)) if offsets else None
        stop = len(data)
        if where is None:
            where, stop = mcap_records(data, NOT_IN_CHUNKS)
        messages = self._define(data, where)
        if stop == len(data):
            if messages:
                self._findings.repaired += len(messages)
                data = data.copy()
                data[messages] = MESSAGE
            return data, where
        found = mended(data, self._heads.within(data), self._define)
        self._findings.unreadable_bytes += found.unreadable
        self._findings.repaired += found.repaired
        if not self._packed:
            # What a broken stream gives may be records that were never written.
            for number in found.lost:
                self._tally.lost(number, 1)
        return found.data, found.where

    def _sizes(self, data: Bytes, where: Ints) -> tuple[Ints, Ints]:
        """Places and payload sizes of the message records among others.

        Records that call themselves messages but are shorter than a message's head are left out.
        """
        is_message = data[where] == MESSAGE
        if not is_message.all():
            where = where[is_message]
        size = words(data, "<i8", where + 1) - MESSAGE_HEAD
        if len(size) and size.min() < 0:
            self._findings.unreadable_bytes += RECORD_HEAD * int((size < 0).sum())
            where, size = where[size >= 0], size[size >= 0]
        return where, size

    def _define_more(self, data: Bytes, where: Ints) -> list[int]:
        """Take in channels that no sound bytes described so far."""
        return self._define(data, where, more=True)

    def _define(self, data: Bytes, where: Ints, more: bool = False) -> list[int]:
        """Take in the schemas and channels among records; more: only new ones.

        Returns the places of those that are messages but for one bit.
        """
        op = data[where]
        messages: list[int] = []
        if (op == MESSAGE).all():
            return messages
        for place in where[(op == SCHEMA) | (op == CHANNEL)].tolist():
            kind, length = _HEAD(data.data, place)
            record = data[place : place + RECORD_HEAD + length].tobytes()
            if self._definitions.met(kind, record[RECORD_HEAD:]):
                continue
            heads = self._heads.within(data)
            head = None if heads.end(place) is not None else heads.repaired(place)
            if head is not None and head[0] == MESSAGE:
                messages.append(place)
                continue
            if head is not None:
                # One of the lengths in it was wrong.
                self._findings.repaired += not more
                record = head[: len(record)] + record[len(head) :]
            try:
                found = self._definitions.take(record[0], record[RECORD_HEAD:])
            except DamageError:
                self._findings.unreadable_bytes += len(record)
                continue
            if found is not None and not (more and self._known(found[0])):
                self._tally.describe(*found)
        return messages


_NO_HEAD = ChunkHead(0, 0, 0, 0, "", 0, 0)


def _in_chunks(data: Bytes) -> tuple[Ints, int]:
    return mcap_records(data, NOT_IN_CHUNKS)


def _record_length(data: Bytes) -> int:
    """Bytes of the record at the front, 0 if it is none of a chunk's."""
    if len(data) < RECORD_HEAD + MESSAGE_HEAD:
        return 0
    op, length = _HEAD(data.data)
    return RECORD_HEAD + int(length) if op in IN_CHUNKS else 0


def _plausible(op: int, length: int) -> bool:
    """Whether a record head can be one: an opcode of the format or a private one, a sane length."""
    if op == MESSAGE:
        return MESSAGE_HEAD <= length < LARGEST_MESSAGE
    return (op in OUTSIDE or op >= PRIVATE) and length < 1 << 40
