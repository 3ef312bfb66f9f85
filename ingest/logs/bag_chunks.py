"""The chunks of a bag, and the index records behind them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator

import numpy as np

from ...topology.arrays import IntArray
from .bag_heads import HEAD_BYTES, compression_of
from .bag_messages import MessageReader
from .bag_small import small_chunks
from .bag_sparse import without_large
from .bag_wire import (
    INDEX,
    INDEX_ENTRY,
    MESSAGE,
    U32,
    IndexTemplate,
    Record,
    listed_offsets,
    number,
)
from .chunk_reader import Chunk, ChunkHead, ChunkReader
from .inflate import WHOLE_BYTES
from .messages import Block, Bytes, Walking
from .walk import bag_records
from .windows import SLAB_BYTES, Window

SPARSE_BYTES = 1 << 26
"""Largest chunk of which only the wanted messages are read into one buffer: as large as the longest
message that is decoded, a fifth of the memory that any log may take (docs/reliability.md)."""


class BagChunks(ChunkReader):
    """The chunks of one bag. record_at: gives the record at a place of the file."""

    _messages: MessageReader

    def __init__(
        self,
        window: Window,
        messages: MessageReader,
        record_at: Callable[[int], Record | None],
    ) -> None:
        super().__init__(window, messages)
        self._record_at = record_at
        self._index_like: IndexTemplate | None = None

    def take(self, position: int, record: Record) -> Walking:
        """Queue a chunk for decompression, or consume small ones at once; returns where the next
        begins."""
        head = _head_of(record)
        self._messages.packed |= head.compression != ""
        if not is_open(record):
            return (yield from self._taken(position, head, record.end))
        yield from self.caught_up(everything=True)
        self._findings.truncated = True
        if head.compression == "":
            return record.data_at
        yield from self._messages.front(self._part(head._replace(data_size=WHOLE_BYTES)))
        return self._window.size

    def cut(self, record: Record) -> Iterator[Block]:
        """The remaining messages of the last chunk of a truncated file."""
        self._findings.truncated = True
        yield from self._messages.front(self._part(_head_of(record)))

    def _needed(self, position: int) -> bool:
        return True  # whether something is left out is decided when the index behind it is known

    def _plain(self, head: ChunkHead) -> None:
        return None

    def _directly(self, chunk: Chunk) -> Iterator[Block]:
        """The messages of a chunk that is not compressed, or too large for memory."""
        head = chunk.head
        if head.compression:
            yield from super()._directly(chunk)
            return
        listed = None
        if head.size <= SPARSE_BYTES:
            offsets = np.concatenate([np.zeros(0, np.int64), *chunk.offsets])
            sparse = without_large(self._window, head, offsets, self._messages.unwanted)
            if sparse is not None:
                listed = self._messages.listed(sparse, offsets)
        if listed is not None:
            yield from listed
        elif head.size > WHOLE_BYTES:
            yield from super()._directly(chunk)
        else:
            data = self._window.view(head.data_at, head.size)
            yield from self._messages.blocks(data, chunk.offsets)

    def _small_chunks(self, position: int) -> Walking:
        batch = small_chunks(self._window.view(position, SLAB_BYTES))
        self.met += len(batch.data)
        self._findings.repaired += batch.repaired
        if batch.data:
            data = np.frombuffer(b"".join(batch.data), np.uint8)
            if bag_records(data)[1] == len(data):
                yield from self._messages.blocks(data)
            else:
                for records in batch.data:
                    yield from self._messages.blocks(np.frombuffer(records, np.uint8))
        if not batch.stop:
            self._small_run = 0  # none of them is sound: not tried at every single one
        return position + batch.stop

    def _listed_behind(self, position: int) -> int:
        chunk = self._ahead.last
        assert chunk is not None
        while (listed := self._index_at(position)) is not None:
            key, count, data_at, position = listed
            chunk.counts[key] = count
            # Each entry stands for a record that takes more than the entry does.
            if position - data_at <= chunk.head.size:
                entries = self._window.view(data_at, position - data_at)
                chunk.offsets.append(listed_offsets(entries))
        return position

    def _index_at(self, position: int) -> tuple[int, int, int, int] | None:
        """Connection and count of the index record at a position, and the range of its data.

        None if there is none. Recorders repeat one header: one equal to the previous is not parsed
        again.
        """
        head = self._window.view(position, HEAD_BYTES).tobytes()
        found = self._index_like.read(head) if self._index_like is not None else None
        if found is None:
            record = self._record_at(position)
            if record is None or record.op != INDEX:
                return None
            self._index_like = IndexTemplate.of(head[: record.data_at - 4 - position])
            key, count = number(record.fields, b"conn"), number(record.fields, b"count")
            found = key, count, record.data_at - position
        key, count, data_at = found
        end = position + data_at + INDEX_ENTRY * count
        return (key, count, position + data_at, end) if end <= self._window.size else None

    def _census(self, chunk: Chunk) -> dict[int, int]:
        """Message counts of a damaged chunk; connections described nowhere else are learned from
        it."""
        if not chunk.head.compression:
            return {}  # it was used as far as its records lead on
        data = self._part(chunk.head)
        where, _ = bag_records(data)
        conn, _, size_at, others = self._messages.columns(data, where)
        records = [
            (place, self._messages.heads.within(data).record(place)) for place in others.tolist()
        ]
        broken = next((place for place, record in records if record is None), len(data))
        found = Counter(conn[size_at < broken].tolist())
        for place, record in records:
            if place >= broken or record is None:
                break
            key = number(record.fields, b"conn")
            if record.op == MESSAGE:
                found[key] += 1
            elif not self._tally.known(key):
                self._messages.one_by_one(data, np.array([place]))
        return found

    def _front(self, data: Bytes) -> int:
        return bag_records(data)[1]

    def _records(self, data: Bytes) -> tuple[IntArray, int]:
        return bag_records(data)

    def _record_length(self, data: Bytes) -> int:
        header = U32(data.data)[0] if len(data) >= HEAD_BYTES else 0
        if not 0 < header <= HEAD_BYTES - 8:
            return 0
        return int(8 + header + U32(data.data, 4 + header)[0])


def _head_of(record: Record) -> ChunkHead:
    compression = compression_of(record.fields).decode("latin-1")
    name = "" if compression == "none" else compression
    return ChunkHead(name, record.data_at, record.data_size, number(record.fields, b"size"))


def is_open(record: Record) -> bool:
    """Whether the recorder died before it could complete the header of its last chunk."""
    return record.data_size == 0 and number(record.fields, b"size") == 0
