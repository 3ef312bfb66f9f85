"""Kidnapped robot: where the robot was carried, i.e. its wheels stand but it sees another place."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...topology.arrays import BoolArray, FloatArray, IntArray
from ...topology.odometry import Odometry
from ...topology.run import Detections


@dataclass(frozen=True, slots=True)
class CarriedSettings:
    """What counts as standing, and as another place.

    Wheels that move by at most standing_m, standing_rad stand: encoders resolve less, and slip
    causes more. At least `sightings` detections on both sides must agree among themselves to
    agree_m, five times the usual noise of a detector, and differ by apart_m or more from the other
    side, three times that: a single wrong detection does not count.
    """

    standing_m: float = 0.02
    standing_rad: float = 0.02
    sightings: int = 4
    agree_m: float = 0.5
    apart_m: float = 1.5


CARRIED = CarriedSettings()


def split_where_carried(odometry: Odometry, detections: Detections) -> tuple[Odometry, int]:
    """The odometry with a break wherever the robot was carried, and the number of these. O(n +
    k)."""
    jumps = _carried(odometry, detections)
    if len(jumps) == 0:
        return odometry, 0
    rows = np.searchsorted(odometry.time_ns, detections.time_ns[jumps + 1])
    breaks = np.union1d(odometry.breaks, np.clip(rows, 1, len(odometry) - 1))
    return replace(odometry, breaks=breaks), len(jumps)


def _carried(odometry: Odometry, detections: Detections) -> IntArray:
    """Rows i of detections such that the robot was carried between i and i + 1."""
    if len(detections) < 2 * CARRIED.sightings or len(odometry) < 2:
        return np.zeros(0, np.int64)
    row = np.clip(np.searchsorted(odometry.time_ns, detections.time_ns), 0, len(odometry) - 1)
    centre = detections.centre
    step = np.hypot(*np.diff(centre, axis=0).T)
    suspects = np.flatnonzero(step > CARRIED.apart_m)
    suspects = suspects[_may_stand(suspects, row, odometry)]
    if len(suspects) == 0:
        return suspects
    # Distance and angle up to each detection, so that standing is a difference of two entries.
    way = np.cumsum(odometry.step_m)[row]
    turn = np.cumsum(np.abs(odometry.turn_rad))[row]
    found = [i for i in suspects.tolist() if _is_journey(i, way, turn, centre)]
    return np.array(found, np.int64)


def _may_stand(i: IntArray, row: IntArray, odometry: Odometry) -> BoolArray:
    """(k,) whether the robot may have stood around detection i, by two poses instead of all
    between.

    If it stood, it ends where it began, except across a break.
    """
    first = np.maximum(i + 1 - CARRIED.sightings, 0)
    last = np.minimum(i + CARRIED.sightings, len(row) - 1)
    before, after = row[first], row[last]
    moved = np.hypot(*(odometry.pose[after, :2] - odometry.pose[before, :2]).T)
    broken = np.diff(np.searchsorted(odometry.breaks, [before, after], "right"), axis=0)[0] > 0
    return np.asarray((moved <= 2 * CARRIED.standing_m) | broken)


def _is_journey(i: int, way: FloatArray, turn: FloatArray, centre: FloatArray) -> bool:
    first, last = i + 1 - CARRIED.sightings, i + CARRIED.sightings
    if first < 0 or last >= len(way):
        return False
    stands = way[last] - way[first] <= CARRIED.standing_m
    stands &= turn[last] - turn[first] <= CARRIED.standing_rad
    before, after = centre[first : i + 1], centre[i + 1 : last + 1]
    agree = max(_spread(before), _spread(after)) <= CARRIED.agree_m
    apart = np.hypot(*(np.median(after, axis=0) - np.median(before, axis=0)))
    return bool(stands and agree and apart > CARRIED.apart_m)


def _spread(points: FloatArray) -> float:
    return float(np.hypot(*(points - np.median(points, axis=0)).T).max())
