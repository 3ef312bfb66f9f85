"""The chunks of an MCAP file and the message indexes behind them."""

from __future__ import annotations

import functools
import struct
from collections import Counter
from collections.abc import Callable, Iterator

import numpy as np

from ...topology.arrays import IntArray
from .ahead import Task
from .checksum import agrees
from .chunk_reader import Chunk, ChunkHead, ChunkReader, WrongChecksumError
from .columns import words
from .inflate import WHOLE_BYTES
from .mcap_heads import IN_CHUNKS, NOT_IN_CHUNKS
from .mcap_mend import mended
from .mcap_messages import MessageReader
from .mcap_small import joined, small_chunks
from .mcap_summary import McapSummary
from .mcap_wire import MESSAGE, MESSAGE_HEAD, MESSAGE_INDEX, RECORD_HEAD
from .messages import UNWANTED, Block, Bytes, DamageError, Walking
from .walk import mcap_records
from .windows import SLAB_BYTES, Window

_HEAD = struct.Struct("<BQ").unpack_from
_NO_RECORD = frozenset({0})

INDEX_HEAD = 6
_INDEX = struct.Struct("<HI").unpack_from
_INDEX_RECORD = struct.Struct("<BQHI").unpack_from
"""Channel and size of a message index record, without and with its record head."""


def _plain(head: ChunkHead, window: Window, crc: int) -> Bytes:
    """The records of an uncompressed chunk, from the window; raises DamageError."""
    if head.crc and not agrees(crc, head.crc):
        raise WrongChecksumError
    return window.view(head.data_at, head.data_size)


def _damaged_task(reason: str) -> Callable[[], bytes]:
    def task() -> bytes:
        raise DamageError(reason)

    return task


class McapChunks(ChunkReader):
    """The chunks of one file."""

    _messages: MessageReader

    def __init__(
        self, window: Window, messages: MessageReader, summary: McapSummary | None
    ) -> None:
        super().__init__(window, messages)
        self._summary = summary
        # What is not described there may be described in a chunk of nothing but images.
        self._index_serves = summary is not None and summary.checked and summary.describes_all

    def take(self, position: int, head: ChunkHead, end: int) -> Walking:
        """Queue a chunk, or read a run of small ones at once; returns the position to continue
        at."""
        self._messages.packed |= head.compression != ""
        return (yield from self._taken(position, head, end))

    def _plain(self, head: ChunkHead) -> Task:
        crc = self._window.checked(head.data_at, head.data_size)[1] if head.crc else 0
        return functools.partial(_plain, head, self._window, crc)

    def _queue(self, chunk: Chunk) -> bool:
        # Of a chosen chunk the index is told later.
        return super()._queue(chunk) and not self._chosen

    def _listed_behind(self, position: int) -> int:
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
        batch = small_chunks(self._window.view(position, SLAB_BYTES), self._patience > 0)
        self.met += len(batch.data) + len(batch.failed)
        self._findings.repaired += batch.repaired
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
            chunk = Chunk(position, _NO_HEAD, True, last.counts, [])
            self._ahead.put(chunk, _damaged_task(last.reason))
        self._window.passed(position + batch.stop)
        return position + batch.stop

    def _count_lost(self, data: Bytes) -> None:
        """Count the recognisable messages of damaged chunks without an index."""
        where, _ = mcap_records(data, NOT_IN_CHUNKS)
        self._findings.lost_at_least |= len(where) > 0
        where = where[data[where] == MESSAGE]
        counts = np.bincount(words(data, "<u2", where + RECORD_HEAD))
        for number in counts.nonzero()[0].tolist():
            if self._tally.known(number):
                self._tally.lost(number, int(counts[number]))

    def _needed(self, position: int) -> bool:
        """Whether a chunk may hold wanted messages; excluded only by an index with a valid
        checksum."""
        if self._summary is None or not self._index_serves:
            return True
        numbers = self._summary.numbers(position)
        if numbers is None or len(numbers) == 0:
            return True
        return any(self._tally.sink(n) != UNWANTED for n in numbers.tolist())

    def told(self, position: int, counts: dict[int, int]) -> None:
        """Record the message counts of a chunk whose index is not read."""
        chunk = self._ahead.last
        if chunk is not None and chunk.position == position:
            chunk.counts.update(counts)

    def listed(self, source: Window | Bytes, position: int, size: int) -> None:
        """Record the count and the positions from a message index record behind a chunk."""
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

    def _directly(self, chunk: Chunk) -> Iterator[Block]:
        """The messages of a chunk that is not needed, or too large for memory."""
        if chunk.needed or not self._passed_over(chunk):
            yield from super()._directly(chunk)

    def _passed_over(self, chunk: Chunk) -> bool:
        """Count the messages of an unneeded chunk, if its index agrees with the summary."""
        assert self._summary is not None
        numbers = self._summary.numbers(chunk.position)
        if numbers is None or set(numbers.tolist()) != chunk.counts.keys():
            return False
        for number, count in chunk.counts.items():
            self._tally.passed(number, count)
        if chunk.head.start_ns <= chunk.head.end_ns:
            self._findings.span(chunk.head.start_ns, chunk.head.end_ns)
        return True

    def _census(self, chunk: Chunk) -> dict[int, int]:
        """Message counts of a chunk; channels that are described only there are read from it."""
        head = chunk.head
        if head.data_size > WHOLE_BYTES:
            return {}
        data = self._part(head)
        if head.compression:
            # What a broken stream gives may end early, or be wrong where heads of records are.
            self._findings.lost_at_least = True
        define = functools.partial(self._messages.define, more=True)
        found = mended(data, self._messages.heads.within(data), define)
        where = found.where[found.data[found.where] == MESSAGE]
        first = self._tally.first(words(found.data, "<u2", where + RECORD_HEAD))
        size = words(found.data, "<i8", where + 1) - MESSAGE_HEAD
        where = where[self._messages.without_descriptions(found.data, where, size, first)]
        numbers = words(found.data, "<u2", where + RECORD_HEAD).tolist() + found.lost
        counts = Counter(numbers).items()
        return {n: c for n, c in counts if not head.compression or self._tally.known(n)}

    def cut(self, head: ChunkHead) -> Iterator[Block]:
        """The messages of the last chunk of a truncated file."""
        data = self._part(head)
        yield from self._messages.blocks(data[: self._front(data)])

    def _front(self, data: Bytes) -> int:
        return mcap_records(data, _NO_RECORD)[1]

    def _records(self, data: Bytes) -> tuple[IntArray, int]:
        return mcap_records(data, NOT_IN_CHUNKS)

    def _record_length(self, data: Bytes) -> int:
        if len(data) < RECORD_HEAD + MESSAGE_HEAD:
            return 0
        op, length = _HEAD(data.data)
        return RECORD_HEAD + int(length) if op in IN_CHUNKS else 0


_NO_HEAD = ChunkHead("", 0, 0, 0)
