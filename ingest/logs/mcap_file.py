"""Reading MCAP files: a walk over their records that needs no index, survives damage and checks
CRCs.

`mcap_chunks` reads chunks, `mcap_messages` messages and descriptions.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from functools import cached_property

import numpy as np

from .checksum import agrees, crc32
from .chunk_index import ChunkIndex, next_listed, passed_over
from .chunked_file import ChunkedFile
from .inflate import WHOLE_BYTES, keep_freed_memory
from .mcap_chunks import McapChunks
from .mcap_heads import (
    HEAD_BYTES,
    IN_CHUNKS,
    NOT_IN_CHUNKS,
    OUTSIDE,
    PRIVATE,
    Heads,
    chunk_head,
)
from .mcap_index import chunk_index
from .mcap_mend import trusted
from .mcap_messages import MessageReader
from .mcap_summary import McapSummary, read_summary
from .mcap_wire import (
    CHUNK,
    DATA_END,
    FOOTER,
    HEADER,
    MAGIC,
    MESSAGE,
    MESSAGE_HEAD,
    MESSAGE_INDEX,
    RECORD_HEAD,
    Cursor,
    Definitions,
)
from .messages import (
    Block,
    Channel,
    Findings,
    Survey,
    Walking,
    Want,
)
from .split import RECORD_BYTES
from .tally import Tally
from .walk import mcap_records
from .windows import SLAB_BYTES, Window, window_on

_HEAD = struct.Struct("<BQ").unpack_from

LARGEST_MESSAGE = 1 << 32
"""A larger message counts as damage: lengths in ROS messages have 32 bits."""


class McapFile(ChunkedFile):
    """One MCAP file, chunked or not, with or without a summary, of any profile."""

    @cached_property
    def summary(self) -> McapSummary | None:
        """The summary section, None unless it is complete with a valid checksum."""
        with window_on(self.path) as window:
            return read_summary(window)

    def _chunks(self) -> ChunkIndex | str:
        return chunk_index(self.summary)

    def _channels(self) -> Mapping[int, Channel]:
        return self.summary.channels if self.summary is not None else {}

    def _walk(self, window: Window, want: Want, findings: Findings) -> _Walk:
        return _Walk(window, Tally(want, findings, self._channels()), findings, self.summary)

    def survey(self, exact: bool = False) -> Survey | None:
        """Message counts from the statistics record of a valid summary."""
        return self.summary.survey() if self.summary is not None else None


class _Walk:
    """One pass over a file."""

    def __init__(
        self, window: Window, tally: Tally, findings: Findings, summary: McapSummary | None
    ) -> None:
        self._window = window
        self._findings = findings
        self._summary = summary
        self.tally = tally
        self._heads = Heads(window.copy, window.size, self.tally.known)
        definitions = summary.definitions if summary is not None else Definitions()
        self._messages = MessageReader(self._heads, self.tally, findings, definitions)
        self._chunks = McapChunks(window, self._messages, summary)

    def run(self, index: ChunkIndex | None = None) -> Iterator[Block]:
        """All blocks from the first record to the footer, the end of file, or the last readable
        position.

        index: read only the chunks that hold wanted messages.
        """
        keep_freed_memory()
        with self._chunks:
            complete = yield from self._records() if index is None else self._chosen(index)
            yield from self._chunks.caught_up(everything=True)
        self._findings.truncated |= not complete
        self.tally.finish(self._summary.counts if self._summary is not None else {})

    def _chosen(self, index: ChunkIndex) -> Walking:
        """Read the chunks that hold wanted messages; of the others the index gives the counts."""
        needed = passed_over(index, self.tally, self._findings)
        for begin, stop, counts in index.places(needed):
            position = begin
            while position < stop:
                head = self._window.view(position, HEAD_BYTES).tobytes()
                end = self._heads.end(position, head)
                if end is None or end > self._window.size:
                    position = yield from self._around_damage(position, end)
                else:
                    position = yield from self._record(position, head, end)
            self._chunks.told(begin, counts)
            self._window.passed(stop)
        return 1

    def _records(self) -> Walking:
        """Walk over the records outside chunks; returns 1 if the footer was reached."""
        window, position = self._window, len(MAGIC)
        if window.view(0, position).tobytes() != MAGIC:
            self._findings.note("the file does not begin with the MCAP magic")
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
        """Whether a message's channel is known once a wrong bit in its number is corrected."""
        if head[0] != MESSAGE or len(head) < RECORD_HEAD + 2:
            return False
        behind = self._window.copy(position + RECORD_HEAD + _HEAD(head)[1], RECORD_HEAD + 2)
        number = head[RECORD_HEAD : RECORD_HEAD + 2]
        alike = behind[:1] == head[:1] and behind[RECORD_HEAD:] == number
        whole = alike or self._heads.begins(position + RECORD_HEAD + _HEAD(head)[1])
        return whole and self.tally.adopt(np.frombuffer(number * (1 + alike), "<u2"))

    def _told_apart(self, position: int, head: bytes) -> bytes:
        """The head of an apparent message, corrected if it is another record but for one bit.

        Any bytes can be a message. But in a file with chunks, indexes follow them, and the header
        is first.
        """
        ops = (MESSAGE_INDEX,) if self._chunks.met else ()
        if position == len(MAGIC):
            ops = (HEADER,)
        for op in ops:
            other = bytes([op]) + head[1:]
            if self._heads.end(position, other) is not None:
                self._findings.repaired += 1
                return other
        return head

    def _record(self, position: int, head: bytes, end: int) -> Walking:
        """Process a valid record outside chunks, or several; returns the position to continue
        at."""
        op = head[0]
        if op == CHUNK:
            self._messages.ended = False
            return (yield from self._chunks.take(position, chunk_head(head, position), end))
        if op == MESSAGE_INDEX:
            if end - position <= WHOLE_BYTES:
                self._chunks.listed(self._window, position, end - position)
        elif op in IN_CHUNKS:
            yield from self._chunks.caught_up(everything=True)
            return (yield from self._slab(position, end))
        elif op == DATA_END:
            yield from self._chunks.caught_up(everything=True)
            self._check_data(position)
            self._messages.ended = True
        return end

    def _slab(self, position: int, end: int) -> Walking:
        """Messages outside chunks, up to the next record of another kind; returns its position."""
        if end - position > RECORD_BYTES:
            record = self._window.view(position, HEAD_BYTES)
            if not self._messages.takes(record, end - position):
                self._messages.too_large(record)
                return end
        data = self._window.view(position, max(SLAB_BYTES, end - position))
        where, stop = mcap_records(data, NOT_IN_CHUNKS)
        doubted = self._messages.define(data, where)
        if not self._heads.begins(position + stop):
            where, stop = trusted(self._heads, data, where, stop, position)
            if stop == 0:
                return (yield from self._around_damage(position, None))
        if doubted or (data[where] == MESSAGE).any():
            yield from self._messages.blocks(data[:stop])
        self._window.passed(position + stop)
        return int(position + stop)

    def _check_data(self, position: int) -> None:
        """Compare the checksum of the data section, if there is one."""
        expected = Cursor(self._window.view(position + RECORD_HEAD, 4)).u32()
        if not expected:
            return
        found = 0
        for at in range(0, position, SLAB_BYTES):
            data = self._window.view(at, min(SLAB_BYTES, position - at))
            found = crc32(data.data, found)
        if not agrees(found, expected):
            self._findings.note("the checksum (CRC) of the data section is wrong")

    def _around_damage(self, position: int, end: int | None) -> Walking:
        """Continue where there is no valid record: repair its head or find the next one; returns a
        position.

        end: end of the record if only the file's end precedes it.
        """
        yield from self._chunks.caught_up(everything=True)
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
            yield from self._messages.blocks(window.view(position, whole - position))
            position = whole
            if position == found:
                return position
            op = 0
        if found is not None:
            self._findings.unreadable_bytes += found - position
            number = int.from_bytes(window.copy(position + RECORD_HEAD, 2), "little")
            if op == MESSAGE and self.tally.known(number):
                self.tally.lost(number, 1)
            return found
        if end is None and not _plausible(op, length):
            self._findings.unreadable_bytes += window.size - position
            return window.size
        self._findings.truncated = True
        if end is not None and op == CHUNK:
            yield from self._chunks.cut(chunk_head(window.copy(position, HEAD_BYTES), position))
        return window.size

    def _repaired(self, position: int, head: bytes) -> Walking:
        """Process the one record whose head was repaired; returns its end."""
        end = self._heads.end(position, head)
        assert end is not None
        if head[0] not in IN_CHUNKS and head[0] != MESSAGE_INDEX:
            return (yield from self._record(position, head, end))
        if end - position > RECORD_BYTES:
            start = np.frombuffer(head, np.uint8)
            if not self._messages.takes(start, end - position):
                self._messages.too_large(start)
                return end
        record = self._window.view(position, end - position).copy()
        record[: len(head)] = np.frombuffer(head, np.uint8)[: len(record)]
        if head[0] == MESSAGE_INDEX:
            self._chunks.listed(record, 0, len(record))
        else:
            yield from self._messages.blocks(record)
        return end

    def _next_record(self, position: int) -> int | None:
        """Position of the next plausible record at or after `position`, None if there is none."""
        if self._summary is not None:
            starts, stop = self._summary.chunk_starts, self._summary.start
            listed = next_listed(starts, stop, position, lambda at: bool(self._heads.sound(at)))
            if listed is not None:
                return listed
        return self._heads.following(position, self._messages.packed)


def _plausible(op: int, length: int) -> bool:
    """Whether a record head is possible: a known or private opcode and a possible length."""
    if op == MESSAGE:
        return MESSAGE_HEAD <= length < LARGEST_MESSAGE
    return (op in OUTSIDE or op >= PRIVATE) and length < 1 << 40
