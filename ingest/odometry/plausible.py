"""Rejection of odometry that no ground robot can have driven: wrong units, or damaged."""

from __future__ import annotations

import numpy as np

from ...topology.errors import LogError
from ...topology.odometry import Odometry
from .step_bounds import StepBounds

LONGEST_M = 1e6
"""Largest extent of a drive without a break, 1000 km, to bound memory."""

FASTEST_M_PER_S = 100.0
"""No ground robot is usually faster: autonomous race cars reach 80 m/s."""


def check_plausible(odometry: Odometry, bounds: StepBounds, topic: str, log: str) -> None:
    """Raise LogError if a drive is too wide or, in half of its steps, too fast. O(n) at worst.

    bounds: of all steps, which are usually sufficient.
    """
    position = odometry.pose[:, :2]
    if len(position) < 2:
        return
    if bounds.way * len(position) > LONGEST_M:
        starts = np.concatenate([[0], odometry.breaks]).astype(np.int64)
        extent = np.maximum.reduceat(position, starts) - np.minimum.reduceat(position, starts)
        widest = float(extent.max())
        if widest > LONGEST_M:
            raise LogError(
                f"{log}: {topic} spans {widest / 1000:.0f} km, more than {LONGEST_M / 1000:.0f} "
                "km; positions are expected in metres"
            )
    if bounds.way <= 0.99e-9 * FASTEST_M_PER_S * bounds.shortest_ns:
        return
    way = np.hypot(*np.diff(position, axis=0).T)
    way[odometry.breaks - 1] = 0
    duration = np.diff(odometry.time_ns) / 1e9
    too_fast = way > FASTEST_M_PER_S * duration
    if 2 * int(too_fast.sum()) > int((way > 0).sum()):
        speed = float(np.quantile(way[too_fast] / duration[too_fast], 0.5))
        raise LogError(
            f"{log}: {topic} moves at {speed:.0f} m/s, more than {FASTEST_M_PER_S:.0f} m/s; "
            "positions are expected in metres"
        )
