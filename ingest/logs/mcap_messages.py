"""Decoding runs of MCAP records into blocks of messages, with the schemas and channels among
them."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence

import numpy as np

from ...topology.arrays import BoolArray, IntArray
from .columns import MANY, column, gather, without_repeats, words
from .described import TOO_MANY
from .mcap_heads import NOT_IN_CHUNKS, Heads
from .mcap_mend import mended
from .mcap_wire import CHANNEL, MESSAGE, MESSAGE_HEAD, RECORD_HEAD, SCHEMA, Definitions
from .messages import MESSAGE_BYTES, UNWANTED, Block, Bytes, DamageError, Findings
from .tally import Tally
from .walk import inside, mcap_listed, mcap_records, seamless

_HEAD = struct.Struct("<BQ").unpack_from

LOG_TIME_AT = 15
"""Offset of the log time in a message record; the channel follows the record head."""


class MessageReader:
    """Turns runs of records of one file into blocks of messages.

    packed: the file has compressed chunks, whose damage may produce invented records; ended: the
    end of the data section was reached, after which descriptions are repeated.
    """

    def __init__(
        self, heads: Heads, tally: Tally, findings: Findings, definitions: Definitions
    ) -> None:
        self.heads = heads
        self.tally = tally
        self.findings = findings
        self.packed = False
        self.ended = False
        self._definitions = definitions

    def blocks(self, data: Bytes, offsets: Sequence[IntArray] = ()) -> Iterator[Block]:
        """The wanted messages in a run of records; offsets: their positions by an index."""
        regular = self._regular(data, offsets) if offsets else None
        if regular is not None:
            positions, heads = regular
        else:
            data, where, op = self._walked(data, offsets)
            positions, heads = self._heads(data, where, op)
        if len(positions) == 0:
            return
        size = column(heads, "<i8", 1) - MESSAGE_HEAD
        number = column(heads, "<u2", RECORD_HEAD)
        log_time = column(heads, "<i8", LOG_TIME_AT)
        counts = np.bincount(number)
        if self.ended or not self.tally.all_usual(counts):
            first = self.tally.first(number, again=self.ended)
            kept = self.without_descriptions(data, positions, size, first)
            self.findings.repaired += int((~kept).sum())
            positions, size, number, log_time = (
                a[kept] for a in (positions, size, number, log_time)
            )
            self.tally.adopt(number)
            counts = np.bincount(number)
        if len(number) == 0:
            return
        start = positions + (RECORD_HEAD + MESSAGE_HEAD)
        for sink, rows in self.tally.met(number, log_time, counts):
            yield Block(data, sink, log_time[rows], start[rows], size[rows])

    def without_descriptions(
        self, data: Bytes, positions: IntArray, size: IntArray, asked: Sequence[int]
    ) -> BoolArray:
        """(n,) which messages are messages; those that are a channel's description but for one bit
        are processed as such.

        asked: the ones to check; descriptions precede the first message or follow the data section.
        """
        heads, kept = self.heads.within(data), np.ones(len(positions), bool)
        for k in asked:
            place = int(positions[k])
            channel = bytes([CHANNEL]) + heads.head(place)[1:]
            if heads.end(place, channel) is not None:
                kept[k] = False
                record = data[place : place + RECORD_HEAD + MESSAGE_HEAD + int(size[k])].copy()
                record[0] = CHANNEL
                self.define(record, np.zeros(1, np.int64))
        return kept

    def _regular(self, data: Bytes, offsets: Sequence[IntArray]) -> tuple[IntArray, Bytes] | None:
        """Positions and heads of messages if the index describes all of `data`, else None.

        Each message must end where the next begins, from the first byte to the last: a walk would
        find the same.
        """
        where = inside(np.concatenate(offsets), len(data) - (RECORD_HEAD + MESSAGE_HEAD))
        if where is None or where[0]:
            return None
        heads = gather(data, where, LOG_TIME_AT + 8)
        length = column(heads, "<i8", 1)
        if length.min() < MESSAGE_HEAD or not (heads[:, 0] == MESSAGE).all():
            return None
        return (where, heads) if seamless(where, where + RECORD_HEAD + length, len(data)) else None

    def _walked(self, data: Bytes, offsets: Sequence[IntArray]) -> tuple[Bytes, IntArray, Bytes]:
        """Positions and kinds of the records in `data`, which is mended first if broken.

        Schemas and channels are processed.
        """
        where = mcap_listed(data, np.concatenate(offsets)) if offsets else None
        stop = len(data)
        if where is None:
            where, stop = mcap_records(data, NOT_IN_CHUNKS)
        op = data[where]
        messages = [] if (op == MESSAGE).all() else self.define(data, where)
        if stop == len(data):
            if messages:
                self.findings.repaired += len(messages)
                data = data.copy()
                data[messages] = MESSAGE
                op = data[where]
            return data, where, op
        found = mended(data, self.heads.within(data), self.define)
        self.findings.unreadable_bytes += found.unreadable
        self.findings.repaired += found.repaired
        if not self.packed:
            # What a broken stream gives may be records that were never written.
            for number in found.lost:
                self.tally.lost(number, 1)
        return found.data, found.where, found.data[found.where]

    def _heads(self, data: Bytes, where: IntArray, op: Bytes) -> tuple[IntArray, Bytes]:
        """Positions of the message records, and their heads as rows; those shorter than a message
        head are left out."""
        is_message = op == MESSAGE
        if not is_message.all():
            where = where[is_message]
        if len(where) and where[-1] + (RECORD_HEAD + MESSAGE_HEAD) > len(data):
            where = self._long_enough(data, where)
        heads = gather(data, where, LOG_TIME_AT + 8)
        if len(where) and column(heads, "<i8", 1).min() < MESSAGE_HEAD:
            where = self._long_enough(data, where)
            heads = gather(data, where, LOG_TIME_AT + 8)
        return where, heads

    def _long_enough(self, data: Bytes, where: IntArray) -> IntArray:
        fits = words(data, "<i8", where + 1) >= MESSAGE_HEAD
        self.findings.unreadable_bytes += RECORD_HEAD * int((~fits).sum())
        return where[fits]

    def define(self, data: Bytes, where: IntArray, more: bool = False) -> list[int]:
        """Process the schemas and channels among records.

        more: only channels that no valid data has described yet. Returns the positions of those
        that are messages but for one bit.
        """
        op = data[where]
        messages: list[int] = []
        if (op == MESSAGE).all():
            return messages
        # What stands behind the data does not say what they are.
        only_new = more or self.ended
        heads = self.heads.within(data)
        places = where[(op == SCHEMA) | (op == CHANNEL)]
        if len(places) >= MANY:
            size = words(data, "<i8", places + 1) + RECORD_HEAD
            places = places[without_repeats(data, places, size)]
        if len(places) > self._definitions.left:
            # Of one that is cut, other bytes are taken for its number.
            number = words(data, "<u2", np.minimum(places + RECORD_HEAD, len(data) - 2))
            worth = self._definitions.worth(data[places], number.astype(np.int64))
            if not worth.all():
                self.findings.note(TOO_MANY)
                places = places[worth]
        for place in places.tolist():
            kind, length = _HEAD(data.data, place)
            record = data[place : place + RECORD_HEAD + length].tobytes()
            if self._definitions.met(kind, record[RECORD_HEAD:]):
                continue
            head = None if heads.end(place) is not None else heads.repaired(place)
            if head is not None and head[0] == MESSAGE:
                messages.append(place)
                continue
            if head is not None:
                # One of the lengths in it was wrong.
                self.findings.repaired += not more
                record = head[: len(record)] + record[len(head) :]
            overrule = not only_new and self._definitions.overrule(record[0], record[RECORD_HEAD:])
            try:
                found = self._definitions.take(record[0], record[RECORD_HEAD:])
            except DamageError:
                self.findings.unreadable_bytes += len(record)
                continue
            if found is not None and not (only_new and self.tally.known(found[0])):
                self.tally.describe(*found, overrule)
        return messages

    def takes(self, head: Bytes, size: int) -> bool:
        """Whether a record above the usual limit is to be read, by its first bytes and size."""
        number = int(head[RECORD_HEAD]) | int(head[RECORD_HEAD + 1]) << 8
        return bool(head[0] == MESSAGE) and self.tally.takes(number, size)

    def too_large(self, head: Bytes) -> None:
        """Count a record that is too large to be read, from its first bytes."""
        if head[0] == MESSAGE:
            number = int(head[RECORD_HEAD]) | int(head[RECORD_HEAD + 1]) << 8
            if self.tally.sink(number) == UNWANTED:
                self.tally.passed(number, 1)
            else:
                self.tally.too_large(number)
            return
        self.findings.too_large["", MESSAGE_BYTES] += 1
