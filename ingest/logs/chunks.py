"""Logs that hold their messages in chunks, MCAP files and bags: what both have in common.

Chunks are read and decompressed ahead of the decoding, checked, and skipped if they are damaged.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from typing import NamedTuple

import numpy as np

from ...topology.arrays import BoolArray, IntArray
from ..remote.path import LogPath, RemotePath
from .channels import Channels
from .inflate import (
    SLOW,
    WHOLE_BYTES,
    Allowance,
    LimitError,
    WrongSizeError,
    checksum,
    inflate,
    inflate_part,
    keep_freed_memory,
    pieces,
)
from .messages import MESSAGE_BYTES, Block, Bytes, DamageError, Findings, Progress, Walking, Want
from .source import SLAB_BYTES, RemoteSource, Source, open_source

THREADS = 2
"""Threads that decompress: reading, decompression and checksums release the interpreter's lock."""

AHEAD_BYTES = 1 << 25
"""Bytes read and decompressed ahead of the decoding."""

SMALL_BYTES = 1 << 15
"""Chunks up to this size are decoded together: the work per chunk exceeds the work per byte."""

RECORD_BYTES = MESSAGE_BYTES + (1 << 12)
"""Longest record of most channels: a longer one holds a longer message than is decoded."""


Read = Callable[[int, int], bytes]
"""Gives bytes by their position and number, fewer at the end."""


def reader_of(data: Bytes) -> Read:
    """Reads from a buffer."""
    return lambda at, count: data[at : at + count].tobytes()


class Chunk(NamedTuple):
    """A chunk record's description of its data.

    compression: empty if there is none; size: of the data when decompressed; crc: their checksum, 0
    if none is given; listed: messages per channel by the index records behind it.
    """

    compression: str
    data_at: int
    data_size: int
    size: int
    crc: int
    listed: dict[int, int]


class ChunkIndex(NamedTuple):
    """The chunks of a log in the order of the file.

    begin, end: (c,) positions of their bytes; first_ns, last_ns: (c,) log times; chunk, channel,
    messages: (k,) number of messages of a channel in a chunk, in the order of chunks.
    """

    begin: IntArray
    end: IntArray
    first_ns: IntArray
    last_ns: IntArray
    chunk: IntArray
    channel: IntArray
    messages: IntArray

    def needed(self, wanted: BoolArray) -> BoolArray:
        """(c,) which chunks hold any message that is wanted, by channel number."""
        out = np.zeros(len(self.begin), bool)
        out[self.chunk[wanted[self.channel] & (self.messages > 0)]] = True
        return out

    def counts(self, chunks: BoolArray) -> dict[int, int]:
        """Messages per channel in some of the chunks."""
        inside = chunks[self.chunk]
        channel, count = self.channel[inside], self.messages[inside]
        totals = np.zeros(int(channel.max(initial=-1)) + 1, np.int64)
        np.add.at(totals, channel, count)
        return {int(n): int(totals[n]) for n in totals.nonzero()[0]}


class ChunkedLog(ABC):
    """One log in chunks. BEHIND: bytes read behind a chunk to find its end."""

    BEHIND = 0

    def __init__(self, path: LogPath) -> None:
        self.path = path

    @abstractmethod
    def _chunks(self) -> ChunkIndex | str:
        """The contents of each chunk by the file's index, or why there is none."""

    @abstractmethod
    def _scan(self, source: Source, channels: Channels, findings: Findings, by_index: bool) -> Scan:
        """A new scan of the file; what its index describes is registered with the channels.

        by_index: whether it is believed.
        """

    def _ranges(self, index: ChunkIndex, needed: BoolArray) -> tuple[IntArray, IntArray]:
        return index.begin[needed], index.end[needed] + self.BEHIND

    def cost(self, want: Want) -> int:
        """Number of bytes of a remote file to be fetched for what is wanted."""
        assert isinstance(self.path, RemotePath)
        index, source = self._chunks(), RemoteSource(self.path)
        begin, end = np.array([0]), np.array([source.size])
        if isinstance(index, ChunkIndex):
            channels = Channels(want, Findings())
            self._scan(source, channels, Findings(), by_index=True)
            begin, end = self._ranges(index, index.needed(channels.wanted()))
        return self.path.file.cost(begin, np.minimum(end, source.size))

    def blocks(
        self,
        want: Want,
        findings: Findings,
        progress: Progress | None = None,
        *,
        by_index: bool = True,
    ) -> Iterator[Block]:
        """Scan the file once. O(bytes); memory: some chunks, compressed and decompressed.

        by_index: whether only the chunks are read that hold what is wanted, if the index is sound.
        """
        keep_freed_memory()
        with open_source(self.path, progress) as source:
            remote = source if isinstance(source, RemoteSource) else None
            index = self._chunks() if by_index or remote else "it is not believed"
            if remote is not None and isinstance(index, str):
                remote.check_scan(index)
            channels = Channels(want, findings)
            with self._scan(source, channels, findings, by_index) as scan:
                if isinstance(index, ChunkIndex):
                    yield from self._chosen(scan, source, index, channels)
                elif remote is not None:
                    with remote.reading(np.array([0]), np.array([source.size])):
                        yield from scan.all()
                else:
                    yield from scan.all()
            source.passed(source.size)

    def _chosen(
        self, scan: Scan, source: Source, index: ChunkIndex, channels: Channels
    ) -> Iterator[Block]:
        """Read the chunks that hold wanted messages; of the others the index gives the counts."""
        needed = index.needed(channels.wanted())
        for number, count in index.counts(~needed).items():
            channels.passed(number, count)
        filled = ~needed & (index.first_ns <= index.last_ns)
        if filled.any():
            scan.findings.span(int(index.first_ns[filled].min()), int(index.last_ns[filled].max()))
        begin, end = index.begin[needed].tolist(), index.end[needed].tolist()
        if isinstance(source, RemoteSource):
            with source.reading(*self._ranges(index, needed)):
                yield from scan.some(begin, end)
        else:
            yield from scan.some(begin, end)


class Scan(ABC):
    """One scan over the records of a chunked log."""

    def __init__(self, source: Source, channels: Channels, findings: Findings) -> None:
        self.findings = findings
        self._source = source
        self._channels = channels
        self._allowance = Allowance()
        self._pool: ThreadPoolExecutor | None = None
        self._ahead: deque[tuple[Chunk, Future[Bytes | bytes]]] = deque()
        self._ahead_bytes = 0
        self._small: list[bytes] = []
        self._small_bytes = 0
        self._broken: list[Chunk] = []
        self._last: Chunk | None = None
        self._packed = self._at_least = False

    def __enter__(self) -> Scan:
        return self

    def __exit__(self, *_: object) -> None:
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)

    # What a format tells

    @abstractmethod
    def _walk(self, position: int, stop: int) -> Iterator[Block]:
        """The messages of all records, in chunks or not, from a position on."""

    @abstractmethod
    def _records(self, data: Bytes) -> tuple[IntArray, int]:
        """Positions of the complete records at the front of a chunk's data, and where they end."""

    @abstractmethod
    def _blocks(self, data: Bytes, where: IntArray) -> Iterator[Block]:
        """The wanted messages among records."""

    @abstractmethod
    def _head(self, data: Bytes) -> tuple[int, int]:
        """Length of the record that begins with `data`, 0 if it cannot be one, and the number of
        its channel, NUMBERS if it is no message."""

    @abstractmethod
    def _next_record(self, read: Read, position: int, stop: int) -> int | None:
        """The next position from which on records follow each other, None if there is none."""

    @abstractmethod
    def _plausible(self, position: int) -> bool:
        """Whether a record may begin at a position of the file."""

    @abstractmethod
    def _declared(self) -> Mapping[int, int]:
        """Messages per channel by the file's index, empty without one."""

    # What is the same

    def all(self) -> Iterator[Block]:
        """All messages of the file."""
        yield from self._walk(0, self._source.size)
        yield from self._finish()

    def some(self, begin: list[int], end: list[int]) -> Iterator[Block]:
        """All messages in some ranges of the file."""
        for first, stop in zip(begin, end, strict=True):
            yield from self._walk(first, stop)
            self._source.passed(stop)
        yield from self._finish()

    def _finish(self) -> Iterator[Block]:
        yield from self._caught_up()
        declared = self._declared()
        for chunk in self._broken:
            for number, count in chunk.listed.items():
                self._channels.lost(number, count)
            self._at_least |= not chunk.listed
        # The file's own counts tell exactly what is missing.
        self.findings.lost_at_least |= self._at_least and not declared
        self._channels.finish(declared)

    def _around_damage(self, position: int, stop: int) -> Walking:
        """Go on at the next record behind one that cannot be read; returns its position."""
        yield from self._caught_up()
        found = self._next_record(self._source.copy, position + 1, stop)
        self.findings.truncated |= found is None and stop == self._source.size
        if found is None and self._plausible(position):
            return stop
        found = stop if found is None else found
        self.findings.unreadable_bytes += found - position
        self._at_least = True
        if self._packed:
            # The index of a chunk that is not found counts its messages.
            self._last = Chunk("", position, 0, 0, 0, {})
            self._skip(self._last, DamageError("its head is damaged"))
        return found

    def _take(self, chunk: Chunk) -> Iterator[Block]:
        """Queue a chunk, and use those that are ready."""
        self._last = chunk
        self._packed |= chunk.compression != ""
        if max(chunk.size, chunk.data_size) > WHOLE_BYTES:
            yield from self._caught_up()
            yield from self._guarded(chunk, self._piecewise(chunk))
        elif chunk.compression in SLOW and chunk.size > SMALL_BYTES:
            yield from self._used_together()
            yield from self._begin(chunk)
        else:
            yield from self._caught_up(small=chunk.size > SMALL_BYTES)
            yield from self._guarded(chunk, self._whole(chunk))

    def _begin(self, chunk: Chunk) -> Iterator[Block]:
        """Decompress a chunk on another thread."""
        try:
            self._allowance.take(chunk.compression, chunk.data_size, chunk.size)
        except DamageError as damage:
            yield from self._caught_up()
            self._skip(chunk, damage)
            return
        if self._pool is None:
            self._pool = ThreadPoolExecutor(THREADS)
        task = partial(_inflated, chunk, self._source.copy)
        self._ahead.append((chunk, self._pool.submit(task)))
        self._ahead_bytes += chunk.data_size + chunk.size
        while self._ahead_bytes > AHEAD_BYTES:
            yield from self._next()

    def _next(self) -> Iterator[Block]:
        chunk, future = self._ahead.popleft()
        self._ahead_bytes -= chunk.data_size + chunk.size

        def used() -> Iterator[Block]:
            yield from self._used(np.frombuffer(future.result(), np.uint8))

        yield from self._guarded(chunk, used())

    def _caught_up(self, small: bool = True) -> Iterator[Block]:
        """The messages of all chunks so far; small: also of the small ones, which are kept to be
        used together."""
        while self._ahead:
            yield from self._next()
        if small:
            yield from self._used_together()

    def _guarded(self, chunk: Chunk, blocks: Iterator[Block]) -> Iterator[Block]:
        """Blocks of a chunk, which is skipped if it is damaged."""
        try:
            yield from blocks
        except DamageError as damage:
            self._skip(chunk, damage)

    def _skip(self, chunk: Chunk, damage: DamageError) -> None:
        """Count a chunk that cannot be used."""
        if isinstance(damage, LimitError):
            self.findings.beyond_limit[str(damage)] += 1
        else:
            self.findings.damaged_chunks[str(damage)] += 1
        self._broken.append(chunk)

    def _whole(self, chunk: Chunk) -> Iterator[Block]:
        """The messages of a chunk that is decompressed on this thread; small ones are kept."""
        if chunk.compression:
            self._allowance.take(chunk.compression, chunk.data_size, chunk.size)
        raw = _inflated(chunk, self._source.view)
        if chunk.size > SMALL_BYTES:
            yield from self._used(np.frombuffer(raw, np.uint8))
            return
        self._small.append(bytes(raw))
        self._small_bytes += len(raw)
        if self._small_bytes > 8 * SMALL_BYTES:
            yield from self._used_together()

    def _used_together(self) -> Iterator[Block]:
        """The messages of small chunks."""
        held, self._small, self._small_bytes = self._small, [], 0
        if not held:
            return
        data = np.frombuffer(b"".join(held), np.uint8)
        where, stop = self._records(data)
        if stop == len(data):
            yield from self._blocks(data, where)
            return
        for raw in held:
            yield from self._used(np.frombuffer(raw, np.uint8))

    def _used(self, data: Bytes) -> Iterator[Block]:
        """The messages in the data of a chunk; records that are damaged are skipped."""
        while True:
            where, stop = self._records(data)
            yield from self._blocks(data[:stop], where)
            if stop == len(data):
                return
            found = self._next_record(reader_of(data), stop + 1, len(data))
            following = len(data) if found is None else found
            self.findings.unreadable_bytes += following - stop
            self._at_least = True
            data = data[following:]

    def _cut(self, chunk: Chunk) -> Iterator[Block]:
        """The messages of the last chunk of a file that is cut within it."""
        yield from self._caught_up()
        self.findings.truncated = True
        data = self._source.copy(chunk.data_at, min(chunk.data_size, WHOLE_BYTES))
        if chunk.compression:
            most = min(self._allowance.limit(chunk.compression, len(data)), WHOLE_BYTES)
            data = inflate_part(chunk.compression, data, most)
        part = np.frombuffer(data, np.uint8)
        where, stop = self._records(part)
        yield from self._blocks(part[:stop], where)

    def _piecewise(self, chunk: Chunk) -> Iterator[Block]:
        """The messages of a chunk too large for memory, which is checked before any is used."""
        found, crc, allowed = 0, 0, self._allowance.limit(chunk.compression, chunk.data_size)
        for piece in self._stream(chunk) if chunk.compression or chunk.crc else ():
            found += len(piece)
            crc = checksum(piece, crc)
            if found > allowed:
                raise LimitError
        if chunk.crc and crc != chunk.crc:
            raise WrongChecksumError
        if (found or chunk.data_size) != chunk.size:
            raise WrongSizeError
        if chunk.compression:
            self._allowance.take(chunk.compression, chunk.data_size, 2 * chunk.size)
        held, need, skip = bytearray(), 0, 0
        for piece in self._stream(chunk):
            held += piece[skip:]
            skip = max(skip - len(piece), 0)
            if len(held) < need:
                continue
            data = np.frombuffer(held, np.uint8)
            where, stop = self._records(data)
            yield from self._blocks(data[:stop], where)
            rest = data[stop:]
            need, number = self._head(rest)
            if need == 0 and len(rest) > SLAB_BYTES:
                break
            if need > RECORD_BYTES and not self._channels.large(number, need):
                need, skip, rest = 0, need - len(rest), rest[:0]
            held = bytearray(rest)
        if held or skip:
            raise DamageError("the records of a chunk do not fill it")

    def _stream(self, chunk: Chunk) -> Iterator[bytes]:
        """The decompressed chunk, piece by piece."""
        at, end = chunk.data_at, chunk.data_at + chunk.data_size

        def read(size: int) -> bytes:
            nonlocal at
            data = self._source.copy(at, min(size, end - at))
            at += len(data)
            return data

        return pieces(chunk.compression, read)


class WrongChecksumError(DamageError):
    """The data have another checksum than declared."""

    def __init__(self) -> None:
        super().__init__("checksum (CRC) is wrong")


def _inflated(chunk: Chunk, read: Callable[[int, int], Bytes | bytes]) -> Bytes | bytes:
    """The records of a chunk; raises DamageError. Thread-safe if `read` is."""
    data = read(chunk.data_at, chunk.data_size)
    if chunk.compression:
        data = inflate(chunk.compression, data, chunk.size)
    elif len(data) != chunk.size:
        raise WrongSizeError
    if chunk.crc and checksum(np.frombuffer(data, np.uint8).data) != chunk.crc:
        raise WrongChecksumError
    return data
