"""The channels of one file by their numbers: which are wanted, how many messages were met."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .messages import Channel, Findings, Ints, Want
from .spelling import one_bit_apart

NUMBERS = 1 << 16
UNKNOWN = -2
"""Sink number of a channel that has not been described yet."""


class Tally:
    """Counts the messages met per channel number, 0 … NUMBERS - 1, and turns them into findings."""

    def __init__(self, want: Want, findings: Findings, channels: Mapping[int, Channel]) -> None:
        self._want = want
        self._findings = findings
        self._channels: dict[int, Channel] = {}
        self._sink = np.full(NUMBERS, UNKNOWN, np.int64)
        self._met = np.zeros(NUMBERS, np.int64)
        self._lost: dict[int, int] = {}
        for number, channel in channels.items():
            self.describe(number, channel)

    def describe(self, number: int, channel: Channel) -> None:
        """Take in what a channel is; the last description counts.

        A wanted one stays what it is: a number means one thing in a file, and an index that was
        checked describes it first.
        """
        if number < NUMBERS and self._sink[number] < 0 and self._channels.get(number) != channel:
            self._channels[number] = channel
            self._sink[number] = self._want(channel)

    def unknown(self, number: NDArray[Any]) -> list[int]:
        """The numbers among these that are not described."""
        strange = number[self._sink[number] == UNKNOWN]
        return np.bincount(strange).nonzero()[0].tolist() if len(strange) else []

    def adopt(self, number: int) -> bool:
        """Take a number that is described nowhere for the one it can only have been.

        That is the only channel whose number is a bit away, if none of its messages were met.
        """
        if number >= NUMBERS or self._sink[number] != UNKNOWN:
            return False
        near = [n for n in self._channels if one_bit_apart(n, number)]
        if len(near) != 1 or self._met[near[0]]:
            return False
        self.describe(number, self._channels[near[0]])
        return True

    def sink(self, number: int) -> int:
        """Sink number of a channel: wanted from 0 on, UNWANTED, or UNKNOWN."""
        return int(self._sink[number])

    def known(self, number: int) -> bool:
        """Whether a channel has been described."""
        return number < NUMBERS and self.sink(number) != UNKNOWN

    def met(self, number: NDArray[Any], time_ns: Ints) -> list[tuple[int, Ints]]:
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
        """Count messages of a channel that were not looked at, as nobody wants them."""
        if number < NUMBERS:
            self._met[number] += count

    def lost(self, number: int, count: int) -> None:
        """Count messages known to be lost in a damaged place."""
        self._lost[number] = self._lost.get(number, 0) + count

    def lacks(self, declared: Mapping[int, int]) -> bool:
        """Whether fewer messages were met than are declared."""
        return any(c > (int(self._met[n]) if n < NUMBERS else 0) for n, c in declared.items())

    def finish(self, declared: Mapping[int, int]) -> None:
        """Turn the counts into findings.

        declared: messages per number by the file's own index; what is missing of them is lost.
        Empty where there is none: then the losses counted on the way are reported.
        """
        for number in np.flatnonzero(self._met).tolist():
            channel = self._channels.get(number)
            if channel is None:
                self._findings.unknown += int(self._met[number])
            else:
                self._findings.seen(channel, int(self._met[number]))
        lost = dict(self._lost)
        if declared:
            lost = {n: c - (int(self._met[n]) if n < NUMBERS else 0) for n, c in declared.items()}
        for number, count in lost.items():
            if count > 0:
                channel = self._channels.get(number)
                self._findings.lost[channel.topic if channel else "an unknown channel"] += count
