"""Hypotheses seeded by a meeting of two robots (§4.2).

"If two robots exchange maps only when they are within communication range, we can start the
hypothesis formation by pairing vertices near both robots": matches are grown from such pairs only.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from ...topology.arrays import IntArray
from ...topology.errors import DataError, UsageError
from ...topology.topomap import TopoMap


@dataclass(frozen=True, slots=True)
class Meeting:
    """Two robots were within range of each other, each at a time of its own log."""

    run_a: str
    time_a_ns: int
    run_b: str
    time_b_ns: int
    range_m: float = 15.0
    """Vertices within this distance of a robot are near it."""


def parse_meeting(text: str) -> Meeting:
    """A meeting from "run1@TIME,run2@TIME", times in seconds (with a decimal point) or nanoseconds.

    Raises UsageError on any other text.
    """
    form = r"(?P<run_a>.+)@(?P<a>\d+(\.\d*)?),(?P<run_b>.+)@(?P<b>\d+(\.\d*)?)"
    found = re.fullmatch(form, text)
    if found is None:
        raise UsageError(
            f"a meeting is written run1@TIME,run2@TIME with times in nanoseconds or in seconds "
            f"with a decimal point, not {text!r}"
        )
    if found["run_a"] == found["run_b"]:
        raise UsageError(f"{text!r}: a robot does not meet itself")
    return Meeting(found["run_a"], _ns(found["a"]), found["run_b"], _ns(found["b"]))


def _ns(text: str) -> int:
    whole, point, fraction = text.partition(".")
    return int(whole) * 10**9 + int(fraction[:9].ljust(9, "0")) if point else int(whole)


def near_vertices(topomap: TopoMap, time_ns: int, range_m: float) -> IntArray:
    """Vertices within `range_m` of the junctions that the robot passed before and after a time.

    Raises DataError if the run passed nothing within a minute of that time.
    """
    times, slack = topomap.observation_time_ns, 60 * 10**9
    if len(times) == 0 or not times[0] - slack <= time_ns <= times[-1] + slack:
        raise DataError(
            f"run {topomap.run!r} passed no junction around the time of the meeting "
            f"({time_ns} ns): give a time of its own log"
        )
    after = int(np.searchsorted(times, time_ns))
    passed = topomap.observation_vertex[max(after - 1, 0) : after + 1]
    gap = topomap.xy[:, None] - topomap.xy[None, passed]
    return np.flatnonzero(np.hypot(gap[..., 0], gap[..., 1]).min(axis=1) <= range_m)
