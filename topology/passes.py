"""Junction passes: each time that the robot drove by a junction, once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .arrays import FloatArray, IntArray
from .frozen import freeze
from .ragged import Ragged
from .se2 import wrap

NO_BRANCH = -1
"""Index of an unknown branch."""

ONE_WAY_RAD = 0.35
"""Directions nearer to each other than this (20 degrees) are one branch: readings of one branch are
14 degrees apart in one of 2,000 pairs with the usual noise of 0.05 rad."""

DRIVEN_RAD = 2 * ONE_WAY_RAD
"""Largest angle between a branch and the direction in which the robot drove along it."""


@dataclass(frozen=True, slots=True, eq=False)
class Passes:
    """The junction passes of one run, by time; everything in the odometry frame.

    time_ns: (p,) when the robot was nearest to the centre; start_ns, end_ns: (p,) first and last
    detection; centre: (p, 2) [m]; branches: p rows of headings [rad], ascending in [-pi, pi);
    entry, exit: (p,) row-local index of the branch the robot came by and left by, NO_BRANCH where
    unknown; messages: (p,) detections fused; confidence: (p,) in (0, 1], 1 for passes from a topic.
    Raises ValueError on shapes that do not fit or times that descend.
    """

    time_ns: IntArray
    start_ns: IntArray
    end_ns: IntArray
    centre: FloatArray
    branches: Ragged
    entry: IntArray
    exit: IntArray
    messages: IntArray
    confidence: FloatArray

    def __post_init__(self) -> None:
        p = len(self.time_ns)
        freeze(self, np.int64, time_ns=(p,), start_ns=(p,), end_ns=(p,))
        freeze(self, np.int64, entry=(p,), exit=(p,), messages=(p,))
        freeze(self, np.float64, centre=(p, 2), confidence=(p,))
        check_passes(self.time_ns, self.branches)
        for name in ("entry", "exit"):
            index = getattr(self, name)
            if np.any(index < NO_BRANCH) or np.any(index >= self.branches.counts):
                raise ValueError(f"{name} names a branch that the pass does not have")

    def __len__(self) -> int:
        return len(self.time_ns)


def check_passes(time_ns: IntArray, branches: Ragged) -> None:
    """Raise ValueError unless the p rows of branches are those of `time_ns`, by time."""
    if len(branches) != len(time_ns):
        raise ValueError("branches must have one row per pass")
    if np.any(np.diff(time_ns) < 0):
        raise ValueError("passes must be in the order of time")


def nearest_branch(branches: Ragged, direction: FloatArray) -> IntArray:
    """(p,) row-local index of the branch nearest to each direction; NO_BRANCH beyond `DRIVEN_RAD`.

    direction: (p,) [rad]; NaN gives NO_BRANCH.
    """
    out = np.full(len(branches), NO_BRANCH, np.int64)
    off = np.abs(wrap(branches.values - direction[branches.owner]))
    off = np.where(np.isfinite(off), off, np.inf)
    order = np.lexsort((off, branches.owner))
    some = np.flatnonzero(branches.counts > 0)
    first = order[branches.offsets[some]]
    near = off[first] <= DRIVEN_RAD
    out[some[near]] = first[near] - branches.offsets[some[near]]
    return out
