"""The interface between containers and decoders: channels, blocks of messages, findings."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from ...topology.arrays import IntArray
from ...topology.errors import LogError
from ...topology.wording import utc
from .checksum import crc32

Bytes = NDArray[np.uint8]
Key = TypeVar("Key")

UNWANTED = -1
"""Sink number of a channel whose messages are not wanted."""

LATEST_NS = 1 << 62
"""Latest time accepted (the year 2116): differences of times must fit 64 bits."""

NAME_BYTES = 4096
"""Longest topic or type name accepted; DDS allows 255."""

SCHEMA_BYTES = 1 << 20
"""Longest message definition accepted: twenty times the largest in use, of a thousand lines."""


MESSAGE_BYTES = 1 << 24
"""Longest message that is decoded, 16 MiB: an odometry message has 700 bytes, an array of a
thousand poses 56,000. Longer ones are skipped without being read, but for clouds and grids
(`limits.longest_message`)."""


class Channel(NamedTuple):
    """One stream of messages as described by its container.

    encoding: of the messages ("cdr", "ros1", "protobuf", "json"); schema and schema_encoding: the
    embedded definition ("ros2msg", "ros2idl", "ros1msg", "protobuf", "jsonschema"), both empty if
    there is none.
    """

    topic: str
    type_name: str
    encoding: str
    schema: bytes = b""
    schema_encoding: str = ""


def normal_type(name: str) -> str:
    """The ROS 2 spelling of a type name: `nav_msgs/Odometry` → `nav_msgs/msg/Odometry`."""
    parts = name.split("/")
    return f"{parts[0]}/msg/{parts[1]}" if len(parts) == 2 and all(parts) else name


def normal_topic(name: str) -> str:
    """A topic name with a single leading slash, so that all containers agree."""
    return "/" + "/".join(part for part in name.split("/") if part)


def text(raw: bytes) -> str:
    """Bytes of a name as text on one line; invalid characters are replaced, never an error."""
    return printable(raw[:NAME_BYTES].decode("utf-8", "replace"))


def printable(name: str) -> str:
    """A name in which every character can be shown."""
    return name if name.isprintable() else "".join(c if c.isprintable() else "�" for c in name)


class Block(NamedTuple):
    """Messages for one sink in one buffer, which is valid until the next block is requested.

    data: (b,) uint8; sink: number returned by the `Want` callback; log_time_ns: (m,), m ≥ 1; start,
    size: (m,) position of each payload in `data`, always inside it.
    """

    data: Bytes
    sink: int
    log_time_ns: IntArray
    start: IntArray
    size: IntArray


def first_messages(block: Block, count: int) -> Block:
    """A block reduced to its first messages."""
    log_time_ns, start, size = (a[:count] for a in (block.log_time_ns, block.start, block.size))
    return block._replace(log_time_ns=log_time_ns, start=start, size=size)


Want = Callable[[Channel], int]
"""Returns the sink number of a channel, or UNWANTED."""

Progress = Callable[[int], None]
"""Called with the number of further bytes of the log that were processed."""


Walking = Generator[Block, None, int]
"""Yields blocks, and returns the position at which reading goes on."""


class Survey(NamedTuple):
    """A container's own index: messages per channel, first and last log time.

    sure: whether it is confirmed by a checksum, or counted from the data themselves.
    """

    counts: dict[Channel, int]
    start_ns: int
    end_ns: int
    sure: bool = False


def one_line(error: object) -> str:
    """The text of a foreign error, short and on one line."""
    return printable(" ".join(str(error).split()))[:200]


def several(count: int, noun: str) -> str:
    """ "1 message", "2 messages"; numbers as scripts read them."""
    return f"{count} {noun}{'s' * (count != 1)}"


_OF_ONE = {
    "are": "is", "have": "has", "hold": "holds", "carry": "carries",
    "go": "goes", "see": "sees", "lie": "lies", "point": "points",
}  # fmt: skip
"""Verbs of sentences on several things, and on one."""


def several_that(count: int, noun: str, told: str) -> str:
    """ "1 message is of another type", "2 messages are …"; told: of several, from its verb on."""
    verb, space, rest = told.partition(" ")
    verb = _OF_ONE.get(verb, verb) if count == 1 else verb
    return f"{several(count, noun)} {verb}{space}{rest}"


@dataclass(slots=True)
class Findings:
    """What was found in a scan of a log: counts, and all faults.

    counts: messages per channel, wanted or not; lost: messages per topic known to be lost in
    damaged places; lost_at_least: there may be more; unknown: messages of undescribed channels;
    repaired: record heads with one wrong bit; too_large: records left out as too large, by topic
    ("" if they are no messages of a known one) and limit [bytes]; misdescribed: channels that the
    index describes differently from the data.
    """

    counts: Counter[Channel] = field(default_factory=Counter)
    lost: Counter[str] = field(default_factory=Counter)
    lost_at_least: bool = False
    unknown: int = 0
    truncated: bool = False
    unreadable_bytes: int = 0
    broken_rows: int = 0
    damaged_chunks: Counter[str] = field(default_factory=Counter)
    repaired: int = 0
    too_large: Counter[tuple[str, int]] = field(default_factory=Counter)
    misdescribed: int = 0
    first_ns: int | None = None
    last_ns: int | None = None
    notes: list[str] = field(default_factory=list)

    def seen(self, channel: Channel, count: int) -> None:
        """Count messages of a channel."""
        if count:
            self.counts[channel] += count

    def span(self, first_ns: int, last_ns: int) -> None:
        """Extend the span of log times."""
        self.first_ns = first_ns if self.first_ns is None else min(self.first_ns, first_ns)
        self.last_ns = last_ns if self.last_ns is None else max(self.last_ns, last_ns)

    def note(self, sentence: str) -> None:
        """Keep a sentence, once."""
        if sentence not in self.notes:
            self.notes.append(sentence)

    @property
    def whole(self) -> bool:
        """Whether everything could be read without repair."""
        broken = (self.unreadable_bytes, self.repaired, self.too_large, self.truncated)
        return not any(broken) and not self.damaged_chunks

    def beyond(self, known: Sequence[Findings]) -> Findings:
        """The faults that no other walk over the same log found, as far as their numbers tell."""

        def more(own: int, others: Iterator[int]) -> int:
            return max(own - max(others, default=0), 0)

        def each(own: Counter[Key], others: list[Counter[Key]]) -> Counter[Key]:
            return +Counter({k: more(n, (other[k] for other in others)) for k, n in own.items()})

        return Findings(
            lost=each(self.lost, [k.lost for k in known]),
            lost_at_least=self.lost_at_least,
            unknown=more(self.unknown, (k.unknown for k in known)),
            truncated=self.truncated and not any(k.truncated for k in known),
            unreadable_bytes=more(self.unreadable_bytes, (k.unreadable_bytes for k in known)),
            broken_rows=more(self.broken_rows, (k.broken_rows for k in known)),
            damaged_chunks=each(self.damaged_chunks, [k.damaged_chunks for k in known]),
            repaired=more(self.repaired, (k.repaired for k in known)),
            too_large=each(self.too_large, [k.too_large for k in known]),
            misdescribed=more(self.misdescribed, (k.misdescribed for k in known)),
            notes=[note for note in self.notes if not any(note in k.notes for k in known)],
        )

    @property
    def messages(self) -> int:
        """All messages met."""
        return self.counts.total() + self.unknown

    @property
    def damage(self) -> list[str]:
        """Sentences about what is broken, empty for a whole log."""
        out = list(self.notes)
        for reason, count in sorted(self.damaged_chunks.items()):
            out.append(f"{several(count, 'damaged chunk')} skipped: {reason}")
        if self.repaired:
            out.append(f"{several(self.repaired, 'damaged record head')} set right")
        if self.misdescribed:
            channels = several(self.misdescribed, "channel")
            out.append(
                f"the index describes {channels} otherwise than the data, which are believed"
            )
        lost = self.lost.copy()
        for (topic, limit), count in sorted(self.too_large.items()):
            what = f"{several(count, 'message')} of {topic}" if topic else several(count, "record")
            out.append(f"{what} above {limit >> 20} MiB left out")
            lost[topic] -= count
        if self.unreadable_bytes:
            out.append(f"{several(self.unreadable_bytes, 'byte')} could not be read as messages")
        if self.broken_rows:
            out.append(f"{several(self.broken_rows, 'row')} of the database without a message")
        if self.truncated:
            out.append("the log is cut short")
        if self.unknown:
            unknown = several(self.unknown, "message")
            out.append(f"{unknown} of channels that the log does not describe")
        for topic, count in sorted((+lost).items()):
            told = f"{'at least ' * self.lost_at_least}{several(count, 'message')} of {topic}"
            out.append(f"{told} {'is' if count == 1 else 'are'} lost in damaged places")
        if out and self.first_ns is not None and self.last_ns is not None:
            seconds = (self.last_ns - self.first_ns) / 1e9
            out.append(
                f"{several(self.messages, 'message')} could be read, {seconds:.3f} s by log time, "
                f"from {utc(self.first_ns)} to {utc(self.last_ns)} UTC"
            )
        return out


class Container(Protocol):
    """One log file of any format."""

    def survey(self, exact: bool = False) -> Survey | None:
        """The index, or None if there is none that can be trusted.

        exact: the counts must be right; without it a count above 0 may stand for any other.
        """

    def blocks(
        self, want: Want, findings: Findings, progress: Progress | None = None
    ) -> Iterator[Block]:
        """Scan the file once; a channel is offered to `want` when it is met."""


class DamageError(Exception):
    """A part of a log cannot be read; its text says why. Never leaves `ingest.logs`."""


class Passed:
    """Tells how much of a file is dealt with, every byte once."""

    def __init__(self, progress: Progress | None) -> None:
        self._progress = progress
        self._told = 0

    def passed(self, offset: int) -> None:
        """Everything before `offset` is dealt with."""
        if self._progress is not None and offset > self._told:
            self._progress(offset - self._told)
            self._told = offset


class FileWindow(Passed):
    """Bounded look at a file: bytes of any place, from one buffer that is used again and again.

    Reusing the buffer matters: fresh memory costs a page fault per 4 KiB, more than the copy.
    """

    STEP = 1 << 15
    """So much is read beyond what is asked for: the small records behind it."""

    CHECKED_STEP = 1 << 19
    """So much is read and then checked: what stays in the processor's cache (benchmarks/ingest.py:
    reading and checking take 10 % longer where whole chunks are read first)."""

    def __init__(self, path: Path, progress: Progress | None = None) -> None:
        super().__init__(progress)
        try:
            self._file = path.open("rb", buffering=0)
            self._second = path.open("rb")
        except OSError as error:
            raise LogError(f"{path}: cannot be opened ({error.strerror})") from error
        self.size = path.stat().st_size
        self._path = path
        self._copying = threading.Lock()
        self._buffer = np.empty(2 * self.STEP, np.uint8)
        self._base = 0
        self._fill = 0

    def __enter__(self) -> FileWindow:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()
        self._second.close()

    def view(self, offset: int, length: int) -> Bytes:
        """The bytes [offset, offset + length), fewer at the file's end; until the next call."""
        length = max(0, min(length, self.size - offset))
        at = offset - self._base
        if at < 0 or at + length > self._fill:
            self._load(offset, length)
            at = 0
        return self._buffer[at : at + length]

    def checked(self, offset: int, length: int) -> tuple[Bytes, int]:
        """The same as `view`, and the checksum (CRC-32) of the bytes."""
        length = max(0, min(length, self.size - offset))
        self._move_to(offset, length + self.STEP)
        done = min(self._fill, length)
        crc = crc32(self._buffer.data[:done])
        while done < length:
            begin, done = done, min(done + self.CHECKED_STEP, length)
            self._read_on(done if done < length else length + self.STEP)
            crc = crc32(self._buffer.data[begin:done], crc)
        return self._buffer[:length], crc

    def copy(self, offset: int, length: int) -> bytes:
        """The same bytes to keep, read past the buffer. Other threads may call this."""
        length = max(0, min(length, self.size - offset))
        if length == 0:
            return b""  # the offset may be one that no file can have
        try:
            with self._copying:
                self._second.seek(offset)
                data: bytes = self._second.read(length)
        except OSError as error:
            raise LogError(f"{self._path}: cannot be read ({error.strerror})") from error
        if len(data) < length:
            raise self._shorter()
        return data

    def fill(self, target: Bytes, offset: int) -> None:
        """Read past the buffer into all of `target`; the file must reach that far."""
        done = 0
        try:
            self._file.seek(offset)
            while done < len(target):
                got = self._file.readinto(target.data[done:])
                if not got:
                    raise self._shorter()
                done += got
        except OSError as error:
            raise LogError(f"{self._path}: cannot be read ({error.strerror})") from error

    def _shorter(self) -> LogError:
        return LogError(f"{self._path}: became shorter while it was read; read it again")

    def _load(self, offset: int, length: int) -> None:
        """Fill the buffer from `offset` on, keeping what it already holds of it."""
        self._move_to(offset, length + self.STEP)
        self._read_on(length + self.STEP)

    def _move_to(self, offset: int, want: int) -> None:
        """Have the buffer begin at `offset`, with what it holds of that, and room for `want`."""
        at = offset - self._base
        kept = self._fill - at if 0 <= at <= self._fill else 0
        if want > len(self._buffer):
            larger = np.empty(want + self.STEP, np.uint8)
            larger[:kept] = self._buffer[at : at + kept]
            self._buffer = larger
        elif kept and at:
            self._buffer[:kept] = self._buffer[at : at + kept]
        self._base, self._fill = offset, kept

    def _read_on(self, goal: int) -> None:
        """Fill the buffer up to `goal`, or to the file's end."""
        goal = min(goal, self.size - self._base)
        try:
            self._file.seek(self._base + self._fill)
            while self._fill < goal:
                got = self._file.readinto(self._buffer.data[self._fill : goal])
                if not got:
                    raise self._shorter()
                self._fill += got
        except OSError as error:
            raise LogError(f"{self._path}: cannot be read ({error.strerror})") from error
