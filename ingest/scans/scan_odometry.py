"""Odometry from scans alone, for logs without another one."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from ...topology.arrays import FloatArray, IntArray
from ...topology.columns import take
from ...topology.se2 import between, compose, inverse
from .alignment import Steps, chained, match_steps
from .association import Swept
from .keyframes import Keyframes, Posed, join, prepared
from .scan import ScanBatch

MOST_SCANS = 256
"""Scans matched at once."""

APART_S = 0.18
"""Least time between scans that are matched: at 40 Hz the errors of many short steps add up to
three times those of few long ones. At 5 Hz some come early by a tenth."""

LOOSE_M = 0.05
"""1 sigma of the motion above which scans do not determine the distance of a step."""


ANY_TURN_RAD = np.pi
"""Where a scan does not fit the one before, all turns are tried: logs have gaps of seconds, in
which a robot turns by more than is searched beside an odometry (a quarter turn in 3 s of aces)."""

SPEED_M_PER_S, TURN_RAD_PER_S = 1.0, 1.0
"""Prior of the motion: 1 sigma of speed and of turning rate."""


def scan_odometry(batches: Iterable[ScanBatch]) -> Iterator[Posed]:
    """The robot's pose at scans of the first laser, each matched to one at least `APART_S` before.

    It starts at (0, 0, 0). `usable` is False for scans of other lasers and skipped ones.
    """
    before: Keyframes | None = None
    pose = np.zeros(3)
    first: int | None = None
    for whole in batches:
        first = whole.laser if first is None else first
        for begin in range(0, len(whole), MOST_SCANS):
            part = _without_pose(whole.rows(slice(begin, begin + MOST_SCANS)), pose)
            if whole.laser == first:
                part, pose, before = _posed(part, pose, before)
            yield part


def _without_pose(batch: ScanBatch, pose: FloatArray) -> Posed:
    n = len(batch)
    still = np.zeros((n, 3))
    return Posed(batch, still + pose, still, np.zeros(n), np.zeros(n, bool), np.zeros(n, np.int64))


def _posed(
    part: Posed, pose: FloatArray, before: Keyframes | None
) -> tuple[Posed, FloatArray, Keyframes | None]:
    """A batch with its poses; the last scan's pose, and the last scan with returns."""
    batch = part.batch
    rows = _apart(batch, before)
    if len(rows) == 0:
        return part, pose, before
    fresh = prepared(part, rows)
    frames = fresh if before is None else join([before, fresh])
    scans = Swept.of(frames)
    seconds = np.maximum(np.diff(frames.time_ns) * 1e-9, 1e-3)
    information = np.zeros((len(seconds), 3, 3))
    information[:, 0, 0] = information[:, 1, 1] = (SPEED_M_PER_S * seconds) ** -2
    information[:, 2, 2] = (TURN_RAD_PER_S * seconds) ** -2
    pairs = np.arange(1, len(frames)), np.arange(len(frames) - 1)
    still = Steps(np.zeros((len(seconds), 3)), information)
    found = match_steps(scans, pairs, still, ANY_TURN_RAD)
    motion = found.motion
    if (found.loose_m > LOOSE_M).any() and (found.loose_m <= LOOSE_M).any():
        # Along bare walls: match again, expecting the speed of the well-determined steps around.
        sure = found.loose_m <= LOOSE_M
        when = np.cumsum(seconds)
        pace_of = [np.interp(when, when[sure], (motion[:, k] / seconds)[sure]) for k in range(3)]
        going = Steps(np.stack(pace_of, axis=1) * seconds[:, None], 4 * information)
        again = match_steps(scans, pairs, going, ANY_TURN_RAD).motion
        motion = np.where(sure[:, None], motion, again)
    mount = batch.T_body_laser
    own = compose(compose(mount, motion), inverse(mount))
    path = chained(pose, own)
    seen = path if before is not None else np.concatenate([pose[None], path])
    # Scans between have the last known pose.
    last = np.searchsorted(batch.times_ns[rows], batch.times_ns, side="right") - 1
    poses = seen[np.maximum(last, 0)]
    rate = np.zeros(len(batch))
    rate[rows] = _rates(batch.times_ns[rows], poses[rows])
    swept = np.column_stack([np.zeros((len(batch), 2)), rate * batch.sweep_s])
    usable = np.isin(np.arange(len(batch)), rows)
    done = Posed(batch, poses, swept, rate, usable, part.piece)
    return done, seen[-1], take(fresh, slice(-1, None))


def _apart(batch: ScanBatch, before: Keyframes | None) -> IntArray:
    """Rows of scans with returns, at least `APART_S` from each other and from those before."""
    rows: list[int] = []
    next_ns = int(batch.times_ns[0]) if before is None else int(before.time_ns[-1] + 1e9 * APART_S)
    seen = np.isfinite(batch.ranges_m).any(axis=1)
    for row, time_ns in zip(
        np.flatnonzero(seen).tolist(), batch.times_ns[seen].tolist(), strict=True
    ):
        if time_ns >= next_ns:
            rows.append(row)
            next_ns = time_ns + int(1e9 * APART_S)
    return np.array(rows, np.int64)


def _rates(time_ns: IntArray, pose: FloatArray) -> FloatArray:
    """(n,) turning rate [rad/s] at every scan."""
    if len(pose) < 2:
        return np.zeros(len(pose))
    step = between(pose[:-1], pose[1:])[:, 2] / np.maximum(np.diff(time_ns) * 1e-9, 1e-3)
    return np.convolve(np.concatenate([step[:1], step, step[-1:]]), [0.5, 0.5], mode="valid")
