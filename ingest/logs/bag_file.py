"""ROS 1 bags, closed or `.active`: a walk over chunks that needs no index and survives damage."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from .bag_wire import (
    BAG_HEADER,
    CHUNK,
    CHUNK_INFO,
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
    number,
    op_of,
    read_index,
    record_at,
    time_ns,
)
from .inflate import CHUNK_BYTES, inflate, inflate_part, keep_freed_memory
from .messages import (
    Block,
    Bytes,
    Channel,
    DamageError,
    FileWindow,
    Findings,
    Ints,
    Progress,
    Survey,
    Walking,
    Want,
)
from .walk import bag_records

_UNKNOWN = -2
_CONNECTIONS = 1 << 16
"""Connection numbers from here on are not believed."""

SLAB_BYTES = 1 << 20

_CHUNK_MARK = b"\x04\x00\x00\x00op=\x05"
_INDEX_MARK = b"\x04\x00\x00\x00op=\x04"
_CHUNK_HEADER_BYTES = 128


class BagFile:
    """One ROS 1 bag of format 2.0, uncompressed, bz2 or lz4."""

    format = "bag"

    def __init__(self, path: Path) -> None:
        self.path = path
        self._index: BagIndex | None = None
        self._index_read = False

    def index(self) -> BagIndex | None:
        """The index section of a closed bag, None where it is missing or wrong."""
        if not self._index_read:
            with FileWindow(self.path) as window:
                self._index = read_index(window)
            self._index_read = True
        return self._index

    def survey(self, exact: bool = False) -> Survey | None:
        """Counts from the chunk infos of the index."""
        index = self.index()
        return index.survey() if index is not None else None

    def blocks(
        self, want: Want, findings: Findings, progress: Progress | None = None
    ) -> Iterator[Block]:
        """Walk the file once. O(bytes); memory: one chunk, compressed and inflated."""
        with FileWindow(self.path, progress) as window:
            yield from _Walk(window, want, findings, self.index()).run()
            window.passed(window.size)


class _Walk:
    """One pass over a bag."""

    def __init__(
        self, window: FileWindow, want: Want, findings: Findings, index: BagIndex | None
    ) -> None:
        self._window = window
        self._want = want
        self._findings = findings
        self._index = index
        self._channels: dict[int, Channel] = {}
        self._sink = np.full(_CONNECTIONS, _UNKNOWN, np.int64)
        self._met = np.zeros(_CONNECTIONS, np.int64)
        self._lost: dict[int, int] = {}
        self._template: HeadTemplate | None = None
        self._after_damage = False
        if index is not None:
            for key, channel in index.channels.items():
                self._describe(key, channel)

    def run(self) -> Iterator[Block]:
        """All blocks up to the index, the end, or the last readable place."""
        keep_freed_memory()
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
                position = yield from self._slab(position, record)
                continue
            if record.op == CHUNK:
                if record.end > window.size and self._next_chunk(position + 1) is not None:
                    position = self._after(position)
                    continue
                position = yield from self._chunk(record)
                if not self._after_damage:
                    position = self._behind_index(position)
            else:
                if record.op == INDEX and self._after_damage:
                    self._count_lost(record)
                elif record.op == BAG_HEADER:
                    self._closed(record)
                position = record.end
            if position > window.size:
                self._findings.truncated = True
            window.passed(min(position, window.size))
        self._finish()

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
        """The messages of a chunk; returns where the next record begins."""
        self._after_damage = False
        window = self._window
        compression = record.fields.get(b"compression", b"none").decode("latin-1")
        try:
            size = number(record.fields, b"size")
            if size == 0 and record.data_size == 0:
                # The recorder died before it could fill in the head of its last chunk.
                return (yield from self._open_chunk(record, compression))
            if record.end > window.size:
                return (yield from self._cut_chunk(record, compression, size))
            if record.data_size > CHUNK_BYTES:
                raise DamageError(f"a chunk declares more than {CHUNK_BYTES >> 20} MiB")
            data = window.view(record.data_at, record.data_size)
            if compression == "none":
                if size != record.data_size:
                    raise DamageError("a chunk does not have its declared size")
            else:
                data = np.frombuffer(inflate(compression, data, size), np.uint8)
        except DamageError as damage:
            self._findings.damaged_chunks[str(damage)] += 1
            self._after_damage = True
            return record.end
        yield from self._messages(data)
        return record.end

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

    def _behind_index(self, position: int) -> int:
        """Place behind the index records at `position`: of no use, so they are not parsed."""
        while True:
            head = self._window.view(position, 128).tobytes()
            if len(head) < 128:
                return position
            size = U32(head)[0]
            if size > 100 or _INDEX_MARK not in head[4 : 4 + size]:
                return position
            position += 8 + size + int(U32(head, 4 + size)[0])

    def _count_lost(self, record: Record) -> None:
        try:
            key, count = number(record.fields, b"conn"), number(record.fields, b"count")
        except DamageError:
            return
        if record.data_size == count * 12:
            self._lost[key] = self._lost.get(key, 0) + count

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

    def _messages(self, data: Bytes) -> Iterator[Block]:
        """The wanted messages in a run of records; connections met are taken in."""
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
        known = np.minimum(conn, _CONNECTIONS - 1)
        counts = np.bincount(known)
        self._met[: len(counts)] += counts
        self._findings.span(int(time.min()), int(time.max()))
        sink = self._sink[known]
        keep = sink >= 0
        if keep.any():
            size_at = size_at[keep]
            size = _rows(data, size_at, 4).view("<u4")[:, 0].astype(np.int64)
            yield Block(data, sink[keep], time[keep], size_at + 4, size)

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
        heads = _rows(data, inside, template.size + 4)
        same = heads[:, template.fixed] == template.head[template.fixed]
        found = inside
        if not same.all():
            like = same.all(axis=1)
            found, heads = inside[like], heads[like]
        conn = _word(heads, template.conn_at)
        time = _word(heads, template.time_at) * 10**9 + _word(heads, template.time_at + 4)
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
                    self._describe(*connection_of(fields, data[size_at + 4 : end].tobytes()))
                else:
                    raise DamageError("unexpected record")
            except DamageError:
                self._findings.unreadable_bytes += size
        return out

    def _describe(self, key: int, channel: Channel) -> None:
        if key < _CONNECTIONS - 1 and self._channels.get(key) != channel:
            self._channels[key] = channel
            self._sink[key] = self._want(channel)

    def _finish(self) -> None:
        """Turn counts per connection into findings, and compare them with the index."""
        findings = self._findings
        for key in np.flatnonzero(self._met).tolist():
            channel = self._channels.get(key)
            if channel is None:
                findings.unknown += int(self._met[key])
            else:
                findings.seen(channel, int(self._met[key]))
        lost = self._lost
        if self._index is not None:
            met = self._met
            lost = {
                key: count - int(met[key]) if key < _CONNECTIONS else count
                for key, count in self._index.counts.items()
            }
        for key, count in lost.items():
            if count > 0:
                channel = self._channels.get(key)
                findings.lost[channel.topic if channel else "an unknown topic"] += count


def _rows(data: Bytes, where: Ints, width: int) -> Bytes:
    """(len(where), width) bytes of `data` from each place on, gathered as opaque items."""
    if len(where) == 0:
        return np.zeros((0, width), np.uint8)
    items = np.ndarray((len(data) - width + 1,), f"V{width}", data.data, strides=(1,))[where]
    return items.view(np.uint8).reshape(len(where), width)


def _word(rows: Bytes, at: int) -> Ints:
    """The little-endian 32-bit word at one place of every row."""
    return np.ascontiguousarray(rows[:, at : at + 4]).view("<u4")[:, 0].astype(np.int64)


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
