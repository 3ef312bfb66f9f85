"""Reading one remote log: needed ranges are announced and read ahead in few requests.

Bytes read are kept within a limit of memory, since logs are read more than once.
"""

from __future__ import annotations

import threading
from bisect import bisect_right
from collections import OrderedDict
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager

from ...topology.arrays import IntArray
from .ranges import coalesced, in_parts, without
from .store import TAIL_MOST, Got

PART_BYTES = 1 << 22
"""Longest request: the usual part size of buckets, 40 ms at 100 MB/s, against which a request's
latency is small."""

AHEAD_BYTES, AHEAD = 4 * PART_BYTES, 16
"""Limits on outstanding bytes and requests: one connection to a bucket gives 50 to 100 MB/s, less
than decoding needs, and short requests are dominated by latency."""

HELD_BYTES = 1 << 26
"""Bytes kept of a log: more than its walk holds at a time (`logs.chunks.AHEAD_BYTES`)."""

LEAST_BYTES = 1 << 12
"""Least length of a request that was not announced: record heads are close together."""


class _Held:
    """Disjoint pieces of an object; the least recently used ones are dropped first."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._bytes = 0
        self._pieces: OrderedDict[int, bytes] = OrderedDict()
        self._starts: list[int] = []

    def put(self, start: int, data: bytes) -> None:
        """Keep a piece, within the limit."""
        if not data or start in self._pieces:
            return
        self._pieces[start] = data
        self._starts.insert(bisect_right(self._starts, start), start)
        self._bytes += len(data)
        while self._bytes > self._most and len(self._pieces) > 1:
            old, gone = self._pieces.popitem(last=False)
            self._starts.remove(old)
            self._bytes -= len(gone)

    def at(self, offset: int) -> tuple[int, bytes] | None:
        """The piece that holds the byte at `offset`, with its offset."""
        k = bisect_right(self._starts, offset) - 1
        if k < 0:
            return None
        start = self._starts[k]
        data = self._pieces[start]
        if offset >= start + len(data):
            return None
        self._pieces.move_to_end(start)
        return start, data

    def after(self, offset: int) -> int | None:
        """Offset of the next piece after `offset`."""
        k = bisect_right(self._starts, offset)
        return self._starts[k] if k < len(self._starts) else None

    def spans(self) -> list[tuple[int, int]]:
        """First byte, and the one after the last, of every piece."""
        return [(start, start + len(self._pieces[start])) for start in self._starts]


class ReadAhead:
    """Parts of an object that are read in order, the next few of them ahead."""

    def __init__(
        self, parts: list[tuple[int, int]], ask: Callable[[tuple[int, int]], Future[Got]]
    ) -> None:
        self._parts = parts
        self._ask = ask
        self._begun: dict[int, Future[Got]] = {}
        self._fresh = 0

    def at(self, offset: int) -> tuple[int, bytes] | None:
        """The part that holds the byte at `offset`, with its offset; requests for the following
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
        return self._parts[k][0], self._begun.pop(k).result().data

    def after(self, offset: int) -> int | None:
        """Offset of the next part after `offset`."""
        k = bisect_right(self._parts, offset, key=lambda part: part[0])
        return self._parts[k][0] if k < len(self._parts) else None

    def left(self) -> Iterator[tuple[int, bytes]]:
        """Completed parts that were not read; failed requests are repeated when needed."""
        for k, part in self._begun.items():
            if part.exception() is None:
                yield self._parts[k][0], part.result().data


class RemoteFile:
    """One object for reading; thread-safe. Raises LogError on server errors.

    ends: bytes of its ends by offset; index bytes that are read are added. ask: starts a request
    for a range: first byte, and the one after the last.
    """

    def __init__(
        self, size: int, ends: dict[int, bytes], ask: Callable[[tuple[int, int]], Future[Got]]
    ) -> None:
        self.size = size
        self._ends = ends
        self._ask = ask
        self._lock = threading.Lock()
        self._held = _Held(HELD_BYTES)
        for start, data in sorted(ends.items()):
            self._put(start, data)

    def cost(self, begin: IntArray, end: IntArray) -> int:
        """Bytes that reading these ranges requests, with gaps and without bytes already held."""
        return sum(stop - start for start, stop in self._planned(begin, end))

    def _planned(self, begin: IntArray, end: IntArray) -> list[tuple[int, int]]:
        with self._lock:
            held = self._held.spans()
        return in_parts(*coalesced(*without(begin, end, held)), PART_BYTES)

    @contextmanager
    def reading_ahead(self, begin: IntArray, end: IntArray) -> Iterator[ReadAhead]:
        """Context in which these ranges are read ahead, in order."""
        ahead = ReadAhead(self._planned(begin, end), self._ask)
        try:
            yield ahead
        except GeneratorExit:
            self._keep_left(ahead)
            raise
        self._keep_left(ahead)

    def _keep_left(self, ahead: ReadAhead) -> None:
        with self._lock:
            for start, data in ahead.left():
                self._put(start, data)

    def read(self, offset: int, length: int, ahead: ReadAhead | None = None) -> bytes:
        """The bytes at an offset inside the object."""
        out: list[bytes] = []
        at, stop = offset, offset + length
        with self._lock:
            while at < stop:
                start, data = self._held.at(at) or self._fetched(at, stop, ahead)
                out.append(data[at - start : stop - start])
                at += len(out[-1])
        return out[0] if len(out) == 1 else b"".join(out)

    def _fetched(self, at: int, stop: int, ahead: ReadAhead | None) -> tuple[int, bytes]:
        """A piece with the byte at `at`, which is not held."""
        found = ahead.at(at) if ahead is not None else None
        if found is None:
            # Not announced: read a little more, but nothing twice.
            behind = (self._held.after(at), ahead.after(at) if ahead is not None else None)
            most = min(max(stop, at + LEAST_BYTES), self.size)
            end = min([most, *(place for place in behind if place is not None)])
            found = at, self._ask((at, end)).result().data
            if ahead is None and end - at <= TAIL_MOST:
                self._ends[at] = found[1]  # part of an index
        self._put(*found)
        return found

    def _put(self, start: int, data: bytes) -> None:
        """Keep the bytes of a piece that are not held yet."""
        at, stop = start, start + len(data)
        while at < stop:
            there = self._held.at(at)
            if there is not None:
                at = there[0] + len(there[1])
                continue
            behind = self._held.after(at)
            end = stop if behind is None else min(stop, behind)
            self._held.put(at, data[at - start : end - start])
            at = end
