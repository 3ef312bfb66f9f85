"""Jumps of the odometry: steps that the robot did not drive, their size and kind.

A jump is a step of unknown size: the odometry frame jumped while the robot drove on (a slipping
wheel, a pose corrected by the driver), or the robot was pushed and the odometry measured it. Its
error is at most the size of the jump. So the track is continued with the motion of the neighbouring
steps, with an uncertainty of the size of the jump. At a reset the motion is unknown altogether.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...topology.arrays import BoolArray, FloatArray, IntArray
from ...topology.odometry import Odometry
from ...topology.se2 import between, compose, inverse, wrap

MOST_LISTED = 5
"""Number of jumps that are listed one by one."""
BESIDE = np.array([-2, -1, 1, 2])
"""Offsets of the steps that a step is compared with."""


def times(count: int) -> str:
    """ "once", "2 times"."""
    return "once" if count == 1 else f"{count} times"


@dataclass(frozen=True, slots=True)
class JumpSettings:
    """Which steps stand out from the run's own motion."""

    least_m: float = 0.05
    least_rad: float = 0.07
    """Smaller jumps are within the noise of one detection (0.05 to 0.1 m, 2 to 5 degrees)."""
    usual_way_m: float = 30.0
    """Deviations that occur more often than once per this distance count as normal motion."""
    factor: float = 3.0
    """A jump exceeds normal deviations by this factor."""
    margin: float = 1.2
    """A rotation is fast if it exceeds the 99 % quantile of the turning rate by this factor."""
    few_steps: int = 100
    """Shorter tracks do not show what is normal."""


JUMPS = JumpSettings()


@dataclass(frozen=True, slots=True, eq=False)
class _Usual:
    """period: median time between rows [s]; speed [m/s] and rate [rad/s]: 99 % quantiles in
    motion."""

    period: float
    speed: float
    rate: float

    @classmethod
    def of(cls, duration: FloatArray, pose: FloatArray) -> _Usual:
        way, turn = np.hypot(*np.diff(pose[:, :2], axis=0).T), np.abs(wrap(np.diff(pose[:, 2])))
        period = float(np.median(duration))
        # Bursts of messages must not count as high speed.
        duration = np.maximum(duration, 0.5 * period)
        return cls(period, _seldom_exceeded(way / duration), _seldom_exceeded(turn / duration))


def _seldom_exceeded(values: FloatArray) -> float:
    """The 99 % quantile of the values in motion; 0 without any."""
    moving = values[values > 0]
    return float(np.quantile(moving, 0.99)) if len(moving) else 0.0


def spikes(time_ns: IntArray, pose: FloatArray) -> BoolArray:
    """(n - 1,) steps that deviate from their neighbours more than others of the run.

    Because of its inertia a robot makes no large step between two small ones. What is normal for
    this robot and odometry (sparse rows, jerky drives) is estimated from the run. Light robots turn
    on the spot by jerks: a rotation stands out only if it is also faster than usual. O(n).
    """
    found = np.zeros(max(len(pose) - 1, 0), bool)
    if len(pose) <= JUMPS.few_steps:
        return found
    # Including smaller deviations, which show what is normal.
    rows = _large(pose, JUMPS.least_m / JUMPS.factor, JUMPS.least_rad / JUMPS.factor)
    if len(rows) == 0:
        return found
    duration = np.diff(time_ns) * 1e-9
    usual = _Usual.of(duration, pose)
    way, turn = _excess(duration, pose, rows, usual)
    driven = float(np.hypot(np.diff(pose[:, 0]), np.diff(pose[:, 1])).sum())
    often = 1 + int(driven / JUMPS.usual_way_m)
    out = way > max(JUMPS.least_m, JUMPS.factor * _at_rank(way, often))
    turned_rad = np.abs(wrap(pose[rows + 1, 2] - pose[rows, 2]))
    fast = turned_rad > JUMPS.margin * usual.rate * duration[rows]
    out |= fast & (turn > max(JUMPS.least_rad, JUMPS.factor * _at_rank(turn, often)))
    found[rows[out]] = True
    return found


def _large(pose: FloatArray, least_m: float, least_rad: float) -> IntArray:
    """Steps that may leave the range of their neighbours by more than the given amounts.

    The range includes standing still and the steps before and after: a step outside it differs from
    all three by at least as much, which is cheap to bound. The first and the last step are within
    their own range.
    """
    x, y, turn = np.diff(pose, axis=0).T
    turn, far = wrap(turn), np.abs(x) + np.abs(y)
    # Seen from the robot, a step is turned by what the one before it turned.
    off_m = np.abs(np.diff(x)) + np.abs(np.diff(y)) + far[:-1] * np.abs(turn[:-1])
    off_rad = np.abs(wrap(np.diff(turn)))
    large = np.minimum(np.minimum(off_m[:-1], off_m[1:]), far[1:-1]) > least_m
    off_rad = np.minimum(np.minimum(off_rad[:-1], off_rad[1:]), np.abs(turn[1:-1]))
    return 1 + np.flatnonzero(large | (off_rad > least_rad))


def _at_rank(values: FloatArray, rank: int) -> float:
    """The `rank`-th largest value, from 0 on; 0 if there are fewer."""
    if len(values) <= rank:
        return 0.0
    return float(np.partition(values, len(values) - rank - 1)[len(values) - rank - 1])


def _moved(pose: FloatArray, rows: IntArray) -> FloatArray:
    """(k, 3) motion forward [m], left [m], turn [rad] of the steps that begin at rows."""
    return between(pose[rows], pose[rows + 1])


def _excess(
    duration: FloatArray, pose: FloatArray, rows: IntArray, usual: _Usual
) -> tuple[FloatArray, FloatArray]:
    """(k,) each: distance [m] and angle [rad] by which the steps that begin at rows leave the range
    of their neighbours.

    The range includes standing still, and the neighbours' motion both per step and per second,
    because stamps may be wrong. In gaps longer than the usual period it is extended by the usual
    speed.
    """
    beside = np.clip(rows[:, None] + BESIDE, 0, len(pose) - 2)
    moved, around = _moved(pose, rows), _moved(pose, beside.ravel()).reshape(*beside.shape, 3)
    own = duration[rows]
    per_second = (own[:, None] / np.maximum(duration[beside], 0.5 * usual.period))[:, :, None]
    span = np.concatenate([around, around * per_second], axis=1)
    spare = np.maximum(own - usual.period, 0.0)
    spare = spare[:, None] * np.array([usual.speed, usual.speed, usual.rate])
    least, most = np.minimum(span.min(axis=1), 0.0), np.maximum(span.max(axis=1), 0.0)
    off = moved - np.clip(moved, least - spare, most + spare)
    return np.hypot(off[:, 0], off[:, 1]), np.abs(off[:, 2])


def without_jumps(
    odometry: Odometry, leaps: BoolArray, restarted: BoolArray
) -> tuple[Odometry, list[str]]:
    """The odometry with breaks at resets, and other leaps, its jumps, replaced by the motion of
    neighbouring steps; and a warning for each of the two kinds.

    leaps: (n - 1,) steps that cannot have been driven; restarted: (n - 1,) those of them at which
    the clock jumps as well. A reset leads back to the origin or to the start of the track, or
    farther than the robot drives in the whole run. The uncertainty of a jump is its size and the
    usual motion in its time. Rows before the first jump stay as they are. O(n).
    """
    if not leaps.any():
        return odometry, []
    time_ns, pose = odometry.time_ns, odometry.pose
    begin = np.flatnonzero(leaps)
    steps_s = np.diff(time_ns) * 1e-9
    usual, duration = _Usual.of(steps_s, pose), steps_s[begin]
    moved, step = _moved(pose, begin), _expected(steps_s, pose, leaps, usual)
    off = moved - step
    way, turn = np.hypot(off[:, 0], off[:, 1]), np.abs(wrap(off[:, 2]))
    driven = float(np.hypot(*np.diff(pose[:, :2], axis=0).T)[~leaps].sum())
    again = np.minimum(duration, 2 * usual.period)
    reset = _near(pose, begin + 1, np.zeros(3), again, usual)
    reset |= _near(pose, begin + 1, pose[0], again, usual)
    reset |= restarted[begin] | (way > max(driven, JUMPS.least_m))
    sigma_rad = np.minimum(np.hypot(turn, usual.rate * duration), np.pi / np.sqrt(3))
    sigma = np.column_stack([np.hypot(way, usual.speed * duration), sigma_rad])
    jumps, known = begin[~reset] + 1, ~reset
    replaced = replace(
        odometry,
        pose=driven_on(pose, jumps, step[known]),
        breaks=begin[reset] + 1,
        jumps=jumps,
        jump_sigma=sigma[known],
        jump_other=moved[known],
    )
    at_s = (time_ns[begin + 1] - time_ns[0]) * 1e-9
    sizes = [
        f"{metres:.2f} m and {np.degrees(rad):.0f} degrees at {second:.1f} s"
        for metres, rad, second in zip(way, turn, at_s, strict=True)
    ]
    warnings = []
    for which, what, how in (
        (known, "odometry jumps", "steps of unknown size; places seen again measure it"),
        (reset, "odometry is reset", "the chain is split there"),
    ):
        own = [sizes[k] for k in np.flatnonzero(which)]
        if own:
            listed = ", ".join([*own[:MOST_LISTED], *(["…"] if len(own) > MOST_LISTED else [])])
            warnings.append(f"{what} {times(len(own))} ({listed}): {how}")
    return replaced, warnings


def _near(
    pose: FloatArray, rows: IntArray, home: FloatArray, spare_s: FloatArray, usual: _Usual
) -> BoolArray:
    """(k,) whether a robot that started at `home` can have reached the rows in the times
    `spare_s`."""
    away = np.hypot(*(pose[rows, :2] - home[:2]).T)
    turned = np.abs(wrap(pose[rows, 2] - home[2]))
    return np.asarray((away <= usual.speed * spare_s) & (turned <= usual.rate * spare_s))


def _expected(
    duration: FloatArray, pose: FloatArray, leaps: BoolArray, usual: _Usual
) -> FloatArray:
    """(k, 3) motion [m, m, rad] of the leaps, at the mean speed of the nearest regular steps before
    and after. A gap counts as at most two usual periods."""
    good, rows = np.flatnonzero(~leaps), np.flatnonzero(leaps)
    if len(good) == 0:
        return np.zeros((len(rows), 3))
    after = np.searchsorted(good, rows)
    sides = good[np.clip(np.stack([after - 1, after]), 0, len(good) - 1)]
    own = np.minimum(duration[rows], 2 * usual.period)
    out = np.zeros((len(rows), 3))
    for side in sides:
        share = own / np.maximum(duration[side], 0.5 * usual.period)
        out += 0.5 * _moved(pose, side) * share[:, None]
    return out


def driven_on(pose: FloatArray, rows: IntArray, step: FloatArray) -> FloatArray:
    """Poses with the steps into the given rows replaced, and the parts between them moved
    rigidly."""
    out, ends = pose.copy(), np.append(rows, len(pose))[1:]
    for row, end, moved in zip(rows, ends, step, strict=True):
        T_new_old = compose(compose(out[row - 1], moved), inverse(pose[row]))
        out[row:end] = compose(T_new_old, pose[row:end])
    return out
