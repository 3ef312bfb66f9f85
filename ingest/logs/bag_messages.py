"""The messages in runs of bag records, with the connection records among them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from ...topology.arrays import IntArray
from .bag_heads import BagHeads
from .bag_mend import mended
from .bag_wire import (
    CONNECTION,
    MESSAGE,
    U32,
    Fields,
    HeadTemplate,
    connection_of,
    fields_of,
    number,
    numbers_of,
    op_of,
    time_ns,
)
from .columns import MANY, column, gather, without_repeats, words
from .described import TOO_MANY, Described, contradicts, short
from .messages import MESSAGE_BYTES, UNWANTED, Block, Bytes, DamageError, Findings
from .tally import NUMBERS, Tally
from .walk import bag_listed, bag_records, inside, seamless

HEAD_BYTES = 64
"""Bytes of many records examined together: number and kind of most connections."""


class MessageReader:
    """Turns runs of records of one bag into blocks of messages.

    told: the connection records of the index; packed: whether the bag has compressed chunks, where
    damage may produce records that were never written.
    """

    def __init__(
        self, heads: BagHeads, tally: Tally, findings: Findings, told: Mapping[int, bytes]
    ) -> None:
        self._told = told
        self.heads = heads
        self.tally = tally
        self.findings = findings
        self.packed = False
        self._described = Described()
        self._template: HeadTemplate | None = None

    def blocks(self, data: Bytes, offsets: Sequence[IntArray] = ()) -> Iterator[Block]:
        """The wanted messages in a run of records; offsets: their positions by an index."""
        listed = self.listed(data, np.concatenate(offsets)) if offsets else None
        if listed is None:
            where, stop = bag_records(data)
            if stop != len(data):
                data, where = self._mended(data)
            listed = self._records(data, where)
        yield from listed

    def listed(self, data: Bytes, offsets: IntArray) -> Iterator[Block] | None:
        """The same by the listed positions of messages; None unless the index is proven right."""
        regular = self._regular(data, offsets)
        if regular is not None:
            return self._blocks(data, *regular)
        where = bag_listed(data, offsets)
        return None if where is None else self._records(data, where)

    def _regular(
        self, data: Bytes, offsets: IntArray
    ) -> tuple[IntArray, IntArray, IntArray, IntArray] | None:
        """Connection, time, size and its position, of messages in data that hold nothing else.

        None unless all are like the template and each ends where the next begins, from the first
        byte to the last: a scan would then find exactly these.
        """
        template = self._template
        if template is None:
            return None
        where = inside(offsets, len(data) - (template.size + 8))
        if where is None or where[0]:
            return None
        heads = gather(data, where, template.size + 8)
        if template.shape.misfits(heads) is not None:
            return None
        size, size_at = column(heads, "<u4", 4 + template.size), where + (4 + template.size)
        if not seamless(where, size_at + 4 + size, len(data)):
            return None
        return (*template.read(heads), size, size_at)

    def _records(self, data: Bytes, where: IntArray) -> Iterator[Block]:
        """The wanted messages among records; connections are learned."""
        conn, time, size_at, others = self.columns(data, where)
        if len(others) and any(self.heads.within(data).record(k) is None for k in others.tolist()):
            data, where = self._mended(data)
            conn, time, size_at, others = self.columns(data, where)
        extra = self.one_by_one(data, others)
        if extra:
            columns = np.stack([conn, time, size_at])
            conn, time, size_at = np.hstack([columns, np.array(extra, np.int64).T])
        size = words(data, "<u4", size_at).astype(np.int64)
        yield from self._blocks(data, conn, time, size, size_at)

    def _blocks(
        self, data: Bytes, conn: IntArray, time: IntArray, size: IntArray, size_at: IntArray
    ) -> Iterator[Block]:
        """The wanted ones among messages."""
        if len(conn) == 0:
            return
        conn = np.minimum(conn, NUMBERS - 1)
        counts = np.bincount(conn)
        if not self.tally.all_usual(counts):
            self.tally.adopt(conn)
        for sink, rows in self.tally.met(conn, time, counts):
            yield Block(data, sink, time[rows], size_at[rows] + 4, size[rows])

    def front(self, data: Bytes) -> Iterator[Block]:
        """The messages in complete records at the front of truncated data."""
        where, stop = bag_records(data)
        self.findings.unreadable_bytes += len(data) - stop
        yield from self._records(data[:stop], where)

    def _mended(self, data: Bytes) -> tuple[Bytes, IntArray]:
        """Damaged records without unrecoverable ones, and their positions."""
        found = mended(data, self.heads.within(data))
        self.findings.unreadable_bytes += found.unreadable
        self.findings.repaired += found.repaired
        if not self.packed:
            # What a broken stream gives may be records that were never written.
            for key in found.lost:
                self.tally.lost(key, 1)
        return found.data, found.where

    def _learn(self, data: Bytes, where: IntArray) -> None:
        """Use the header of the first message as the template of all."""
        for place in where.tolist():
            size = U32(data.data, place)[0]
            try:
                self._template = HeadTemplate.of(data[place : place + 4 + size].tobytes())
            except DamageError:
                continue
            return

    def columns(
        self, data: Bytes, where: IntArray
    ) -> tuple[IntArray, IntArray, IntArray, IntArray]:
        """Connection, time and position of the payload's size of messages like the template;
        positions of other records."""
        if self._template is None:
            self._learn(data, where)
        conn, time, size_at, others = self._columns(data, where)
        if len(others) > self._described.left:
            others = self._worth(data, others)
        if len(others) >= MANY:
            others = self._once(data, others)
        return conn, time, size_at, others

    def _columns(
        self, data: Bytes, where: IntArray
    ) -> tuple[IntArray, IntArray, IntArray, IntArray]:
        """Connection, time and position of the payload's size of the records like the template.

        Also the positions of the other records. All headers are gathered at once and compared with
        the template in the bytes that every message shares.
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
        conn, time = template.read(heads)
        left = np.ones(len(where), bool)
        left[np.searchsorted(where, found)] = False
        return conn, time, found + (4 + template.size), where[left]

    def _once(self, data: Bytes, places: IntArray) -> IntArray:
        """The positions without repeated connection records."""
        header = words(data, "<u4", places).astype(np.int64)
        inside = places + header + 8 <= len(data)
        size = np.full(len(places), len(data), np.int64)
        size[inside] = words(data, "<u4", places[inside] + 4 + header[inside]) + header[inside] + 8
        kept = without_repeats(data, places, size)
        left_out = np.ones(len(places), bool)
        left_out[kept] = False
        # Messages count, however alike they are.
        kinds = (self.heads.within(data).record(k) for k in places[kept].tolist())
        described = all(record is not None and record.op == CONNECTION for record in kinds)
        return places[~left_out] if described else places

    def _worth(self, data: Bytes, places: IntArray) -> IntArray:
        """The positions without connections beyond the plausible number."""
        at = np.minimum(places, max(len(data) - HEAD_BYTES, 0))
        rows = gather(data, at, min(HEAD_BYTES, len(data)))
        key = numbers_of(rows)
        key[at != places] = -1
        described = (key >= 0).nonzero()[0]
        worth = self._described.worth(np.minimum(key[described], NUMBERS - 1))
        if worth.all():
            return places
        self.findings.note(TOO_MANY)
        return np.delete(places, described[~worth])

    def one_by_one(self, data: Bytes, places: IntArray) -> list[tuple[int, int, int]]:
        """Connection records, and messages with another order of header fields."""
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
                    self._connection(fields, data[place:end].tobytes(), size_at + 4 - place)
                else:
                    raise DamageError("unexpected record")
            except DamageError:
                self.findings.unreadable_bytes += size
        return out

    def _connection(self, fields: Fields, record: bytes, data_at: int) -> None:
        """Learn a connection, once; raises DamageError."""
        if record not in self._described:
            self._described.look(min(number(fields, b"conn"), NUMBERS - 1))
            key, channel = connection_of(fields, record[data_at:])
            if not self._described.add(record):
                channel = short(channel)
            self.tally.describe(key, channel, contradicts(record, self._told.get(key)))

    def unwanted(self, conn: int) -> bool:
        """Whether the messages of that connection are not wanted."""
        return conn < NUMBERS and self.tally.sink(conn) == UNWANTED

    def takes(self, head: Bytes, size: int) -> bool:
        """Whether a record above the usual limit is to be read, by its first bytes and size."""
        try:
            fields = fields_of(head[4 : 4 + U32(head.data)[0]].tobytes())
            return op_of(fields) == MESSAGE and self.tally.takes(number(fields, b"conn"), size)
        except DamageError:
            return False

    def too_large(self, head: Bytes) -> None:
        """Count a record that is too large to be processed, by its first bytes."""
        header = U32(head.data)[0]
        try:
            fields = fields_of(head[4 : 4 + header].tobytes())
            if op_of(fields) == MESSAGE:
                key = number(fields, b"conn")
                if self.unwanted(key):
                    self.tally.passed(key, 1)
                else:
                    self.tally.too_large(key)
                return
        except DamageError:
            self.findings.unreadable_bytes += header
        self.findings.too_large["", MESSAGE_BYTES] += 1
