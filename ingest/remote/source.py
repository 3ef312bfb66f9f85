"""Reading one remote log in blocks: few requests, parts that are wanted read ahead.

Blocks that were read are kept within a limit of memory, since logs are read more than once.
"""

from __future__ import annotations

import threading
from bisect import bisect_left, bisect_right
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
"""Bytes kept of a log: more than its walk holds at a time (`logs.chunks.AHEAD_BYTES`)."""

Ranges = list[tuple[int, int]]
"""First bytes, and those after the last."""

Ask = Callable[[tuple[int, int]], Future[Got]]
"""Starts a request for a range of bytes: the first one, and the one after the last."""


class ReadAhead:
    """Parts of an object (ranges of bytes) that are read in order, the next few of them ahead."""

    def __init__(self, parts: Ranges, ask: Ask) -> None:
        self._parts = parts
        self._ask = ask
        self._begun: dict[int, Future[Got]] = {}
        self._fresh = 0

    def at(self, offset: int) -> Got | None:
        """The part that holds the byte at `offset`, None if none does; requests for the following
        ones are started."""
        k = bisect_right(self._parts, offset, key=lambda part: part[0]) - 1
        if k < 0 or offset >= self._parts[k][1]:
            return None
        left = AHEAD_BYTES
        for n, (start, stop) in enumerate(self._parts[k : k + AHEAD], k):
            left -= stop - start
            if n > k and left < 0:
                break
            # Threads may read out of order: parts read after this one are not requested twice.
            if n not in self._begun and (n == k or n >= self._fresh):
                self._begun[n] = self._ask((start, stop))
                self._fresh = max(self._fresh, n + 1)
        # Dropped parts are requested again when needed.
        return self._begun.pop(k).result()


class RemoteFile:
    """One object for reading; thread-safe. Raises LogError on server errors.

    known: bytes that were read before, if any; ask: requests further ones.
    """

    def __init__(self, size: int, known: Got | None, ask: Ask) -> None:
        self.size = size
        self._ask = ask
        self._lock = threading.Lock()
        self._held: OrderedDict[int, bytes] = OrderedDict()
        self._ahead: ReadAhead | None = None
        if known is not None:
            self._keep(known)

    def _planned(self, ranges: Ranges) -> Ranges:
        """Requests for the blocks of some ranges that are not held."""
        with self._lock:
            held = sorted(self._held)
        out: list[tuple[int, int]] = []
        for first, stop in _joined(ranges):
            at = first
            while at < stop:
                k = bisect_left(held, at)
                until = min(stop, at + PART_BYTES // BLOCK_BYTES, *held[k : k + 1])
                if until > at:
                    out.append(self._bytes(at, until))
                at = max(until, at + 1)  # a block that is held is passed over
        return out

    def _bytes(self, first: int, stop: int) -> tuple[int, int]:
        return first * BLOCK_BYTES, min(stop * BLOCK_BYTES, self.size)

    @contextmanager
    def ahead(self, ranges: Ranges) -> Iterator[None]:
        """Context in which these ranges are read, in order; they are requested ahead."""
        self._ahead = ReadAhead(self._planned(ranges), self._ask)
        yield
        self._ahead = None

    def read(self, offset: int, length: int) -> bytes:
        """The bytes [offset, offset + length), fewer at the object's end."""
        first, stop = offset // BLOCK_BYTES, -(-min(offset + length, self.size) // BLOCK_BYTES)
        with self._lock:
            blocks = [self._block(k, stop) for k in range(first, stop)]
        at = offset - first * BLOCK_BYTES
        return b"".join(blocks)[at : at + length]

    def _block(self, k: int, stop: int) -> bytes:
        """A block; if it is not held, it is read with those behind it up to `stop`."""
        if k not in self._held:
            got = self._ahead.at(k * BLOCK_BYTES) if self._ahead is not None else None
            if got is None:
                most = min(stop, k + PART_BYTES // BLOCK_BYTES)
                end = next((n for n in range(k + 1, most) if n in self._held), most)
                got = self._ask(self._bytes(k, end)).result()
            self._keep(got)
        self._held.move_to_end(k)
        return self._held[k]

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
