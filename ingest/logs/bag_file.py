"""ROS 1 bags, closed or `.active`: a walk over chunks that needs no index and survives damage."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np

from .ahead import Ahead
from .bag_sparse import without_large
from .bag_wire import (
    BAG_HEADER,
    CHUNK,
    CHUNK_INFO,
    CONNECTION,
    INDEX,
    INDEX_ENTRY,
    MAGIC,
    MESSAGE,
    U32,
    BagIndex,
    HeadTemplate,
    Record,
    connection_of,
    fields_of,
    index_record,
    listed_offsets,
    number,
    op_of,
    read_index,
    record_at,
    time_ns,
)
from .columns import column, gather, words
from .inflate import CHUNK_BYTES, SLOW, inflate, inflate_part, keep_freed_memory
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
from .tally import NUMBERS, Tally
from .walk import bag_listed, bag_records

SLAB_BYTES = 1 << 20

_CHUNK_MARK = b"\x04\x00\x00\x00op=\x05"
_CHUNK_HEADER_BYTES = 128


class _Chunk(NamedTuple):
    """A chunk read ahead: where it ends, and where the index behind it says its messages are."""

    end: int
    offsets: Ints


def _inflated(
    read: Callable[[int, int], Bytes | bytes], record: Record, compression: str, size: int
) -> bytes:
    """The records of a compressed chunk; raises DamageError. For any thread if `read` is."""
    _check(record, size)
    return inflate(compression, read(record.data_at, record.data_size), size)


def _check(record: Record, size: int) -> None:
    if max(record.data_size, size) > CHUNK_BYTES:
        raise DamageError(f"a chunk declares more than {CHUNK_BYTES >> 20} MiB")


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
        self._ahead: Ahead[_Chunk] = Ahead()

    def run(self) -> Iterator[Block]:
        """All blocks up to the index, the end, or the last readable place."""
        keep_freed_memory()
        with self._ahead:
            yield from self._records()
            yield from self._caught_up(everything=True)
        self._tally.finish(self._index.counts if self._index is not None else {})

    def _records(self) -> Iterator[Block]:
        """Go through the records outside chunks."""
        window, position = self._window, len(MAGIC)
        while position < window.size:
            if self._index is not None and position == self._index.start:
                break
            try:
                record = record_at(window, position)
                if record.op not in (MESSAGE, BAG_HEADER, INDEX, CHUNK, CHUNK_INFO, CONNECTION):
                    raise DamageError("a record of an unknown kind")
            except DamageError:
                position = self._after(position)
                continue
            if record.op in (MESSAGE, CONNECTION):
                yield from self._caught_up(everything=True)
                position = yield from self._slab(position, record)
                continue
            if record.op == CHUNK:
                if record.end > window.size and self._next_chunk(position + 1) is not None:
                    position = self._after(position)
                    continue
                position = yield from self._chunk(record)
            else:
                if record.op == BAG_HEADER:
                    self._closed(record)
                position = record.end
            if position > window.size:
                self._findings.truncated = True
            window.passed(min(position, window.size))

    def _after(self, position: int) -> int:
        """Where reading can go on behind a damaged place; counts what is left out."""
        found = self._next_chunk(position + 1)
        if found is None:
            tail = self._window.size - position
            if self._index is None:
                self._findings.truncated = True
            self._findings.unreadable_bytes += tail
            return self._window.size
        self._findings.unreadable_bytes += found - position
        return found

    def _next_chunk(self, position: int) -> int | None:
        """Place of the next chunk record (or of the index) at or after `position`."""
        if self._index is not None:
            starts = self._index.chunk_starts
            at = int(np.searchsorted(starts, position))
            if at < len(starts):
                return int(starts[at])
            return self._index.start if position <= self._index.start else None
        window = self._window
        while position < window.size:
            data = window.view(position, SLAB_BYTES + _CHUNK_HEADER_BYTES).tobytes()
            mark = data.find(_CHUNK_MARK)
            while mark >= 0:
                found = self._chunk_around(position + mark)
                if found is not None and found >= position:
                    return found
                mark = data.find(_CHUNK_MARK, mark + 1)
            position += SLAB_BYTES
        return None

    def _chunk_around(self, mark: int) -> int | None:
        """Start of the chunk record whose `op` field stands at `mark`, None if there is none."""
        for start in range(mark - 4, max(mark - _CHUNK_HEADER_BYTES, 0), -1):
            try:
                record = record_at(self._window, start)
                number(record.fields, b"size")
            except DamageError:
                continue
            if record.op == CHUNK and record.data_at > mark:
                return start
        return None

    # Chunks

    def _chunk(self, record: Record) -> Walking:
        """Have a chunk inflated ahead, or take what it holds; returns where the next begins."""
        compression = record.fields.get(b"compression", b"none").decode("latin-1")
        try:
            size = number(record.fields, b"size")
        except DamageError as damage:
            self._damaged(str(damage), record.end)
            return record.end
        if size == 0 and record.data_size == 0:
            # The recorder died before it could fill in the head of its last chunk.
            yield from self._caught_up(everything=True)
            return (yield from self._open_chunk(record, compression))
        if record.end > self._window.size:
            yield from self._caught_up(everything=True)
            return (yield from self._cut_chunk(record, compression, size))
        offsets, position = self._index_behind(record.end, size)
        if compression == "none":
            yield from self._caught_up(everything=True)
            yield from self._plain(record, size, offsets)
        elif compression in SLOW:
            task = functools.partial(_inflated, self._window.copy, record, compression, size)
            self._ahead.begin(_Chunk(record.end, offsets), task, record.data_size + size)
            yield from self._caught_up()
        else:
            inline = functools.partial(_inflated, self._window.view, record, compression, size)
            self._ahead.put(_Chunk(record.end, offsets), inline)
            yield from self._caught_up()
        return position

    def _plain(self, record: Record, size: int, offsets: Ints) -> Iterator[Block]:
        """The messages of a chunk that is not compressed."""
        try:
            _check(record, size)
            if size != record.data_size:
                raise DamageError("a chunk does not have its declared size")
        except DamageError as damage:
            self._damaged(str(damage), record.end)
            return
        sparse = without_large(self._window, record, offsets, self._unwanted)
        where = bag_listed(sparse, offsets, least=1) if sparse is not None else None
        if sparse is not None and where is not None:
            yield from self._messages(sparse, where)
        else:
            data = self._window.view(record.data_at, size)
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
                self._damaged(str(damage), chunk.end)
                continue
            yield from self._messages(data, bag_listed(data, chunk.offsets))

    def _index_behind(self, position: int, size: int) -> tuple[Ints, int]:
        """Places of messages in a chunk of `size` by the index behind it, and where that ends."""
        offsets = [np.zeros(0, np.int64)]
        while (record := index_record(self._window.view(position, 128))) is not None:
            begin, end = record
            # Each entry stands for a record that takes more than the entry does.
            if end - begin <= size:
                offsets.append(listed_offsets(self._window.view(position + begin, end - begin)))
            position += end
        return np.concatenate(offsets), position

    def _damaged(self, reason: str, end: int) -> None:
        """Count a chunk that cannot be used, and its messages by the index that begins at `end`."""
        self._findings.damaged_chunks[reason] += 1
        try:
            while (record := record_at(self._window, end)).op == INDEX:
                self._count_lost(record)
                end = record.end
        except DamageError:
            # The index ends in something else; the walk will come to it.
            return

    def _open_chunk(self, record: Record, compression: str) -> Walking:
        self._findings.truncated = True
        if compression == "none":
            return record.data_at
        rest = self._window.view(record.data_at, CHUNK_BYTES)
        part = np.frombuffer(inflate_part(compression, rest, CHUNK_BYTES), np.uint8)
        yield from self._messages(part)
        return self._window.size

    def _cut_chunk(self, record: Record, compression: str, size: int) -> Walking:
        self._findings.truncated = True
        data = self._window.view(record.data_at, min(record.data_size, CHUNK_BYTES))
        if compression != "none":
            data = np.frombuffer(inflate_part(compression, data, size), np.uint8)
        yield from self._messages(data)
        return self._window.size

    def _closed(self, record: Record) -> None:
        """Report a bag without index; one whose header names its place was closed and had one."""
        try:
            index_at = number(record.fields, b"index_pos", 8)
        except DamageError:
            index_at = 0
        if self._index is None and index_at >= self._window.size:
            self._findings.truncated = True
        elif self._index is None:
            reason = "is damaged" if index_at else "was never written"
            self._findings.note(f"the index {reason}")

    def _count_lost(self, record: Record) -> None:
        try:
            key, count = number(record.fields, b"conn"), number(record.fields, b"count")
        except DamageError:
            return
        if record.data_size == count * INDEX_ENTRY:
            self._tally.lost(key, count)

    def _slab(self, position: int, record: Record) -> Walking:
        """Messages and connections outside chunks; returns the place of the next other record."""
        need = record.end - position
        if need > CHUNK_BYTES or record.end > self._window.size:
            self._findings.truncated = True
            return self._window.size
        data = self._window.view(position, max(SLAB_BYTES, need))
        # The first record is whole and of a right kind: it always gets on.
        stop = max(_whole_records(data, only=(MESSAGE, CONNECTION)), need)
        yield from self._messages(data[:stop])
        self._window.passed(position + stop)
        return position + stop

    # Messages

    def _messages(self, data: Bytes, where: Ints | None = None) -> Iterator[Block]:
        """The wanted messages in a run of records; connections met are taken in.

        where: all records in `data`, if an index has told.
        """
        if where is None:
            where, stop = bag_records(data)
            self._findings.unreadable_bytes += len(data) - stop
        if self._template is None:
            self._learn(data, where)
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
        for sink, rows in self._tally.met(np.minimum(conn, NUMBERS - 1), time):
            at = size_at[rows]
            size = words(data, "<u4", at).astype(np.int64)
            yield Block(data, sink, time[rows], at + 4, size)

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
        others = where[:0] if len(found) == len(where) else np.setdiff1d(where, found)
        return conn, time, found + (4 + template.size), others

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


def _whole_records(data: Bytes, only: tuple[int, ...] | None = None) -> int:
    """Length of the records at the front of `data` that are there to their last byte.

    only: stop at the first record of another kind.
    """
    raw, position, end = data.data, 0, len(data) - 8
    while position <= end:
        body = position + 4 + U32(raw, position)[0]
        if body > end + 4:
            break
        following = body + 4 + U32(raw, body)[0]
        if following > len(data):
            break
        if only is not None and not _is_kind(data, position, body, only):
            break
        position = following
    return position


def _is_kind(data: Bytes, position: int, body: int, kinds: tuple[int, ...]) -> bool:
    try:
        return op_of(fields_of(data[position + 4 : body].tobytes())) in kinds
    except DamageError:
        return False
