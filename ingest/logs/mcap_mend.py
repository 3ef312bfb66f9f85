"""Recovery of records from damaged data.

Where the walk meets no valid record, either the head there or the length of the record before is
damaged. Both are tried with each one of their bits flipped; if neither helps, the walk continues at
the next position with valid records.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ...topology.arrays import IntArray
from .columns import words
from .mcap_heads import NOT_IN_CHUNKS, PRIVATE, Heads
from .mcap_wire import MESSAGE, RECORD_HEAD
from .mended import Mended
from .messages import Bytes
from .walk import mcap_records


def mended(data: Bytes, heads: Heads, define: Callable[[Bytes, IntArray], list[int]]) -> Mended:
    """All records of damaged data that can be recovered. heads: of the data.

    define: called with further records to make their channels known; returns the positions of those
    that are messages after all.
    """
    data = data.copy()
    heads = heads.within(data)
    parts: list[IntArray] = []
    lost: list[int] = []
    position = unreadable = repaired = 0
    while position < len(data):
        where, stop = mcap_records(data[position:], NOT_IN_CHUNKS)
        messages = define(data[position:], where)
        data[position:][messages] = MESSAGE
        repaired += len(messages)
        if position + stop == len(data):
            parts.append(where + position)
            break
        private = _private_end(data, position + stop)
        if private and heads.repaired(position + stop) is None and heads.begins(private):
            parts.append(where + position)
            position = private
            continue
        where, stop = trusted(heads, data[position:], where, stop, position)
        parts.append(where + position)
        position += stop
        head = heads.repaired(position)
        if head is not None:
            data[position : position + len(head)] = np.frombuffer(head, np.uint8)
            repaired += 1
            continue
        found = heads.following(position + 1)
        reach = len(data) if found is None else found
        end = heads.end(position) if data[position] == MESSAGE else None
        if end is not None and position < end <= reach:
            # Whole after all: what is behind it is broken in more than one bit.
            parts.append(np.array([position]))
            position = end
        elif end is not None:
            lost.append(int.from_bytes(data[position + RECORD_HEAD :][:2].tobytes(), "little"))
        unreadable += reach - position
        position = reach
    where = np.concatenate(parts) if parts else np.zeros(0, np.int64)
    return Mended(data, where, lost, unreadable, repaired)


def _private_end(data: Bytes, position: int) -> int:
    """End of the record of a private kind, 0 if there is none or it is not in the data."""
    if position + RECORD_HEAD > len(data) or data[position] < PRIVATE:
        return 0
    end = position + RECORD_HEAD + int(words(data, "<u8", np.array([position + 1]))[0])
    return end if end <= len(data) else 0


def trusted(
    heads: Heads, data: Bytes, where: IntArray, stop: int, base: int
) -> tuple[IntArray, int]:
    """The trustworthy records before a position at which none begins, and where they end.

    The last record's length is wrong, unless only the head at the position is. base: position of
    `data` for `heads`.
    """
    if heads.repaired(base + stop) is not None:
        return where, stop
    known = heads.known(words(data, "<u2", where + RECORD_HEAD))
    count = len(where)
    # Where a walk went astray it meets what looks like messages of channels that do not exist.
    while count and data[where[count - 1]] == MESSAGE and not known[count - 1]:
        count -= 1
    if count == 0:
        return where[:0], 0
    return where[: count - 1], int(where[count - 1])
