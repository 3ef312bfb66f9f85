"""The channels of one file by number: which are wanted, and how many messages were met."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...topology.arrays import BoolArray, IntArray
from .messages import UNWANTED, Channel, Findings, Want
from .topics import longest_message

NUMBERS = 1 << 16
"""Channels have numbers below this."""

UNKNOWN = -2
"""Sink number of a channel that is not described yet."""

DEFINITION_BYTES = 1 << 25
"""Limit of the different schemas and channels of one file, 32 MiB: a thousand topics with the
largest definitions in use take 20."""

DEFINITION_COST = 200
"""Memory of a channel in addition to its names [bytes]."""

SHORT_NAMES = 256
"""Longest names kept once there is no room for definitions: 65,536 of them take 16 MiB."""

TOO_MANY = "implausibly many or long descriptions of channels; some are left out"


class Channels:
    """Counts the messages per channel number and turns them into findings."""

    def __init__(self, want: Want, findings: Findings) -> None:
        self._want = want
        self._findings = findings
        self.described: dict[int, Channel] = {}
        self._sink = np.full(NUMBERS, UNKNOWN, np.int32)
        self._met = np.zeros(NUMBERS, np.int64)
        self._lost: dict[int, int] = {}
        self._indexed: dict[int, Channel] = {}
        self._room = DEFINITION_BYTES

    def take_index(self, described: Mapping[int, Channel], *, believed: bool) -> None:
        """Register the channels as an index describes them, to be compared with the data."""
        self._indexed = dict(described)
        for number, channel in described.items() if believed else ():
            self._add(number, channel)

    def describe(self, number: int, channel: Channel) -> None:
        """Register a channel as the data describe it.

        Of several descriptions the first one counts whose messages are wanted or met.
        """
        indexed = self._indexed.pop(number, channel)
        self._findings.misdescribed += indexed != channel
        used = number < NUMBERS and (self._met[number] or self._sink[number] >= 0)
        if indexed != channel or not used:
            self._add(number, channel)

    def _add(self, number: int, channel: Channel) -> None:
        if self.described.get(number) == channel or number >= NUMBERS or self._met[number]:
            return
        if not self.has_room(len(channel.topic) + len(channel.schema)):
            channel = channel._replace(schema=b"", schema_encoding="")
            if len(channel.topic) + len(channel.type_name) > SHORT_NAMES:
                return
        self.described[number] = channel
        self._sink[number] = self._want(channel)

    def has_room(self, size: int) -> bool:
        """Whether a description of this size is kept; otherwise that is told."""
        self._room -= size + DEFINITION_COST
        if self._room < 0:
            self._findings.note(TOO_MANY)
        return self._room >= 0

    def wanted(self) -> BoolArray:
        """(NUMBERS,) whether messages are wanted, or may be because they are undescribed."""
        return np.asarray(self._sink != UNWANTED)

    def known(self, number: int) -> bool:
        """Whether a channel has been described."""
        return number in self.described

    def longest(self, number: int) -> int:
        """Longest message of a channel that is used [bytes], 0 if none is wanted."""
        wanted = number < NUMBERS and self._sink[number] >= 0
        return longest_message(self.described[number]) if wanted else 0

    def met(self, number: NDArray[Any], time_ns: IntArray) -> list[tuple[int, IntArray]]:
        """Count messages by their channel numbers; returns the wanted sinks, each with its rows."""
        counts = np.bincount(number)
        self._met[: len(counts)] += counts
        self._findings.span(int(time_ns.min()), int(time_ns.max()))
        numbers: dict[int, list[int]] = {}
        for key in counts.nonzero()[0].tolist():
            if self._sink[key] >= 0:
                numbers.setdefault(int(self._sink[key]), []).append(key)
        return [
            (sink, (number == keys[0] if len(keys) == 1 else np.isin(number, keys)).nonzero()[0])
            for sink, keys in numbers.items()
        ]

    def passed(self, number: int, count: int) -> None:
        """Count messages of a channel that were skipped as unwanted."""
        if number < NUMBERS:
            self._met[number] += count

    def lost(self, number: int, count: int) -> None:
        """Count messages known to be lost in a damaged place."""
        self._lost[number] = self._lost.get(number, 0) + count

    def large(self, number: int, size: int) -> bool:
        """Whether a message of a size above the usual limit is used; otherwise it is counted."""
        longest = self.longest(number)
        if size <= longest:
            return True
        if longest:
            self.lost(number, 1)
            self._findings.too_large[self.described[number].topic, longest] += 1
        else:
            self.passed(number, 1)
        return False

    def lacks(self, declared: Mapping[int, int]) -> bool:
        """Whether fewer messages of any channel were met than are declared."""
        return any(c > (int(self._met[n]) if n < NUMBERS else 0) for n, c in declared.items())

    def finish(self, declared: Mapping[int, int]) -> None:
        """Convert the counts to findings.

        declared: messages per number by the file's own index: missing ones are lost. If empty, the
        losses counted on the way are reported.
        """
        lost, unknown = dict(self._lost), 0
        if declared:
            lost = {n: c - (int(self._met[n]) if n < NUMBERS else 0) for n, c in declared.items()}
        for number in self._met.nonzero()[0].tolist():
            channel = self.described.get(number)
            if channel is None:
                unknown += int(self._met[number])
            else:
                self._findings.seen(channel, int(self._met[number]))
            if channel is not None and declared and lost.get(number, -1) < 0:
                self._findings.note(f"the index counts too few messages of {channel.topic}")
        if declared:
            # Those under a wrong number are missing of the right one.
            unknown -= min(unknown, sum(count for count in lost.values() if count > 0))
        self._findings.unknown += unknown
        for number, count in lost.items():
            if count > 0:
                channel = self.described.get(number)
                self._findings.lost[channel.topic if channel else "an unknown channel"] += count
