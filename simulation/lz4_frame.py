"""LZ4 frames of records, whose bytes depend on the records alone, not on the version of a library.

One frame with the header that every LZ4 reader knows (independent blocks of up to 4 MiB, no
checksums). Messages of one kind have one length and differ in few bytes, so a record is compared
with the last one of its length, and with nothing else: that needs no search.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

HEADER = bytes.fromhex("04224d18607073")
"""Magic number, flags, block size, and the checksum of the latter two."""

BLOCK_BYTES = 1 << 22
FARTHEST = 65535
LEAST_MATCH = 4
"""The format's shortest copy."""

WORTHWHILE = 5
"""A shorter copy takes as much room as the bytes themselves."""

LAST_LITERALS = 5
LAST_MATCH = 12
"""The format's rules: no copy begins in the last 12 bytes or reaches into the last 5."""

IntArray = NDArray[np.int64]
Bytes = NDArray[np.uint8]


def lz4_frame(records: Sequence[bytes]) -> bytes:
    """The records, one after another, as one LZ4 frame. O(bytes), vectorised."""
    out = [HEADER]
    for block in _blocks(records):
        plain = b"".join(block)
        packed = _packed(plain, np.array([len(record) for record in block], np.int64))
        if len(packed) < len(plain):
            out += [len(packed).to_bytes(4, "little"), packed]
        else:
            out += [(len(plain) | 1 << 31).to_bytes(4, "little"), plain]
    return b"".join([*out, bytes(4)])


def _blocks(records: Sequence[bytes]) -> Iterator[list[bytes]]:
    """The records in groups of up to BLOCK_BYTES; one that is longer is cut."""
    block: list[bytes] = []
    size = 0
    for whole in records:
        for at in range(0, len(whole), BLOCK_BYTES):
            record = whole[at : at + BLOCK_BYTES]
            if size + len(record) > BLOCK_BYTES:
                yield block
                block, size = [], 0
            block.append(record)
            size += len(record)
    if block:
        yield block


def _packed(plain: bytes, lengths: IntArray) -> bytes:
    """One compressed block."""
    data = np.frombuffer(plain, np.uint8)
    distance = np.repeat(_distances(lengths), lengths)
    start, end = _copies(data, distance)
    return _sequences(data, start, end, distance[start])


def _distances(lengths: IntArray) -> IntArray:
    """For every record the way back to the last record of its length; 0 if there is none near."""
    place = np.cumsum(lengths) - lengths
    order = np.argsort(lengths, kind="stable")
    same = lengths[order[1:]] == lengths[order[:-1]]
    back = np.zeros(len(lengths), np.int64)
    back[order[1:][same]] = (place[order[1:]] - place[order[:-1]])[same]
    return np.where(back <= FARTHEST, back, 0)


def _copies(data: Bytes, distance: IntArray) -> tuple[IntArray, IntArray]:
    """Half-open spans of bytes that equal those at their distance back.

    All at once: compare every byte with its counterpart, then cut where that or the distance
    changes.
    """
    equal = (distance > 0) & (data == data[np.arange(len(data)) - distance])
    equal[max(0, len(data) - LAST_LITERALS) :] = False
    before = np.concatenate([[False], equal[:-1] & (distance[1:] == distance[:-1])])
    after = np.concatenate([before[1:] & equal[1:], [False]])
    start = np.flatnonzero(equal & ~before)
    end = np.flatnonzero(equal & ~after) + 1
    kept = (end - start >= WORTHWHILE) & (start < len(data) - LAST_MATCH)
    return start[kept], end[kept]


def _sequences(data: Bytes, start: IntArray, end: IntArray, distance: IntArray) -> bytes:
    """The block: for each copy the literals before it and the copy, then the last literals.

    The place of every sequence in the output is computed first; then all of one kind of byte are
    scattered at once. Lengths from 15 on go on in bytes of 255 and one that is smaller, so the
    output is filled with 255 at first.
    """
    literals = np.append(start, len(data)) - np.append(0, end)
    copied = end - start - LEAST_MATCH
    more_literals = np.where(literals >= 15, (literals - 15) // 255 + 1, 0)
    more_copied = np.where(copied >= 15, (copied - 15) // 255 + 1, 0)
    size = 1 + more_literals + literals
    size[:-1] += 2 + more_copied
    token = np.cumsum(size) - size
    text = token + 1 + more_literals
    out = np.full(int(size.sum()), 255, np.uint8)
    out[token] = np.minimum(literals, 15) << 4
    out[token[:-1]] |= np.minimum(copied, 15).astype(np.uint8)
    long = more_literals > 0
    out[text[long] - 1] = (literals[long] - 15) % 255
    source = np.arange(literals.sum()) + np.repeat(np.append(0, np.cumsum(end - start)), literals)
    shift = np.repeat(text - np.append(0, end), literals)
    out[source + shift] = data[source]
    far = (text + literals)[:-1]
    out[far], out[far + 1] = distance & 255, distance >> 8
    long = more_copied > 0
    out[(far + 1 + more_copied)[long]] = (copied[long] - 15) % 255
    return out.tobytes()
