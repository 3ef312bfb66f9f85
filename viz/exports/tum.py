"""Trajectories as lines `time x y z qx qy qz qw`: the TUM benchmark's format, which evo reads."""

from __future__ import annotations

import numpy as np

from ...topology.arrays import FloatArray, IntArray
from ...topology.odometry import Odometry
from ...topology.se2 import compose
from ...topology.topomap import TopoMap
from ..robot_track import robot_track


def recorded_tum(odometry: Odometry) -> str:
    """The odometry of a run as it was recorded, in its own frame."""
    return _lines(odometry.time_ns, odometry.pose)


def corrected_tum(
    topomap: TopoMap, odometry: Odometry, T_out_map: FloatArray | None = None
) -> str | None:
    """The odometry bent onto the run's map, in the map's frame or, with T_out_map, another.

    Every pass lies on its junction, what is between is turned and stretched to fit. Stretches of a
    broken odometry in which no junction was passed are left out. None without any pass.
    """
    track = robot_track(topomap, odometry, every_row=True)
    if track is None:
        return None
    pose = track.bent if T_out_map is None else compose(T_out_map, track.bent)
    return _lines(track.time_ns, pose)


def _lines(time_ns: IntArray, pose: FloatArray) -> str:
    """Seconds with nine decimals: a float would round them to some 200 ns."""
    half = pose[:, 2] / 2
    columns = zip(
        time_ns.tolist(),
        pose[:, 0].tolist(),
        pose[:, 1].tolist(),
        np.sin(half).tolist(),
        np.cos(half).tolist(),
        strict=True,
    )
    return "".join(
        f"{_stamp(t)} {x:.6f} {y:.6f} 0 0 0 {qz:.9f} {qw:.9f}\n" for t, x, y, qz, qw in columns
    )


def _stamp(time_ns: int) -> str:
    sign = "-" if time_ns < 0 else ""
    return f"{sign}{abs(time_ns) // 10**9}.{abs(time_ns) % 10**9:09d}"
