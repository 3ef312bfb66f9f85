"""Kidnapped robot: where the robot was carried, i.e. its wheels stand but it sees another place."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...topology.odometry import Odometry
from ...topology.run import Detections


@dataclass(frozen=True, slots=True)
class CarriedSettings:
    """What counts as standing, and as another place."""

    standing: float = 0.02
    """Wheels that move by at most this [m, rad] stand: encoders resolve less, slip causes more."""
    sightings: int = 4
    """At least so many detections on both sides must agree: one that is wrong does not count."""
    agree_m: float = 0.5
    """To agree among themselves, five times the usual noise of a detector."""
    apart_m: float = 1.5
    """Least distance between what both sides show."""


CARRIED = CarriedSettings()


def split_where_carried(odometry: Odometry, detections: Detections) -> tuple[Odometry, int]:
    """The odometry with a break wherever the robot was carried, and the number of these. O(n +
    k)."""
    side, centre = CARRIED.sightings, detections.centre
    # Between detections i and i + 1.
    i = np.arange(side - 1, len(detections) - side)
    if len(i) == 0 or len(odometry) < 2:
        return odometry, 0
    i = i[np.hypot(*(centre[i + 1] - centre[i]).T) > CARRIED.apart_m]
    row = np.clip(np.searchsorted(odometry.time_ns, detections.time_ns), 0, len(odometry) - 1)
    way, turn = np.cumsum(odometry.step_m)[row], np.cumsum(np.abs(odometry.turn_rad))[row]
    first, last = i + 1 - side, i + side
    stands = way[last] - way[first] <= CARRIED.standing
    i = i[stands & (turn[last] - turn[first] <= CARRIED.standing)]
    sides = centre[i[:, None] + 1 + np.arange(-side, side)].reshape(-1, 2, side, 2)
    middle = np.median(sides, axis=2)
    spread = np.hypot(*np.moveaxis(sides - middle[:, :, None], -1, 0)).max(axis=(1, 2))
    apart = np.hypot(*(middle[:, 1] - middle[:, 0]).T)
    i = i[(spread <= CARRIED.agree_m) & (apart > CARRIED.apart_m)]
    if len(i) == 0:
        return odometry, 0
    at = np.searchsorted(odometry.time_ns, detections.time_ns[i + 1])
    breaks = np.union1d(odometry.breaks, np.clip(at, 1, len(odometry) - 1))
    return replace(odometry, breaks=breaks), len(i)
