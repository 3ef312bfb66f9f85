"""Logs that hold their messages in chunks, MCAP files and bags: what both have in common.

A format tells what record begins at a place. The walk lists a file's chunks and the runs of records
outside of them (`Chunk`), which are read and decompressed ahead of the decoding, checked, and
skipped if they are damaged.
"""

from __future__ import annotations

import re
import struct
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from functools import cached_property
from typing import ClassVar, NamedTuple

import numpy as np

from ...topology.arrays import IntArray
from ...topology.errors import LogError
from ..remote.path import LogPath, RemotePath
from ..remote.source import Ranges
from .channels import Channels
from .inflate import INFLATED_BYTES, WHOLE_BYTES, WRONG_SIZE, checksum, excess, inflate, pieces
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

TOGETHER_BYTES = 1 << 18
"""Small chunks are decoded together up to this size: the work per chunk exceeds the work per
byte."""

TRIES = 1 << 18
"""Places of one file that are looked at in search of a record, 3 µs each."""

HEAD_BYTES = 256
"""Bytes of a record that are looked at first: they show what most records are."""

INDEX_BYTES = 1 << 26
"""Largest index that is read; a chunk takes 100 to 200 bytes in it."""

NO_RECORDS = "its records do not fill it"

Read = Callable[[int, int], bytes]
"""Gives bytes by their position and number, fewer at the end."""


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


class Found(NamedTuple):
    """A record of a file. end: where the next one begins; chunk: if it is one; loose: whether it
    describes a channel or is a message, outside of any chunk."""

    end: int
    chunk: Chunk | None = None
    loose: bool = False


class Index(NamedTuple):
    """The index of a log.

    channels: by number; counts: messages of each; span_ns: first and last log time; chunks: bytes
    of each chunk and the channels in it, in the order of the file, none if they contradict each
    other; checked: whether a checksum covers it all; start: where the index begins.
    """

    channels: Mapping[int, Channel]
    counts: Mapping[int, int]
    span_ns: tuple[int, int]
    chunks: list[tuple[int, int, frozenset[int]]]
    checked: bool
    start: int


class ChunkedLog:
    """One log in chunks. read_index: gives the index of a format, None if it needs none; raises
    DamageError if it is missing or damaged; scan: the scan of that format."""

    def __init__(
        self, path: LogPath, read_index: Callable[[Source], Index | None], scan: type[Scan]
    ) -> None:
        self.path = path
        self._read_index = read_index
        self._scan = scan

    @cached_property
    def _found(self) -> tuple[Index | None, str]:
        """The file's index, and what is wrong with it."""
        with open_source(self.path) as source:
            try:
                return self._read_index(source), ""
            except DamageError as damage:
                return None, str(damage)
            except struct.error:
                return None, "the index is damaged"

    def survey(self, exact: bool = False) -> Survey | None:
        """Message counts by the index."""
        found, _ = self._found
        if found is None or not found.counts or not found.counts.keys() <= found.channels.keys():
            return None
        counts: Counter[Channel] = Counter()
        for number, channel in found.channels.items():
            counts[channel] += found.counts.get(number, 0)
        return Survey(counts, *found.span_ns, found.checked)

    def blocks(self, want: Want, findings: Findings, passed: Passed = NOT_TOLD) -> Iterator[Block]:
        """Scan the file once: the chunks that hold wanted channels by the index, or all of it.

        O(bytes); memory: some chunks, compressed and decompressed.
        """
        channels, (index, flaw) = Channels(want, findings), self._found
        if flaw:
            findings.note(flaw)
        for number, channel in (index.channels if index is not None else {}).items():
            channels.describe(number, channel)
        remote = self.path if isinstance(self.path, RemotePath) else None
        # Here reading all is quick, and an index without a checksum may be wrong.
        by_index = index is not None and bool(index.chunks) and (index.checked or remote)
        with open_source(self.path) as source:
            if index is not None and by_index:
                wanted = {number for number in index.channels if channels.wanted(number)}
                needed = [(begin, end) for begin, end, held in index.chunks if held & wanted]
            elif remote is not None and not remote.allow_scan:
                raise LogError(
                    f"{self.path}: it has no index, or a damaged one, so that all of its "
                    f"{source.size:,} bytes would have to be read; {ALLOW_SCAN} does that"
                )
            else:
                needed = [(0, source.size)]
            stop = index.start if index is not None else source.size
            scan = self._scan(source, channels, findings, passed, stop)
            with source.ahead(needed):
                yield from scan.blocks(scan.some(needed) if by_index else scan.all())
            counts = index.counts if index is not None else {}
            channels.finish(counts, by_index=bool(by_index))


class Scan(ABC):
    """One scan over the records of a chunked log. stop: where its data end."""

    def __init__(
        self, source: Source, channels: Channels, findings: Findings, passed: Passed, stop: int
    ) -> None:
        self.findings = findings
        self._passed = passed
        self._stop = stop
        self._source = source
        self._channels = channels
        self._excess_left = INFLATED_BYTES
        self._tries = TRIES
        self._held: list[bytes] = []
        self._held_bytes = 0

    # What a format tells

    FIRST: ClassVar[int]
    """Where the first record begins."""

    FRONT: ClassVar[re.Pattern[bytes]]
    """How chunks, and records outside of them, may begin: in less than HEAD_BYTES."""

    @abstractmethod
    def _record_at(self, position: int) -> Found | None:
        """The record at a position, None if there is none that could be one."""

    @abstractmethod
    def _records(self, data: Bytes) -> tuple[IntArray, int]:
        """Positions of the complete records at the front of a chunk's data, and where they end."""

    @abstractmethod
    def _blocks(self, data: Bytes, where: IntArray) -> Iterator[Block]:
        """The wanted messages among records."""

    # What is the same

    def all(self) -> Iterator[Chunk]:
        """All chunks of the file, and runs of records outside of them."""
        position, window = self.FIRST, LEAST_BYTES
        while position < self._stop:
            found = self._record_at(position)
            if found is None or found.end > self._stop:
                following = self._next_record(position + 1)
                if following is None:
                    yield from self._cut(position, found)
                    return
                self._fault(*UNREADABLE, following - position)
                position = following
            elif not found.loose:
                if found.chunk is not None:
                    yield found.chunk
                position = found.end
            elif found.end - position > MESSAGE_BYTES:
                self._fault(*TOO_LARGE)
                position = found.end
            else:
                raw = self._source.read(position, max(window, found.end - position))
                _, size = self._records(np.frombuffer(raw, np.uint8))
                yield Chunk("", position, size, size)
                window = min(max(4 * size, LEAST_BYTES), SLAB_BYTES)
                position += size

    def _cut(self, position: int, found: Found | None) -> Iterator[Chunk]:
        """What remains of the last record that the data hold, which is not whole."""
        if self._stop == self._source.size:
            self.findings.faults[CUT] = 1
        if found is not None and found.chunk is not None:
            yield found.chunk._replace(packed=self._stop - found.chunk.at, cut=True)
        else:
            self._fault(*UNREADABLE, self._stop - position)

    def _next_record(self, position: int) -> int | None:
        """Where the next chunk, or record outside of chunks, begins that another record or the end
        follows; None if there is none."""
        while position < self._stop:
            raw = self._source.read(position, min(SLAB_BYTES, self._stop - position))
            for match in self.FRONT.finditer(raw):
                self._tries -= 1
                if self._tries < 0:
                    return None
                at = position + match.start()
                found = self._record_at(at)
                if found is not None and self._is_followed(found):
                    return at
            position += SLAB_BYTES - HEAD_BYTES
        return None

    def _is_followed(self, found: Found) -> bool:
        if found.end >= self._stop:
            return found.end == self._stop or found.chunk is not None
        return self._record_at(found.end) is not None

    def some(self, ranges: Ranges) -> Iterator[Chunk]:
        """The chunks at some places of the index."""
        for begin, end in ranges:
            found = self._record_at(begin)
            if found is None or found.chunk is None or found.end > end:
                self._fault("damaged chunk", "skipped: it is not where the index says")
            else:
                yield found.chunk

    def blocks(self, chunks: Iterator[Chunk]) -> Iterator[Block]:
        """The messages of chunks; damaged ones are skipped."""
        for chunk in chunks:
            yield from self._of_chunk(chunk)
        yield from self._used_together()

    def _of_chunk(self, chunk: Chunk) -> Iterator[Block]:
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
                self._held.append(_inflated(chunk, self._source.read))
                self._held_bytes += max(chunk.size, 64)  # an empty one takes memory as well
                if self._held_bytes > TOGETHER_BYTES:
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
            data = np.frombuffer(raw, np.uint8)
            where, stop = self._records(data)
            yield from self._blocks(data[:stop], where)
            if stop < len(data):
                self._fault(*UNREADABLE, len(data) - stop)

    def _streamed(self, chunk: Chunk) -> Iterator[Block]:
        """The messages of a chunk too large for memory, or cut: what comes before its end is
        used."""
        held, size, crc = b"", 0, 0
        try:
            for piece in pieces(chunk.compression, _ChunkData(self._source, chunk)):
                size, crc = size + len(piece), checksum(piece, crc)
                held += piece
                data = np.frombuffer(held, np.uint8)
                where, stop = self._records(data)
                yield from self._blocks(data[:stop], where)
                held = held[stop:]
                if size > chunk.size or len(held) > MESSAGE_BYTES:
                    raise DamageError(WRONG_SIZE if size > chunk.size else NO_RECORDS)
        except DamageError:
            if not chunk.cut:
                raise
        if not chunk.cut and held:
            raise DamageError(NO_RECORDS)
        if not chunk.cut and chunk.crc and crc != chunk.crc:
            self._fault("large chunk", "with a wrong checksum (CRC), used all the same")


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
    """The records of a chunk; raises DamageError."""
    data = read(chunk.at, chunk.packed)
    if chunk.compression:
        data = inflate(chunk.compression, data, chunk.size)
    elif len(data) != chunk.size:
        raise DamageError(WRONG_SIZE)
    if chunk.crc and checksum(data) != chunk.crc:
        raise DamageError("checksum (CRC) is wrong")
    return data
