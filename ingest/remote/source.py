"""Reading one remote log in blocks: few requests, parts that are wanted read ahead.

Blocks that were read are kept within a limit of memory, since logs are read more than once.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import OrderedDict
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager

from .store import Got

BLOCK_BYTES = 1 << 12
"""Unit of what is read and kept. A range wastes one on average: 4 % of a chunk of 100 kB. Keeping
one takes 1 µs, a hundredth of the time in which it comes."""

PART_BYTES = 1 << 22
"""Longest request: the usual part size of buckets, 40 ms at 100 MB/s, against which a request's
latency is small."""

AHEAD_BYTES, AHEAD = 4 * PART_BYTES, 16
"""Limits on outstanding bytes and requests: one connection to a bucket gives 50 to 100 MB/s, less
than decoding needs, and short requests are dominated by latency."""

HELD_BYTES = 1 << 26
"""Bytes kept of a log: more than its walk holds at a time."""

Ranges = list[tuple[int, int]]
"""First bytes, and those after the last."""

Ask = Callable[[tuple[int, int]], Future[Got]]
"""Starts a request for a range of bytes: the first one, and the one after the last."""


class RemoteFile:
    """One object for reading. Raises LogError on server errors.

    known: bytes that were read before, if any; ask: requests further ones.
    """

    def __init__(self, size: int, known: Got | None, ask: Ask) -> None:
        self.size = size
        self._ask = ask
        self._held: OrderedDict[int, bytes] = OrderedDict()
        self._parts: Ranges = []
        self._begun: dict[int, Future[Got]] = {}
        if known is not None:
            self._keep(known)

    @contextmanager
    def ahead(self, ranges: Ranges) -> Iterator[None]:
        """Context in which these ranges of bytes are read, in order; the next few parts of them are
        requested ahead."""
        self._parts = [
            (at, min(at + PART_BYTES // BLOCK_BYTES, stop))
            for first, stop in _joined(ranges)
            for at in range(first, stop, PART_BYTES // BLOCK_BYTES)
        ]
        self._begun = {}
        yield
        self._parts = []

    def read(self, offset: int, length: int) -> bytes:
        """The bytes [offset, offset + length), fewer at the object's end."""
        first, stop = offset // BLOCK_BYTES, -(-min(offset + length, self.size) // BLOCK_BYTES)
        blocks = [self._block(k, stop) for k in range(first, stop)]
        at = offset - first * BLOCK_BYTES
        return b"".join(blocks)[at : at + length]

    def _block(self, k: int, stop: int) -> bytes:
        """A block; if it is not held, it is read with its part, or with those behind it up to
        `stop`."""
        if k not in self._held:
            n = bisect_right(self._parts, k, key=lambda part: part[0]) - 1
            until = min(stop, k + PART_BYTES // BLOCK_BYTES)
            if n >= 0 and k < self._parts[n][1]:
                until = self._parts[n][1]
                self._begin(n)
            if n in self._begun:
                self._keep(self._begun.pop(n).result())
            if k not in self._held:
                self._keep(self._requested(k, until).result())
        self._held.move_to_end(k)
        return self._held[k]

    def _begin(self, n: int) -> None:
        """Start the requests for a part and the next ones."""
        left = AHEAD_BYTES
        for m, (first, stop) in enumerate(self._parts[n : n + AHEAD], n):
            left -= (stop - first) * BLOCK_BYTES
            if m > n and left < 0:
                break
            if m not in self._begun and first not in self._held:
                self._begun[m] = self._requested(first, stop)

    def _requested(self, first: int, stop: int) -> Future[Got]:
        """A request for blocks that are not held, up to the first that is."""
        until = next((k for k in range(first + 1, stop) if k in self._held), stop)
        return self._ask((first * BLOCK_BYTES, min(until * BLOCK_BYTES, self.size)))

    def _keep(self, got: Got) -> None:
        """Keep the whole blocks among some bytes, within the limit."""
        start, data, _ = got
        end = start + len(data)
        stop = -(-end // BLOCK_BYTES) if end == self.size else end // BLOCK_BYTES
        for k in range(-(-start // BLOCK_BYTES), stop):
            at = k * BLOCK_BYTES - start
            self._held[k] = data[at : at + BLOCK_BYTES]
        while len(self._held) * BLOCK_BYTES > HELD_BYTES:
            self._held.popitem(last=False)


def _joined(ranges: Ranges) -> Ranges:
    """The blocks of ranges of bytes, in ascending order, those that touch or overlap as one."""
    out: Ranges = []
    for begin, end in sorted(ranges):
        first, stop = begin // BLOCK_BYTES, -(-end // BLOCK_BYTES)
        if out and first <= out[-1][1]:
            out[-1] = out[-1][0], max(out[-1][1], stop)
        else:
            out.append((first, stop))
    return out
