"""LZ4 frames whose bytes depend on the data alone, not on the version of a library.

One frame with the header that every LZ4 reader knows (independent blocks of up to 4 MiB, no
checksums), greedy matches against the last occurrence of four bytes or, where that is longer, at
the distance of the match before: messages of one kind repeat at a constant distance.
"""

from __future__ import annotations

import numpy as np

HEADER = bytes.fromhex("04224d18607073")
"""Magic number, flags, block size, and the checksum of the latter two."""

BLOCK_BYTES = 1 << 22
FARTHEST = 65535
LEAST_MATCH = 4
WORTH_ANOTHER_LOOK = 48
"""Matches as long as this are taken without looking for a longer one."""

LAST_LITERALS = 5
LAST_MATCH = 12
"""The format's rules: no match begins in the last 12 bytes or reaches into the last 5."""


def lz4_frame(data: bytes) -> bytes:
    """`data` as one LZ4 frame. O(n log n)."""
    out = [HEADER]
    for at in range(0, len(data), BLOCK_BYTES):
        plain = data[at : at + BLOCK_BYTES]
        packed = _block(plain)
        if len(packed) < len(plain):
            out += [len(packed).to_bytes(4, "little"), packed]
        else:
            out += [(len(plain) | 1 << 31).to_bytes(4, "little"), plain]
    return b"".join([*out, b"\0\0\0\0"])


def _block(data: bytes) -> bytes:
    """One compressed block."""
    out = bytearray()
    done, distance, end = 0, 0, len(data) - LAST_LITERALS
    places, sources, next_at = _repeats(data)
    at = 0
    while at < len(places):
        start, source = places[at], sources[at]
        length = _common(data, source, start, end)
        again = start - distance
        if distance and again >= 0 and again != source and length < WORTH_ANOTHER_LOOK:
            other = _common(data, again, start, end)
            if other >= length:
                source, length = again, other
        if length < LEAST_MATCH:
            at += 1
            continue
        distance = start - source
        _put(out, data[done:start], distance, length)
        done = start + length
        at = next_at[done]
    _put(out, data[done:], 0, 0)
    return bytes(out)


def _repeats(data: bytes) -> tuple[memoryview, memoryview, memoryview]:
    """Places whose four bytes occurred before, and their last occurrence, if near enough.

    The third part says for every byte which of the places is the first from there on. All at
    once: a stable sort by the four bytes brings the occurrences side by side.
    """
    if len(data) <= LAST_MATCH:
        return memoryview(b""), memoryview(b""), memoryview(b"")
    raw = np.frombuffer(data, np.uint8).astype(np.uint32)
    words = raw[:-3] | raw[1:-2] << 8 | raw[2:-1] << 16 | raw[3:] << 24
    order = np.argsort(words, kind="stable")
    same = words[order[1:]] == words[order[:-1]]
    last = np.full(len(words), -1, np.int64)
    last[order[1:][same]] = order[:-1][same]
    place = np.arange(len(words))
    usable = (last >= 0) & (place - last <= FARTHEST) & (place < len(data) - LAST_MATCH)
    next_at = np.searchsorted(place[usable], np.arange(len(data) + 1))
    return place[usable].data, last[usable].data, next_at.data


def _common(data: bytes, source: int, start: int, end: int) -> int:
    """How many bytes from `source` equal those from `start`, up to `end`.

    Compared as whole numbers: the lowest bit in which they differ tells the first wrong byte.
    """
    length, step = 0, 32
    while start + length < end:
        step = min(step, end - start - length)
        a, b = source + length, start + length
        if data[a : a + step] != data[b : b + step]:
            one, two = (int.from_bytes(data[i : i + step], "little") for i in (a, b))
            differing = one ^ two
            return length + ((differing & -differing).bit_length() - 1) // 8
        length += step
        step *= 2
    return length


def _put(out: bytearray, literals: bytes, distance: int, length: int) -> None:
    """One sequence: literals, then a copy of `length` bytes from `distance` back (0: none)."""
    extra = length - LEAST_MATCH
    out.append(min(len(literals), 15) << 4 | (min(extra, 15) if distance else 0))
    _put_rest(out, len(literals))
    out += literals
    if distance:
        out += distance.to_bytes(2, "little")
        _put_rest(out, extra)


def _put_rest(out: bytearray, count: int) -> None:
    """What is beyond the four bits of a count."""
    if count >= 15:
        out += b"\xff" * ((count - 15) // 255)
        out.append((count - 15) % 255)
