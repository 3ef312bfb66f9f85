"""Shares of the distance driven that the corridors of a map represent."""

from __future__ import annotations

import numpy as np

from ..topology.odometry import Odometry
from ..topology.topomap import TopoMap
from ..topology.track import way_along, way_at
from ..topology.turning_back import TurnedBack
from ..topology.turning_points import NO_TURNING_POINTS
from ..topology.turning_vertices import with_turning_points

ON_THE_WAY = TurnedBack(NO_TURNING_POINTS)
"""For a robot that turned round only at its junctions."""


def driven_shares(
    topomap: TopoMap, odometry: Odometry, turned: TurnedBack = ON_THE_WAY
) -> dict[str, float]:
    """The distance driven [m] and its shares: `corridors`: between junctions, to turning points and
    back, and partial traversals of these; `out_and_back`: out of a junction and back where the map
    has no corridor; `ends`: before the first and after the last place of the map, likewise.

    odometry: that of the map; turned: distances driven on partial traversals. O(n log n).
    """
    way = float(way_along(odometry)[-1]) if len(odometry) else 0.0
    topomap = with_turning_points(topomap)
    times = topomap.traversal_ns or ()
    driven = np.concatenate([np.zeros((0, 2), np.int64), *times])
    edge = np.repeat(np.arange(len(times)), [len(t) for t in times])
    if way == 0 or len(driven) == 0:
        return {"way_m": round(way, 1)}
    back = driven[:, 0] > driven[:, 1]
    source, target = topomap.source[edge], topomap.target[edge]
    begin_at, end_at = np.where(back, target, source), np.where(back, source, target)
    order = np.argsort(driven.min(axis=1), kind="stable")
    begin = way_at(odometry, driven.min(axis=1)[order])
    end = way_at(odometry, driven.max(axis=1)[order])
    # Ways to a place are told as far as the robot's standing there: they may overlap a little.
    between = np.maximum(begin[1:] - end[:-1], 0.0)
    same = begin_at[order][1:] == end_at[order][:-1]
    ends = begin[0] + max(way - end[-1], 0.0)
    around = float(between[same].sum())
    part, late = min(turned.out_and_back_m, around), min(turned.ends_m, ends)
    parts = {
        "corridors": way - ends - between.sum() + part + late,
        "out_and_back": around - part,
        "ends": ends - late,
    }
    shares = {name: round(float(part) / way, 3) for name, part in parts.items()}
    return {"way_m": round(way, 1), **shares}
