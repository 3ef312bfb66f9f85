"""From raw poses to a sane track: order of times, duplicates, glitches, jumps, gaps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...topology.arrays import BoolArray, FloatArray, IntArray
from ...topology.odometry import Odometry
from ...topology.se2 import wrap
from .jumps import spikes, times, without_jumps

SECOND_NS = 10**9
"""A second in nanoseconds."""

FEW_STEPS = 20
"""With fewer steps in motion, the usual speed of the robot is unknown."""


@dataclass(frozen=True, slots=True)
class TrackSettings:
    """When odometry is broken.

    A step is a teleport if it is long (teleport_min_m; as a rotation, teleport_min_rad), faster
    than robots drive indoors (teleport_min_speed_m_per_s, teleport_min_turn_rad_per_s) and
    teleport_speed_factor times faster than this robot elsewhere. A step onto exactly the origin is
    a reset if it is longer than reset_min_m or turns by more than reset_min_rad, because a robot
    may stand there. A gap is at least gap_periods of the usual period, and gap_min_s; a clock that
    goes back by more than gap_min_s was set, by less it jitters.
    """

    teleport_min_m: float = 0.5
    teleport_min_rad: float = 0.7
    teleport_speed_factor: float = 5.0
    teleport_min_speed_m_per_s: float = 3.0
    teleport_min_turn_rad_per_s: float = 6.0
    reset_min_m: float = 0.1
    reset_min_rad: float = 0.1
    gap_periods: float = 20.0
    gap_min_s: float = 1.0


TRACK = TrackSettings()


@dataclass(frozen=True, slots=True)
class Track:
    """recorded: the track in order, as in the log; odometry: with its jumps replaced; warnings: one
    per kind of fault."""

    recorded: Odometry
    odometry: Odometry
    warnings: tuple[str, ...]


def backward_jumps(time_ns: IntArray) -> int:
    """How often the clock itself went back: a step back that is not made up for immediately.

    Single reordered messages do not count. O(n).
    """
    starts, ends = _behind(time_ns)
    return int((time_ns[ends - 1] - time_ns[starts] >= TRACK.gap_min_s * SECOND_NS).sum())


def _behind(time_ns: IntArray) -> tuple[IntArray, IntArray]:
    """Runs [start, end) of rows before a time already seen."""
    if (time_ns[1:] >= time_ns[:-1]).all():
        none = np.zeros(0, np.int64)
        return none, none
    behind = time_ns < np.maximum.accumulate(time_ns)
    edges = np.flatnonzero(np.diff(behind.astype(np.int8), prepend=0, append=0))
    return edges[::2], edges[1::2]


def sane_track(time_ns: IntArray, pose: FloatArray, frame: str, child_frame: str) -> Track:
    """Sort by time, drop duplicates and glitches, replace jumps.

    time_ns: (n,) in the order of the log, n ≥ 1; pose: (n, 3) x, y [m], theta [rad], finite. O(n
    log n) at worst, O(n) for times in order.
    """
    warnings: list[str] = []
    time_ns, pose = _forward(time_ns, pose, warnings)
    time_ns, pose = _in_order(time_ns, pose, warnings)
    teleports, leaps = _leaps(time_ns, pose)
    glitches = _glitches(pose, leaps)
    if len(glitches):
        warnings.append(
            f"{len(glitches)} odometry poses lie off the track for one message; dropped"
        )
        time_ns, pose = np.delete(time_ns, glitches), np.delete(pose, glitches, axis=0)
        teleports, leaps = _leaps(time_ns, pose)
    for array in (time_ns, pose):
        array.flags.writeable = False
    recorded = Odometry(time_ns, pose, np.zeros(0, np.int64), frame, child_frame)
    gaps = _gaps(time_ns)
    odometry, of_jumps = without_jumps(recorded, leaps, teleports & gaps)
    warnings += of_jumps
    if gaps.any():
        longest = np.diff(time_ns)[gaps].max() / SECOND_NS
        warnings.append(f"odometry is silent {times(int(gaps.sum()))} (longest {longest:.2f} s)")
    return Track(recorded, odometry, tuple(warnings))


def _forward(
    time_ns: IntArray, pose: FloatArray, warnings: list[str]
) -> tuple[IntArray, FloatArray]:
    """Drop what was recorded after the clock was set back, until it has caught up.

    Sorting would interleave two parts of the drive. A part that fills a gap is kept: the log was
    then not written in the order of time.
    """
    starts, ends = _behind(time_ns)
    jumps = time_ns[ends - 1] - time_ns[starts] >= TRACK.gap_min_s * SECOND_NS
    if not jumps.any():
        return time_ns, pose
    starts, ends = starts[jumps], ends[jumps]
    woven = ~_fills_gaps(time_ns, starts, ends)
    keep = np.ones(len(time_ns), bool)
    for start, end in zip(starts[woven].tolist(), ends[woven].tolist(), strict=True):
        keep[start:end] = False
    if woven.any():
        warnings.append(
            f"the clock goes back {times(int(woven.sum()))}; {int((~keep).sum())} odometry "
            "messages until it catches up were dropped"
        )
    return time_ns[keep], pose[keep]


def _fills_gaps(time_ns: IntArray, starts: IntArray, ends: IntArray) -> BoolArray:
    """Whether rows [start, end) lie between two others in time, without a gap to either.

    It is unlikely of a clock that was set back. O(n log n).
    """
    order = np.argsort(time_ns, kind="stable")
    place = np.empty(len(order), np.int64)
    place[order] = np.arange(len(order))
    step = np.diff(time_ns[order], prepend=time_ns[order[0]], append=time_ns[order[-1]])
    near = step <= TRACK.gap_min_s * SECOND_NS
    fills = np.zeros(len(starts), bool)
    for k, (start, end) in enumerate(zip(starts.tolist(), ends.tolist(), strict=True)):
        first, last = int(place[start:end].min()), int(place[start:end].max())
        alone = last - first == end - start - 1
        fills[k] = alone and near[first] and near[last + 1]
    return fills


def _in_order(
    time_ns: IntArray, pose: FloatArray, warnings: list[str]
) -> tuple[IntArray, FloatArray]:
    if (time_ns[1:] > time_ns[:-1]).all():
        return time_ns, pose
    late = int((time_ns[1:] < time_ns[:-1]).sum())
    if late:
        order = np.argsort(time_ns, kind="stable")
        time_ns, pose = time_ns[order], pose[order]
        warnings.append(f"{late} odometry messages are out of order; they were sorted by time")
    fresh = np.concatenate([[True], np.diff(time_ns) > 0])
    if not fresh.all():
        twice = int((~fresh).sum())
        time_ns, pose = time_ns[fresh], pose[fresh]
        warnings.append(f"{twice} odometry messages repeat the time of another and were dropped")
    return time_ns, pose


def _leaps(time_ns: IntArray, pose: FloatArray) -> tuple[BoolArray, BoolArray]:
    """(n - 1,) steps that cannot have been driven; these, and those that stand out from all
    others."""
    teleports = _teleports(time_ns, pose)
    return teleports, teleports | spikes(time_ns, pose)


def _glitches(pose: FloatArray, leaps: BoolArray) -> IntArray:
    """Rows of single poses between two leaps whose neighbours are consistent."""
    lone = np.flatnonzero(leaps[:-1] & leaps[1:]) + 1
    way = np.hypot(*(pose[lone + 1, :2] - pose[lone - 1, :2]).T)
    turn = np.abs(wrap(pose[lone + 1, 2] - pose[lone - 1, 2]))
    return np.asarray(lone[(way <= TRACK.teleport_min_m) & (turn <= TRACK.teleport_min_rad)])


def _teleports(time_ns: IntArray, pose: FloatArray) -> BoolArray:
    """(n - 1,) whether a step cannot have been driven, or leads back to the origin exactly."""
    way = np.hypot(np.diff(pose[:, 0]), np.diff(pose[:, 1]))
    turn: FloatArray = np.abs(wrap(np.diff(pose[:, 2])))
    duration = np.diff(time_ns) / SECOND_NS
    zero = ~pose[1:].any(axis=1)
    away = (way > TRACK.reset_min_m) | (turn > TRACK.reset_min_rad)
    reset = zero & away
    long_step = (way > TRACK.teleport_min_m) | (turn > TRACK.teleport_min_rad)
    if not (long_step | reset).any():
        return reset
    speed_limit = _limit(way, duration, TRACK.teleport_min_speed_m_per_s)
    turn_limit = _limit(turn, duration, TRACK.teleport_min_turn_rad_per_s)
    far = (way > TRACK.teleport_min_m) & (way > speed_limit * duration)
    far |= (turn > TRACK.teleport_min_rad) & (turn > turn_limit * duration)
    # Driving through the exact origin is a step like any other; a reset is far longer.
    factor = TRACK.teleport_speed_factor
    sudden = (way > factor * np.quantile(way, 0.99)) | (turn > factor * np.quantile(turn, 0.99))
    return np.asarray(far | (reset & sudden))


def _limit(size: FloatArray, duration: FloatArray, least: float) -> float:
    """Speed above which a step is rejected: far above the robot's usual one."""
    moving = size > 0
    if int(moving.sum()) < FEW_STEPS:
        return least
    usual = float(np.quantile(size[moving] / duration[moving], 0.95))
    return max(least, TRACK.teleport_speed_factor * usual)


def _gaps(time_ns: IntArray) -> BoolArray:
    """(n - 1,) steps in which the odometry is silent."""
    step, least = np.diff(time_ns), TRACK.gap_min_s * SECOND_NS
    if not (step > least).any():
        return np.zeros(len(step), bool)
    return np.asarray(step > max(least, TRACK.gap_periods * float(np.median(step))))
