"""When the robot was at which vertex, and the track between two visits in the map frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .arrays import BoolArray, FloatArray, IntArray
from .odometry import Odometry
from .ragged import numbered
from .se2 import turned, wrap
from .track import piece_of, point_at, way_at

STEP_M = 0.1
"""Distance of the points by which a track is drawn: finer than junctions are seen."""


@dataclass(frozen=True, slots=True, eq=False)
class Visits:
    """When the robot was at which vertex, by time, whether it was detected or not.

    time_ns, vertex: (v,); seen: (v,) whether there is a detection; pose: (v, 3) position in the map
    [m] and rotation from the odometry frame to the map frame [rad]; centre: (v, 2) the vertex in
    the odometry frame at that time [m]; piece: (v,) unbroken piece of odometry.
    """

    time_ns: IntArray
    vertex: IntArray
    seen: BoolArray
    pose: FloatArray
    centre: FloatArray
    piece: IntArray


@dataclass(frozen=True, slots=True, eq=False)
class PassesAtPlaces:
    """The vertices of a run's passes, with their layout.

    place: (p,) vertex of each pass, negative for none; fair: (p,) whether the pass shows its vertex
    correctly, so that its branches count; turn: (p,) from the odometry frame to the map frame
    [rad]; xy: (n, 2) vertices [m]; visits: by time.
    """

    place: IntArray
    fair: BoolArray
    turn: FloatArray
    xy: FloatArray
    visits: Visits


@dataclass(frozen=True, slots=True, eq=False)
class DrawnTrack:
    """Pieces of the track between visits, deformed to meet the vertices at their ends.

    owner: (k,) piece of each point; offsets: (m + 1,) first point of each piece; way: (k,) distance
    driven [m]; odom, xy: (k, 2) in the odometry frame and in the map frame; turn: (k,) rotation
    between the two [rad].
    """

    owner: IntArray
    offsets: IntArray
    way: FloatArray
    odom: FloatArray
    xy: FloatArray
    turn: FloatArray


def draw_track(odometry: Odometry, visits: Visits, xy: FloatArray, first: IntArray) -> DrawnTrack:
    """The track from visit `first[k]` to the next one, in the map frame, for all k at once.

    All pieces are sampled every `STEP_M` or less in one flat array. Each point is transformed
    as seen from either visit, and interpolated between the two by the distance driven.
    """
    arc_m = way_at(odometry, visits.time_ns)
    length = arc_m[first + 1] - arc_m[first]
    points = np.maximum(np.ceil(length / STEP_M), 2).astype(np.int64) + 1
    owner, number = numbered(points)
    offsets = np.concatenate([[0], np.cumsum(points)]).astype(np.int64)
    share = number / (points[owner] - 1)
    point_arc_m = arc_m[first][owner] + share * length[owner]
    odom = point_at(odometry, point_arc_m)
    xy_drawn, turn = _drawn(visits, xy, (first[owner], first[owner] + 1), share, odom)
    return DrawnTrack(owner, offsets, point_arc_m, odom, xy_drawn, np.asarray(wrap(turn)))


def _drawn(
    visits: Visits,
    xy: FloatArray,
    between: tuple[IntArray, IntArray],
    share: FloatArray,
    odom: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Points (k, 2) of the odometry frame in the map frame, each transformed as seen from both of
    two visits and interpolated by `share` (k,); (k,) rotation between the frames [rad]."""
    by_first, by_second = (
        xy[visits.vertex[v]] + turned(odom - visits.centre[v], visits.pose[v, 2]) for v in between
    )
    turn, turn_second = (visits.pose[v, 2] for v in between)
    weight = share[:, None]
    return (1 - weight) * by_first + weight * by_second, turn + share * wrap(turn_second - turn)


def in_map_frame(
    odometry: Odometry, visits: Visits, xy: FloatArray, time_ns: IntArray, pose: FloatArray
) -> FloatArray:
    """(k, 3) poses of the odometry frame at times (k,) in the map frame, transformed and
    interpolated as by `draw_track`; before the first and after the last visit of a piece by that
    visit alone.

    xy: (n, 2) vertices. NaN for pieces without a visit.
    """
    moved = np.full((len(time_ns), 3), np.nan)
    arc_m, piece = way_at(odometry, time_ns), piece_of(odometry, time_ns)
    visited = way_at(odometry, visits.time_ns)
    for k in np.unique(piece):
        rows, piece_visits = np.flatnonzero(piece == k), np.flatnonzero(visits.piece == k)
        if not len(piece_visits):
            continue
        after = np.clip(
            np.searchsorted(visited[piece_visits], arc_m[rows]), 0, len(piece_visits) - 1
        )
        before, later = piece_visits[np.maximum(after - 1, 0)], piece_visits[after]
        length = visited[later] - visited[before]
        share = np.clip(
            (arc_m[rows] - visited[before]) / np.where(length > 0, length, 1.0), 0.0, 1.0
        )
        moved[rows, :2], turn = _drawn(visits, xy, (before, later), share, pose[rows, :2])
        moved[rows, 2] = wrap(pose[rows, 2] + turn)
    return moved


def carried_along(
    odometry: Odometry,
    known: tuple[IntArray, FloatArray, FloatArray],
    time_ns: IntArray,
    pose: FloatArray,
) -> FloatArray:
    """(k, 3) poses of the odometry frame at times (k,) in the map frame, as `in_map_frame` has
    them, by times (v,), poses (v, 3) and centres (v, 2), as of `Visits`, of single places."""
    times, known_pose, centre = known
    count = len(times)
    seen, piece = np.ones(count, bool), piece_of(odometry, times)
    visits = Visits(times, np.arange(count), seen, known_pose, centre, piece)
    return in_map_frame(odometry, visits, known_pose[:, :2], time_ns, pose)
