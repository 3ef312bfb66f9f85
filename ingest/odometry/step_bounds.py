"""Bounds of the steps of a track, in one pass: most tracks are sound, and these alone prove it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from ...topology.arrays import FloatArray, IntArray

BLOCK_STEPS = 1 << 14
"""So many steps are looked at together: they stay in the processor's cache, and no large array is
made."""


class StepBounds(NamedTuple):
    """No step of a track is longer than way [m] or turns by more than turn [rad]; none is shorter
    than shortest_ns."""

    way: float = 0.0
    turn: float = 0.0
    shortest_ns: int = 0

    @classmethod
    def of(cls, time_ns: IntArray, pose: FloatArray) -> StepBounds:
        """Of poses (n, 3) at times (n,). A way is at most the sum of its two parts. O(n)."""
        way = turn = 0.0
        for _, (x, y, theta) in blocks_of_steps(pose):
            way = max(way, reach(x) + reach(y))
            turn = max(turn, widest_turn(theta))
        shortest = int((time_ns[1:] - time_ns[:-1]).min()) if len(time_ns) > 1 else 0
        return cls(way, turn, shortest)

    def within(self, way: float, turn: float) -> bool:
        """Whether no step can be so long, or turn so far; rounding is allowed for."""
        return self.way <= 0.99 * way and self.turn <= 0.99 * turn


def blocks_of_steps(pose: FloatArray, beside: int = 0) -> Iterator[tuple[int, FloatArray]]:
    """Differences (3, k) between rows of poses (n, 3) in blocks, with the number of the first.

    beside: so many steps of the blocks before and behind come along. Good until the next block.
    """
    count = len(pose) - 1
    room = np.empty((3, min(count, BLOCK_STEPS + 2 * beside)))
    for first in range(0, count - 2 * beside, BLOCK_STEPS):
        rows = pose[first : first + BLOCK_STEPS + 2 * beside + 1]
        yield first, np.subtract(rows[1:].T, rows[:-1].T, out=room[:, : len(rows) - 1])


def reach(values: FloatArray) -> float:
    """The largest size among numbers of either sign."""
    return max(float(values.max()), -float(values.min()))


def widest_turn(theta: FloatArray) -> float:
    """The largest size of differences of angles, all in [-π, π)."""
    size = reach(theta)
    return size if size <= np.pi else float(turned(theta).max())


def turned(theta: FloatArray) -> FloatArray:
    """Sizes of turns: from one end of the range of angles to the other is a short one as well."""
    size = np.abs(theta)
    return np.minimum(size, np.abs(size - 2 * np.pi))
