"""ROS 1 bags (http://wiki.ros.org/Bags/Format/2.0), closed or `.active`, whole or damaged."""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from ...topology.arrays import IntArray
from .channels import NUMBERS, TOO_MANY
from .chunks import HEAD_BYTES, INDEX_BYTES, Chunk, Found, Index, Read, Scan
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
from .source import Source
from .walk import bag_records

MAGIC = b"#ROSBAG V2.0\n"
MESSAGE, BAG_HEADER, INDEX, CHUNK, CHUNK_INFO, CONNECTION = 2, 3, 4, 5, 6, 7
"""Kinds of records."""

HEADER_BYTES = 2 * NAME_BYTES + 128
"""Largest record header accepted: it holds one or two names and a few numbers."""

DESCRIBED = 1 << 18
"""Records of one file that are parsed one by one, 3 µs each: four for every connection."""

INDEX_DAMAGED = "the index is damaged"

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


def _reader_of(data: Bytes) -> Read:
    return lambda at, count: data[at : at + count].tobytes()


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
    wanted = _FIELDS.get(record.op, {b"op": 1})
    if any(len(fields.get(name, b"")) != width for name, width in wanted.items()):
        return None
    unknown = record.op == CHUNK and fields.get(b"compression") not in COMPRESSIONS
    return None if unknown else record


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

    FIRST = len(MAGIC)
    FRONT = re.compile(rb"(?=..\0\0..\0\0(?:op=\x05|compression=|size=))", re.DOTALL)

    def __init__(self, *parts: Any) -> None:
        super().__init__(*parts)
        self._template: HeadTemplate | None = None
        self._headers: set[bytes] = set()
        self._described = DESCRIBED

    def _record_at(self, position: int) -> Found | None:
        record = record_at(self._source.read, position)
        if record is None or record.op != CHUNK:
            return None if record is None else Found(record.end)
        compression = COMPRESSIONS[record.fields[b"compression"]]
        size, packed = record.number(b"size"), record.data_size
        if size == packed == 0:  # the recorder died before it could complete the header
            size, packed = WHOLE_BYTES, self._stop
        chunk = Chunk(compression, record.data_at, packed, size)
        return Found(record.data_at + packed, chunk)

    def _records(self, data: Bytes) -> tuple[IntArray, int]:
        return bag_records(data)

    def _blocks(self, data: Bytes, where: IntArray) -> Iterator[Block]:
        """All headers are gathered at once and compared with the template, in the bytes that every
        message shares."""
        template = self._template = self._template or self._learned(data, where)
        if template is None:
            self._describe(data, where)
            return
        alike = where + (template.size + 8) <= len(data)
        heads = gather(data, where[alike], template.size + 4)
        other = template.shape.misfits(heads) if len(heads) else None
        if other is not None:
            alike[alike] = ~other
            heads = heads[~other]
        self._describe(data, where[~alike])
        if len(heads) == 0:
            return
        conn, time = template.read(heads)
        size_at = where[alike] + (4 + template.size)
        size = words(data, "<u4", size_at).astype(np.int64)
        for sink, rows in self._channels.met(np.minimum(conn, NUMBERS - 1), time):
            yield Block(data, sink, time[rows], size_at[rows] + 4, size[rows])

    def _learned(self, data: Bytes, where: IntArray) -> HeadTemplate | None:
        """The header of the first message as the template of all."""
        for place in where.tolist():
            record = record_at(_reader_of(data), place)
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
            record = record_at(_reader_of(data), place)
            try:
                if record is None or record.op != CONNECTION:
                    raise DamageError("no record of a chunk, or unlike the others")
                channel = _channel(record, data[record.data_at : record.end].tobytes())
                self._channels.describe(record.number(b"conn"), channel)
                self._headers.add(head)
            except DamageError:
                self._fault(*UNREADABLE, size)


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


def read_index(source: Source) -> Index:
    """The index of a bag; raises DamageError if it is missing or damaged."""
    header = record_at(source.read, len(MAGIC))
    if header is None or header.op != BAG_HEADER:
        raise DamageError(INDEX_DAMAGED)
    start, count = header.number(b"index_pos"), header.number(b"conn_count")
    if start == 0:
        raise DamageError("the index was never written")
    if start >= source.size:
        raise DamageError(CUT[1])
    if not header.end <= start <= source.size <= start + INDEX_BYTES:
        raise DamageError(INDEX_DAMAGED)
    raw = np.frombuffer(source.read(start, source.size - start), np.uint8)
    channels: dict[int, Channel] = {}
    counts: dict[int, int] = {}
    infos: list[tuple[int, frozenset[int]]] = []
    times: list[int] = []
    position = 0
    while position < len(raw):
        record = record_at(_reader_of(raw), position)
        if record is None or record.end > len(raw):
            raise DamageError(INDEX_DAMAGED)
        data = raw[record.data_at : record.end].tobytes()
        if record.op == CONNECTION and len(channels) < min(count, NUMBERS):
            channels[record.number(b"conn")] = _channel(record, data)
        elif record.op == CHUNK_INFO and len(data) <= 8 * count:
            held = dict(struct.iter_unpack("<II", data))
            for number, messages in held.items():
                counts[number] = counts.get(number, 0) + messages
            infos.append((record.number(b"chunk_pos"), frozenset(held)))
            times += [record.time_ns(b"start_time"), record.time_ns(b"end_time")] if held else []
        else:
            raise DamageError(INDEX_DAMAGED)
        position = record.end
    infos.sort(key=lambda info: info[0])
    begins = [begin for begin, _ in infos]
    sound = counts.keys() <= channels.keys() and max(begins, default=0) < start
    if not sound or (len(channels), len(infos)) != (count, header.number(b"chunk_count")):
        raise DamageError(INDEX_DAMAGED)
    ends = [*begins[1:], start]
    chunks = [(begin, end, held) for (begin, held), end in zip(infos, ends, strict=False)]
    span = (min(times), max(times)) if times else (0, 0)
    return Index(channels, counts, span, chunks, checked=False, start=start)
