"""Logs that hold their messages in chunks, MCAP files and bags: what both have in common.

A format lists the pieces of a file (`Chunk`): its chunks and the runs of records outside of them.
They are read and decompressed ahead of the decoding, checked, and skipped if they are damaged.
"""

from __future__ import annotations

import struct
from abc import ABC, abstractmethod
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property, partial
from typing import ClassVar, NamedTuple

import numpy as np

from ...topology.arrays import IntArray
from ...topology.errors import LogError
from ..remote.path import LogPath, RemotePath
from ..remote.source import Ranges
from .channels import Channels
from .inflate import (
    INFLATED_BYTES,
    SLOW,
    WHOLE_BYTES,
    WRONG_SIZE,
    checksum,
    excess,
    inflate,
    pieces,
)
from .messages import (
    CUT,
    MESSAGE_BYTES,
    NOT_TOLD,
    TOO_LARGE,
    UNREADABLE,
    Block,
    Bytes,
    Channel,
    DamageError,
    Findings,
    Passed,
    Survey,
    Want,
)
from .source import LEAST_BYTES, SLAB_BYTES, Source, open_source

ALLOW_SCAN = "--allow-scan"

THREADS = 2
"""Threads that decompress: reading, decompression and checksums release the interpreter's lock."""

SMALL_BYTES = 1 << 15
"""Chunks up to this size are decoded together: the work per chunk exceeds the work per byte."""

AHEAD_BYTES, AHEAD = 1 << 25, 64
"""Bytes, and chunks, read and decompressed ahead of the decoding."""

RECORD_BYTES = MESSAGE_BYTES + (1 << 12)
"""Longest record: a longer one holds a longer message than is read."""

TRIES = 1 << 16
"""Places of one file that are looked at in search of a record, 10 µs each."""

Read = Callable[[int, int], bytes]
"""Gives bytes by their position and number, fewer at the end."""


def reader_of(data: Bytes) -> Read:
    """Reads from a buffer."""
    return lambda at, count: data[at : at + count].tobytes()


class Chunk(NamedTuple):
    """A stretch of a file that holds records of messages and channels.

    compression: empty if there is none; at, packed: position and number of its bytes; size: of the
    records when decompressed; crc: their checksum, 0 if none is given; cut: whether the file ends
    within it.
    """

    compression: str
    at: int
    packed: int
    size: int
    crc: int = 0
    cut: bool = False


class Index(NamedTuple):
    """The index of a log.

    channels: by number; counts: messages of each; span_ns: first and last log time; chunks: bytes
    of each chunk and the channels in it, in the order of the file; distrusted: why they are not
    used to choose chunks, empty if they are; checked: whether a checksum covers it all; start:
    where the index begins.
    """

    channels: Mapping[int, Channel]
    counts: Mapping[int, int]
    span_ns: tuple[int, int]
    chunks: list[tuple[int, int, frozenset[int]]]
    distrusted: str
    checked: bool
    start: int


class ChunkedLog:
    """One log in chunks. read_index: gives the index of a format, None if there is none; scan: the
    scan of that format."""

    def __init__(
        self, path: LogPath, read_index: Callable[[Source], Index | None], scan: type[Scan]
    ) -> None:
        self.path = path
        self._read_index = read_index
        self._scan = scan

    @cached_property
    def index(self) -> Index | None:
        """The file's index, None if it has none or a damaged one."""
        with open_source(self.path) as source:
            try:
                return self._read_index(source)
            except (DamageError, struct.error):
                return None

    def survey(self, exact: bool = False) -> Survey | None:
        """Message counts by the index."""
        found = self.index
        if found is None or not found.counts or not found.counts.keys() <= found.channels.keys():
            return None
        counts: Counter[Channel] = Counter()
        for number, channel in found.channels.items():
            counts[channel] += found.counts.get(number, 0)
        return Survey(counts, *found.span_ns, found.checked)

    def _channels(self, want: Want, findings: Findings) -> tuple[Channels, Ranges | str]:
        """The channels as the index describes them, and the chunks that hold wanted ones, or why
        all are to be read."""
        channels, found = Channels(want, findings), self.index
        if found is None:
            return channels, "it has no index, or a damaged one"
        for number, channel in found.channels.items():
            channels.describe(number, channel)
        if found.distrusted:
            return channels, found.distrusted
        if not (found.checked or isinstance(self.path, RemotePath)):
            return channels, "its index has no checksum"  # reading all is quick here
        wanted = {number for number in found.channels if channels.wanted(number)}
        return channels, [(begin, end) for begin, end, held in found.chunks if held & wanted]

    def blocks(self, want: Want, findings: Findings, passed: Passed = NOT_TOLD) -> Iterator[Block]:
        """Scan the file once. O(bytes); memory: some chunks, compressed and decompressed."""
        with open_source(self.path) as source:
            channels, needed = self._channels(want, findings)
            whole = isinstance(needed, str)
            if isinstance(needed, str):
                if isinstance(self.path, RemotePath) and not self.path.allow_scan:
                    raise LogError(
                        f"{self.path}: {needed}, so that all of its {source.size:,} bytes would "
                        f"have to be read; {ALLOW_SCAN} does that"
                    )
                needed = [(0, source.size)]
            scan = self._scan(source, channels, findings, passed, self.index)
            with source.ahead(needed):
                yield from scan.blocks(scan.all() if whole else scan.some(needed))
            channels.finish(self.index.counts if self.index is not None else {}, by_index=not whole)


class Scan(ABC):
    """One scan over the records of a chunked log."""

    def __init__(
        self,
        source: Source,
        channels: Channels,
        findings: Findings,
        passed: Passed,
        index: Index | None,
    ) -> None:
        self.findings = findings
        self._passed = passed
        self._index = index
        self._source = source
        self._channels = channels
        self._excess_left = INFLATED_BYTES
        self._tries = TRIES
        self._held: list[bytes] = []
        self._held_bytes = 0

    # What a format tells

    @abstractmethod
    def all(self) -> Iterator[Chunk]:
        """All chunks of the file."""

    @abstractmethod
    def _chunk_at(self, position: int) -> Chunk | None:
        """The chunk whose record begins at a position."""

    @abstractmethod
    def _records(self, data: Bytes) -> tuple[IntArray, int]:
        """Positions of the complete records at the front of a chunk's data, and where they end."""

    @abstractmethod
    def _blocks(self, data: Bytes, where: IntArray) -> Iterator[Block]:
        """The wanted messages among records."""

    @abstractmethod
    def _record_size(self, data: Bytes) -> int:
        """Length of the record that begins with `data`, 0 if it cannot be one."""

    front: ClassVar[int]
    """Bytes that show whether a record may begin."""

    @abstractmethod
    def _starts(self, raw: bytes, most: int) -> Iterable[int]:
        """Positions where records may begin, by their first bytes; most: the longest record that
        fits, from the first byte on."""

    @abstractmethod
    def _leads_on(self, read: Read, position: int, stop: int) -> bool:
        """Whether believable records follow each other from a position on."""

    # What is the same

    def some(self, ranges: Ranges) -> Iterator[Chunk]:
        """The chunks at some places of the index."""
        for begin, end in ranges:
            chunk = self._chunk_at(begin)
            if chunk is None or chunk.at + chunk.packed > end:
                self._fault("damaged chunk", "skipped: it is not where the index says")
            else:
                yield chunk

    def blocks(self, chunks: Iterator[Chunk]) -> Iterator[Block]:
        """The messages of chunks, which are decompressed ahead; damaged ones are skipped."""
        pool = ThreadPoolExecutor(THREADS)
        waiting: deque[tuple[Chunk, Callable[[], bytes]]] = deque()
        ahead = 0
        try:
            for chunk in chunks:
                task = partial(_inflated, chunk, self._source.read)
                slow = chunk.compression in SLOW and chunk.size > SMALL_BYTES
                slow &= not _in_parts(chunk)
                waiting.append((chunk, pool.submit(task).result if slow else task))
                ahead += chunk.packed + chunk.size
                while ahead > AHEAD_BYTES or len(waiting) > AHEAD:
                    ahead -= waiting[0][0].packed + waiting[0][0].size
                    yield from self._of_chunk(*waiting.popleft())
            while waiting:
                yield from self._of_chunk(*waiting.popleft())
            yield from self._used_together()
        finally:
            pool.shutdown(cancel_futures=True)

    def _of_chunk(self, chunk: Chunk, inflated: Callable[[], bytes]) -> Iterator[Block]:
        """The messages of a chunk, which is skipped if it is damaged."""
        try:
            more = excess(chunk.compression, chunk.packed, chunk.size)
            if more > self._excess_left:
                raise DamageError("a limit: they inflate to far more than logs do")
            self._excess_left -= more
            if _in_parts(chunk):
                yield from self._used_together()
                yield from self._streamed(chunk)
            else:
                raw = inflated()
                if chunk.size > SMALL_BYTES:
                    yield from self._used_together()
                self._held.append(raw)
                self._held_bytes += max(len(raw), 64)  # an empty one takes memory as well
                if self._held_bytes > 8 * SMALL_BYTES or chunk.size > SMALL_BYTES:
                    yield from self._used_together()
        except DamageError as damage:
            self._fault("damaged chunk", f"skipped: {damage}")
        self._passed.passed(chunk.at + chunk.packed)

    def _fault(self, noun: str, rest: str, count: int = 1) -> None:
        self.findings.faults[noun, rest] += count

    def _used_together(self) -> Iterator[Block]:
        """The messages of the chunks held."""
        held, self._held, self._held_bytes = self._held, [], 0
        data = np.frombuffer(held[0] if len(held) == 1 else b"".join(held), np.uint8)
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
            self._fault(*UNREADABLE, following - stop)
            data = data[following:]

    def _streamed(self, chunk: Chunk) -> Iterator[Block]:
        """The messages of a chunk too large for memory, or cut: what comes before its end is used.

        A record too large for memory is skipped.
        """
        held, need, skip, found, crc = bytearray(), 0, 0, 0, 0
        try:
            for piece in pieces(chunk.compression, _ChunkData(self._source, chunk)):
                found, crc = found + len(piece), checksum(piece, crc)
                if found > chunk.size:
                    raise DamageError(WRONG_SIZE)
                held += piece[skip:]
                skip = max(skip - len(piece), 0)
                if len(held) < need:
                    continue
                data = np.frombuffer(held, np.uint8)
                where, stop = self._records(data)
                yield from self._blocks(data[:stop], where)
                rest = data[stop:]
                need = self._record_size(rest)
                if need == 0 and len(rest) > SLAB_BYTES:
                    raise DamageError("the records of a chunk do not fill it")
                if need > RECORD_BYTES:
                    self._fault(*TOO_LARGE)
                    need, skip, rest = 0, need - len(rest), rest[:0]
                held = bytearray(rest)
        except DamageError:
            if not chunk.cut:
                raise
        if chunk.cut:
            self.findings.faults[CUT] = 1
        elif held or skip:
            raise DamageError("the records of a chunk do not fill it")
        elif chunk.crc and crc != chunk.crc:
            self._fault("large chunk", "with a wrong checksum (CRC), used all the same")

    def _next_record(self, read: Read, position: int, stop: int) -> int | None:
        """The next position from which on records follow each other, None if there is none."""
        window = LEAST_BYTES
        while position < stop:
            raw = read(position, window + self.front - 1)
            for start in self._starts(raw, stop - position):
                self._tries -= 1
                if self._tries < 0:
                    return None
                if self._leads_on(read, position + start, stop):
                    return position + start
            position += window
            window = min(4 * window, SLAB_BYTES)
        return None

    def _around_damage(self, position: int, stop: int) -> int:
        """Where reading goes on behind a record that cannot be read; what is between is counted."""
        found = self._next_record(self._source.read, position + 1, stop)
        if found is None and stop == self._source.size:
            self.findings.faults[CUT] = 1
        found = stop if found is None else found
        self._fault(*UNREADABLE, found - position)
        return found


class _ChunkData:
    """The packed bytes of a chunk, as a file."""

    def __init__(self, source: Source, chunk: Chunk) -> None:
        self._source, self._at, self._end = source, chunk.at, chunk.at + chunk.packed

    def read(self, size: int) -> bytes:
        """The next bytes."""
        data = self._source.read(self._at, min(size, self._end - self._at))
        self._at += len(data)
        return data


def _in_parts(chunk: Chunk) -> bool:
    return chunk.cut or max(chunk.size, chunk.packed) > WHOLE_BYTES


def _inflated(chunk: Chunk, read: Read) -> bytes:
    """The records of a chunk; raises DamageError. Thread-safe if `read` is."""
    data = read(chunk.at, chunk.packed)
    if chunk.compression:
        data = inflate(chunk.compression, data, chunk.size)
    elif len(data) != chunk.size:
        raise DamageError(WRONG_SIZE)
    if chunk.crc and checksum(data) != chunk.crc:
        raise DamageError("checksum (CRC) is wrong")
    return data
