"""The records of a ROS 1 bag (format 2.0): header fields, connections, index, chunk heads."""

from __future__ import annotations

import struct
from array import array
from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...topology.arrays import IntArray
from .chunk_index import ChunkIndex
from .columns import Shape, column
from .described import Described
from .messages import (
    NAME_BYTES,
    SCHEMA_BYTES,
    Bytes,
    Channel,
    DamageError,
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

HEADER_BYTES = 2 * NAME_BYTES + 128
"""Largest record header accepted: it holds one or two names and a few numbers."""

INDEX_BYTES = 1 << 26
"""Largest index section read: a chunk with a dozen topics takes 200 bytes in it, so 300,000 of
them."""

U32 = struct.Struct("<I").unpack_from
U64 = struct.Struct("<Q").unpack_from
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
    """A record outside chunks: its fields and the position of its data."""

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


_CONNECTION, _NUMBER = (U64(field)[0] for field in (b"\4\0\0\0op=\7", b"\x09\0\0\0conn"))


def numbers_of(heads: Bytes) -> IntArray:
    """(n,) numbers of connections by the first bytes of records, as rows; -1 for other records."""
    out, is_connection = np.full(len(heads), -1), np.zeros(len(heads), bool)
    for at in range(4, heads.shape[1] - 12):
        word = np.ndarray((len(heads),), "<u8", heads.data, at, (heads.shape[1],))
        is_connection |= word == _CONNECTION
        named = (word == _NUMBER).nonzero()[0]
        out[named] = column(heads[named], "<u4", at + 9)
    out[~is_connection] = -1
    return out


INDEX_ENTRY = 12
"""Bytes of an entry in an index record: a time and a place in the chunk."""


def listed_offsets(entries: Bytes) -> IntArray:
    """Positions in their chunk that the entries of an index record list, unchecked."""
    count = len(entries) // INDEX_ENTRY
    return np.asarray(np.ndarray((count, 3), "<u4", entries.data)[:, 2].astype(np.int64))


class BagIndex(NamedTuple):
    """The index at the end of a closed bag.

    start: its position; told: the connection records; counts: messages per connection;
    chunk_starts, first_ns, last_ns, listed: (c,) of every chunk, ascending: its position, its log
    times, and the number of connections in it; pairs: (k, 2) these connections, chunk by chunk,
    with the number of messages of each.
    """

    start: int
    channels: dict[int, Channel]
    told: dict[int, bytes]
    chunk_starts: IntArray
    first_ns: IntArray
    last_ns: IntArray
    listed: IntArray
    pairs: NDArray[np.uint32]
    counts: dict[int, int]

    @property
    def chunks(self) -> ChunkIndex:
        """The contents of each chunk, which extends up to the next one, including its index
        records."""
        begin = self.chunk_starts
        stop = np.append(begin[1:], self.start)[: len(begin)]
        channel, count = self.pairs.T.astype(np.int64)
        channel = np.minimum(channel, NUMBERS - 1)
        chunk = np.repeat(np.arange(len(begin)), self.listed)
        return ChunkIndex(begin, stop, self.first_ns, self.last_ns, chunk, channel, count)

    @property
    def span_ns(self) -> tuple[int, int]:
        """First and last log time; 0 if there are no messages."""
        first, last = self.first_ns[self.listed > 0], self.last_ns[self.listed > 0]
        return (int(first.min()), int(last.max())) if len(first) else (0, 0)

    def survey(self) -> Survey:
        """Counts per channel."""
        counts: dict[Channel, int] = {}
        for key, channel in self.channels.items():
            counts[channel] = counts.get(channel, 0) + self.counts.get(key, 0)
        return Survey(counts, *self.span_ns)


def read_index(window: Window) -> BagIndex | None:
    """The index of a bag, None if it is missing or inconsistent with the bag's header."""
    try:
        header = record_at(window, len(MAGIC))
        start = number(header.fields, b"index_pos", 8)
        connections = number(header.fields, b"conn_count")
        chunks = number(header.fields, b"chunk_count")
        if header.op != BAG_HEADER or not header.end <= start <= window.size:
            return None
        if window.size - start > INDEX_BYTES or connections > NUMBERS:
            return None
        return _parse_index(window, start, connections, chunks)
    except DamageError:
        return None


def _parse_index(window: Window, start: int, connections: int, chunks: int) -> BagIndex | None:
    described, channels, told = Described(), dict[int, Channel](), dict[int, bytes]()
    infos, listed = array("q"), bytearray()
    position = start
    if isinstance(window, RemoteWindow):
        window.copy(start, window.size - start)  # one request, not one per record
    while position < window.size:
        record = record_at(window, position)
        info = _chunk_info(record, connections) if record.op == CHUNK_INFO else ()
        data = window.view(record.data_at, record.data_size)
        if len(data) < record.data_size:
            return None
        if record.op == CONNECTION:
            whole = window.view(position, record.end - position).tobytes()
            key, channel = connection_of(record.fields, whole[record.data_at - position :])
            if told.setdefault(key, whole) != whole or not described.add(whole):
                return None
            channels[key] = channel
        elif info:
            infos.extend(info)
            listed += data.data
        else:
            return None
        position = record.end
    begin, *times, count = np.frombuffer(infos, np.int64).reshape(-1, 4).T
    if len(channels) != connections or len(begin) != chunks or begin.max(initial=0) >= start:
        return None
    pairs, order = np.frombuffer(listed, "<u4").reshape(-1, 2), np.argsort(begin, kind="stable")
    if (np.diff(order) < 0).any():
        parts = np.split(pairs, np.cumsum(count[:-1]))
        pairs = np.concatenate([parts[k] for k in order.tolist()])
    counts = _totals(pairs, channels)
    if counts is None:
        return None
    begin, first, last, count = (column[order] for column in (begin, *times, count))
    return BagIndex(start, channels, told, begin, first, last, count, pairs, counts)


def _chunk_info(record: Record, connections: int) -> tuple[int, int, int, int]:
    """Position, first and last time of a chunk, and number of connections in it.

    Raises DamageError; connections: number in the file.
    """
    if record.data_size % 8 or record.data_size > 8 * connections:
        raise DamageError("a chunk info record is cut, or counts more connections than there are")
    begin = number(record.fields, b"chunk_pos", 8)
    first, last = (
        time_ns(record.fields.get(name, b"")) if record.data_size else 0
        for name in (b"start_time", b"end_time")
    )
    if begin >= 1 << 63:
        raise DamageError("a chunk is nowhere in a file")
    return begin, first, last, record.data_size // 8


def _totals(pairs: NDArray[np.uint32], channels: Iterable[int]) -> dict[int, int] | None:
    """Messages per connection that has any, None if one is not described."""
    known = np.array(sorted(channels), np.uint32)
    at = np.searchsorted(known, pairs[:, 0])
    if len(pairs) and (at.max() == len(known) or (known[at] != pairs[:, 0]).any()):
        return None
    totals = np.zeros(len(known), np.int64)
    np.add.at(totals, at, pairs[:, 1])
    met = np.bincount(at, minlength=len(known)).nonzero()[0]
    return dict(zip(known[met].tolist(), totals[met].tolist(), strict=True))


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

    def read(self, heads: Bytes) -> tuple[IntArray, IntArray]:
        """Connections and times [ns] of gathered headers, as rows."""
        time = column(heads, "<u4", self.time_at) * 10**9
        time += column(heads, "<u4", self.time_at + 4)
        return column(heads, "<u4", self.conn_at), time


class IndexTemplate(NamedTuple):
    """The header of an index record, length included, and the positions of its numbers.

    fixed: bytes that such headers share.
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
        """Connection, count, and position of the data of a record, by its first bytes.

        None if its header is not like this one, or the size of its data contradicts the count.
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
