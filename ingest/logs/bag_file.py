"""ROS 1 bags, closed or `.active`: a scan over chunks that needs no index and survives damage.

The contents of chunks are read by `bag_chunks`, messages and connections by `bag_messages`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cached_property

import numpy as np

from .bag_chunks import BagChunks, is_open
from .bag_heads import HEAD_BYTES, IN_CHUNKS, BagHeads, compression_of
from .bag_messages import MessageReader
from .bag_wire import (
    BAG_HEADER,
    CHUNK,
    CONNECTION,
    MAGIC,
    MESSAGE,
    U32,
    BagIndex,
    Record,
    fields_of,
    number,
    op_of,
    read_index,
)
from .chunk_index import ChunkIndex, next_listed, passed_over
from .chunked_file import ChunkedFile
from .inflate import keep_freed_memory
from .messages import (
    Block,
    Bytes,
    Channel,
    DamageError,
    Findings,
    Survey,
    Walking,
    Want,
)
from .split import RECORD_BYTES
from .tally import Tally
from .windows import SLAB_BYTES, Window, window_on


class BagFile(ChunkedFile):
    """One ROS 1 bag of format 2.0, uncompressed, bz2 or lz4."""

    BEHIND = HEAD_BYTES

    @cached_property
    def index(self) -> BagIndex | None:
        """The index section of a closed bag, None if it is missing or wrong."""
        with window_on(self.path) as window:
            return read_index(window)

    def _chunks(self) -> ChunkIndex | str:
        return "it has no index, or a damaged one" if self.index is None else self.index.chunks

    def _channels(self) -> Mapping[int, Channel]:
        return self.index.channels if self.index is not None else {}

    def _walk(self, window: Window, want: Want, findings: Findings) -> _Walk:
        return _Walk(window, Tally(want, findings, self._channels()), findings, self.index)

    def survey(self, exact: bool = False) -> Survey | None:
        """Counts from the chunk infos of the index."""
        return self.index.survey() if self.index is not None else None


class _Walk:
    """One scan of a bag."""

    def __init__(
        self, window: Window, tally: Tally, findings: Findings, index: BagIndex | None
    ) -> None:
        self._window = window
        self._findings = findings
        self._index = index
        self.tally = tally
        self._heads = BagHeads(window.copy, window.size)
        told = index.told if index is not None else {}
        self._messages = MessageReader(self._heads, self.tally, findings, told)
        self._chunks = BagChunks(window, self._messages, self._at)
        self._looked_at: tuple[int, Record | None] = (-1, None)

    def run(self, index: ChunkIndex | None = None) -> Iterator[Block]:
        """All blocks up to the index, the end, or the last readable place.

        index: only those of the chunks that hold what is wanted, and nothing else is read.
        """
        keep_freed_memory()
        with self._chunks:
            yield from self._records() if index is None else self._chosen(index)
            yield from self._chunks.caught_up(everything=True)
        declared = self._index.counts if self._index is not None else {}
        if (
            self._index is not None
            and self._findings.whole
            and self._chunks.met == len(self._index.chunk_starts)
            and self.tally.lacks(declared)
            and not self.tally.moved(declared)
        ):
            # Nothing is damaged and no chunk is missing: it is the index that is wrong.
            self._findings.note("the index counts other numbers of messages than there are")
            declared = {}
        self.tally.finish(declared)

    def _chosen(self, index: ChunkIndex) -> Iterator[Block]:
        """Scan the chunks with wanted messages; for the others the index suffices."""
        needed = passed_over(index, self.tally, self._findings)
        self._chunks.met += int((~needed).sum())
        for begin, stop, _ in index.places(needed):
            position = begin
            while position < stop:
                position = yield from self._next(position)
            self._window.passed(stop)

    def _records(self) -> Iterator[Block]:
        """Scan the records outside chunks."""
        window, position = self._window, len(MAGIC)
        while position < window.size:
            if self._index is not None and position == self._index.start:
                break
            position = yield from self._next(position)
            window.passed(min(position, window.size))

    def _next(self, position: int) -> Walking:
        """Process what is at a position; returns where to go on."""
        record = self._at(position)
        if record is None or not self._leads_on(record):
            return (yield from self._around_damage(position, record))
        return (yield from self._record(position, record))

    def _leads_on(self, record: Record) -> bool:
        """Whether a record is complete and followed by another one."""
        if record.op == CHUNK and is_open(record):
            return True
        return record.end <= self._window.size and (
            self._at(record.end) is not None or self._heads.begins(record.end)
        )

    def _at(self, position: int) -> Record | None:
        """The record at a position, cached, as each is asked for twice."""
        if self._looked_at[0] != position:
            head = self._window.view(position, HEAD_BYTES).tobytes()
            self._looked_at = position, self._heads.record(position, head)
        return self._looked_at[1]

    def _record(self, position: int, record: Record) -> Walking:
        """Process a sound record outside chunks, or several; returns where to go on."""
        if record.op in IN_CHUNKS:
            yield from self._chunks.caught_up(everything=True)
            return (yield from self._slab(position, record))
        if record.op == CHUNK:
            return (yield from self._chunks.take(position, record))
        if record.op == BAG_HEADER:
            self._closed(record)
        return record.end

    def _around_damage(self, position: int, record: Record | None) -> Walking:
        """Continue at a position without a sound record: repair its head, or find the next one.

        record: the one there, if only what follows is in doubt. Returns a position.
        """
        yield from self._chunks.caught_up(everything=True)
        whole = record is not None and record.end < self._window.size
        if record is not None and whole and self._heads.repaired(record.end) is not None:
            return (yield from self._record(position, record))
        head = self._heads.repaired(position)
        if head is not None:
            return (yield from self._repaired(position, head))
        if record is not None and record.op == CHUNK:
            self._messages.packed |= compression_of(record.fields) != b"none"
        found = self._next_record(position + 1)
        if record is not None and record.end <= (self._window.size if found is None else found):
            # The record is whole, and what is behind it broken.
            position = yield from self._record(position, record)
            if found is not None and position < found:
                self._findings.unreadable_bytes += found - position
                return found
            return position
        if found is not None:
            self._findings.unreadable_bytes += found - position
            if record is not None and record.op == MESSAGE:
                self.tally.lost(number(record.fields, b"conn"), 1)
            return found
        if record is not None and record.op == CHUNK:
            yield from self._chunks.cut(record)
        else:
            self._findings.unreadable_bytes += self._window.size - position
        self._findings.truncated |= self._index is None
        return self._window.size

    def _repaired(self, position: int, head: bytes) -> Walking:
        """Process the record with a repaired head; returns where to go on."""
        self._findings.repaired += 1
        record = self._heads.record(position, head)
        assert record is not None
        if record.op not in IN_CHUNKS:
            return (yield from self._record(position, record))
        data = self._window.view(position, min(record.end - position, RECORD_BYTES)).copy()
        data[: len(head)] = np.frombuffer(head, np.uint8)[: len(data)]
        yield from self._messages.blocks(data)
        return record.end

    def _next_record(self, position: int) -> int | None:
        """Position of the next plausible record at or after `position`, None if there is none."""
        if self._index is not None:
            starts, stop = self._index.chunk_starts, self._index.start
            listed = next_listed(starts, stop, position, self._is_chunk)
            if listed is not None:
                return listed
        return self._heads.following(position, self._messages.packed)

    def _is_chunk(self, position: int) -> bool:
        record = self._heads.record(position)
        return record is not None and record.op == CHUNK

    def _closed(self, record: Record) -> None:
        """Report a missing index in a bag whose header claims one."""
        index_at = number(record.fields, b"index_pos", 8)
        if self._index is None and index_at >= self._window.size:
            self._findings.truncated = True
        elif self._index is None:
            reason = "is damaged" if index_at else "was never written"
            self._findings.note(f"the index {reason}")

    def _slab(self, position: int, record: Record) -> Walking:
        """Messages and connections outside chunks; returns the position of the next other
        record."""
        need = record.end - position
        if need > RECORD_BYTES:
            head = self._window.view(position, HEAD_BYTES)
            if not self._messages.takes(head, need):
                self._messages.too_large(head)
                return record.end
        data = self._window.view(position, max(SLAB_BYTES, need))
        # The first record is sound: it always gets on.
        stop = max(self._led_on(data, position), need)
        yield from self._messages.blocks(data[:stop])
        self._window.passed(position + stop)
        return position + stop

    def _led_on(self, data: Bytes, position: int) -> int:
        """Length of the records at the front of `data` that are followed by a sound record."""
        ends = _whole_records(data, only=(MESSAGE, CONNECTION))
        while ends and not self._heads.begins(position + ends[-1]):
            ends.pop()
        return ends[-1] if ends else 0


def _whole_records(data: Bytes, only: tuple[int, ...]) -> list[int]:
    """Ends of the complete records at the front of `data`.

    only: stop at the first record of another kind.
    """
    raw, position, end = data.data, 0, len(data) - 8
    ends: list[int] = []
    while position <= end:
        body = position + 4 + U32(raw, position)[0]
        if body > end + 4:
            break
        following = body + 4 + U32(raw, body)[0]
        if following > len(data):
            break
        if not _is_kind(data, position, body, only):
            break
        position = following
        ends.append(position)
    return ends


def _is_kind(data: Bytes, position: int, body: int, kinds: tuple[int, ...]) -> bool:
    try:
        return op_of(fields_of(data[position + 4 : body].tobytes())) in kinds
    except DamageError:
        return False
