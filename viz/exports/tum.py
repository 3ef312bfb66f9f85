"""Trajectories in the TUM benchmark's format, `time x y z qx qy qz qw`, which evo reads."""

from __future__ import annotations

import numpy as np

from ...topology.arrays import FloatArray, IntArray
from ...topology.odometry import Odometry
from ...topology.se2 import compose
from ...topology.topomap import TopoMap
from ..robot_track import robot_track
from .tables import seconds_text


def recorded_tum(odometry: Odometry) -> str:
    """A run's odometry as recorded, in its own frame."""
    return _lines(odometry.time_ns, odometry.pose)


def corrected_tum(
    topomap: TopoMap, odometry: Odometry, T_out_map: FloatArray | None = None
) -> str | None:
    """A run's odometry corrected to its map (`robot_track`), in the map's frame, or with T_out_map
    in another.

    Unbroken stretches of the odometry in which no junction was passed are left out. None without
    any pass.
    """
    track = robot_track(topomap, odometry, every_row=True)
    if track is None:
        return None
    pose = track.bent if T_out_map is None else compose(T_out_map, track.bent)
    return _lines(track.time_ns, pose)


def _lines(time_ns: IntArray, pose: FloatArray) -> str:
    """Times are written in seconds with nine decimals, not as floats, which would round to about
    200 ns."""
    half = pose[:, 2] / 2
    columns = zip(
        time_ns.tolist(),
        pose[:, 0].tolist(),
        pose[:, 1].tolist(),
        np.sin(half).tolist(),
        np.cos(half).tolist(),
        strict=True,
    )
    lines = (
        f"{seconds_text(t)} {x:.6f} {y:.6f} 0 0 0 {qz:.9f} {qw:.9f}\n"
        for t, x, y, qz, qw in columns
    )
    return "".join(lines)
