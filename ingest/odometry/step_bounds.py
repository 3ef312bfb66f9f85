"""Bounds of the steps of a track, in one pass: they suffice to show that most tracks are sound."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from ...topology.arrays import FloatArray, IntArray

BLOCK_STEPS = 1 << 14
"""Steps per block, to stay in the processor's cache without large temporary arrays."""


class StepBounds(NamedTuple):
    """Upper bounds of all steps' length `way` [m] and rotation `turn` [rad], lower bound of their
    time."""

    way: float = 0.0
    turn: float = 0.0
    shortest_ns: int = 0

    @classmethod
    def of(cls, time_ns: IntArray, pose: FloatArray) -> StepBounds:
        """From poses (n, 3) at times (n,); the length is bounded by the sum of its two components.
        O(n)."""
        way = turn = 0.0
        for _, (x, y, theta) in blocks_of_steps(pose):
            way = max(way, reach(x) + reach(y))
            turn = max(turn, widest_turn(theta))
        shortest = int((time_ns[1:] - time_ns[:-1]).min()) if len(time_ns) > 1 else 0
        return cls(way, turn, shortest)

    def within(self, way: float, turn: float) -> bool:
        """Whether all steps are shorter and turn less; with a margin for rounding."""
        return self.way <= 0.99 * way and self.turn <= 0.99 * turn


def blocks_of_steps(pose: FloatArray, beside: int = 0) -> Iterator[tuple[int, FloatArray]]:
    """Differences (3, k) between consecutive poses (n, 3) in blocks, with the index of the first.

    beside: number of steps of the previous and the next block included. Valid until the next block.
    """
    count = len(pose) - 1
    room = np.empty((3, min(count, BLOCK_STEPS + 2 * beside)))
    for first in range(0, count - 2 * beside, BLOCK_STEPS):
        rows = pose[first : first + BLOCK_STEPS + 2 * beside + 1]
        yield first, np.subtract(rows[1:].T, rows[:-1].T, out=room[:, : len(rows) - 1])


def reach(values: FloatArray) -> float:
    """The largest absolute value."""
    return max(float(values.max()), -float(values.min()))


def widest_turn(theta: FloatArray) -> float:
    """The largest absolute difference of angles that are all in [-π, π)."""
    size = reach(theta)
    return size if size <= np.pi else float(turned(theta).max())


def turned(theta: FloatArray) -> FloatArray:
    """Absolute rotations of differences of angles, the short way round."""
    size = np.abs(theta)
    return np.minimum(size, np.abs(size - 2 * np.pi))
