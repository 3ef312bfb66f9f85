"""Chunks of a log: read ahead, decompressed, checked, and recovered if they are damaged.

Subclasses in `bag_chunks` and `mcap_chunks` know the records and chunk indexes of their format.
"""

from __future__ import annotations

import functools
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple, Protocol, Self

import numpy as np

from ...topology.arrays import IntArray
from .ahead import Ahead, Task
from .checksum import agrees, crc32
from .inflate import (
    SLOW,
    WHOLE_BYTES,
    Allowance,
    WrongSizeError,
    inflate,
    inflate_anyhow,
    inflate_part,
    pieces,
)
from .messages import Block, Bytes, DamageError, FileWindow, Findings, Walking
from .split import Large, whole_records
from .tally import Tally
from .windows import RemoteWindow, Window

SMALL_BYTES = FileWindow.STEP
"""Up to this size, compressed and decompressed, the work per chunk exceeds the work per byte: it
was read with the preceding bytes."""

RUN = 8
"""After so many consecutive small chunks the next ones are expected to be small. After 64, logs of
4,000 chunks of one message take 1.1 to 1.2 times as long (benchmarks/reading_numbers.py)."""

PATIENCE = 1000
"""Damaged chunks that are examined closely; a file with more is an attack."""


class ChunkHead(NamedTuple):
    """A chunk record's description of its data, and their position.

    compression: empty if there is none; size: of the data when decompressed; crc: their checksum, 0
    if none is given; start_ns, end_ns: of the messages, if the format states it. MCAP's C++ writer
    lets an empty chunk start at the largest time and end at 0.
    """

    compression: str
    data_at: int
    data_size: int
    size: int
    crc: int = 0
    start_ns: int = 0
    end_ns: int = 0


class Chunk(NamedTuple):
    """A chunk read ahead.

    position: of its record; needed: whether it may hold wanted messages; counts, offsets: contents
    of the index records behind it, per channel and of all of them.
    """

    position: int
    head: ChunkHead
    needed: bool
    counts: dict[int, int]
    offsets: list[IntArray]


class Messages(Protocol):
    """Turns runs of records into blocks of messages; `MessageReader` of either format."""

    tally: Tally
    findings: Findings

    def blocks(self, data: Bytes, offsets: Sequence[IntArray] = ()) -> Iterator[Block]:
        """The wanted messages in a run of records; offsets: their positions by an index."""

    def takes(self, head: Bytes, size: int) -> bool:
        """Whether a record above the usual limit is to be read, by its first bytes and size."""

    def too_large(self, head: Bytes) -> None:
        """Count a record that is too large to be processed, by its first bytes."""


class WrongChecksumError(DamageError):
    """The data have another checksum than declared."""

    def __init__(self) -> None:
        super().__init__("checksum (CRC) is wrong")


def wrong_size() -> bytes:
    """The task of a chunk with an implausible declared size."""
    raise WrongSizeError


def _inflated(head: ChunkHead, read: Callable[[int, int], Bytes | bytes]) -> bytes:
    """The records of a compressed chunk; raises DamageError. Thread-safe if `read` is."""
    data = inflate(head.compression, read(head.data_at, head.data_size), head.size)
    if head.crc and not agrees(crc32(data), head.crc):
        raise WrongChecksumError
    return data


class ChunkReader(ABC):
    """The chunks of one file in their order; leaving the context ends the decompressing threads.

    met: number of chunks met.
    """

    def __init__(self, window: Window, messages: Messages) -> None:
        self.met = 0
        self._window = window
        self._messages = messages
        self._tally = messages.tally
        self._findings = messages.findings
        self._ahead: Ahead[Chunk] = Ahead()
        self._allowance = Allowance()
        self._small_run = 0
        # The gap is not part of the file.
        self._chosen = isinstance(window, RemoteWindow)
        self._patience = PATIENCE

    def __enter__(self) -> Self:
        self._ahead.__enter__()
        return self

    def __exit__(self, *error: object) -> None:
        self._ahead.__exit__(*error)

    # What a format tells

    @abstractmethod
    def _needed(self, position: int) -> bool:
        """Whether the chunk at a position may hold wanted messages."""

    @abstractmethod
    def _plain(self, head: ChunkHead) -> Task | None:
        """The task for the records of an uncompressed chunk, None if `_directly` reads it."""

    @abstractmethod
    def _listed_behind(self, position: int) -> int:
        """Read the sound index records behind the last chunk; returns where they end."""

    @abstractmethod
    def _small_chunks(self, position: int) -> Walking:
        """The messages of consecutive small chunks; returns where they end."""

    @abstractmethod
    def _front(self, data: Bytes) -> int:
        """Bytes of the complete records, of whatever kind, at the front of data."""

    @abstractmethod
    def _records(self, data: Bytes) -> tuple[IntArray, int]:
        """Positions of the complete records at the front of a chunk's data, and where they end."""

    @abstractmethod
    def _record_length(self, data: Bytes) -> int:
        """Bytes of the record at the front of a chunk's data, 0 if it cannot be one."""

    @abstractmethod
    def _census(self, chunk: Chunk) -> dict[int, int]:
        """Message counts of a damaged chunk without index, as far as its records show."""

    # What is the same

    def _taken(self, position: int, head: ChunkHead, end: int) -> Walking:
        """Queue a chunk, or process many small ones at once; returns where to go on."""
        wrong = head.compression == "" and head.size != head.data_size
        if wrong:
            # How large the data are is told by the record as well.
            head = head._replace(size=head.data_size)
        stop = yield from self._small_ones(position, head)
        if stop > position:
            return stop
        self._findings.repaired += wrong
        self.met += 1
        at_once = self._queue(Chunk(position, head, self._needed(position), {}, []))
        end = self._listed_behind(end)
        yield from self.caught_up(everything=at_once)
        return end

    def _small_ones(self, position: int, head: ChunkHead) -> Walking:
        """Process a run of small chunks; returns where it ends, or where it begins if there is
        none."""
        small = max(head.size, head.data_size) <= SMALL_BYTES and not self._chosen
        self._small_run = self._small_run + 1 if small else 0
        if self._small_run <= RUN:
            return position
        yield from self.caught_up(everything=True)
        return (yield from self._small_chunks(position))

    def _queue(self, chunk: Chunk) -> bool:
        """Start a slowly decompressing chunk on another thread; others wait in the queue.

        Returns whether it is best processed at once, while its bytes are in the cache.
        """
        head, window = chunk.head, self._window
        if not chunk.needed or max(head.size, head.data_size) > WHOLE_BYTES:
            self._ahead.put(chunk, None)
            return False
        if head.compression == "":
            self._ahead.put(chunk, self._plain(head))
            return True
        try:
            self._allowance.take(head.compression, head.data_size, head.size)
        except DamageError:
            # The size may be the only thing that is wrong.
            self._ahead.put(chunk, wrong_size)
            return False
        if head.compression in SLOW:
            task = functools.partial(_inflated, head, window.copy)
            self._ahead.begin(chunk, task, head.data_size + head.size)
            return False
        window.view(head.data_at, head.data_size)
        self._ahead.put(chunk, functools.partial(_inflated, head, window.view))
        return True

    def caught_up(self, everything: bool = False) -> Iterator[Block]:
        """Messages of the chunks read ahead; of the last one only after its index has been read."""
        for chunk, task in self._ahead.due(everything):
            try:
                if task is None:
                    yield from self._directly(chunk)
                    continue
                data = np.frombuffer(task(), np.uint8)
            except DamageError as damage:
                rescued = self._rescued(chunk, damage)
                if rescued is None:
                    continue
                data = rescued
            yield from self._messages.blocks(data, chunk.offsets)

    def _rescued(self, chunk: Chunk, damage: DamageError) -> Bytes | None:
        """The records of a chunk with only a wrong declared size; else None, and it is counted."""
        self._patience -= 1
        head = chunk.head
        if isinstance(damage, WrongSizeError) and head.compression and self._patience >= 0:
            packed = self._window.view(head.data_at, min(head.data_size, WHOLE_BYTES))
            try:
                raw = inflate_anyhow(head.compression, packed, self._allowance)
                data = np.frombuffer(raw, np.uint8)
                self._check(head, data)
            except DamageError as further:
                damage = further
            else:
                self._findings.repaired += 1
                return data
        self._damaged(str(damage), chunk.counts or self._seen(chunk))
        return None

    def _check(self, head: ChunkHead, data: Bytes) -> None:
        """Raise DamageError if data of another size than declared are not a valid chunk anyway.

        Without a checksum, records that fill the data show that the declared size is wrong.
        """
        if head.crc:
            if not agrees(crc32(data), head.crc):
                raise WrongChecksumError
        elif len(data) == 0 or self._front(data) != len(data):
            raise WrongSizeError

    def _seen(self, chunk: Chunk) -> dict[int, int]:
        return self._census(chunk) if self._patience >= 0 else {}

    def _part(self, head: ChunkHead) -> Bytes:
        """The recoverable part of a truncated or damaged chunk."""
        data = self._window.view(head.data_at, min(head.data_size, WHOLE_BYTES))
        if not head.compression:
            return data
        limit = min(self._allowance.limit(head.compression, len(data)), WHOLE_BYTES)
        part = np.frombuffer(inflate_part(head.compression, data, limit), np.uint8)
        self._allowance.take(head.compression, len(data), len(part))
        self._findings.lost_at_least |= len(part) == limit < head.size
        return part

    def _directly(self, chunk: Chunk) -> Iterator[Block]:
        """The messages of a chunk too large for memory; it is checked before any is used."""
        head = chunk.head
        size = self._check_pieces(head)
        self._allowance.again(head.compression, head.data_size, size)
        lengths = self._record_length, self._messages.takes
        for part in whole_records(self._pieces(head), self._records, *lengths):
            if isinstance(part, Large):
                self._messages.too_large(part.head)
            else:
                yield from self._messages.blocks(part)

    def _check_pieces(self, head: ChunkHead) -> int:
        """Check all data of a chunk; returns their size, or raises DamageError if they are not as
        declared."""
        found, crc = head.data_size, 0
        if head.compression or head.crc:
            found, stream = 0, self._pieces(head)
            for piece in self._allowance.counted(head.compression, head.data_size, stream):
                found += len(piece)
                crc = crc32(piece, crc) if head.crc else 0
        if head.crc and not agrees(crc, head.crc):
            raise WrongChecksumError
        if found != head.size:
            if not head.crc:
                raise WrongSizeError
            self._findings.repaired += 1
        return found

    def _pieces(self, head: ChunkHead) -> Iterator[bytes]:
        """The decompressed chunk, piece by piece."""
        at, end = head.data_at, head.data_at + head.data_size

        def read(size: int) -> bytes:
            nonlocal at
            data = self._window.copy(at, min(size, end - at))
            at += len(data)
            return data

        return pieces(head.compression, read)

    def _damaged(self, reason: str, counts: dict[int, int]) -> None:
        """Count an unusable chunk, and its messages if its index states their number."""
        self._findings.damaged_chunks[reason] += 1
        for number, count in counts.items():
            self._tally.lost(number, count)
