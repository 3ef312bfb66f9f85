"""The chunks of an MCAP file: read ahead, inflated, checked, and saved where they are damaged."""

from __future__ import annotations

import functools
import struct
from collections import Counter
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

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
    pieces,
)
from .mcap_heads import IN_CHUNKS, ChunkHead
from .mcap_mend import mended
from .mcap_messages import NOT_IN_CHUNKS, MessageReader
from .mcap_small import RUN, SMALL_BYTES, joined, small_chunks
from .mcap_summary import McapSummary
from .mcap_wire import MESSAGE, MESSAGE_HEAD, MESSAGE_INDEX, RECORD_HEAD
from .messages import UNWANTED, Block, Bytes, DamageError, Ints, Walking
from .split import Large, whole_records
from .walk import mcap_records
from .windows import RemoteWindow, Window

_HEAD = struct.Struct("<BQ").unpack_from
_NO_RECORD = frozenset({0})

INDEX_HEAD = 6
_INDEX = struct.Struct("<HI").unpack_from
_INDEX_RECORD = struct.Struct("<BQHI").unpack_from
"""Channel and bytes of a message index record; the same with the head in front of them."""

SLAB_BYTES = 1 << 20
"""How much of a run of small chunks is taken at a time."""

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


def _plain(head: ChunkHead, window: Window, crc: int) -> Bytes:
    """The records of a chunk that is not compressed, in the window; raises DamageError."""
    if head.crc and not agrees(crc, head.crc):
        raise _WrongChecksumError
    return window.view(head.data_at, head.data_size)


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


class ChunkReader:
    """The chunks of one file in their order; leaving the context ends the threads that inflate.

    met: whether there was a chunk.
    """

    def __init__(
        self, window: Window, messages: MessageReader, summary: McapSummary | None
    ) -> None:
        self.met = False
        self._window = window
        self._messages = messages
        self._tally = messages.tally
        self._findings = messages.findings
        self._summary = summary
        self._ahead: Ahead[_Chunk] = Ahead()
        self._allowance = Allowance()
        self._small_run = 0
        # What lies between them is not there.
        self._chosen = isinstance(window, RemoteWindow)
        self._patience = PATIENCE
        # What is not described there may be described in a chunk of nothing but images.
        self._index_serves = summary is not None and summary.checked and summary.describes_all

    def __enter__(self) -> ChunkReader:
        self._ahead.__enter__()
        return self

    def __exit__(self, *error: object) -> None:
        self._ahead.__exit__(*error)

    def take(self, position: int, head: ChunkHead, end: int) -> Walking:
        """Queue a chunk, or take many small ones at once; returns where to go on."""
        if head.compression == "" and head.size != head.data_size:
            # How large the data are is told by the record as well.
            head = head._replace(size=head.data_size)
            self._findings.repaired += 1
        self._messages.packed |= head.compression != ""
        self.met = True
        small = max(head.size, head.data_size) <= SMALL_BYTES and not self._chosen
        self._small_run = self._small_run + 1 if small else 0
        if self._small_run > RUN:
            yield from self.caught_up(everything=True)
            stop = yield from self._small_chunks(position)
            if stop > position:
                return stop
        at_once = self._queue(_Chunk(position, head, self._needed(position), {}, []))
        end = self._listed_behind(end)
        yield from self.caught_up(everything=at_once)
        return end

    def _queue(self, chunk: _Chunk) -> bool:
        """Have a chunk that is slow to inflate begun on another thread; others are read here.

        Returns whether it is best used at once, while its bytes and those behind it are at hand.
        """
        head, window = chunk.head, self._window
        if not chunk.needed or max(head.size, head.data_size) > WHOLE_BYTES:
            self._ahead.put(chunk, None)
        elif head.compression == "":
            crc = window.checked(head.data_at, head.data_size)[1] if head.crc else 0
            self._ahead.put(chunk, functools.partial(_plain, head, window, crc))
            return not self._chosen
        else:
            try:
                self._allowance.take(head.compression, head.data_size, head.size)
            except DamageError as damage:
                self._ahead.put(chunk, _damaged_task(str(damage)))
                return False
            if head.compression in SLOW:
                task = functools.partial(_inflated, head, window.copy)
                self._ahead.begin(chunk, task, head.data_size + head.size)
            else:
                window.view(head.data_at, head.data_size)
                self._ahead.put(chunk, functools.partial(_inflated, head, window.view))
                return not self._chosen
        return False

    def _listed_behind(self, position: int) -> int:
        """Take in the index records behind a chunk, as far as they are sound; where they end."""
        window = self._window
        while not self._chosen:
            head = window.view(position, RECORD_HEAD + INDEX_HEAD)
            if len(head) < RECORD_HEAD + INDEX_HEAD:
                break
            op, length, _, entries = _INDEX_RECORD(head.data)
            end = position + RECORD_HEAD + length
            if op != MESSAGE_INDEX or length != INDEX_HEAD + entries or end > window.size:
                break
            if end - position <= WHOLE_BYTES:
                self.listed(window, position, end - position)
            position = end
        return position

    def _small_chunks(self, position: int) -> Walking:
        """The messages of small chunks one behind the other; returns where they end."""
        batch = small_chunks(self._window.view(position, SLAB_BYTES), self._patience > 0)
        data = joined(batch.data)
        if mcap_records(data, NOT_IN_CHUNKS)[1] == len(data):
            yield from self._messages.blocks(data)
        else:
            for records in batch.data:
                yield from self._messages.blocks(np.frombuffer(records, np.uint8))
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
            if self._tally.known(number):
                self._tally.lost(number, int(counts[number]))

    def _needed(self, position: int) -> bool:
        """Whether a chunk may hold wanted messages; only a checked index is trusted to deny it."""
        if self._summary is None or not self._index_serves:
            return True
        numbers = self._summary.numbers(position)
        if numbers is None or len(numbers) == 0:
            return True
        return any(self._tally.sink(n) != UNWANTED for n in numbers.tolist())

    def told(self, position: int, counts: dict[int, int]) -> None:
        """Remember how many messages a chunk holds, where the index behind it is not read."""
        chunk = self._ahead.last
        if chunk is not None and chunk.position == position:
            chunk.counts.update(counts)

    def listed(self, source: Window | Bytes, position: int, size: int) -> None:
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

    def caught_up(self, everything: bool = False) -> Iterator[Block]:
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
            yield from self._messages.blocks(data, chunk.offsets)

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
        found = mended(data, self._messages.heads.within(data), self._messages.define_more)
        where = found.where[found.data[found.where] == MESSAGE]
        first = self._tally.first(words(found.data, "<u2", where + RECORD_HEAD))
        size = words(found.data, "<i8", where + 1) - MESSAGE_HEAD
        where = where[self._messages.without_descriptions(found.data, where, size, first)]
        numbers = words(found.data, "<u2", where + RECORD_HEAD).tolist() + found.lost
        counts = Counter(numbers).items()
        return {n: c for n, c in counts if not head.compression or self._tally.known(n)}

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
                self._messages.too_large(part.head)
            else:
                yield from self._messages.blocks(part)

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

    def cut(self, head: ChunkHead) -> Iterator[Block]:
        """What is left of the last chunk of a file that was cut."""
        data = self._window.view(head.data_at, min(head.data_size, WHOLE_BYTES))
        if head.compression:
            part = inflate_part(head.compression, data, min(head.size, WHOLE_BYTES))
            data = np.frombuffer(part, np.uint8)
        _, whole = mcap_records(data, _NO_RECORD)
        yield from self._messages.blocks(data[:whole])


_NO_HEAD = ChunkHead(0, 0, 0, 0, "", 0, 0)


def _in_chunks(data: Bytes) -> tuple[Ints, int]:
    return mcap_records(data, NOT_IN_CHUNKS)


def _record_length(data: Bytes) -> int:
    """Bytes of the record at the front, 0 if it is none of a chunk's."""
    if len(data) < RECORD_HEAD + MESSAGE_HEAD:
        return 0
    op, length = _HEAD(data.data)
    return RECORD_HEAD + int(length) if op in IN_CHUNKS else 0
