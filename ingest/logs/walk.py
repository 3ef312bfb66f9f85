"""Finding record boundaries in a buffer, with strides for runs of records of one size.

Recorders write long runs of records of equal size (odometry between two images). Such a run is
checked as one strided column instead of record by record.
"""

from __future__ import annotations

import struct

import numpy as np

from ...topology.arrays import IntArray
from .messages import Bytes

_U64 = struct.Struct("<Q").unpack_from
_U32 = struct.Struct("<I").unpack_from

REACH = 256
"""Records checked at once after two equal ones. A factor of 4 makes no difference."""


def mcap_records(data: Bytes, end_ops: frozenset[int] = frozenset()) -> tuple[IntArray, int]:
    """Offsets of the complete MCAP records at the front of `data`, and where they end.

    A record is an opcode byte and a 64-bit length. Ends before a record that exceeds the data and,
    with `end_ops`, before the first record with such an opcode.
    """
    raw, size = data.data, len(data)
    firsts: list[int] = []
    steps: list[int] = []
    counts: list[int] = []
    position, before, frequent, last = 0, -1, -1, size - 9
    while position <= last:
        # Opcode and the lower 56 bits of the length in one word; the top byte is checked apart.
        word = _U64(raw, position)[0]
        step = 9 + (word >> 8)
        if position + step > size or raw[position + 8] or (word & 0xFF) in end_ops:
            break
        firsts.append(position)
        steps.append(step)
        if word in (before, frequent):
            most = min((size - position) // step, REACH)
            count = _leading(np.ndarray((most,), "<u8", raw, position, (step,)) == word)
            frequent = word if count > 1 else -1
        else:
            count = 1
        counts.append(count)
        position += step * count
        before = word
    return _unrolled(firsts, steps, counts), position


def bag_records(data: Bytes) -> tuple[IntArray, int]:
    """Offsets of the complete ROS 1 records at the front of `data`, and where they end.

    A record is a non-empty header and data, each with a 32-bit length.
    """
    raw, size = data.data, len(data)
    firsts: list[int] = []
    steps: list[int] = []
    counts: list[int] = []
    before, frequent = (-1, -1), (-1, -1)
    position, last = 0, size - 8
    while position <= last:
        header = _U32(raw, position)[0]
        body = position + 4 + header
        if body > size - 4 or header == 0:
            break
        shape = header, _U32(raw, body)[0]
        step = 8 + header + shape[1]
        if position + step > size:
            break
        firsts.append(position)
        steps.append(step)
        if shape in (before, frequent):
            most = min((size - position) // step, REACH)
            headers = np.ndarray((most,), "<u4", raw, position, (step,))
            bodies = np.ndarray((most,), "<u4", raw, body, (step,))
            count = _leading((headers == header) & (bodies == shape[1]))
            frequent = shape if count > 1 else (-1, -1)
        else:
            count = 1
        counts.append(count)
        position += step * count
        before = shape
    return _unrolled(firsts, steps, counts), position


def _leading(same: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> int:
    """Number of true entries before the first false one."""
    first = int(same.argmin())
    return len(same) if same[first] else first


def _unrolled(firsts: list[int], steps: list[int], counts: list[int]) -> IntArray:
    """All offsets of runs with the given first offsets, steps and counts."""
    first, step, count = (np.array(column, np.int64) for column in (firsts, steps, counts))
    within = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    return np.asarray(np.repeat(first, count) + np.repeat(step, count) * within)
