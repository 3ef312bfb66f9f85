"""Shares of the distance driven that the corridors of a map represent."""

from __future__ import annotations

import numpy as np

from ..topology.odometry import Odometry
from ..topology.polyline import Ways
from ..topology.topomap import TopoMap
from ..topology.track import in_milliseconds, seconds_at, way_along
from ..topology.turning_vertices import with_turning_points
from ..topology.visits import Visits, in_map_frame

NEAR_M = 1.0
"""A robot within this of a corridor's line drives along it: half the width of a wide corridor."""

STEP_M = NEAR_M / 4
"""The track is looked at this often."""


def driven_shares(topomap: TopoMap, odometry: Odometry, visits: Visits) -> dict[str, float]:
    """The distance driven [m] and its shares: `corridors`: along corridors of the map, also those
    to turning points; `out_and_back`: elsewhere between two junctions, mostly out of one and back;
    `ends`: elsewhere before the first or after the last junction.

    odometry: that of the map; visits: to its vertices. O(n log n).
    """
    way, whole = way_along(odometry), with_turning_points(topomap)
    if len(way) == 0 or way[-1] == 0 or not whole.paths:
        return {"way_m": round(float(way.max(initial=0.0)), 1)}
    first_s, _ = seconds_at(odometry, np.arange(0.5 * STEP_M, way[-1], STEP_M))
    time_ns = in_milliseconds(odometry, first_s)
    at = in_map_frame(odometry, visits, topomap.xy, time_ns, odometry.at(time_ns))[:, :2]
    known = np.flatnonzero(np.isfinite(at).all(axis=1))
    along = np.zeros(len(at), bool)
    along[known] = Ways(whole.paths, STEP_M).nearest(at[known]) <= NEAR_M
    between = (time_ns > visits.time_ns[0]) & (time_ns < visits.time_ns[-1])
    parts = {"corridors": along, "out_and_back": ~along & between, "ends": ~along & ~between}
    shares = {name: round(float(part.mean()), 3) for name, part in parts.items()}
    return {"way_m": round(float(way[-1]), 1), **shares}
