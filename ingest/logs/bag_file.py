"""ROS 1 bags, closed or `.active`: a walk over chunks that needs no index and survives damage."""

from __future__ import annotations

import functools
from collections import Counter
from collections.abc import Callable, Iterator
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np

from .ahead import Ahead
from .bag_heads import HEAD_BYTES, IN_CHUNKS, BagHeads, compression_of
from .bag_mend import mended
from .bag_small import RUN, SMALL_BYTES, small_chunks
from .bag_sparse import without_large
from .bag_wire import (
    BAG_HEADER,
    CHUNK,
    CONNECTION,
    INDEX,
    MAGIC,
    MESSAGE,
    U32,
    BagIndex,
    HeadTemplate,
    Record,
    connection_of,
    fields_of,
    listed_offsets,
    number,
    op_of,
    read_index,
    time_ns,
)
from .columns import column, gather, words
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
from .tally import NUMBERS, Tally
from .walk import bag_listed, bag_records

SLAB_BYTES = 1 << 20

TRIED_STARTS = 64
"""So many chunks of an index are looked for before the index is given up."""

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


class BagFile:
    """One ROS 1 bag of format 2.0, uncompressed, bz2 or lz4."""

    format = "bag"

    def __init__(self, path: Path) -> None:
        self.path = path

    @cached_property
    def index(self) -> BagIndex | None:
        """The index section of a closed bag, None where it is missing or wrong."""
        with FileWindow(self.path) as window:
            return read_index(window)

    def survey(self, exact: bool = False) -> Survey | None:
        """Counts from the chunk infos of the index."""
        return self.index.survey() if self.index is not None else None

    def blocks(
        self, want: Want, findings: Findings, progress: Progress | None = None
    ) -> Iterator[Block]:
        """Walk the file once. O(bytes); memory: one chunk, compressed and inflated."""
        with FileWindow(self.path, progress) as window:
            yield from _Walk(window, want, findings, self.index).run()
            window.passed(window.size)


class _Walk:
    """One pass over a bag."""

    def __init__(
        self, window: FileWindow, want: Want, findings: Findings, index: BagIndex | None
    ) -> None:
        self._window = window
        self._findings = findings
        self._index = index
        self._tally = Tally(want, findings, index.channels if index is not None else {})
        self._template: HeadTemplate | None = None
        self._heads = BagHeads(window.copy, window.size)
        self._ahead: Ahead[_Chunk] = Ahead()
        self._allowance = Allowance()
        self._looked_at: tuple[int, Record | None] = (-1, None)
        self._small_run = 0
        self._packed = False
        self._chunks = 0
        self._patience = PATIENCE

    def run(self) -> Iterator[Block]:
        """All blocks up to the index, the end, or the last readable place."""
        keep_freed_memory()
        with self._ahead:
            yield from self._records()
            yield from self._caught_up(everything=True)
        declared = self._index.counts if self._index is not None else {}
        if (
            self._index is not None
            and self._findings.whole
            and self._chunks == len(self._index.chunk_starts)
            and self._tally.lacks(declared)
            and not self._tally.moved(declared)
        ):
            # Nothing is damaged and no chunk is missing: it is the index that is wrong.
            self._findings.note("the index counts other numbers of messages than there are")
            declared = {}
        self._tally.finish(declared)

    def _records(self) -> Iterator[Block]:
        """Go through the records outside chunks."""
        window, position = self._window, len(MAGIC)
        while position < window.size:
            if self._index is not None and position == self._index.start:
                break
            record = self._at(position)
            if record is None or not self._leads_on(record):
                position = yield from self._around_damage(position, record)
            else:
                position = yield from self._record(position, record)
            window.passed(min(position, window.size))

    def _leads_on(self, record: Record) -> bool:
        """Whether a record is all there, and another one behind it."""
        if record.op == CHUNK and self._is_open(record):
            return True
        return record.end <= self._window.size and (
            self._at(record.end) is not None or self._heads.begins(record.end)
        )

    def _at(self, position: int) -> Record | None:
        """The record at a place; each is asked for as what follows, and then as what is next."""
        if self._looked_at[0] != position:
            head = self._window.view(position, HEAD_BYTES).tobytes()
            self._looked_at = position, self._heads.record(position, head)
        return self._looked_at[1]

    def _is_open(self, record: Record) -> bool:
        """Whether the recorder died before it could fill in the head of its last chunk."""
        return record.data_size == 0 and number(record.fields, b"size") == 0

    def _record(self, position: int, record: Record) -> Walking:
        """Take in a sound record outside chunks, or several; returns where to go on."""
        if record.op in IN_CHUNKS:
            yield from self._caught_up(everything=True)
            return (yield from self._slab(position, record))
        if record.op == CHUNK:
            return (yield from self._chunk(position, record))
        if record.op == BAG_HEADER:
            self._closed(record)
        return record.end

    # Damage

    def _around_damage(self, position: int, record: Record | None) -> Walking:
        """Go on at a place where no sound record is: repair its head, or find the next one.

        record: the one there, if only what is behind it is in doubt. Returns a place.
        """
        yield from self._caught_up(everything=True)
        whole = record is not None and record.end < self._window.size
        if record is not None and whole and self._heads.repaired(record.end) is not None:
            return (yield from self._record(position, record))
        head = self._heads.repaired(position)
        if head is not None:
            return (yield from self._repaired(position, head))
        if record is not None and record.op == CHUNK:
            self._packed |= compression_of(record.fields) != b"none"
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
                self._tally.lost(number(record.fields, b"conn"), 1)
            return found
        if record is not None and record.op == CHUNK:
            yield from self._cut_chunk(record)
        else:
            self._findings.unreadable_bytes += self._window.size - position
        self._findings.truncated |= self._index is None
        return self._window.size

    def _repaired(self, position: int, head: bytes) -> Walking:
        """Take in the record whose head was set right; returns where to go on."""
        self._findings.repaired += 1
        record = self._heads.record(position, head)
        assert record is not None
        if record.op not in IN_CHUNKS:
            return (yield from self._record(position, record))
        data = self._window.view(position, min(record.end - position, RECORD_BYTES)).copy()
        data[: len(head)] = np.frombuffer(head, np.uint8)[: len(data)]
        yield from self._messages(data)
        return record.end

    def _next_record(self, position: int) -> int | None:
        """Place of the next believable record at or after `position`, None if there is none."""
        if self._index is not None:
            starts = self._index.chunk_starts
            for start in starts[np.searchsorted(starts, position) :][:TRIED_STARTS].tolist():
                record = self._heads.record(start)
                if record is not None and record.op == CHUNK:
                    return int(start)
            if len(starts) and starts[-1] < position <= self._index.start:
                return self._index.start
        return self._heads.following(position, self._packed)

    def _closed(self, record: Record) -> None:
        """Report a bag without index; one whose header names its place was closed and had one."""
        index_at = number(record.fields, b"index_pos", 8)
        if self._index is None and index_at >= self._window.size:
            self._findings.truncated = True
        elif self._index is None:
            reason = "is damaged" if index_at else "was never written"
            self._findings.note(f"the index {reason}")

    # Chunks

    def _chunk(self, position: int, record: Record) -> Walking:
        """Have a chunk inflated ahead, or take what it holds; returns where the next begins."""
        compression = compression_of(record.fields).decode("latin-1")
        size = number(record.fields, b"size")
        self._packed |= compression != "none"
        if self._is_open(record):
            yield from self._caught_up(everything=True)
            return (yield from self._open_chunk(record, compression))
        if compression == "none" and size != record.data_size:
            # How large the data are is told by the record as well.
            size = record.data_size
            self._findings.repaired += 1
        small = max(size, record.data_size) <= SMALL_BYTES
        self._small_run = self._small_run + 1 if small else 0
        if self._small_run > RUN:
            yield from self._caught_up(everything=True)
            stop = yield from self._small_chunks(position)
            if stop > position:
                return stop
            self._small_run = 0  # none of them is sound: not tried at every single one
        self._chunks += 1
        counts, offsets, end = self._index_behind(record.end, size)
        if compression == "none" and not size and not counts:
            return end
        yield from self._queue(_Chunk(record, compression, size, counts, offsets))
        return end

    def _queue(self, chunk: _Chunk) -> Iterator[Block]:
        """Have a chunk that is slow to inflate begun on another thread; others wait their turn."""
        record, compression, size = chunk.record, chunk.compression, chunk.size
        if compression == "none":
            yield from self._caught_up(everything=True)
            yield from self._plain(chunk)
            return
        if max(size, record.data_size) > WHOLE_BYTES:
            yield from self._caught_up(everything=True)
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
        yield from self._caught_up()

    def _small_chunks(self, position: int) -> Walking:
        """The messages of small chunks one behind the other; returns where they end."""
        batch = small_chunks(self._window.view(position, SLAB_BYTES))
        self._chunks += len(batch.data)
        if batch.data:
            data = np.frombuffer(b"".join(batch.data), np.uint8)
            if bag_records(data)[1] == len(data):
                yield from self._messages(data)
            else:
                for records in batch.data:
                    yield from self._messages(np.frombuffer(records, np.uint8))
        return position + batch.stop

    def _plain(self, chunk: _Chunk) -> Iterator[Block]:
        """The messages of a chunk that is not compressed."""
        record, offsets = chunk.record, chunk.offsets
        sparse = where = None
        if chunk.size <= SPARSE_BYTES:
            sparse = without_large(self._window, record, offsets, self._unwanted)
            where = bag_listed(sparse, offsets, least=1) if sparse is not None else None
        if sparse is not None and where is not None:
            yield from self._messages(sparse, where)
        elif chunk.size > WHOLE_BYTES:
            yield from self._large(chunk)
        else:
            data = self._window.view(record.data_at, chunk.size)
            yield from self._messages(data, bag_listed(data, offsets))

    def _unwanted(self, conn: int) -> bool:
        return conn < NUMBERS and self._tally.sink(conn) == UNWANTED

    def _caught_up(self, everything: bool = False) -> Iterator[Block]:
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
            yield from self._messages(data, bag_listed(data, chunk.offsets))

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
            record = self._heads.within(data).record(place)
            if record is None:
                break
            key = number(record.fields, b"conn")
            if record.op == MESSAGE:
                found[key] += 1
            elif not self._tally.known(key):
                self._one_by_one(data, where[where == place])
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
                    self._too_large(part.head)
                else:
                    yield from self._messages(part)
        except DamageError as damage:
            rescued = self._rescued(chunk, damage)
            if rescued is not None:
                yield from self._messages(rescued)

    def _pieces(self, record: Record, compression: str) -> Iterator[bytes]:
        at = record.data_at

        def read(size: int) -> bytes:
            nonlocal at
            data = self._window.copy(at, min(size, record.end - at))
            at += len(data)
            return data

        return pieces(compression, read)

    def _too_large(self, head: Bytes) -> None:
        """Count a record that is too large to be looked at, by its first bytes."""
        header = U32(head.data)[0]
        try:
            fields = fields_of(head[4 : 4 + header].tobytes())
            if op_of(fields) == MESSAGE:
                key = number(fields, b"conn")
                if self._unwanted(key):
                    self._tally.passed(key, 1)
                    return
                self._tally.lost(key, 1)
        except DamageError:
            self._findings.unreadable_bytes += header
        self._findings.too_large += 1

    def _index_behind(self, position: int, size: int) -> tuple[dict[int, int], Ints, int]:
        """Messages per connection in a chunk of `size` by the index behind it, and their places.

        Also where the index ends.
        """
        offsets = [np.zeros(0, np.int64)]
        counts: dict[int, int] = {}
        while (record := self._at(position)) is not None:
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
        yield from self._front(np.frombuffer(inflate_part(compression, rest), np.uint8))
        return self._window.size

    def _cut_chunk(self, record: Record) -> Iterator[Block]:
        """What is left of the last chunk of a file that was cut."""
        self._findings.truncated = True
        compression = compression_of(record.fields).decode("latin-1")
        data = self._window.view(record.data_at, min(record.data_size, WHOLE_BYTES))
        if compression != "none":
            part = inflate_part(compression, data)
            data = np.frombuffer(part, np.uint8)
        yield from self._front(data)

    def _front(self, data: Bytes) -> Iterator[Block]:
        """The messages in whole records at the front of data that were cut."""
        where, stop = bag_records(data)
        self._findings.unreadable_bytes += len(data) - stop
        yield from self._messages(data[:stop], where)

    def _slab(self, position: int, record: Record) -> Walking:
        """Messages and connections outside chunks; returns the place of the next other record."""
        need = record.end - position
        if need > RECORD_BYTES:
            self._too_large(self._window.view(position, HEAD_BYTES))
            return record.end
        data = self._window.view(position, max(SLAB_BYTES, need))
        # The first record is sound: it always gets on.
        stop = max(self._led_on(data, position), need)
        yield from self._messages(data[:stop])
        self._window.passed(position + stop)
        return position + stop

    def _led_on(self, data: Bytes, position: int) -> int:
        """Length of the records at the front of `data` that a sound record is behind."""
        ends = _whole_records(data, only=(MESSAGE, CONNECTION))
        while ends and not self._heads.begins(position + ends[-1]):
            ends.pop()
        return ends[-1] if ends else 0

    # Messages

    def _messages(self, data: Bytes, where: Ints | None = None) -> Iterator[Block]:
        """The wanted messages in a run of records; connections met are taken in.

        where: all records in `data`, if an index has told.
        """
        if where is None:
            where, stop = bag_records(data)
            if stop != len(data):
                data, where = self._mended(data)
        if self._template is None:
            self._learn(data, where)
        conn, time, size_at, others = self._columns(data, where)
        if len(others) and any(self._heads.within(data).record(k) is None for k in others.tolist()):
            data, where = self._mended(data)
            conn, time, size_at, others = self._columns(data, where)
        extra = self._one_by_one(data, others)
        if extra:
            conn, time, size_at = (
                np.concatenate([column, np.array(more, np.int64)])
                for column, more in zip(
                    (conn, time, size_at), zip(*extra, strict=True), strict=True
                )
            )
        if len(conn) == 0:
            return
        conn = np.minimum(conn, NUMBERS - 1)
        self._tally.adopt(conn)
        for sink, rows in self._tally.met(conn, time):
            at = size_at[rows]
            size = words(data, "<u4", at).astype(np.int64)
            yield Block(data, sink, time[rows], at + 4, size)

    def _mended(self, data: Bytes) -> tuple[Bytes, Ints]:
        """Damaged records without those that cannot be found again, and their places."""
        found = mended(data, self._heads.within(data))
        self._findings.unreadable_bytes += found.unreadable
        self._findings.repaired += found.repaired
        if not self._packed:
            # What a broken stream gives may be records that were never written.
            for key in found.lost:
                self._tally.lost(key, 1)
        return found.data, found.where

    def _learn(self, data: Bytes, where: Ints) -> None:
        """Take the header of the first message as the template of all."""
        for place in where.tolist():
            size = U32(data.data, place)[0]
            try:
                self._template = HeadTemplate.of(data[place : place + 4 + size].tobytes())
            except DamageError:
                continue
            return

    def _columns(self, data: Bytes, where: Ints) -> tuple[Ints, Ints, Ints, Ints]:
        """Connection, time and place of the payload's size of the records like the template.

        Also the places of the records that are not. All headers are gathered at once and compared
        with the template in the bytes that every message shares.
        """
        template = self._template
        if template is None:
            none = np.zeros(0, np.int64)
            return none, none, none, where
        inside = where[where + (template.size + 8) <= len(data)]
        heads = gather(data, inside, template.size + 4)
        other = template.shape.misfits(heads) if len(heads) else None
        found = inside
        if other is not None:
            found, heads = inside[~other], heads[~other]
        conn = column(heads, "<u4", template.conn_at)
        time = column(heads, "<u4", template.time_at) * 10**9
        time += column(heads, "<u4", template.time_at + 4)
        left = np.ones(len(where), bool)
        left[np.searchsorted(where, found)] = False
        return conn, time, found + (4 + template.size), where[left]

    def _one_by_one(self, data: Bytes, places: Ints) -> list[tuple[int, int, int]]:
        """Connection records, and messages whose header is written in another order."""
        out = []
        for place in places.tolist():
            size = U32(data.data, place)[0]
            size_at = place + 4 + size
            try:
                fields = fields_of(data[place + 4 : size_at].tobytes())
                op = op_of(fields)
                if op == MESSAGE:
                    time = time_ns(fields.get(b"time", b""))
                    out.append((number(fields, b"conn"), time, size_at))
                elif op == CONNECTION:
                    end = size_at + 4 + U32(data.data, size_at)[0]
                    self._tally.describe(*connection_of(fields, data[size_at + 4 : end].tobytes()))
                else:
                    raise DamageError("unexpected record")
            except DamageError:
                self._findings.unreadable_bytes += size
        return out


def _record_length(data: Bytes) -> int:
    """Bytes of the record at the front, 0 if it cannot be one."""
    header = U32(data.data)[0] if len(data) >= HEAD_BYTES else 0
    if not 0 < header <= HEAD_BYTES - 8:
        return 0
    return int(8 + header + U32(data.data, 4 + header)[0])


def _whole_records(data: Bytes, only: tuple[int, ...]) -> list[int]:
    """Where the records at the front of `data` end that are there to their last byte.

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
