"""When the robot was at which vertex, and the track between two visits, drawn in the map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .arrays import BoolArray, FloatArray, IntArray
from .odometry import Odometry
from .ragged import numbered
from .se2 import turned, wrap
from .track import point_at, way_at


@dataclass(frozen=True, slots=True, eq=False)
class Visits:
    """When the robot was at which vertex, by time: passes, and drives by that went undetected.

    time_ns, vertex: (v,); seen: (v,) whether a pass tells it; pose: (v, 3) corrected: position in
    the map and turn from the odometry's frame to the map's; centre: (v, 2) the vertex in the
    odometry frame at that time; piece: (v,) unbroken piece of odometry.
    """

    time_ns: IntArray
    vertex: IntArray
    seen: BoolArray
    pose: FloatArray
    centre: FloatArray
    piece: IntArray


@dataclass(frozen=True, slots=True, eq=False)
class PassesAtPlaces:
    """By which vertices the passes of a run were, and how it lies by that.

    place: (p,) vertex of each pass, negative for none; fair: (p,) whether the pass shows its vertex
    as it is, so that its branches count; turn: (p,) from the odometry's frame to the map's [rad];
    xy: (n, 2) vertices [m]; visits: by time.
    """

    place: IntArray
    fair: BoolArray
    turn: FloatArray
    xy: FloatArray
    visits: Visits


@dataclass(frozen=True, slots=True, eq=False)
class DrawnTrack:
    """Pieces of the track between visits, bent to meet the vertices at their ends.

    owner: (k,) number of the piece each point belongs to; offsets: (m + 1,) rows of each piece;
    way: (k,) way driven [m]; odom, xy: (k, 2) in the odometry's frame and in the map's; turn: (k,)
    between the two.
    """

    owner: IntArray
    offsets: IntArray
    way: FloatArray
    odom: FloatArray
    xy: FloatArray
    turn: FloatArray


def draw_track(
    odometry: Odometry, visits: Visits, xy: FloatArray, first: IntArray, step_m: float
) -> DrawnTrack:
    """The track from visit `first[k]` to the next one, for all k at once.

    All pieces are sampled in one flat row. Each point is placed as seen from either visit, and
    between the two views by the way driven; what is left at the ends is spread likewise.
    """
    at = way_at(odometry, visits.time_ns)
    length = at[first + 1] - at[first]
    points = np.maximum(np.ceil(length / step_m), 2).astype(np.int64) + 1
    owner, nth = numbered(points)
    offsets = np.concatenate([[0], np.cumsum(points)]).astype(np.int64)
    share = nth / (points[owner] - 1)
    s = at[first][owner] + share * length[owner]
    odom = point_at(odometry, s)

    def seen_from(visit: IntArray) -> FloatArray:
        away = odom - visits.centre[visit][owner]
        return xy[visits.vertex[visit]][owner] + turned(away, visits.pose[visit, 2][owner])

    w = share[:, None]
    drawn = (1 - w) * seen_from(first) + w * seen_from(first + 1)
    turn = visits.pose[first, 2][owner]
    turn = turn + share * wrap(visits.pose[first + 1, 2][owner] - turn)
    return DrawnTrack(owner, offsets, s, odom, drawn, np.asarray(wrap(turn)))
