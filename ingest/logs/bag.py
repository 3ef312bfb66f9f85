"""ROS 1 bags (http://wiki.ros.org/Bags/Format/2.0), closed or `.active`, whole or damaged."""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator, Mapping
from contextlib import suppress
from functools import cached_property
from itertools import islice
from typing import NamedTuple

import numpy as np

from ...topology.arrays import IntArray
from ..remote.path import RemotePath
from .channels import NUMBERS, TOO_MANY, Channels
from .chunks import RECORD_BYTES, Chunk, ChunkedLog, ChunkIndex, Read, Scan, reader_of
from .columns import Shape, column, gather, words
from .messages import (
    NAME_BYTES,
    SCHEMA_BYTES,
    Block,
    Bytes,
    Channel,
    DamageError,
    Findings,
    Survey,
    Walking,
    normal_topic,
    normal_type,
    text,
)
from .source import SLAB_BYTES, Source, open_source
from .walk import bag_records

MAGIC = b"#ROSBAG V2.0\n"
MESSAGE, BAG_HEADER, INDEX, CHUNK, CHUNK_INFO, CONNECTION = 2, 3, 4, 5, 6, 7
"""Kinds of records."""

_IN_CHUNKS = frozenset({MESSAGE, CONNECTION})

HEAD_BYTES = 256
"""Bytes of a record that are looked at first: the headers of most."""

HEADER_BYTES = 2 * NAME_BYTES + 128
"""Largest record header accepted: it holds one or two names and a few numbers."""

INDEX_BYTES = 1 << 26
"""Largest index section read: a chunk with a dozen topics takes 200 bytes in it."""

TAIL_BYTES = 1 << 18
"""End of a damaged bag in which descriptions of connections are looked for."""

DESCRIBED = 1 << 18
"""Records of one file that are parsed one by one, 3 µs each: four for every connection."""

TRIES = 1 << 16
"""Places of one file that are looked at in search of a record, 10 µs each."""

COMPRESSIONS = {b"none": "", b"bz2": "bz2", b"lz4": "lz4"}

_FIELDS: Mapping[int, Mapping[bytes, int]] = {
    MESSAGE: {b"conn": 4, b"time": 8},
    BAG_HEADER: {b"index_pos": 8, b"conn_count": 4, b"chunk_count": 4},
    INDEX: {b"ver": 4, b"conn": 4, b"count": 4},
    CHUNK: {b"size": 4},
    CHUNK_INFO: {b"ver": 4, b"chunk_pos": 8, b"start_time": 8, b"end_time": 8, b"count": 4},
    CONNECTION: {b"conn": 4},
}
"""Numbers that a record of every kind has, and their bytes."""

_ITEMS = {INDEX: 12, CHUNK_INFO: 8}
"""Bytes of the data per item that the field `count` counts."""

_NAMES = {b"op", b"compression", b"topic"}.union(*_FIELDS.values())
_START = re.compile(rb"(?=..\0\0..\0\0(?:" + b"|".join(sorted(_NAMES)) + b")=)", re.DOTALL)
"""The front of a header: its length, and a field's length and name."""

_U32 = struct.Struct("<I").unpack_from

Fields = dict[bytes, bytes]


class Record(NamedTuple):
    """A record: its fields, kind, and the position and size of its data."""

    fields: Fields
    op: int
    data_at: int
    data_size: int

    @property
    def end(self) -> int:
        """Where the next record begins."""
        return self.data_at + self.data_size

    def number(self, name: bytes, size: int = 4) -> int:
        """An unsigned field of `size` bytes; raises DamageError."""
        return _number(self.fields, name, size)


def _fields(header: bytes) -> Fields:
    """The `name=value` fields of a header; raises DamageError."""
    fields: Fields = {}
    position = 0
    while position < len(header):
        if position + 4 > len(header):
            raise DamageError("a record header is cut")
        size = _U32(header, position)[0]
        field = header[position + 4 : position + 4 + size]
        name, equals, value = field.partition(b"=")
        if len(field) != size or not equals:
            raise DamageError("a record header is not made of fields")
        fields[name] = value
        position += 4 + size
    return fields


def _number(fields: Fields, name: bytes, size: int = 4) -> int:
    value = fields.get(name, b"")
    if len(value) != size:
        raise DamageError(f"a record lacks its field {name.decode()}")
    return int.from_bytes(value, "little")


def _time_ns(raw: bytes) -> int:
    """ROS time as nanoseconds."""
    return int.from_bytes(raw[:4], "little") * 10**9 + int.from_bytes(raw[4:], "little")


def record_at(read: Read, position: int) -> Record | None:
    """The record at `position`, None if its fields are not those of its kind.

    Its data may extend beyond the end. read: gives bytes of a place, fewer at the end.
    """
    head = read(position, HEAD_BYTES)
    size = _U32(head)[0] if len(head) >= 8 else 0
    if not 0 < size <= HEADER_BYTES:
        return None
    if size + 8 > len(head):
        head = read(position, size + 8)
        if size + 8 > len(head):
            return None
    try:
        fields = _fields(head[4 : 4 + size])
        record = Record(
            fields, _number(fields, b"op", 1), position + 8 + size, _U32(head, 4 + size)[0]
        )
        for name, width in _FIELDS.get(record.op, {b"op": 0}).items():
            record.number(name, width)
        if record.op in _ITEMS and record.number(b"count") * _ITEMS[record.op] != record.data_size:
            return None
        if record.op == CHUNK and fields.get(b"compression") not in COMPRESSIONS:
            return None
        return record
    except DamageError:
        return None


def _channel(fields: Fields, data: bytes) -> Channel:
    """The description of a connection record; raises DamageError."""
    described = _fields(data)
    definition = described.get(b"message_definition", b"")
    return Channel(
        normal_topic(text(fields.get(b"topic") or described.get(b"topic", b""))),
        normal_type(text(described.get(b"type", b""))),
        "ros1",
        definition if len(definition) <= SCHEMA_BYTES else b"",
        "ros1msg",
    )


class BagFile(ChunkedLog):
    """One ROS 1 bag of format 2.0, uncompressed, bz2 or lz4."""

    BEHIND = HEAD_BYTES

    @cached_property
    def index(self) -> BagIndex | None:
        """The index section of a closed bag, None if it is missing or wrong."""
        with open_source(self.path) as source:
            try:
                return _read_index(source)
            except DamageError:
                return None

    def _chunks(self) -> ChunkIndex | str:
        if self.index is None:
            return "it has no index, or a damaged one"
        if not isinstance(self.path, RemotePath):
            return "its index has no checksum"  # all is read, which is quick here
        return self.index.chunks

    def _scan(
        self, source: Source, channels: Channels, findings: Findings, by_index: bool
    ) -> BagScan:
        return BagScan(source, channels, findings, self.index, by_index)

    def survey(self, exact: bool = False) -> Survey | None:
        """Counts from the chunk infos of the index."""
        if self.index is None:
            return None
        counts: dict[Channel, int] = {}
        for key, channel in self.index.channels.items():
            counts[channel] = counts.get(channel, 0) + self.index.counts.get(key, 0)
        return Survey(counts, *self.index.span_ns)


class BagScan(Scan):
    """One scan of a bag."""

    def __init__(
        self,
        source: Source,
        channels: Channels,
        findings: Findings,
        index: BagIndex | None,
        by_index: bool,
    ) -> None:
        super().__init__(source, channels, findings)
        self._index = index
        self._template: HeadTemplate | None = None
        self._headers: set[bytes] = set()
        self._described, self._tries = DESCRIBED, TRIES
        if index is None:
            channels.take_index(_at_the_end(source), believed=True)
        else:
            channels.take_index(index.channels, believed=by_index)

    def all(self) -> Iterator[Block]:
        """All messages of the file, record by record, up to its index."""
        stop = self._source.size if self._index is None else self._index.start
        yield from self._walk(len(MAGIC), stop)
        yield from self._finish()

    def _declared(self) -> Mapping[int, int]:
        counts = self._index.counts if self._index is not None else {}
        if self.findings.whole and self._channels.lacks(counts):
            # Nothing is damaged: it is the index, which has no checksum, that is wrong.
            self.findings.note("the index counts other numbers of messages than there are")
            return {}
        return counts

    def _record(self, position: int) -> Record | None:
        return record_at(lambda at, n: self._source.view(at, n).tobytes(), position)

    def _walk(self, position: int, stop: int) -> Iterator[Block]:
        while position < stop:
            record = self._record(position)
            if record is None:
                position = yield from self._around_damage(position, stop)
                continue
            if record.op == CHUNK:
                chunk = _chunk(record)
                if record.end > stop or chunk.size == record.data_size == 0:
                    # Cut, or the recorder died before it could complete the header.
                    yield from self._open_chunk(chunk, stop)
                    return
                yield from self._take(chunk)
            elif record.end > stop:
                position = yield from self._around_damage(position, stop)
                continue
            elif record.op in _IN_CHUNKS:
                position = yield from self._loose(position, record, stop)
                continue
            elif record.op == INDEX and self._last is not None:
                self._last.listed[record.number(b"conn")] = record.number(b"count")
            elif record.op == BAG_HEADER and self._index is None:
                self._unclosed(record)
            position = record.end
            self._source.passed(position)

    def _unclosed(self, record: Record) -> None:
        """Report that the index is missing that the bag's header claims."""
        at = record.number(b"index_pos", 8)
        if at >= self._source.size:
            self.findings.truncated = True
        else:
            self.findings.note(f"the index {'is damaged' if at else 'was never written'}")

    def _open_chunk(self, chunk: Chunk, stop: int) -> Iterator[Block]:
        """The messages of the last chunk of a bag that was not closed."""
        self.findings.truncated = True
        if not chunk.compression:
            yield from self._caught_up()
            yield from self._walk(chunk.data_at, stop)
        else:
            yield from self._cut(chunk._replace(data_size=stop - chunk.data_at))

    def _loose(self, position: int, record: Record, stop: int) -> Walking:
        """Messages and connections outside chunks; returns the position of the next other
        record."""
        yield from self._caught_up()
        need = record.end - position
        if need > RECORD_BYTES:
            number = record.number(b"conn") if record.op == MESSAGE else NUMBERS
            if not self._channels.large(number, need):
                return record.end
        data = self._source.view(position, min(max(SLAB_BYTES, need), stop - position))
        where, end = bag_records(data)
        for place in self._columns(data, where)[3].tolist():
            other = record_at(reader_of(data), place)
            if other is None or other.op not in _IN_CHUNKS:
                end = max(place, need)
                break
        yield from self._blocks(data[:end], where[where < end])
        self._source.passed(position + end)
        return position + end

    def _next_record(self, read: Read, position: int, stop: int) -> int | None:
        while position < stop:
            raw = read(position, SLAB_BYTES + 32)
            for match in _START.finditer(raw, 0, SLAB_BYTES + 24):
                self._tries -= 1
                if self._tries < 0:
                    return None
                record = record_at(read, position + match.start())
                if record is None:
                    continue
                cut = record.end > stop and record.op == CHUNK
                if cut or record.end == stop or record_at(read, record.end) is not None:
                    return position + match.start()
            position += SLAB_BYTES
        return None

    def _plausible(self, position: int) -> bool:
        return self._record(position) is not None

    def _records(self, data: Bytes) -> tuple[IntArray, int]:
        return bag_records(data)

    def _head(self, data: Bytes) -> tuple[int, int]:
        record = record_at(reader_of(data), 0)
        if record is None or record.op not in _IN_CHUNKS:
            return 0, NUMBERS
        return record.end, record.number(b"conn") if record.op == MESSAGE else NUMBERS

    def _blocks(self, data: Bytes, where: IntArray) -> Iterator[Block]:
        conn, time, size_at, others = self._columns(data, where)
        extra = self._one_by_one(data, others)
        if extra:
            columns = np.stack([conn, time, size_at])
            conn, time, size_at = np.hstack([columns, np.array(extra, np.int64).T])
        if len(conn) == 0:
            return
        size = words(data, "<u4", size_at).astype(np.int64)
        for sink, rows in self._channels.met(np.minimum(conn, NUMBERS - 1), time):
            yield Block(data, sink, time[rows], size_at[rows] + 4, size[rows])

    def _columns(
        self, data: Bytes, where: IntArray
    ) -> tuple[IntArray, IntArray, IntArray, IntArray]:
        """Connection, time and position of the payload's size of messages like the template.

        Also the positions of the other records. All headers are gathered at once and compared with
        the template in the bytes that every message shares.
        """
        template = self._template = self._template or self._learned(data, where)
        if template is None:
            none = np.zeros(0, np.int64)
            return none, none, none, where
        inside = where[where + (template.size + 8) <= len(data)]
        heads = gather(data, inside, template.size + 4)
        other = template.shape.misfits(heads) if len(heads) else None
        found = inside
        if other is not None:
            found, heads = inside[~other], heads[~other]
        conn, time = template.read(heads)
        left = np.ones(len(where), bool)
        left[np.searchsorted(where, found)] = False
        return conn, time, found + (4 + template.size), where[left]

    def _learned(self, data: Bytes, where: IntArray) -> HeadTemplate | None:
        """The header of the first message as the template of all."""
        for place in where.tolist():
            record = record_at(reader_of(data), place)
            if record is not None and record.op == MESSAGE:
                return HeadTemplate.of(data[place : record.data_at - 4].tobytes())
        return None

    def _one_by_one(self, data: Bytes, places: IntArray) -> list[tuple[int, int, int]]:
        """Read connections, and messages whose header is not like the template's: connection, time
        and position of the payload's size."""
        out = []
        for place in places.tolist():
            size = _U32(data.data, place)[0]
            head = data[place : place + 4 + size].tobytes()
            if head in self._headers:
                continue  # writers repeat connections in every chunk
            self._described -= 1
            if self._described < 0:
                self.findings.note(TOO_MANY)
                break
            record = record_at(reader_of(data), place)
            if record is not None and record.op == MESSAGE:
                time = _time_ns(record.fields[b"time"])
                out.append((record.number(b"conn"), time, record.data_at - 4))
            elif record is not None and record.op == CONNECTION:
                body = data[record.data_at : record.end].tobytes()
                try:
                    self._channels.describe(record.number(b"conn"), _channel(record.fields, body))
                    self._headers.add(head)
                except DamageError:
                    self.findings.unreadable_bytes += size
            else:
                self.findings.unreadable_bytes += size
        return out


def _at_the_end(source: Source) -> dict[int, Channel]:
    """The connections described in the last bytes of a bag, where a closed one repeats them.

    Elsewhere they stand in the first chunk alone, which may be damaged.
    """
    out: dict[int, Channel] = {}
    tail = source.copy(source.size - TAIL_BYTES, TAIL_BYTES)
    read = reader_of(np.frombuffer(tail, np.uint8))
    for match in islice(_START.finditer(tail), DESCRIBED):
        record = record_at(read, match.start())
        if record is not None and record.op == CONNECTION and record.end <= len(tail):
            with suppress(DamageError):
                data = tail[record.data_at : record.end]
                out.setdefault(record.number(b"conn"), _channel(record.fields, data))
    return out


def _chunk(record: Record) -> Chunk:
    compression = COMPRESSIONS[record.fields[b"compression"]]
    size = record.number(b"size")
    return Chunk(compression, record.data_at, record.data_size, size, 0, {})


class HeadTemplate(NamedTuple):
    """Positions of the fields in a message record's header; most bags use one order throughout.

    size: bytes of the header, without its length; shape: bytes that all such headers share, length
    included; conn_at, time_at: positions from the record's start.
    """

    size: int
    shape: Shape
    conn_at: int
    time_at: int

    @classmethod
    def of(cls, head: bytes) -> HeadTemplate:
        """The template of one message record's header, length included."""
        # Values have a fixed length, so that their names are found where they are.
        conn_at, time_at = (head.index(name) + len(name) for name in (CONN, TIME))
        first, last = sorted(((conn_at, conn_at + 4), (time_at, time_at + 8)))
        fixed = ((0, first[0]), (first[1], last[0]), (last[1], len(head)))
        shape = Shape.of(np.frombuffer(head, np.uint8), fixed)
        return cls(len(head) - 4, shape, conn_at, time_at)

    def read(self, heads: Bytes) -> tuple[IntArray, IntArray]:
        """Connections and times [ns] of gathered headers, as rows."""
        time = column(heads, "<u4", self.time_at) * 10**9
        time += column(heads, "<u4", self.time_at + 4)
        return column(heads, "<u4", self.conn_at), time


CONN, TIME = b"\x09\0\0\0conn=", b"\x0d\0\0\0time="
"""Lengths and names of the fields of a message."""


class BagIndex(NamedTuple):
    """The index at the end of a closed bag. start: its position; counts: messages per
    connection."""

    start: int
    channels: dict[int, Channel]
    counts: dict[int, int]
    span_ns: tuple[int, int]
    chunks: ChunkIndex


def _read_index(source: Source) -> BagIndex | None:
    """The index of a bag, None if it is missing or inconsistent with the bag's header; raises
    DamageError."""
    header = record_at(source.copy, len(MAGIC))
    if header is None or header.op != BAG_HEADER:
        return None
    start, count = header.number(b"index_pos", 8), header.number(b"conn_count")
    if not header.end <= start <= source.size <= start + INDEX_BYTES:
        return None
    raw = source.copy(start, source.size - start)
    channels: dict[int, Channel] = {}
    infos: list[tuple[int, int, int, int]] = []
    pairs: list[bytes] = []
    position = 0
    while position < len(raw):
        record = record_at(lambda at, n: raw[at : at + n], position)
        if record is None or record.end > len(raw):
            raise DamageError("the index is cut")
        data = raw[record.data_at : record.end]
        if record.op == CONNECTION and len(channels) < min(count, NUMBERS):
            channels[record.number(b"conn")] = _channel(record.fields, data)
        elif record.op == CHUNK_INFO and len(data) <= 8 * count:
            first, last = (_time_ns(record.fields[name]) for name in (b"start_time", b"end_time"))
            infos.append((record.number(b"chunk_pos", 8), first, last, len(data) // 8))
            pairs.append(data)
        else:
            raise DamageError("the index holds other records")
        position = record.end
    if len(channels) != count or len(infos) != header.number(b"chunk_count"):
        return None
    order = sorted(range(len(infos)), key=lambda k: infos[k])
    begin, first_ns, last_ns, listed = (
        np.array([infos[k] for k in order], np.int64).reshape(-1, 4).T
    )
    held = np.frombuffer(b"".join(pairs[k] for k in order), "<u4").reshape(-1, 2).astype(np.int64)
    if begin.max(initial=0) >= start or not set(np.unique(held[:, 0]).tolist()) <= set(channels):
        return None
    chunk = np.repeat(np.arange(len(begin)), listed)
    end = np.append(begin[1:], start)[: len(begin)]
    index = ChunkIndex(begin, end, first_ns, last_ns, chunk, *held.T)
    filled = listed > 0
    span = int(first_ns[filled].min(initial=1 << 62)), int(last_ns[filled].max(initial=0))
    counts = index.counts(np.ones(len(begin), bool))
    return BagIndex(start, channels, counts, span if filled.any() else (0, 0), index)
