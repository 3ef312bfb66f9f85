"""From the poses of detection messages to junction detections in the robot's frame."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from ..topology.arrays import BoolArray, FloatArray, IntArray
from ..topology.odometry import Odometry
from ..topology.ragged import Ragged
from ..topology.run import Detections
from ..topology.se2 import apply, inverse, wrap
from .frames import NO_TRANSFORMS, FixedTransforms, seen_from
from .logs.intake import in_plane
from .logs.messages import several, several_that
from .logs.poses import Poses
from .scans.slicing import FARTHEST_M

MAX_BRANCHES = 32
"""More are implausible, and would take memory."""
OUTSIDE_S = 1.0
"""How far beyond the odometry's first and last time a detection may lie."""
CENTRE_M = 0.5
"""Distance between the poses of one message above which there is a warning."""
STEEPEST = 0.71
"""Sine of the largest elevation of a branch after applying a sensor's mount, 45 degrees."""


def robot_frame_sightings(
    columns: Poses,
    time_ns: IntArray,
    frames: Sequence[str],
    odometry: Odometry,
    transforms: Callable[[], FixedTransforms] = lambda: NO_TRANSFORMS,
) -> tuple[Detections, list[str]]:
    """One detection per junction of a message, in the robot's frame at the message's time, by time;
    and warnings on messages that were left out.

    columns: poses in space; time_ns: (k,) time of each pose's message; frames: name of every frame
    number; transforms: those of the log, asked for if some frame is not of the odometry. Messages
    in a frame that is neither of the odometry's nor fixed to one, with branches that point up or
    down, with implausibly many, or outside the odometry's time are left out.
    """
    warnings: list[str] = []
    mounted = _mounted(columns, frames, odometry, transforms)
    pose = in_plane(mounted.pose)
    message, part = columns.message, columns.part
    new = np.ones(len(message), bool)
    new[1:] = (message[1:] != message[:-1]) | (part[1:] != part[:-1])
    first = new.nonzero()[0]
    rows = Ragged(np.append(first, len(message)), pose[:, 2])
    counts = rows.counts
    centre = _centres(pose[:, :2], first, counts, warnings)
    time = time_ns[first]
    frame = columns.frame[first]

    outside = OUTSIDE_S * 1e9
    steep = np.maximum.reduceat(mounted.rise, first) if len(first) else np.zeros(0)
    within = (time >= odometry.time_ns[0] - outside) & (time <= odometry.time_ns[-1] + outside)
    keep = np.ones(len(first), bool)
    for good, why in (
        (~np.isin(frame, mounted.foreign), mounted.expected),
        (
            steep <= STEEPEST,
            f"point a branch up or down, seen from {odometry.child_frame!r} (angles turn about the "
            "z axis of their frame)",
        ),
        (counts <= MAX_BRANCHES, f"have more than {MAX_BRANCHES} branches"),
        (within, "lie outside the time of the odometry"),
    ):
        keep = _leave_out(keep, good, warnings, why)

    chosen = np.flatnonzero(keep)
    chosen = chosen[np.argsort(time[chosen], kind="stable")]
    branches, centre, time = rows.take(chosen), centre[chosen], time[chosen]
    in_odometry = np.isin(frame[chosen], mounted.in_odometry)
    if in_odometry.any():
        T_odom_base = odometry.at(time)
        turned = apply(inverse(T_odom_base), centre)
        centre = np.where(in_odometry[:, None], turned, centre)
        heading = np.where(in_odometry, T_odom_base[:, 2], 0.0)
        yaw = wrap(branches.values - heading[branches.owner])
        branches = Ragged(branches.offsets, yaw)
    near = np.flatnonzero(
        _leave_out(
            np.ones(len(centre), bool),
            np.hypot(*centre.T) <= FARTHEST_M,
            warnings,
            f"lie more than {FARTHEST_M:.0f} m from the robot (are positions in metres?)",
        )
    )
    return Detections(time[near], centre[near], branches.take(near)), warnings


class _Mounted(NamedTuple):
    """Poses (k, 7) in the odometry's two frames, all but the foreign ones.

    rise: (k,) sine of the elevation of each x axis if a mount was applied, else 0; in_odometry,
    foreign: numbers of the frames that are the odometry's parent, or neither of the two; expected:
    why the latter cannot be used.
    """

    pose: FloatArray
    rise: FloatArray
    in_odometry: list[int]
    foreign: list[int]
    expected: str


def _mounted(
    columns: Poses,
    frames: Sequence[str],
    odometry: Odometry,
    transforms: Callable[[], FixedTransforms],
) -> _Mounted:
    """The poses as seen from the odometry's frames, where fixed transforms lead there."""
    pose, rise = columns.pose, np.zeros(len(columns.pose))
    # The robot's own frame comes last, so that it counts where a frame is fixed to both.
    owns = odometry.frame, odometry.child_frame
    side = {odometry.frame: odometry.frame, odometry.child_frame: odometry.child_frame}
    side[""] = odometry.child_frame
    fixed, joins = NO_TRANSFORMS, dict[str, tuple[str, FloatArray]]()
    if not side.keys() >= set(frames):
        fixed, pose = transforms(), pose.copy()
        for own in owns:
            joins |= {name: (own, T) for name, T in fixed.connected_to(own).items()}
    for number, name in enumerate(frames):
        if name not in side and name in joins:
            rows = columns.frame == number
            side[name], T_own_sensor = joins[name]
            pose[rows] = seen_from(T_own_sensor, pose[rows])
            rise[rows] = _rise(pose[rows])
    foreign = [number for number, name in enumerate(frames) if name not in side]
    names = ", ".join(repr(name[:100]) for name in sorted({frames[k] for k in foreign})[:5])
    expected = (
        f"are in frame {names}, expected {odometry.child_frame!r} or {odometry.frame!r}, or "
        f"one fixed to them ({fixed})"
    )
    parent, child = odometry.frame, odometry.child_frame
    in_odometry = [k for k, name in enumerate(frames) if side.get(name) == parent != child]
    return _Mounted(pose, rise, in_odometry, foreign, expected)


def _rise(pose: FloatArray) -> FloatArray:
    """(k,) sine of the elevation of the x axis of poses (k, 7)."""
    x, y, z, w = pose[:, 3:].T
    return np.asarray(np.abs(2 * (x * z - w * y)))


def _centres(xy: FloatArray, first: IntArray, counts: IntArray, warnings: list[str]) -> FloatArray:
    """(m, 2) mean position of every message's poses, which should coincide."""
    if len(first) == 0:
        return np.zeros((0, 2))
    # Relative to the first pose of each message, so that equal positions give exactly that one.
    origin = xy[first]
    away = xy - np.repeat(origin, counts, axis=0)
    spread = np.maximum.reduceat(np.abs(away).max(axis=1), first)
    apart = int((spread > CENTRE_M).sum())
    if apart:
        warnings.append(
            f"the branches of {several(apart, 'detection')} spread over more than "
            f"{CENTRE_M} m; their mean is taken as the centre"
        )
    return np.asarray(origin + np.add.reduceat(away, first, axis=0) / counts[:, None])


def _leave_out(keep: BoolArray, good: BoolArray, warnings: list[str], why: str) -> BoolArray:
    bad = int((keep & ~good).sum())
    if bad:
        warnings.append(f"{several_that(bad, 'detection', why)}; left out")
    return keep & good
