"""Which chunks of a log hold which channels, by the log's own index."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from ...topology.arrays import BoolArray, IntArray
from .messages import Findings
from .tally import Tally

Wanted = BoolArray
"""By channel number: whether its messages are wanted, or it is not described."""


TRIED_STARTS = 64
"""Indexed chunks that are tried before an index is given up: damage affects a few in a row; of
another file's index none exists."""


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

    def needed(self, wanted: Wanted) -> BoolArray:
        """(c,) which chunks hold any wanted message."""
        out = np.zeros(len(self.begin), bool)
        out[self.chunk[wanted[self.channel] & (self.messages > 0)]] = True
        return out

    def ranges(self, wanted: Wanted) -> tuple[IntArray, IntArray]:
        """Begin and end of these chunks."""
        needed = self.needed(wanted)
        return self.begin[needed], self.end[needed]

    def places(self, chunks: BoolArray) -> Iterator[tuple[int, int, dict[int, int]]]:
        """Begin and end of some of the chunks, one by one, and the messages per channel in each."""
        edges = np.searchsorted(self.chunk, np.arange(len(self.begin) + 1))
        for k in chunks.nonzero()[0].tolist():
            rows = slice(edges[k], edges[k + 1])
            counts = zip(self.channel[rows].tolist(), self.messages[rows].tolist(), strict=True)
            yield int(self.begin[k]), int(self.end[k]), dict(counts)

    def counts(self, chunks: BoolArray) -> dict[int, int]:
        """Messages per channel in some of the chunks."""
        inside = chunks[self.chunk]
        channel, count = self.channel[inside], self.messages[inside]
        totals = np.zeros(int(channel.max(initial=-1)) + 1, np.int64)
        np.add.at(totals, channel, count)
        return {int(n): int(totals[n]) for n in totals.nonzero()[0]}

    def span_ns(self, chunks: BoolArray) -> tuple[int, int] | None:
        """First and last log time in some of the chunks, None if they are empty."""
        filled = chunks & (self.first_ns <= self.last_ns)
        if not filled.any():
            return None
        return int(self.first_ns[filled].min()), int(self.last_ns[filled].max())


def passed_over(index: ChunkIndex, tally: Tally, findings: Findings) -> BoolArray:
    """Count the messages in chunks that are not needed; returns (c,) which are needed."""
    needed = index.needed(tally.wanted())
    for number, count in index.counts(~needed).items():
        tally.passed(number, count)
    span = index.span_ns(~needed)
    if span is not None:
        findings.span(*span)
    return needed


def next_listed(
    starts: IntArray, stop: int, position: int, is_chunk: Callable[[int], bool]
) -> int | None:
    """The next position at or after `position` with a listed chunk, or where the index begins.

    starts: (c,) positions of chunks by the index, ascending; stop: position of the index; is_chunk:
    whether there is one at a position. None if it is unknown.
    """
    for start in starts[np.searchsorted(starts, position) :][:TRIED_STARTS].tolist():
        if is_chunk(start):
            return int(start)
    return stop if len(starts) and starts[-1] < position <= stop else None
