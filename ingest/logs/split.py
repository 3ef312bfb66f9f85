"""Chunks too large for memory, processed in pieces of whole records."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from ...topology.arrays import IntArray
from .inflate import PIECE_BYTES
from .messages import MESSAGE_BYTES, Bytes, DamageError

RECORD_BYTES = MESSAGE_BYTES + (1 << 12)
"""Longest record of most channels: a longer one holds a longer message than is decoded."""


class Large(NamedTuple):
    """A record too long to be kept: its first bytes."""

    head: Bytes


def whole_records(
    pieces: Iterator[bytes],
    walk: Callable[[Bytes], tuple[IntArray, int]],
    length: Callable[[Bytes], int],
    takes: Callable[[Bytes, int], bool],
) -> Iterator[Bytes | Large]:
    """Runs of whole records out of a stream, and the heads of records too long to be kept.

    walk: finds the records at the front of bytes and where they stop; length: of the record at the
    front, 0 if there is none; takes: whether one above RECORD_BYTES is to be kept, by its first
    bytes and length. Raises DamageError if the stream holds anything else, or ends within a record.
    """
    pending = b""
    over = 0
    long, filled = np.empty(0, np.uint8), 0
    for read in pieces:
        piece = read
        if filled < len(long):
            part = np.frombuffer(piece, np.uint8)[: len(long) - filled]
            long[filled : filled + len(part)] = part
            filled += len(part)
            if filled < len(long):
                continue
            yield long
            long, filled, piece = np.empty(0, np.uint8), 0, piece[len(part) :]
        if over:
            dropped = min(over, len(piece))
            over -= dropped
            pending = piece[dropped:]
        else:
            pending += piece
        data = np.frombuffer(pending, np.uint8)
        _, stop = walk(data)
        if stop:
            yield data[:stop]
            pending = pending[stop:]
        total = length(data[stop:])
        if total > RECORD_BYTES and takes(data[stop:], total):
            long, filled, pending = np.empty(total, np.uint8), len(data) - stop, b""
            long[:filled] = data[stop:]
        elif total > RECORD_BYTES:
            yield Large(data[stop:])
            over, pending = max(total - len(pending), 0), pending[total:]
        elif total <= 0 and len(pending) > PIECE_BYTES:
            break
    if pending or over or filled:
        raise DamageError("the records of a chunk do not fill it")
