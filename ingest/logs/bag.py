"""ROS 1 bags (http://wiki.ros.org/Bags/Format/2.0), closed or `.active`, whole or damaged."""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from ...topology.arrays import IntArray
from .channels import NUMBERS, TOO_MANY
from .chunks import RECORD_BYTES, Chunk, Index, Read, Scan, reader_of
from .columns import Shape, column, gather, words
from .inflate import WHOLE_BYTES
from .messages import (
    CUT,
    NAME_BYTES,
    SCHEMA_BYTES,
    UNREADABLE,
    Block,
    Bytes,
    Channel,
    DamageError,
    normal_topic,
    normal_type,
    text,
)
from .source import SLAB_BYTES, Source
from .walk import bag_records

MAGIC = b"#ROSBAG V2.0\n"
MESSAGE, BAG_HEADER, INDEX, CHUNK, CHUNK_INFO, CONNECTION = 2, 3, 4, 5, 6, 7
"""Kinds of records."""

HEAD_BYTES = 256
"""Bytes of a record that are looked at first: the headers of most."""

HEADER_BYTES = 2 * NAME_BYTES + 128
"""Largest record header accepted: it holds one or two names and a few numbers."""

INDEX_BYTES = 1 << 26
"""Largest index section read: a chunk with a dozen topics takes 200 bytes in it."""

DESCRIBED = 1 << 18
"""Records of one file that are parsed one by one, 3 µs each: four for every connection."""

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

    def number(self, name: bytes) -> int:
        """An unsigned field."""
        return int.from_bytes(self.fields[name], "little")

    def time_ns(self, name: bytes) -> int:
        """A time."""
        seconds, nanoseconds = struct.unpack("<II", self.fields[name])
        return int(seconds * 10**9 + nanoseconds)


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
    except DamageError:
        return None
    op = fields.get(b"op", b"")
    data_at, data_size = position + 8 + size, _U32(head, 4 + size)[0]
    record = Record(fields, op[0] if len(op) == 1 else 0, data_at, data_size)
    return record if _is_sound(record) else None


def _is_sound(record: Record) -> bool:
    """Whether a record has the fields of its kind."""
    wanted = _FIELDS.get(record.op, {b"op": 1})
    if any(len(record.fields.get(name, b"")) != width for name, width in wanted.items()):
        return False
    if record.op in _ITEMS and record.number(b"count") * _ITEMS[record.op] != record.data_size:
        return False
    return record.op != CHUNK or record.fields.get(b"compression") in COMPRESSIONS


def _channel(record: Record, data: bytes) -> Channel:
    """The description of a connection record; raises DamageError."""
    described = _fields(data)
    definition = described.get(b"message_definition", b"")
    return Channel(
        normal_topic(text(record.fields.get(b"topic") or described.get(b"topic", b""))),
        normal_type(text(described.get(b"type", b""))),
        "ros1",
        definition if len(definition) <= SCHEMA_BYTES else b"",
        "ros1msg",
    )


class BagScan(Scan):
    """One scan of a bag, uncompressed, bz2 or lz4."""

    def __init__(self, *parts: Any) -> None:
        super().__init__(*parts)
        self._template: HeadTemplate | None = None
        self._headers: set[bytes] = set()
        self._described = DESCRIBED

    def all(self) -> Iterator[Chunk]:
        """All chunks up to the index, and runs of records outside of them."""
        position = len(MAGIC)
        stop = self._source.size if self._index is None else self._index.start
        while position < stop:
            record = record_at(self._source.read, position)
            chunk = _chunk(record) if record is not None else None
            if chunk is not None and (chunk.cut or chunk.at + chunk.packed > stop):
                if chunk.compression:
                    # Cut, or the recorder died before it could complete the header.
                    size = max(chunk.size, WHOLE_BYTES)
                    yield chunk._replace(packed=stop - chunk.at, size=size, cut=True)
                    return
                self.findings.faults[CUT] = 1
                position = chunk.at
            elif record is None or record.end > stop:
                position = self._around_damage(position, stop)
            elif chunk is not None:
                yield chunk
                position = record.end
            elif record.op in (MESSAGE, CONNECTION):
                size = self._loose(position, record.end - position)
                yield Chunk("", position, size, size)
                position += size
            else:
                if record.op == BAG_HEADER and self._index is None:
                    self._unclosed(record)
                position = record.end

    def _unclosed(self, record: Record) -> None:
        """Report that the index is missing that the bag's header claims."""
        at = record.number(b"index_pos")
        if at >= self._source.size:
            self.findings.faults[CUT] = 1
        else:
            self.findings.note(f"the index {'is damaged' if at else 'was never written'}")

    def _loose(self, position: int, need: int) -> int:
        """Bytes of the messages and connections outside chunks from a position on, of which the
        first takes `need`."""
        if need > RECORD_BYTES:
            return need
        data = np.frombuffer(self._source.read(position, max(SLAB_BYTES, need)), np.uint8)
        where, size = bag_records(data)
        for place in self._columns(data, where)[3].tolist():
            other = record_at(reader_of(data), place)
            if other is None or other.op not in (MESSAGE, CONNECTION):
                return max(int(place), need)
        return size

    front = 33

    def _starts(self, raw: bytes, most: int) -> Iterator[int]:
        return (match.start() for match in _START.finditer(raw, 0, len(raw) - 8))

    def _leads_on(self, read: Read, position: int, stop: int) -> bool:
        record = record_at(read, position)
        if record is None:
            return False
        cut = record.end > stop and record.op == CHUNK
        return cut or record.end == stop or record_at(read, record.end) is not None

    def _chunk_at(self, position: int) -> Chunk | None:
        record = record_at(self._source.read, position)
        return None if record is None else _chunk(record)

    def _records(self, data: Bytes) -> tuple[IntArray, int]:
        return bag_records(data)

    def _record_size(self, data: Bytes) -> int:
        record = record_at(reader_of(data), 0)
        return record.end if record is not None and record.op in (MESSAGE, CONNECTION) else 0

    def _blocks(self, data: Bytes, where: IntArray) -> Iterator[Block]:
        conn, time, size_at, others = self._columns(data, where)
        self._describe(data, others)
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
        inside = where + (template.size + 8) <= len(data)
        heads = gather(data, where[inside], template.size + 4)
        other = template.shape.misfits(heads) if len(heads) else None
        alike = inside.copy()
        if other is not None:
            alike[inside] = ~other
            heads = heads[~other]
        conn, time = template.read(heads)
        return conn, time, where[alike] + (4 + template.size), where[~alike]

    def _learned(self, data: Bytes, where: IntArray) -> HeadTemplate | None:
        """The header of the first message as the template of all."""
        for place in where.tolist():
            record = record_at(reader_of(data), place)
            if record is not None and record.op == MESSAGE:
                return HeadTemplate.of(data[place : record.data_at - 4].tobytes())
        return None

    def _describe(self, data: Bytes, places: IntArray) -> None:
        """Read connections; other records, and messages unlike the template, count as damaged."""
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
            try:
                if record is None or record.op != CONNECTION:
                    raise DamageError("no record of a chunk, or unlike the others")
                channel = _channel(record, data[record.data_at : record.end].tobytes())
                self._channels.describe(record.number(b"conn"), channel)
                self._headers.add(head)
            except DamageError:
                self._fault(*UNREADABLE, size)


def _chunk(record: Record) -> Chunk | None:
    """The chunk of a record; one that says that it is empty is still open, so that it is cut."""
    if record.op != CHUNK:
        return None
    compression = COMPRESSIONS[record.fields[b"compression"]]
    size = record.number(b"size")
    open_ = size == record.data_size == 0
    return Chunk(compression, record.data_at, record.data_size, size, cut=open_)


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
        names = (b"\x09\0\0\0conn=", b"\x0d\0\0\0time=")
        conn_at, time_at = (head.index(name) + len(name) for name in names)
        first, last = sorted(((conn_at, conn_at + 4), (time_at, time_at + 8)))
        fixed = ((0, first[0]), (first[1], last[0]), (last[1], len(head)))
        shape = Shape.of(np.frombuffer(head, np.uint8), fixed)
        return cls(len(head) - 4, shape, conn_at, time_at)

    def read(self, heads: Bytes) -> tuple[IntArray, IntArray]:
        """Connections and times [ns] of gathered headers, as rows."""
        time = column(heads, "<u4", self.time_at) * 10**9
        time += column(heads, "<u4", self.time_at + 4)
        return column(heads, "<u4", self.conn_at), time


def read_index(source: Source) -> Index | None:
    """The index of a bag, None if it is missing or inconsistent with the bag's header; raises
    DamageError."""
    header = record_at(source.read, len(MAGIC))
    if header is None or header.op != BAG_HEADER:
        return None
    start, count = header.number(b"index_pos"), header.number(b"conn_count")
    if not header.end <= start <= source.size <= start + INDEX_BYTES:
        return None
    raw = source.read(start, source.size - start)
    channels: dict[int, Channel] = {}
    counts: dict[int, int] = {}
    infos: list[tuple[int, frozenset[int]]] = []
    times: list[int] = []
    position = 0
    while position < len(raw):
        record = record_at(lambda at, n: raw[at : at + n], position)
        if record is None or record.end > len(raw):
            raise DamageError("the index is cut")
        data = raw[record.data_at : record.end]
        if record.op == CONNECTION and len(channels) < min(count, NUMBERS):
            channels[record.number(b"conn")] = _channel(record, data)
        elif record.op == CHUNK_INFO and len(data) <= 8 * count:
            held = dict(struct.iter_unpack("<II", data))
            for number, messages in held.items():
                counts[number] = counts.get(number, 0) + messages
            infos.append((record.number(b"chunk_pos"), frozenset(held)))
            times += [record.time_ns(b"start_time"), record.time_ns(b"end_time")] if held else []
        else:
            raise DamageError("the index holds other records")
        position = record.end
    if len(channels) != count or len(infos) != header.number(b"chunk_count"):
        return None
    infos.sort(key=lambda info: info[0])
    begins = [begin for begin, _ in infos]
    if not counts.keys() <= channels.keys() or max(begins, default=0) >= start:
        return None
    ends = [*begins[1:], start]
    chunks = [(begin, end, held) for (begin, held), end in zip(infos, ends, strict=False)]
    span = (min(times), max(times)) if times else (0, 0)
    return Index(channels, counts, span, chunks, "", checked=False, start=start)
