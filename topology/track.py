"""The robot's track around given places: from which direction it came and in which it left."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .arrays import FloatArray, IntArray
from .odometry import Odometry

BEYOND_M = 0.95
"""Distance from a place's centre at which the track shows the branch driven."""
SEARCH_M, SEARCH_STEP_M = 3.0, 0.05
"""How far along the track that point is looked for, and how finely."""


@dataclass(frozen=True, slots=True, eq=False)
class TrackDirections:
    """Headings [rad, odometry frame] from a place to where the robot came from and went to.

    arriving, leaving: (p,); NaN where the log begins, ends, breaks or jumps too near to the place.
    """

    arriving: FloatArray
    leaving: FloatArray


def way_along(odometry: Odometry) -> FloatArray:
    """(n,) distance driven up to each row [m]; constant across a break."""
    return np.cumsum(odometry.step_m)


def piece_of(odometry: Odometry, time_ns: IntArray) -> IntArray:
    """(m,) index of the unbroken piece of odometry at each time."""
    starts = odometry.time_ns[odometry.breaks]
    return np.searchsorted(starts, np.asarray(time_ns, np.int64), side="right")


def stretch_of(odometry: Odometry, time_ns: IntArray) -> IntArray:
    """(m,) index of the stretch without breaks and jumps at each time."""
    starts = odometry.time_ns[odometry.cuts]
    return np.searchsorted(starts, np.asarray(time_ns, np.int64), side="right")


def way_at(odometry: Odometry, time_ns: IntArray) -> FloatArray:
    """(m,) distance driven up to each time [m]."""
    return interpolated(odometry, way_along(odometry), time_ns)


def walked_at(odometry: Odometry, time_ns: IntArray) -> FloatArray:
    """(m, 2) distance driven [m] and absolute angle turned [rad] up to each time."""
    turned = interpolated(odometry, np.cumsum(np.abs(odometry.turn_rad)), time_ns)
    return np.column_stack([way_at(odometry, time_ns), turned])


def interpolated(odometry: Odometry, values: FloatArray, time_ns: IntArray) -> FloatArray:
    """(m,) values (n,) of an odometry's rows, interpolated at any times, held at the ends."""
    origin = odometry.time_ns[0]
    times = (odometry.time_ns - origin).astype(np.float64)
    query = (np.asarray(time_ns, np.int64) - origin).astype(np.float64)
    return np.asarray(np.interp(query, times, values))


def point_at(odometry: Odometry, way_m: FloatArray) -> FloatArray:
    """(…, 2) position of the robot, in the odometry frame, after a distance `way_m` (…) [m]."""
    way = way_along(odometry)
    # Strictly ascending ways, so that standing still does not make the interpolation ambiguous.
    keep = np.flatnonzero(np.concatenate([[True], np.diff(way) > 0]))
    track = odometry.pose[keep]
    return np.stack([np.interp(way_m, way[keep], track[:, k]) for k in (0, 1)], axis=-1)


def seconds_at(odometry: Odometry, way_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(k,) each: first and last time [s], since the first row, at which the robot had driven the
    distances `way_m` (k,) [m]; they differ where it stood."""
    way, seconds = way_along(odometry), (odometry.time_ns - odometry.time_ns[0]) * 1e-9
    moved = np.diff(way) > 0
    is_first, is_last = np.concatenate([[True], moved]), np.append(moved, True)
    first = np.interp(way_m, way[is_first], seconds[is_first])
    return first, np.maximum(np.interp(way_m, way[is_last], seconds[is_last]), first)


def in_milliseconds(odometry: Odometry, seconds: FloatArray) -> IntArray:
    """Times [ns], in whole milliseconds, of seconds since the first row."""
    return np.asarray(odometry.time_ns[0] + np.round(seconds * 1e3).astype(np.int64) * 10**6)


def by_begin(times_ns: IntArray) -> IntArray:
    """Traversals (t, 2), each with the times at its two ends, sorted by the earlier one."""
    return np.asarray(times_ns[np.argsort(times_ns.min(axis=1), kind="stable")])


def times_between(
    odometry: Odometry, time_ns: IntArray, first: IntArray, near_m: float
) -> IntArray:
    """Times (k, 2) at which the robot left a place and arrived at the next one, in whole
    milliseconds [ns].

    time_ns: (v,) when it was at the places; first: (k,) places that it left for the next one. Time
    spent within `near_m` [m] of a place (standing, turning on the spot) does not count: that
    distance is taken to be driven at the mean speed of the rest.
    """
    arc_m = way_at(odometry, time_ns)
    begin, end = arc_m[first], arc_m[first + 1]
    near = np.minimum(near_m, (end - begin) / 3)
    _, left = seconds_at(odometry, begin + near)
    arrived, _ = seconds_at(odometry, end - near)
    near_s = near * (arrived - left) / np.maximum(end - begin - 2 * near, 1e-9)
    return in_milliseconds(odometry, np.stack([left - near_s, arrived + near_s], axis=1))


def track_directions(odometry: Odometry, time_ns: IntArray, centre: FloatArray) -> TrackDirections:
    """Directions in which the track leaves a circle of radius `BEYOND_M` around each place.

    time_ns: (p,) when the robot was at the place; centre: (p, 2) its position in the odometry
    frame. The track is searched `SEARCH_M` either way. O(p · SEARCH_M / step + n).
    """
    way = way_along(odometry)
    arc_m = way_at(odometry, time_ns)
    stretch = stretch_of(odometry, time_ns)
    edges = np.concatenate([[0], odometry.cuts, [len(odometry)]])
    first, last = way[edges[stretch]], way[edges[stretch + 1] - 1]
    # All places at once: a table (places, steps) of track points before and after.
    steps = np.arange(0.0, SEARCH_M + SEARCH_STEP_M, SEARCH_STEP_M)

    def towards(sign: float) -> FloatArray:
        at = arc_m[:, None] + sign * steps
        dx, dy = np.moveaxis(point_at(odometry, at) - centre[:, None], -1, 0)
        inside = (at >= first[:, None] - 1e-9) & (at <= last[:, None] + 1e-9)
        out = inside & (dx * dx + dy * dy >= BEYOND_M**2)
        hit = out.argmax(axis=1)
        rows = np.arange(len(arc_m))
        heading = np.arctan2(dy[rows, hit], dx[rows, hit])
        return np.where(out.any(axis=1), heading, np.nan)

    return TrackDirections(arriving=towards(-1.0), leaving=towards(1.0))
