"""The channels of one file by number: which are wanted, and how many messages were met."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...topology.arrays import IntArray
from .messages import UNKNOWN, UNWANTED, Channel, Findings, Want

NUMBERS = 1 << 16
"""Channels have numbers below this."""

UNDESCRIBED = -2
"""Sink number of a channel that is not described yet, or was not asked for."""

DEFINITION_BYTES = 1 << 25
"""Limit of the different schemas and channels of one file, 32 MiB: a thousand topics with the
largest definitions in use take 20."""

TOO_MANY = "implausibly many or long descriptions of channels; some are left out"


class Channels:
    """Counts the messages per channel number and turns them into findings."""

    def __init__(self, want: Want, findings: Findings) -> None:
        self._want = want
        self._findings = findings
        self.described: dict[int, Channel] = {}
        self._sink = np.full(NUMBERS, UNDESCRIBED, np.int32)
        self._met = np.zeros(NUMBERS, np.int64)
        self._room = DEFINITION_BYTES

    def describe(self, number: int, channel: Channel) -> None:
        """Register a channel; the last description before it is asked for counts."""
        if number >= NUMBERS or self._sink[number] != UNDESCRIBED or self._met[number]:
            return
        if self.described.get(number) == channel:
            return
        if not self.has_room(len(channel.topic) + len(channel.type_name) + len(channel.schema)):
            channel = channel._replace(schema=b"", schema_encoding="")
            if self._room < -DEFINITION_BYTES:
                return
        self.described[number] = channel

    def has_room(self, size: int) -> bool:
        """Whether a description of this size is kept; otherwise that is told."""
        self._room -= size
        if self._room < 0:
            self._findings.note(TOO_MANY)
        return self._room >= 0

    def _sink_of(self, number: int) -> int:
        """The sink of a channel, which is asked for when its first message is met."""
        if self._sink[number] == UNDESCRIBED and number in self.described:
            self._sink[number] = self._want(self.described[number])
        return int(self._sink[number])

    def wanted(self, number: int) -> bool:
        """Whether messages of a channel are wanted, or may be because it is not described."""
        return self._sink_of(number) != UNWANTED

    def met(self, number: NDArray[Any], time_ns: IntArray) -> list[tuple[int, IntArray]]:
        """Count messages by their channel numbers; returns the wanted sinks, each with its rows."""
        counts = np.bincount(number)
        self._met[: len(counts)] += counts
        self._findings.span(int(time_ns.min()), int(time_ns.max()))
        rows: dict[int, list[IntArray]] = {}
        for key in counts.nonzero()[0].tolist():
            sink = self._sink_of(key)
            if sink >= 0:
                rows.setdefault(sink, []).append((number == key).nonzero()[0])
        return [
            (sink, parts[0] if len(parts) == 1 else np.sort(np.concatenate(parts)))
            for sink, parts in rows.items()
        ]

    def finish(self, declared: Mapping[int, int], *, by_index: bool) -> None:
        """Convert the counts to findings.

        declared: messages per number by the file's own index, of which what is missing is lost;
        by_index: only what is wanted was read, so that of the others the index gives the counts.
        """
        for number in {*self._met.nonzero()[0].tolist(), *declared}:
            channel = self.described.get(number)
            count = int(self._met[number]) if number < NUMBERS else 0
            stated = declared.get(number, 0)
            if by_index and channel is not None and not self.wanted(number):
                count = stated
            if channel is None:
                self._findings.faults[UNKNOWN] += count
            else:
                self._findings.seen(channel, count)
            if stated > count:
                topic = channel.topic if channel is not None else "an unknown channel"
                self._findings.lost[topic] += stated - count
