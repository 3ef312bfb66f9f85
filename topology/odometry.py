"""The track of a robot as its odometry saw it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from .arrays import FloatArray, IntArray
from .frozen import freeze
from .se2 import wrap


@dataclass(frozen=True, slots=True, eq=False)
class Odometry:
    """Poses of the robot in a drifting frame, by time.

    time_ns: (n,) int64, strictly ascending; pose: (n, 3) T_odom_base as x, y [m], theta [rad];
    breaks: (k,) int64, ascending rows i with unknown motion between i - 1 and i (the odometry was
    reset or the robot carried); jumps: (j,) int64, ascending rows i whose step from i - 1 is of
    unknown size; jump_sigma: (j, 2) 1 sigma of these steps per axis [m] and of their turn [rad];
    jump_other: (j, 3) the most likely alternative motion in these steps: forward, left [m] and turn
    [rad]. Raises ValueError on a wrong shape, a NaN, or times that do not ascend.
    """

    time_ns: IntArray
    pose: FloatArray
    breaks: IntArray
    frame: str = "odom"
    child_frame: str = "base_link"
    jumps: IntArray = field(default_factory=lambda: np.zeros(0, np.int64))
    jump_sigma: FloatArray = field(default_factory=lambda: np.zeros((0, 2)))
    jump_other: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))

    def __post_init__(self) -> None:
        n, j = len(self.time_ns), len(self.jumps)
        freeze(self, np.int64, time_ns=(n,), breaks=(None,), jumps=(j,))
        if np.any(self.time_ns[1:] <= self.time_ns[:-1]):
            raise ValueError("odometry times must ascend strictly")
        for name, rows in (("breaks", self.breaks), ("jumps", self.jumps)):
            if not _rows_within(rows, n):
                raise ValueError(f"{name} must ascend and lie within the track")
        freeze(self, np.float64, pose=(n, 3), jump_sigma=(j, 2), jump_other=(j, 3))

    def __len__(self) -> int:
        return len(self.time_ns)

    @property
    def cuts(self) -> IntArray:
        """(c,) first rows of the stretches of known motion: breaks and jumps, ascending."""
        return np.union1d(self.breaks, self.jumps)

    @property
    def step_m(self) -> FloatArray:
        """(n,) distance from the previous row [m]; 0 for the first row and across a break."""
        step = np.zeros(len(self))
        step[1:] = np.hypot(*np.diff(self.pose[:, :2], axis=0).T)
        step[self.breaks] = 0.0
        return step

    @property
    def turn_rad(self) -> FloatArray:
        """(n,) signed turn since the previous row [rad]; 0 for the first row and across a break."""
        turn = np.zeros(len(self))
        turn[1:] = wrap(np.diff(self.pose[:, 2]))
        turn[self.breaks] = 0.0
        return turn

    def delayed(self, by_s: float) -> Odometry:
        """The same poses, `by_s` seconds later."""
        return replace(self, time_ns=self.time_ns + round(by_s * 1e9))

    def shortened(self, share: float) -> Odometry:
        """The same track with all lengths, those of jumps too, shorter by a share; the first
        position stays, and so does what is known of the jumps' errors."""
        pose = self.pose.copy()
        pose[:, :2] -= share * (pose[:, :2] - pose[:1, :2])
        return replace(self, pose=pose)

    def at(self, time_ns: IntArray) -> FloatArray:
        """(m, 3) poses at any times (m,), linearly interpolated, held at the ends. O(n + m log
        n)."""
        return self.interpolator()(time_ns)

    def interpolator(self) -> Callable[[IntArray], FloatArray]:
        """`at` as a function for repeated use, with its tables precomputed. O(n), then O(m log
        n)."""
        origin = self.time_ns[0]
        t = (self.time_ns - origin).astype(np.float64)
        theta = self.pose[0, 2] + np.concatenate([[0.0], np.cumsum(wrap(np.diff(self.pose[:, 2])))])
        # Copied to be one after the other: `interp` would do so for every question.
        columns = (*(self.pose[:, k].copy() for k in (0, 1)), theta)

        def at(time_ns: IntArray) -> FloatArray:
            q = (np.asarray(time_ns, np.int64) - origin).astype(np.float64)
            out = np.stack([np.interp(q, t, column) for column in columns], axis=-1)
            out[..., 2] = wrap(out[..., 2])
            return out

        return at


def _rows_within(rows: IntArray, count: int) -> bool:
    """Whether rows ascend strictly and lie in [1, count)."""
    if len(rows) == 0:
        return True
    return bool(rows[0] >= 1 and rows[-1] < count and (rows[1:] > rows[:-1]).all())
