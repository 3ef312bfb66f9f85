"""By how much the stamps of scans lag behind the odometry's: drivers stamp what arrives, each after
a delay of its own.

Scans and odometry tell the same turns, at times that differ by the lag: of many lags the one is
taken after which the turns between keyframes agree best, whatever bias and scale the odometry's
have (temporal calibration by the angular rates of both: Kelly and Sukhatme, A general framework for
temporal calibration of multiple proprioceptive and exteroceptive sensors, 2010).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...topology.arrays import FloatArray, IntArray
from ...topology.errors import DataError
from ...topology.odometry import Odometry
from ...topology.se2 import wrap


@dataclass(frozen=True, slots=True)
class LagSettings:
    """Which lags are looked for."""

    most_s: float = 1.0
    """Beyond this, headers hold other clocks, which differ by anything."""
    step_s: float = 0.05
    """Robots turn alike for longer than that; what lies between two steps is interpolated."""
    least_s: float = 0.1
    """What is less, `StepErrors` learns with all else that is wrong with turns: 1 sigma there."""
    left: float = 0.67
    """A lag explains at least a third of what turns differ by (root mean square): it explains half
    and more where scans of two buildings are stamped late by 0.15 s and more, and nothing where
    they are of another drive."""


LAG = LagSettings()


class LaggingError(DataError):
    """The scans are stamped late, or early; lag_s: by how much."""

    def __init__(self, lag_s: float) -> None:
        self.lag_s = lag_s
        late = "late" if lag_s > 0 else "early"
        super().__init__(f"the scans turn as the odometry does, {abs(lag_s):.2f} s {late}")


def clock_lag(odometry: Odometry, time_ns: IntArray, pose: FloatArray, piece: IntArray) -> float:
    """By how much scans are stamped late [s]; 0 where no lag is large and sure.

    time_ns: (k,) by the scans' clock, ascending; pose: (k, 3) of the robot, by its scans; piece:
    (k,) of the odometry.
    """
    at = odometry.interpolator()
    step = np.diff(piece) == 0
    turn = wrap(np.diff(pose[:, 2]))[step]
    way = np.hypot(*np.diff(pose[:, :2], axis=0).T)[step]
    count = round(LAG.most_s / LAG.step_s)
    lags = LAG.step_s * np.arange(-count, count + 1)

    def left(lag_s: float) -> float:
        own = wrap(np.diff(at(time_ns - np.int64(1e9 * lag_s))[:, 2]))[step]
        inputs = np.column_stack([way, own])
        off = turn - inputs @ np.linalg.lstsq(inputs, turn)[0]
        return float(np.sqrt(np.mean(off**2)))

    off = np.array([left(lag) for lag in lags])
    best = int(off.argmin())
    if off[best] > LAG.left * off[count] or best in (0, len(off) - 1):
        return 0.0
    before, here, after = off[best - 1 : best + 2] ** 2
    lag = lags[best] + 0.5 * LAG.step_s * (before - after) / (before - 2 * here + after)
    return float(lag) if abs(lag) >= LAG.least_s else 0.0
