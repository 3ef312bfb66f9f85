"""Finds the records in a buffer: one after the other where they differ, in strides where equal.

Recorders write long runs of records of one size (odometry between two images). Such a run is
checked as one strided column instead of record by record.
"""

from __future__ import annotations

import struct

import numpy as np

from .messages import Bytes, Ints

_U64 = struct.Struct("<Q").unpack_from
_U32 = struct.Struct("<I").unpack_from

LEAST_REACH = 64
"""How many records are looked at together at least, once two equal ones were met."""


class _Places:
    """Collects runs of equally spaced places; a single place is a run of one."""

    def __init__(self) -> None:
        self.first: list[int] = []
        self.step: list[int] = []
        self.count: list[int] = []

    def add(self, first: int, step: int, count: int) -> None:
        """Add `count` places."""
        self.first.append(first)
        self.step.append(step)
        self.count.append(count)

    def all(self) -> Ints:
        """All places in their order."""
        first, step, count = (
            np.array(column, np.int64) for column in (self.first, self.step, self.count)
        )
        # All runs are unrolled at once: the number within its run, times the run's step.
        within = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
        return np.asarray(np.repeat(first, count) + np.repeat(step, count) * within)


def mcap_records(data: Bytes, end_ops: frozenset[int] = frozenset()) -> tuple[Ints, int]:
    """Places of the whole MCAP records at the front of `data`, and where they stop.

    A record is an opcode byte and a 64-bit length. Stops in front of a record that reaches beyond
    the data and, with `end_ops`, in front of the first record whose opcode is in it.
    """
    raw, size = data.data, len(data)
    places = _Places()
    add = places.add
    position, before, last, reach = 0, -1, size - 9, LEAST_REACH
    while position <= last:
        # Opcode and the lower 56 bits of the length in one word; the top byte is checked apart.
        word = _U64(raw, position)[0]
        step = 9 + (word >> 8)
        if position + step > size or raw[position + 8] or (word & 0xFF) in end_ops:
            break
        if word == before:
            most = min((size - position) // step, reach)
            column = np.ndarray((most,), "<u8", raw, position, (step,))
            count = _leading(column == word)
            add(position, step, count)
            # How far to look next time: runs between two other messages are much alike.
            reach = 4 * reach if count == most else max(LEAST_REACH, 2 * count)
            position += step * count
            before = word if count == most else -1
        else:
            add(position, step, 1)
            position, before = position + step, word
    return places.all(), position


def bag_records(data: Bytes) -> tuple[Ints, int]:
    """Places of the whole ROS 1 records at the front of `data`, and where they stop.

    A record is a header and data, each with a 32-bit length in front.
    """
    raw, size = data.data, len(data)
    places = _Places()
    add = places.add
    position, before, last, reach = 0, (-1, -1), size - 8, LEAST_REACH
    while position <= last:
        header = _U32(raw, position)[0]
        body = position + 4 + header
        if body > size - 4:
            break
        shape = header, _U32(raw, body)[0]
        step = 8 + header + shape[1]
        if position + step > size:
            break
        if shape == before:
            most = count = min((size - position) // step, reach)
            headers = np.ndarray((count,), "<u4", raw, position, (step,))
            bodies = np.ndarray((count,), "<u4", raw, body, (step,))
            count = _leading((headers == header) & (bodies == shape[1]))
            add(position, step, count)
            reach = 4 * reach if count == most else max(LEAST_REACH, 2 * count)
            position += step * count
            before = shape if count == most else (-1, -1)
        else:
            add(position, step, 1)
            position, before = position + step, shape
    return places.all(), position


def _leading(same: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> int:
    """How many entries are true before the first false one."""
    first = int(same.argmin())
    return len(same) if same[first] else first
