"""What the odometry gets wrong from scan to scan, and what is left of it after matching."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solveh_banded

from ...topology.se2 import between, wrap
from .keyframes import Keyframes

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

PRIOR = (0.035, 0.03, 0.1)
"""1 sigma of heading errors in general: per metre [rad/m], per radian, and by a lag [s]."""


@dataclass(frozen=True, slots=True, eq=False)
class StepErrors:
    """A model of the odometry's steps, learned from what matching makes of them.

    Heading: θ_true = θ + β s + κ θ + δ ω (bias per metre, scale of turns, lag), from `normal`
    (3, 3) and `right` (3,): least squares of the steps so far under `PRIOR`.
    """

    normal: FloatArray | None = None
    right: FloatArray | None = None

    @property
    def terms(self) -> FloatArray:
        """(3,) β [rad/m], κ, δ [s]."""
        if self.normal is None or self.right is None:
            return np.zeros(3)
        return np.asarray(np.linalg.solve(self.normal, self.right))

    def steps(
        self, frames: Keyframes, first: IntArray, second: IntArray
    ) -> tuple[FloatArray, FloatArray]:
        """Motion (p, 3) to keyframes `first` from `second`, heading corrected; information."""
        motion = between(frames.odometry[second], frames.odometry[first])
        way, turn, _ = inputs = _inputs(frames, first, second)
        motion[:, 2] = wrap(motion[:, 2] + self.terms @ inputs)
        learned = self.normal is not None
        along = 0.01 + 0.05 * way
        heading = 0.005 + (0.02 if learned else 0.06) * way + 0.05 * np.abs(turn)
        information = np.zeros((len(motion), 3, 3))
        information[:, 0, 0] = information[:, 1, 1] = along**-2
        information[:, 2, 2] = heading**-2
        return motion, information

    def learned(
        self,
        frames: Keyframes,
        pairs: tuple[IntArray, IntArray],
        motion: FloatArray,
        sure: NDArray[np.bool_],
    ) -> StepErrors:
        """With the motion (p, 3) of more pairs as matched, where that is sure."""
        first, second = pairs
        raw = between(frames.odometry[second], frames.odometry[first])
        error = wrap(motion[:, 2] - raw[:, 2])
        if not sure.any():
            return self
        A, b = np.stack(_inputs(frames, first, second), axis=1)[sure], error[sure]
        normal = np.diag(np.array(PRIOR) ** -2.0) if self.normal is None else self.normal
        right = np.zeros(3) if self.right is None else self.right
        x = self.terms
        for _ in range(8):
            off = b - A @ x
            sigma = max(1.4826 * float(np.median(np.abs(off))), 1e-3)
            w = 1 / (1 + (off / sigma) ** 2) / sigma**2
            more, side = (A * w[:, None]).T @ A, (A * w[:, None]).T @ b
            x = np.linalg.solve(normal + more, right + side)
        return replace(self, normal=normal + more, right=right + side)


def _inputs(
    frames: Keyframes, first: IntArray, second: IntArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Way, turn and change of the rate of turn over each step."""
    way = np.hypot(*(frames.odometry[first, :2] - frames.odometry[second, :2]).T)
    turn = np.asarray(wrap(frames.odometry[first, 2] - frames.odometry[second, 2]))
    return way, turn, frames.rate[first] - frames.rate[second]


USUAL_RESIDUAL_M = 0.0105
"""At which the information of `alignment` is right as it stands (`benchmarks/laser.py`)."""
LEAST_RESIDUAL_M = 0.006
"""What is nearer is by chance: walls are not flatter."""


@dataclass(frozen=True, slots=True, eq=False)
class SpanErrors:
    """Stretches of corrected odometry and how well they are known by the scans' own account.

    way: (q,) [m]; turned: (q,) [rad] summed up; variance: (q, 3) along, across [m²], heading.
    """

    way: FloatArray
    turned: FloatArray
    variance: FloatArray


def span_errors(
    pose: FloatArray, information: FloatArray, rows: slice, residual_m: float
) -> SpanErrors:
    """Marginals of the motion over spans of keyframes, from the banded information of a window.

    residual_m: root mean square of what points are off their surfaces by, which scales them.
    """
    n, begin = len(pose), rows.start
    length = 16
    first = np.arange(begin, max(rows.stop - length, begin), length)
    if len(first) == 0:
        return SpanErrors(np.zeros(0), np.zeros(0), np.zeros((0, 3)))
    last = first + length
    ends = np.union1d(first, last)
    unit = np.zeros((3 * n, 3 * len(ends)))
    index = (3 * ends[:, None] + np.arange(3)).ravel()
    unit[index, np.arange(len(index))] = 1.0
    joint = solveh_banded(information, unit, lower=True)[index]
    a, b = np.searchsorted(ends, first), np.searchsorted(ends, last)
    motion = between(pose[first], pose[last])
    variance = np.zeros((len(first), 3))
    for k in range(len(first)):
        c, s = np.cos(pose[first[k], 2]), np.sin(pose[first[k], 2])
        J = np.zeros((3, 6))
        J[:, 3:] = [[c, s, 0], [-s, c, 0], [0, 0, 1]]
        J[:, :3] = -J[:, 3:]
        J[:2, 2] = motion[k, 1], -motion[k, 0]
        pick = np.concatenate([3 * a[k] + np.arange(3), 3 * b[k] + np.arange(3)])
        variance[k] = np.diag(J @ joint[np.ix_(pick, pick)] @ J.T)
    step = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(pose[:, :2], axis=0).T))])
    turn = np.concatenate([[0.0], np.cumsum(np.abs(wrap(np.diff(pose[:, 2]))))])
    variance *= (max(residual_m, LEAST_RESIDUAL_M) / USUAL_RESIDUAL_M) ** 2
    return SpanErrors(step[last] - step[first], turn[last] - turn[first], variance)
