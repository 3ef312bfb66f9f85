"""The records of a ROS 1 bag (format 2.0): header fields, connections, index, chunk heads."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from .chunk_index import ChunkIndex
from .columns import Shape, column
from .messages import (
    SCHEMA_BYTES,
    Bytes,
    Channel,
    DamageError,
    Ints,
    Survey,
    normal_topic,
    normal_type,
    text,
)
from .tally import NUMBERS
from .windows import RemoteWindow, Window

MAGIC = b"#ROSBAG V2.0\n"
MESSAGE, BAG_HEADER, INDEX, CHUNK, CHUNK_INFO, CONNECTION = 2, 3, 4, 5, 6, 7
"""Codes of the format (http://wiki.ros.org/Bags/Format/2.0)."""

HEADER_BYTES = 1 << 16
"""Longest record header that is believed: it holds one or two names, which take up to
4 KiB each."""

RECORD_BYTES = 16
"""No record is shorter: two lengths and the field that tells its kind."""

INDEX_BYTES = 1 << 27
"""Largest index section that is read: a chunk with a dozen topics takes 200 bytes in it,
so half a million of them."""

U32 = struct.Struct("<I").unpack_from
_U64 = struct.Struct("<Q").unpack_from
_TIME = struct.Struct("<II").unpack_from

Fields = Mapping[bytes, bytes]


def fields_of(header: bytes) -> dict[bytes, bytes]:
    """The `name=value` fields of a header; raises DamageError."""
    fields: dict[bytes, bytes] = {}
    position = 0
    while position < len(header):
        if position + 4 > len(header):
            raise DamageError("a record header is cut")
        size = U32(header, position)[0]
        field = header[position + 4 : position + 4 + size]
        name, equals, value = field.partition(b"=")
        if len(field) != size or not equals:
            raise DamageError("a record header is not made of fields")
        fields[name] = value
        position += 4 + size
    return fields


def number(fields: Fields, name: bytes, size: int = 4) -> int:
    """An unsigned field of `size` bytes; raises DamageError."""
    value = fields.get(name, b"")
    if len(value) != size:
        raise DamageError(f"a record lacks its field {name.decode()}")
    return int.from_bytes(value, "little")


def op_of(fields: Fields) -> int:
    """The kind of a record."""
    return number(fields, b"op", 1)


def time_ns(raw: bytes) -> int:
    """ROS time as nanoseconds."""
    if len(raw) != 8:
        raise DamageError("a record lacks its time")
    seconds, nanoseconds = _TIME(raw)
    return int(seconds) * 10**9 + int(nanoseconds)


class Record(NamedTuple):
    """A record at the top of a file: its fields and the place of its data."""

    fields: dict[bytes, bytes]
    op: int
    data_at: int
    data_size: int

    @property
    def end(self) -> int:
        """Where the next record begins."""
        return self.data_at + self.data_size


def record_at(window: Window, position: int) -> Record:
    """The record at `position`; its data may reach beyond the file. Raises DamageError."""
    head = window.view(position, 4)
    if len(head) < 4:
        raise DamageError("a record is cut")
    size = U32(head.data)[0]
    if not 0 < size <= HEADER_BYTES:
        raise DamageError("a record header has an impossible length")
    data = window.view(position + 4, size + 4)
    if len(data) < size + 4:
        raise DamageError("a record is cut")
    fields = fields_of(data[:size].tobytes())
    return Record(fields, op_of(fields), position + 8 + size, U32(data.data, size)[0])


def connection_of(fields: Fields, data: bytes) -> tuple[int, Channel]:
    """Number and description of a connection record; raises DamageError."""
    described = fields_of(data)
    definition = described.get(b"message_definition", b"")
    topic = fields.get(b"topic") or described.get(b"topic", b"")
    return number(fields, b"conn"), Channel(
        normal_topic(text(topic)),
        normal_type(text(described.get(b"type", b""))),
        "ros1",
        definition if len(definition) <= SCHEMA_BYTES else b"",
        "ros1msg",
    )


INDEX_ENTRY = 12
"""Bytes of an entry in an index record: a time and a place in the chunk."""


def listed_offsets(entries: Bytes) -> Ints:
    """Places in their chunk that the entries of an index record list, unchecked."""
    count = len(entries) // INDEX_ENTRY
    return np.asarray(np.ndarray((count, 3), "<u4", entries.data)[:, 2].astype(np.int64))


class ChunkInfo(NamedTuple):
    """Of one chunk: its place, its log times, and the messages per connection in it."""

    begin: int
    first_ns: int
    last_ns: int
    counts: list[list[int]]


class BagIndex(NamedTuple):
    """The index at the end of a closed bag.

    start: its place; chunk_starts: (c,) ascending; counts: messages per connection; infos: of
    every chunk, ascending.
    """

    start: int
    channels: dict[int, Channel]
    chunk_starts: Ints
    counts: dict[int, int]
    span_ns: tuple[int, int]
    infos: list[ChunkInfo]

    @property
    def chunks(self) -> ChunkIndex:
        """What is in which chunk; each reaches as far as the next one, with the index behind it."""
        stop = np.array([*self.chunk_starts[1:], self.start], np.int64)
        first = np.array([info.first_ns for info in self.infos], np.int64)
        last = np.array([info.last_ns for info in self.infos], np.int64)
        rows = [(k, *pair) for k, info in enumerate(self.infos) for pair in info.counts]
        chunk, channel, count = np.array(rows, np.int64).reshape(-1, 3).T
        channel = np.minimum(channel, NUMBERS - 1)
        return ChunkIndex(self.chunk_starts, stop[: len(first)], first, last, chunk, channel, count)

    def survey(self) -> Survey:
        """Counts per channel."""
        counts: dict[Channel, int] = {}
        for key, channel in self.channels.items():
            counts[channel] = counts.get(channel, 0) + self.counts.get(key, 0)
        return Survey(counts, *self.span_ns)


def read_index(window: Window) -> BagIndex | None:
    """The index of a bag, None where it is missing or does not agree with the bag's header."""
    try:
        header = record_at(window, len(MAGIC))
        start = number(header.fields, b"index_pos", 8)
        connections = number(header.fields, b"conn_count")
        chunks = number(header.fields, b"chunk_count")
        if header.op != BAG_HEADER or not header.end <= start <= window.size:
            return None
        if window.size - start > INDEX_BYTES:
            return None
        return _parse_index(window, start, connections, chunks)
    except DamageError:
        return None


def _parse_index(window: Window, start: int, connections: int, chunks: int) -> BagIndex | None:
    channels: dict[int, Channel] = {}
    infos: list[ChunkInfo] = []
    position = start
    if isinstance(window, RemoteWindow):
        window.copy(start, window.size - start)  # one request, not one per record
    while position < window.size:
        record = record_at(window, position)
        data = window.view(record.data_at, record.data_size).tobytes()
        if len(data) < record.data_size:
            return None
        if record.op == CONNECTION:
            key, channel = connection_of(record.fields, data)
            channels[key] = channel
        elif record.op == CHUNK_INFO:
            infos.append(_chunk_info(record.fields, data))
        else:
            return None
        position = record.end
    infos.sort()
    starts = [info.begin for info in infos]
    if len(channels) != connections or len(infos) != chunks or max(starts, default=0) >= start:
        return None
    counts: dict[int, int] = {}
    for info in infos:
        for key, count in info.counts:
            counts[key] = counts.get(key, 0) + count
    if not counts.keys() <= channels.keys():
        return None
    filled = [info for info in infos if info.counts]
    first = min((info.first_ns for info in filled), default=0)
    last = max((info.last_ns for info in filled), default=0)
    return BagIndex(start, channels, np.array(starts, np.int64), counts, (first, last), infos)


def _chunk_info(fields: Fields, data: bytes) -> ChunkInfo:
    if len(data) % 8:
        raise DamageError("a chunk info record is cut")
    counts = np.frombuffer(data, "<u4").reshape(-1, 2).tolist()
    begin = number(fields, b"chunk_pos", 8)
    first, last = (
        time_ns(fields.get(name, b"")) if data else 0 for name in (b"start_time", b"end_time")
    )
    return ChunkInfo(begin, first, last, counts)


class HeadTemplate(NamedTuple):
    """Where the fields of a message record's header lie; most bags use one order throughout.

    size: bytes of the header, without its length; shape: what every such header shares, length
    included; conn_at, time_at: places from the record's start.
    """

    size: int
    shape: Shape
    conn_at: int
    time_at: int

    @classmethod
    def of(cls, head: bytes) -> HeadTemplate:
        """The template of one message record's header (length included); raises DamageError."""
        fields = fields_of(head[4:])
        if op_of(fields) != MESSAGE:
            raise DamageError("not a message")
        number(fields, b"conn")
        time_ns(fields.get(b"time", b""))
        # The values are found behind their names; both have a fixed length just checked.
        conn_at = _field_at(head, b"conn=")
        time_at = _field_at(head, b"time=")
        first, last = sorted(((conn_at, conn_at + 4), (time_at, time_at + 8)))
        fixed = ((0, first[0]), (first[1], last[0]), (last[1], len(head)))
        shape = Shape.of(np.frombuffer(head, np.uint8), fixed)
        return cls(len(head) - 4, shape, conn_at, time_at)

    def read(self, heads: Bytes) -> tuple[Ints, Ints]:
        """Connections and times [ns] of gathered headers, as rows."""
        time = column(heads, "<u4", self.time_at) * 10**9
        time += column(heads, "<u4", self.time_at + 4)
        return column(heads, "<u4", self.conn_at), time


class IndexTemplate(NamedTuple):
    """The header of an index record, length included, and where its numbers lie.

    fixed: what such headers share, by its place.
    """

    head: bytes
    conn_at: int
    count_at: int
    fixed: tuple[slice, ...]

    @classmethod
    def of(cls, head: bytes) -> IndexTemplate:
        """The template of a sound header; raises DamageError if it lacks a number."""
        conn_at, count_at = _field_at(head, b"conn="), _field_at(head, b"count=")
        first, last = sorted((conn_at, count_at))
        fixed = (slice(first), slice(first + 4, last), slice(last + 4, len(head)))
        return cls(head, conn_at, count_at, fixed)

    def read(self, front: bytes) -> tuple[int, int, int] | None:
        """Connection, count, and place of the data of a record, by its first bytes.

        None if its header is not like this one, or its data have another size than the count says.
        """
        size = len(self.head)
        if len(front) < size + 4 or any(front[part] != self.head[part] for part in self.fixed):
            return None
        count = U32(front, self.count_at)[0]
        if U32(front, size)[0] != INDEX_ENTRY * count:
            return None
        return U32(front, self.conn_at)[0], count, size + 4


def _field_at(head: bytes, name: bytes) -> int:
    """Place of a field's value in a header whose length stands in front."""
    position = 4
    while position < len(head):
        size = U32(head, position)[0]
        if head.startswith(name, position + 4):
            return int(position + 4 + len(name))
        position += 4 + size
    raise DamageError(f"a record lacks its field {name.decode()}")
