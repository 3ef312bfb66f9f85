"""The interface between containers and decoders: channels, blocks of messages, findings."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from ...topology.arrays import BoolArray, IntArray
from ...topology.wording import legible, utc

Bytes = NDArray[np.uint8]

UNWANTED = -1
"""Sink number of a channel whose messages are not wanted."""

LATEST_NS = 1 << 62
"""Latest time accepted (the year 2116): differences of times must fit 64 bits."""

NAME_BYTES = 4096
"""Longest topic or type name accepted; DDS allows 255."""

SCHEMA_BYTES = 1 << 20
"""Longest message definition accepted: twenty times the largest in use, of a thousand lines."""

MESSAGE_BYTES = 1 << 26
"""Longest message that is read, 64 MiB: a cloud of `clouds.MOST_POINTS` of 32 bytes. Longer ones
are left out."""

OBJECT_BYTES = 1 << 24
"""Longest message that is decoded as objects, 16 MiB: an odometry message has 700 bytes, an array
of a thousand poses 56,000."""


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
    return legible(raw[:NAME_BYTES].decode("utf-8", "replace"))


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

    @classmethod
    def of(cls, sink: int, log_time_ns: IntArray, payloads: Sequence[bytes]) -> Block:
        """A block of separate payloads."""
        size = np.fromiter(map(len, payloads), np.int64, len(payloads))
        data = np.frombuffer(b"".join(payloads), np.uint8)
        return cls(data, sink, log_time_ns, np.cumsum(size) - size, size)

    def rows(self, which: IntArray | BoolArray | slice) -> Block:
        """Some of its messages."""
        log_ns, start, size = self.log_time_ns[which], self.start[which], self.size[which]
        return self._replace(log_time_ns=log_ns, start=start, size=size)

    def payloads(self) -> Iterator[bytes]:
        """The payload of each message."""
        raw = self.data.data
        for at, size in zip(self.start.tolist(), self.size.tolist(), strict=True):
            yield bytes(raw[at : at + size])


Want = Callable[[Channel], int]
"""Returns the sink number of a channel, or UNWANTED."""

Progress = Callable[[int], None]
"""Called with the number of further bytes of the log that were processed."""


class Survey(NamedTuple):
    """A container's own index: messages per channel, first and last log time.

    sure: whether it is confirmed by a checksum, or counted from the data themselves.
    """

    counts: Counter[Channel]
    start_ns: int
    end_ns: int
    sure: bool = False


def one_line(error: object) -> str:
    """The text of a foreign error, short and on one line."""
    return legible(" ".join(str(error).split()))[:200]


def several(count: int, noun: str) -> str:
    """ "1 message", "2 messages"; numbers as scripts read them."""
    return f"{count} {noun}{'s' * (count != 1)}"


_OF_ONE = {
    "are": "is", "have": "has", "hold": "holds", "carry": "carries",
    "go": "goes", "see": "sees", "lie": "lies", "point": "points",
}  # fmt: skip
"""Verbs of sentences on several things, and on one."""


def several_that(count: int, noun: str, predicate: str) -> str:
    """ "1 message is of another type", "2 messages are …"; predicate: of several, with its verb."""
    verb, space, rest = predicate.partition(" ")
    verb = _OF_ONE.get(verb, verb) if count == 1 else verb
    return f"{several(count, noun)} {verb}{space}{rest}"


Fault = tuple[str, str]
"""A noun that is counted and the rest of the sentence; the noun is empty where nothing is."""

CUT: Fault = ("", "the log is cut short")
UNREADABLE: Fault = ("byte", "could not be read as messages")
TOO_LARGE: Fault = ("message", f"above {MESSAGE_BYTES >> 20} MiB left out")
UNKNOWN: Fault = ("message", "of channels that the log does not describe")


@dataclass(slots=True)
class Findings:
    """What was found in a scan of a log.

    counts: messages per channel, wanted or not; faults: how often each was met; lost: messages per
    topic known to be lost, by the file's own counts; first_ns, last_ns: log times.
    """

    counts: Counter[Channel] = field(default_factory=Counter)
    faults: Counter[Fault] = field(default_factory=Counter)
    lost: Counter[str] = field(default_factory=Counter)
    first_ns: int | None = None
    last_ns: int | None = None

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
        self.faults["", sentence] = 1

    @property
    def messages(self) -> int:
        """All messages met."""
        return self.counts.total() + self.faults[UNKNOWN]

    @property
    def losses(self) -> list[str]:
        """Sentences about what is broken or lost, empty for a whole log."""
        out = [
            f"{several(count, noun)} {rest}" if noun else rest
            for (noun, rest), count in self.faults.items()
            if count
        ]
        for topic, count in sorted(self.lost.items()):
            messages = f"{several(count, 'message')} of {topic}"
            out.append(f"{messages} {'is' if count == 1 else 'are'} lost in damaged places")
        return out

    @property
    def damage(self) -> list[str]:
        """The same, and what could be read."""
        out = self.losses
        if out and self.first_ns is not None and self.last_ns is not None:
            seconds = (self.last_ns - self.first_ns) / 1e9
            out.append(
                f"{several(self.messages, 'message')} could be read, {seconds:.3f} s by log time, "
                f"from {utc(self.first_ns)} to {utc(self.last_ns)} UTC"
            )
        return out


class Passed:
    """Tells how much of a file is dealt with, every byte once."""

    def __init__(self, progress: Progress | None = None) -> None:
        self._progress = progress
        self._reported = 0

    def passed(self, offset: int) -> None:
        """Everything before `offset` is dealt with."""
        if self._progress is not None and offset > self._reported:
            self._progress(offset - self._reported)
            self._reported = offset


NOT_TOLD = Passed()


class Container(Protocol):
    """One log file of any format."""

    def survey(self, exact: bool = False) -> Survey | None:
        """The index, or None if there is none that can be trusted.

        exact: the counts must be right; without it a count above 0 may stand for any other.
        """

    def blocks(self, want: Want, findings: Findings, passed: Passed = NOT_TOLD) -> Iterator[Block]:
        """Scan the file once; a channel is offered to `want` when it is met."""


class DamageError(Exception):
    """A part of a log cannot be read; its text says why. Never leaves `ingest.logs`."""
