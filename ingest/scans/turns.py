"""Whether scans turn as the odometry does: upside down, or stamped by another clock, they do not.

Seen from above, the scans of a laser that is mounted upside down are mirror images, and matching
them gives rotations of the wrong sign. Drivers stamp messages on arrival, after a delay. Scans and
odometry measure the same rotations, at times that differ by the lag: it is chosen such that the
rotations between keyframes agree best, after fitting bias and scale of the odometry (temporal
calibration by the angular rates of both: Kelly and Sukhatme, A general framework for temporal
calibration of multiple proprioceptive and exteroceptive sensors, 2010).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...topology.arrays import FloatArray, IntArray
from ...topology.errors import DataError
from ...topology.odometry import Odometry
from ...topology.se2 import wrap
from ..topic_poses import LAG_STEP_S, LEFT, MOST_LAG_S, SAME_SHARE
from .step_errors import HEADING_PRIOR

TURN_RAD = 0.05
"""Rotations larger than this, by scans and odometry, exceed the errors of both."""
ENOUGH = 20
"""Number of steps, about one full turn, after which chance alone gives 4 of 5 once in 170 times."""


class MirroredError(DataError):
    """The scans are mirror images: they turn against the odometry."""


@dataclass(frozen=True, slots=True)
class Turns:
    """Numbers of steps between keyframes that turn with the odometry, and against it."""

    alike: int = 0
    against: int = 0

    def more(self, recorded: FloatArray, matched: FloatArray, piece: IntArray) -> Turns:
        """Add the steps between consecutive poses (k, 3), by odometry and by scans."""
        odometry, scans = (wrap(np.diff(pose[:, 2])) for pose in (recorded, matched))
        tells = (np.abs(odometry) > TURN_RAD) & (np.abs(scans) > TURN_RAD) & (np.diff(piece) == 0)
        alike = int(np.sum(odometry[tells] * scans[tells] > 0))
        return Turns(self.alike + alike, self.against + int(tells.sum()) - alike)

    @property
    def enough(self) -> bool:
        """Whether there are enough steps to decide."""
        return self.alike + self.against >= ENOUGH

    @property
    def mirrored(self) -> bool:
        """Whether the scans turn against the odometry."""
        return self.enough and self.against >= SAME_SHARE * (self.alike + self.against)

    def __str__(self) -> str:
        return f"against the odometry at {self.against} of {self.alike + self.against} turns"


@dataclass(frozen=True, slots=True)
class LagSettings:
    """Which lags are considered."""

    most_s: float = 1.0
    """Beyond this, the clocks are different ones, with an arbitrary offset."""
    step_s: float = 0.05
    """Step of the search, with interpolation: rotations of robots last longer."""
    least_s: float = HEADING_PRIOR[2]
    """Smaller lags are estimated by `StepErrors` with the other errors of rotations: 1 sigma
    there."""
    unlike: float = 0.6
    """Least share of the median difference at lags up to `MOST_LAG_S` that the best one up to
    `most_s` leaves where the clocks differ: 0.7 and more in five logs with stamps 2.5 to 8 s off,
    0.06 and less in four without."""


LAG = LagSettings()


class OtherClockError(DataError):
    """The scans do not turn when the odometry does."""


class LaggingError(DataError):
    """The scans are stamped late, or early; lag_s: by how much [s]."""

    def __init__(self, lag_s: float) -> None:
        self.lag_s = lag_s
        late = "late" if lag_s > 0 else "early"
        super().__init__(f"the scans turn as the odometry does, {abs(lag_s):.2f} s {late}")


def clock_lag(odometry: Odometry, time_ns: IntArray, pose: FloatArray, piece: IntArray) -> float:
    """Lag of the scans' stamps [s]; 0 unless it is large and certain. Raises OtherClockError if the
    scans turn at other times than the odometry.

    time_ns: (k,) by the scans' clock, ascending; pose: (k, 3) of the robot, by its scans; piece:
    (k,) of the odometry.
    """
    at, step = odometry.interpolator(), np.diff(piece) == 0
    turn = wrap(np.diff(pose[:, 2]))[step]
    way = np.hypot(*np.diff(pose[:, :2], axis=0).T)[step]

    def difference(lag_s: float) -> float:
        """Of the rotations of all steps (root mean square, [rad])."""
        own = wrap(np.diff(at(time_ns - np.int64(1e9 * lag_s))[:, 2]))[step]
        inputs = np.column_stack([way, own])
        off = turn - inputs @ np.linalg.lstsq(inputs, turn)[0]
        return float(np.sqrt(np.mean(off**2)))

    count = round(LAG.most_s / LAG.step_s)
    lags = np.asarray(LAG.step_s * np.arange(-count, count + 1), np.float64)
    off = np.array([difference(lag) for lag in lags.tolist()])
    best = int(off.argmin())
    ahead = np.arange(LAG.most_s + LAG_STEP_S, MOST_LAG_S + 1e-9, LAG_STEP_S)
    far = np.concatenate([-ahead[::-1], ahead])
    elsewhere = np.array([difference(lag) for lag in far.tolist()])
    if off[best] >= LAG.unlike * float(np.median(elsewhere)):
        there = int(elsewhere.argmin())
        shift = ""
        if elsewhere[there] < LAG.unlike * off[best]:
            late = "late" if far[there] > 0 else "early"
            shift = f"; they are stamped some {abs(far[there]):.1f} s {late}"
        raise OtherClockError(f"the scans do not turn when the odometry does{shift}")
    if off[best] > LEFT * off[count] or best in (0, len(off) - 1):
        return 0.0
    before, here, after = off[best - 1 : best + 2] ** 2
    lag = lags[best] + 0.5 * LAG.step_s * (before - after) / (before - 2 * here + after)
    return float(lag) if abs(lag) >= LAG.least_s else 0.0
