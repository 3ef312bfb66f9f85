"""The channels of one file by number: which are wanted, and how many messages were met."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...topology.arrays import BoolArray, IntArray
from .limits import HEAD_BYTES, longest_message
from .messages import MESSAGE_BYTES, UNWANTED, Channel, Findings, Want
from .spelling import one_bit_apart

NUMBERS = 1 << 16
UNKNOWN = -2
"""Sink number of a channel that is not described yet."""


class Tally:
    """Counts the messages per channel number, 0 … NUMBERS - 1, and turns them into findings."""

    def __init__(self, want: Want, findings: Findings, channels: Mapping[int, Channel]) -> None:
        self._want = want
        self._findings = findings
        self._channels: dict[int, Channel] = {}
        self._sink = np.full(NUMBERS, UNKNOWN, np.int32)
        self._met = np.zeros(NUMBERS, np.int64)
        self._end = 0
        self._lost: dict[int, int] = {}
        self._adopted: set[int] = set()
        self._usual: set[int] = set()
        self._overruled: set[int] = set()
        self._undelivered = 0
        for number, channel in channels.items():
            self.describe(number, channel)

    def describe(self, number: int, channel: Channel, overrule: bool = False) -> None:
        """Register a channel; the last description counts.

        A wanted one is not changed: a number means one thing in a file, and an index describes it
        first. What no number in use has is left out. overrule: the data contradict the index by
        more than a wrong bit, and win.
        """
        number, more = number % NUMBERS, number // NUMBERS
        if more.bit_count() > 1 or (more and self._sink[number] != UNKNOWN):
            return
        if overrule and number not in self._overruled and not self._met[number]:
            self._overruled.add(number)
            if self._channels.get(number, channel) != channel:
                self._findings.misdescribed += 1
                self._sink[number] = UNKNOWN
        if self._sink[number] < 0 and self._channels.get(number) != channel:
            self._channels[number] = channel
            self._sink[number] = self._want(channel)

    def unknown(self, number: NDArray[Any]) -> list[int]:
        """The numbers among these that are not described."""
        strange = number[self._sink[number] == UNKNOWN]
        return np.bincount(strange).nonzero()[0].tolist() if len(strange) else []

    def first(self, number: NDArray[Any], again: bool = False) -> list[int]:
        """Rows of the first message of each channel without any so far.

        again: also of channels with messages so far.
        """
        fresh = np.bincount(number).nonzero()[0]
        if not again:
            fresh = fresh[self._met[fresh] == 0]
        if len(fresh) == 0:
            return []
        # The last one written of a number is the first one met.
        place = np.empty(int(number.max()) + 1, np.int64)
        place[number[::-1]] = np.arange(len(number))[::-1]
        return sorted(place[fresh].tolist())

    def adopt(self, number: NDArray[Any]) -> bool:
        """Map undescribed numbers to the channels that they can only have been; returns whether any
        was.

        number: of messages that were met together. If a description has a wrong number, no message
        has that one, and all of the channel's messages have one that differs in one bit. A single
        message could also belong to another channel with a similar number.
        """
        taken = False
        for strange in self.unknown(number):
            near = [n for n in self._channels if one_bit_apart(n, strange)]
            free = [
                n
                for n in near
                if not self._met[n] and n not in self._adopted and not (number == n).any()
            ]
            if len(free) != 1:
                continue
            if len(near) == 1 or self._met[strange] + int((number == strange).sum()) > 1:
                # Those met before were not delivered.
                self._undelivered += int(self._met[strange])
                self._met[strange] = 0
                self.describe(strange, self._channels[free[0]])
                self._adopted.add(free[0])
                taken = True
        return taken

    def sink(self, number: int) -> int:
        """Sink number of a channel: wanted from 0 on, UNWANTED, or UNKNOWN."""
        return int(self._sink[number])

    def wanted(self) -> BoolArray:
        """(NUMBERS,) whether messages are wanted, or may be because they are undescribed."""
        return np.asarray(self._sink != UNWANTED)

    def known(self, number: int) -> bool:
        """Whether a channel has been described."""
        return number < NUMBERS and self.sink(number) != UNKNOWN

    def all_usual(self, counts: IntArray) -> bool:
        """Whether every number of these messages is described and was met before.

        counts: messages per number. There is then nothing new for `first`, and nothing for `adopt`.
        """
        return self._usual.issuperset(counts.nonzero()[0].tolist())

    def met(
        self, number: NDArray[Any], time_ns: IntArray, counts: IntArray | None = None
    ) -> list[tuple[int, IntArray]]:
        """Count messages by their channel numbers; returns the wanted sinks, each with its rows.

        counts: of each number, if they are known.
        """
        if counts is None:
            counts = np.bincount(number)
        self._met[: len(counts)] += counts
        self._end = max(self._end, len(counts))
        self._findings.span(int(time_ns.min()), int(time_ns.max()))
        numbers: dict[int, list[int]] = {}
        for key in counts.nonzero()[0].tolist():
            sink = int(self._sink[key])
            if sink != UNKNOWN:
                self._usual.add(key)
            if sink >= 0:
                numbers.setdefault(sink, []).append(key)
        return [
            (sink, (number == keys[0] if len(keys) == 1 else np.isin(number, keys)).nonzero()[0])
            for sink, keys in numbers.items()
        ]

    def passed(self, number: int, count: int) -> None:
        """Count messages of a channel that were skipped as unwanted."""
        if number < NUMBERS:
            self._met[number] += count
            self._end = max(self._end, number + 1)

    def _numbers(self) -> list[int]:
        """The numbers of which messages were met."""
        return self._met[: self._end].nonzero()[0].tolist()

    def longest(self, number: int) -> int:
        """Longest message of a channel that is decoded [bytes]."""
        channel = self._channels.get(number)
        return longest_message(channel) if channel is not None else MESSAGE_BYTES

    def too_large(self, number: int) -> None:
        """Count a message that is left out because of its size."""
        channel = self._channels.get(number)
        self.lost(number, 1)
        self._findings.too_large[channel.topic if channel else "", self.longest(number)] += 1

    def takes(self, number: int, size: int) -> bool:
        """Whether a record above the usual limit holds a wanted message of a larger one."""
        longest = self.longest(number) if number < NUMBERS and self._sink[number] >= 0 else 0
        return longest > MESSAGE_BYTES and size <= longest + HEAD_BYTES

    def lost(self, number: int, count: int) -> None:
        """Count messages known to be lost in a damaged place."""
        self._lost[number] = self._lost.get(number, 0) + count

    def _fold(self, declared: Mapping[int, int]) -> None:
        """Add messages met under a wrong number to the number that is declared."""
        own = {self._channels[n]: n for n in declared if n in self._channels}
        for number in self._numbers() if own else ():
            channel = self._channels.get(number)
            if number not in declared and channel in own:
                count, self._met[number] = int(self._met[number]), 0
                self.passed(own[channel], count)

    def moved(self, declared: Mapping[int, int]) -> bool:
        """Whether as many messages were met as are declared, but of other channels."""
        return int(self._met.sum()) == sum(declared.values())

    def lacks(self, declared: Mapping[int, int]) -> bool:
        """Whether fewer messages were met than are declared."""
        self._fold(declared)
        return any(c > (int(self._met[n]) if n < NUMBERS else 0) for n, c in declared.items())

    def finish(self, declared: Mapping[int, int]) -> None:
        """Convert the counts to findings.

        declared: messages per number by the file's own index; missing ones are lost, unless they
        were met under a wrong number. If empty, the losses counted on the way are reported.
        """
        strange = self._undelivered
        self._fold(declared)
        for number in self._numbers():
            channel, count = self._channels.get(number), int(self._met[number])
            if channel is not None:
                self._findings.seen(channel, count)
                if number in declared and count > declared[number]:
                    self._findings.note(f"the index counts too few messages of {channel.topic}")
            elif number in declared:
                self._findings.unknown += count
            else:
                strange += count
        lost = dict(self._lost)
        if declared:
            lost = {n: c - (int(self._met[n]) if n < NUMBERS else 0) for n, c in declared.items()}
            strange -= min(strange, sum(count for count in lost.values() if count > 0))
        self._findings.unknown += strange
        for number, count in lost.items():
            if count > 0:
                channel = self._channels.get(number)
                self._findings.lost[channel.topic if channel else "an unknown channel"] += count
