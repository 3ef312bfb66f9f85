"""Rejection of odometry that no ground robot can have driven: wrong units, or damaged."""

from __future__ import annotations

import numpy as np

from ...topology.errors import LogError
from ...topology.odometry import Odometry

LONGEST_M = 1e6
"""Largest extent of a drive without a break, 1000 km, to bound memory."""

FASTEST_M_PER_S = 100.0
"""No ground robot is usually faster: autonomous race cars reach 80 m/s."""

DOUBTED_M_PER_S = 25.0
"""90 km/h: only cars are usually faster; robots in centimetres taken for metres seem to be."""

ELSE = "else stamps are in another unit than seconds and nanoseconds, or two robots share the topic"


def check_plausible(odometry: Odometry, topic: str, log: str) -> str:
    """Raise LogError if a drive is too wide or, in half of its steps, too fast; return a warning if
    these are as fast as a car's, else "". O(n).
    """
    position = odometry.pose[:, :2]
    if len(position) < 2:
        return ""
    starts = np.concatenate([[0], odometry.breaks]).astype(np.int64)
    extent = np.maximum.reduceat(position, starts) - np.minimum.reduceat(position, starts)
    widest = float(extent.max())
    if widest > LONGEST_M:
        raise LogError(
            f"{log}: {topic} spans {widest / 1000:.0f} km, more than {LONGEST_M / 1000:.0f} km; "
            "positions are expected in metres"
        )
    way = np.hypot(*np.diff(position, axis=0).T)
    way[odometry.breaks - 1] = 0
    duration = np.diff(odometry.time_ns) / 1e9
    moves = int((way > 0).sum())

    def usual_speed(beyond: float) -> float | None:
        """The median of the speeds beyond one that half of the steps exceed."""
        fast = way > beyond * duration
        return float(np.median(way[fast] / duration[fast])) if 2 * int(fast.sum()) > moves else None

    if (speed := usual_speed(FASTEST_M_PER_S)) is not None:
        raise LogError(
            f"{log}: {topic} moves at {speed:.0f} m/s, more than {FASTEST_M_PER_S:.0f} m/s; "
            f"positions are expected in metres; {ELSE}"
        )
    if (speed := usual_speed(DOUBTED_M_PER_S)) is not None:
        return (
            f"{topic} moves at {speed:.0f} m/s, as fast as a car: if it is none, are its positions "
            f"in centimetres? Expected: metres; {ELSE}"
        )
    return ""
