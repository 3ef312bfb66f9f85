"""Reading runs of small chunks together: some recorders close a chunk after every message."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from .checksum import agrees, crc32
from .chunk_reader import SMALL_BYTES
from .inflate import inflate
from .mcap_heads import CHUNK_FIXED
from .mcap_wire import CHUNK, MESSAGE_INDEX, RECORD_HEAD
from .messages import Bytes, DamageError

_HEAD = struct.Struct("<BQ").unpack_from
_CHUNK = struct.Struct("<QQQII").unpack_from
_U64 = struct.Struct("<Q").unpack_from
_INDEX = struct.Struct("<HI").unpack_from


class Failed(NamedTuple):
    """An unusable chunk: the reason, and the message counts of its index by channel."""

    reason: str
    counts: dict[int, int]


class Batch(NamedTuple):
    """A run of small chunks.

    stop: its length in the file; data: the records of each; failed: the unusable ones, in order;
    open: whether the last one failed, so that its counts may continue; unlisted: the records of
    those with a wrong checksum whose messages no index counts; repaired: number with a corrected
    size.
    """

    stop: int
    data: Sequence[bytes]
    failed: list[Failed]
    open: bool
    unlisted: Sequence[bytes]
    repaired: int


def small_chunks(raw: Bytes, patient: bool) -> Batch:
    """The small chunks at the front of `raw` with their indexes, up to the first other record.

    patient: stop before a chunk that cannot be used as it is.
    """
    view, at, size = raw.data, 0, len(raw)
    data: list[bytes] = []
    failed: list[Failed] = []
    counts: dict[int, int] | None = None
    repaired = 0
    broken: list[tuple[bytes, dict[int, int]]] = []
    while at + RECORD_HEAD + CHUNK_FIXED <= size:
        op, length = _HEAD(view, at)
        end = at + RECORD_HEAD + length
        if end > size:
            break
        if op == CHUNK:
            found = _records(view, at, end)
            if found is None or (patient and found.reason):
                break
            counts = {} if found.reason else None
            repaired += found.repaired
            if counts is not None:
                failed.append(Failed(found.reason, counts))
                broken.append((found.records, counts))
            else:
                data.append(found.records)
        elif op == MESSAGE_INDEX and length >= 6:
            number, entries = _INDEX(view, at + RECORD_HEAD)
            if entries + 6 != length:
                break
            if counts is not None:
                counts[number] = entries // 16
        else:
            break
        at = end
    unlisted = [records for records, listed in broken if not listed]
    return Batch(at, data, failed, counts is not None, unlisted, repaired)


class _Found(NamedTuple):
    """The records of a chunk, why it is unusable (if it is), and whether its size was corrected."""

    records: bytes
    reason: str = ""
    repaired: bool = False


def _records(view: memoryview, at: int, end: int) -> _Found | None:
    """The records of a chunk, None if it is not small and simple."""
    _, _, size, crc, named = _CHUNK(view, at + RECORD_HEAD)
    name_at = at + RECORD_HEAD + CHUNK_FIXED
    data_at = name_at + named + 8
    if max(size, end - at) > SMALL_BYTES or data_at > end:
        return None
    if _U64(view, data_at - 8)[0] != end - data_at:
        return None
    packed = view[data_at:end]
    try:
        if named:
            name = str(view[name_at : data_at - 8], "utf-8", "replace")
            records = inflate(name, packed, size)
        else:
            # How large the data are is told by the record as well.
            records = bytes(packed)
    except DamageError as damage:
        return _Found(b"", str(damage))
    if crc and not agrees(crc32(records), crc):
        return _Found(records, "checksum (CRC) is wrong")
    return _Found(records, repaired=size != len(records))


def joined(parts: Sequence[bytes]) -> Bytes:
    """The records of several chunks as one run."""
    return np.frombuffer(b"".join(parts), np.uint8)
