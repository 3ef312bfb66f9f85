"""The chunks of a bag: read ahead, inflated, and saved where they are damaged."""

from __future__ import annotations

import functools
from collections import Counter
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from .ahead import Ahead
from .bag_heads import HEAD_BYTES, compression_of
from .bag_messages import MessageReader
from .bag_small import RUN, SMALL_BYTES, small_chunks
from .bag_sparse import without_large
from .bag_wire import INDEX, MESSAGE, U32, Record, listed_offsets, number
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
from .messages import Block, Bytes, DamageError, Ints, Walking
from .split import Large, whole_records
from .walk import bag_listed, bag_records
from .windows import RemoteWindow, Window

SLAB_BYTES = 1 << 20
"""How much of a run of small chunks is taken at a time."""

SPARSE_BYTES = 1 << 26
"""Largest chunk of which only the wanted messages are read into one buffer."""

PATIENCE = 1000
"""So many damaged chunks are looked at closely; a file with more is an attack."""


class _Chunk(NamedTuple):
    """A chunk read ahead: how it is compressed, where it ends, and what the index behind it says.

    counts: messages per connection; offsets: places of messages.
    """

    record: Record
    compression: str
    size: int
    counts: dict[int, int]
    offsets: Ints


def _inflated(
    read: Callable[[int, int], Bytes | bytes], record: Record, compression: str, size: int
) -> bytes:
    """The records of a compressed chunk; raises DamageError. For any thread if `read` is."""
    return inflate(compression, read(record.data_at, record.data_size), size)


def _wrong_size() -> bytes:
    raise WrongSizeError


class ChunkReader:
    """The chunks of one bag in their order; leaving the context ends the threads that inflate.

    record_at: gives the record at a place of the file; met: how many chunks there were.
    """

    def __init__(
        self,
        window: Window,
        messages: MessageReader,
        record_at: Callable[[int], Record | None],
    ) -> None:
        self.met = 0
        self._window = window
        self._messages = messages
        self._tally = messages.tally
        self._findings = messages.findings
        self._record_at = record_at
        self._ahead: Ahead[_Chunk] = Ahead()
        self._allowance = Allowance()
        self._small_run = 0
        # What lies between them is not there.
        self._chosen = isinstance(window, RemoteWindow)
        self._patience = PATIENCE

    def __enter__(self) -> ChunkReader:
        self._ahead.__enter__()
        return self

    def __exit__(self, *error: object) -> None:
        self._ahead.__exit__(*error)

    def take(self, position: int, record: Record) -> Walking:
        """Have a chunk inflated ahead, or take what it holds; returns where the next begins."""
        compression = compression_of(record.fields).decode("latin-1")
        size = number(record.fields, b"size")
        self._messages.packed |= compression != "none"
        if is_open(record):
            yield from self.caught_up(everything=True)
            return (yield from self._open_chunk(record, compression))
        if compression == "none" and size != record.data_size:
            # How large the data are is told by the record as well.
            size = record.data_size
            self._findings.repaired += 1
        small = max(size, record.data_size) <= SMALL_BYTES and not self._chosen
        self._small_run = self._small_run + 1 if small else 0
        if self._small_run > RUN:
            yield from self.caught_up(everything=True)
            stop = yield from self._small_chunks(position)
            if stop > position:
                return stop
            self._small_run = 0  # none of them is sound: not tried at every single one
        self.met += 1
        counts, offsets, end = self._index_behind(record.end, size)
        if compression == "none" and not size and not counts:
            return end
        yield from self._queue(_Chunk(record, compression, size, counts, offsets))
        return end

    def _queue(self, chunk: _Chunk) -> Iterator[Block]:
        """Have a chunk that is slow to inflate begun on another thread; others wait their turn."""
        record, compression, size = chunk.record, chunk.compression, chunk.size
        if compression == "none":
            yield from self.caught_up(everything=True)
            yield from self._plain(chunk)
            return
        if max(size, record.data_size) > WHOLE_BYTES:
            yield from self.caught_up(everything=True)
            yield from self._large(chunk)
            return
        try:
            self._allowance.take(compression, record.data_size, size)
        except DamageError:
            # The size may be the only thing that is wrong.
            self._ahead.put(chunk, _wrong_size)
        else:
            if compression in SLOW:
                task = functools.partial(_inflated, self._window.copy, record, compression, size)
                self._ahead.begin(chunk, task, record.data_size + size)
            else:
                view = self._window.view
                self._ahead.put(
                    chunk, functools.partial(_inflated, view, record, compression, size)
                )
        yield from self.caught_up()

    def _small_chunks(self, position: int) -> Walking:
        """The messages of small chunks one behind the other; returns where they end."""
        batch = small_chunks(self._window.view(position, SLAB_BYTES))
        self.met += len(batch.data)
        if batch.data:
            data = np.frombuffer(b"".join(batch.data), np.uint8)
            if bag_records(data)[1] == len(data):
                yield from self._messages.blocks(data)
            else:
                for records in batch.data:
                    yield from self._messages.blocks(np.frombuffer(records, np.uint8))
        return position + batch.stop

    def _plain(self, chunk: _Chunk) -> Iterator[Block]:
        """The messages of a chunk that is not compressed."""
        record, offsets = chunk.record, chunk.offsets
        sparse = where = None
        if chunk.size <= SPARSE_BYTES:
            sparse = without_large(self._window, record, offsets, self._messages.unwanted)
            where = bag_listed(sparse, offsets, least=1) if sparse is not None else None
        if sparse is not None and where is not None:
            yield from self._messages.blocks(sparse, where)
        elif chunk.size > WHOLE_BYTES:
            yield from self._large(chunk)
        else:
            data = self._window.view(record.data_at, chunk.size)
            yield from self._messages.blocks(data, bag_listed(data, offsets))

    def caught_up(self, everything: bool = False) -> Iterator[Block]:
        """Messages of the chunks read ahead."""
        for chunk, task in self._ahead.due(everything):
            assert task is not None
            try:
                data = np.frombuffer(task(), np.uint8)
            except DamageError as damage:
                rescued = self._rescued(chunk, damage)
                if rescued is None:
                    continue
                data = rescued
            yield from self._messages.blocks(data, bag_listed(data, chunk.offsets))

    def _rescued(self, chunk: _Chunk, damage: DamageError) -> Bytes | None:
        """The records of a chunk of which only the declared size is wrong; else None, counted."""
        self._patience -= 1
        packed = self._window.view(chunk.record.data_at, min(chunk.record.data_size, WHOLE_BYTES))
        if isinstance(damage, WrongSizeError) and self._patience >= 0:
            try:
                raw = inflate_anyhow(chunk.compression, packed, self._allowance)
                data = np.frombuffer(raw, np.uint8)
                if len(data) and bag_records(data)[1] == len(data):
                    self._findings.repaired += 1
                    return data
            except DamageError as further:
                damage = further
        counts = chunk.counts
        if not counts and self._patience >= 0:
            counts = self._census(inflate_part(chunk.compression, packed))
        self._damaged(str(damage), counts)
        return None

    def _census(self, part: bytes) -> dict[int, int]:
        """How many messages the front of a damaged chunk without index holds.

        Connections that are described nowhere else are taken from it as well.
        """
        data = np.frombuffer(part, np.uint8)
        where, _ = bag_records(data)
        found: Counter[int] = Counter()
        for place in where.tolist():
            record = self._messages.heads.within(data).record(place)
            if record is None:
                break
            key = number(record.fields, b"conn")
            if record.op == MESSAGE:
                found[key] += 1
            elif not self._tally.known(key):
                self._messages.one_by_one(data, where[where == place])
        return found

    def _large(self, chunk: _Chunk) -> Iterator[Block]:
        """The messages of a chunk too large for the memory; it is gone through before any is used.

        That is to know whether it is whole; what is not compressed tells nothing about that.
        """
        compression = "" if chunk.compression == "none" else chunk.compression
        record = chunk.record
        try:
            if compression:
                stream = self._pieces(record, compression)
                counted = self._allowance.counted(compression, record.data_size, stream)
                if sum(map(len, counted)) != chunk.size:
                    raise WrongSizeError
            parts = whole_records(self._pieces(record, compression), bag_records, _record_length)
            for part in parts:
                if isinstance(part, Large):
                    self._messages.too_large(part.head)
                else:
                    yield from self._messages.blocks(part)
        except DamageError as damage:
            rescued = self._rescued(chunk, damage)
            if rescued is not None:
                yield from self._messages.blocks(rescued)

    def _pieces(self, record: Record, compression: str) -> Iterator[bytes]:
        at = record.data_at

        def read(size: int) -> bytes:
            nonlocal at
            data = self._window.copy(at, min(size, record.end - at))
            at += len(data)
            return data

        return pieces(compression, read)

    def _index_behind(self, position: int, size: int) -> tuple[dict[int, int], Ints, int]:
        """Messages per connection in a chunk of `size` by the index behind it, and their places.

        Also where the index ends.
        """
        offsets = [np.zeros(0, np.int64)]
        counts: dict[int, int] = {}
        while (record := self._record_at(position)) is not None:
            if record.op != INDEX or record.end > self._window.size:
                break
            counts[number(record.fields, b"conn")] = number(record.fields, b"count")
            # Each entry stands for a record that takes more than the entry does.
            if record.data_size <= size:
                entries = self._window.view(record.data_at, record.data_size)
                offsets.append(listed_offsets(entries))
            position = record.end
        return counts, np.concatenate(offsets), position

    def _damaged(self, reason: str, counts: dict[int, int]) -> None:
        """Count a chunk that cannot be used, and its messages by its index."""
        self._findings.damaged_chunks[reason] += 1
        for key, count in counts.items():
            self._tally.lost(key, count)

    def _open_chunk(self, record: Record, compression: str) -> Walking:
        self._findings.truncated = True
        if compression == "none":
            return record.data_at
        rest = self._window.view(record.data_at, WHOLE_BYTES)
        yield from self._messages.front(np.frombuffer(inflate_part(compression, rest), np.uint8))
        return self._window.size

    def cut(self, record: Record) -> Iterator[Block]:
        """What is left of the last chunk of a file that was cut."""
        self._findings.truncated = True
        compression = compression_of(record.fields).decode("latin-1")
        data = self._window.view(record.data_at, min(record.data_size, WHOLE_BYTES))
        if compression != "none":
            part = inflate_part(compression, data)
            data = np.frombuffer(part, np.uint8)
        yield from self._messages.front(data)


def is_open(record: Record) -> bool:
    """Whether the recorder died before it could fill in the head of its last chunk."""
    return record.data_size == 0 and number(record.fields, b"size") == 0


def _record_length(data: Bytes) -> int:
    """Bytes of the record at the front, 0 if it cannot be one."""
    header = U32(data.data)[0] if len(data) >= HEAD_BYTES else 0
    if not 0 < header <= HEAD_BYTES - 8:
        return 0
    return int(8 + header + U32(data.data, 4 + header)[0])
