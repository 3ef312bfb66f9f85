"""A model of the odometry's errors between scans, and the uncertainty left after matching."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from ...topology.arrays import BoolArray, FloatArray, IntArray
from ...topology.se2 import between, compose, inverse, wrap
from .alignment import Steps
from .keyframes import KEYFRAMES, Keyframes
from .scatter import STRETCH, Aligned

HEADING_PRIOR = (0.035, 0.03, 0.1)
"""Prior 1 sigma of heading errors: per metre [rad/m], per radian, and by a lag of the scans [s]."""
SHIFT_PRIOR = (0.03, 0.03, 0.1, 0.1)
"""Prior 1 sigma of the scale of distances, of their direction [rad], and of the position of the
odometry's centre of rotation [m]."""
LOOSE_M = 0.03
"""1 sigma of the motion above which scans do not determine the distance of a step."""


@dataclass(frozen=True, slots=True, eq=False)
class _Learned:
    """Recursive robust least squares: `normal` (k, k), `right` (k,), with a prior of k sigmas."""

    normal: FloatArray
    right: FloatArray

    @classmethod
    def of(cls, prior: tuple[float, ...]) -> _Learned:
        return cls(np.diag(np.array(prior) ** -2.0), np.zeros(len(prior)))

    @property
    def terms(self) -> FloatArray:
        return np.asarray(np.linalg.solve(self.normal, self.right))

    def more(self, A: FloatArray, b: FloatArray) -> _Learned:
        """Add rows A (p, k) x = b (p,)."""
        out = self
        for _ in range(8):
            off = b - A @ out.terms
            sigma = max(1.4826 * float(np.median(np.abs(off))), 1e-3)
            weighted = (A / (1 + (off / sigma) ** 2)[:, None] / sigma**2).T
            out = _Learned(self.normal + weighted @ A, self.right + weighted @ b)
        return out


@dataclass(frozen=True, slots=True, eq=False)
class StepErrors:
    """A model of the odometry's errors, learned from scan matching.

    heading: θ_true = θ + β s + κ θ + δ ω (bias per metre forwards, which has the opposite sign
    backwards for unequal wheels; scale of turns, lag of the scans); shift: scale of distances,
    their direction, and x, y of the odometry's centre of rotation in the robot's frame.
    """

    heading: _Learned = field(default_factory=lambda: _Learned.of(HEADING_PRIOR))
    shift: _Learned = field(default_factory=lambda: _Learned.of(SHIFT_PRIOR))

    @property
    def terms(self) -> FloatArray:
        """(3,) β [rad/m], κ, δ [s]."""
        return self.heading.terms

    def steps(self, frames: Keyframes, first: IntArray, second: IntArray) -> Steps:
        """Corrected motion (p, 3) to keyframes `first` from `second`, and its information."""
        own = odometry_motion(frames, first, second)
        turn = wrap(own[:, 2] + _inputs(frames, first, second, own) @ self.terms)
        shift = np.einsum("pkl,l->pk", _shifts(own, turn), self.shift.terms)
        motion = np.column_stack([own[:, :2] + shift, turn])
        motion = compose(compose(inverse(frames.mount[second]), motion), frames.mount[first])
        # Remaining errors of distances and headings, correlated over many steps.
        way, turned = np.hypot(own[:, 0], own[:, 1]), np.abs(own[:, 2])
        least = _least_step(frames.laser[first] != frames.laser[second], way, turned)
        along, heading = 0.01 * least + 0.05 * way, 0.005 * least + 0.02 * way + 0.05 * turned
        information = np.zeros((len(motion), 3, 3))
        information[:, 0, 0] = information[:, 1, 1] = along**-2
        information[:, 2, 2] = heading**-2
        return Steps(motion, information)

    def learned(
        self,
        frames: Keyframes,
        pairs: tuple[IntArray, IntArray],
        matched: tuple[FloatArray, BoolArray, BoolArray],
    ) -> StepErrors:
        """The model after adding the matched motion (p, 3) of pairs, where rotation and where
        distance are certain."""
        (first, second), (motion, turn_sure, way_sure) = pairs, matched
        own = odometry_motion(frames, first, second)
        real = compose(compose(frames.mount[second], motion), inverse(frames.mount[first]))
        out = self
        if turn_sure.any():
            A, error = _inputs(frames, first, second, own), wrap(real[:, 2] - own[:, 2])
            out = replace(out, heading=self.heading.more(A[turn_sure], error[turn_sure]))
        if way_sure.any():
            A = _shifts(own, real[:, 2])[way_sure].reshape(-1, len(SHIFT_PRIOR))
            error = (real - own)[way_sure, :2].ravel()
            out = replace(out, shift=self.shift.more(A, error))
        return out


LEAST_STEP = 0.1
"""Lower bound of a step between two lasers' keyframes, as a share of one laser's: 1 mm, 0.03
degrees."""


def _least_step(other_laser: BoolArray, way: FloatArray, turned: FloatArray) -> FloatArray:
    """(p,) factor on the part of a step's error that is the same for all lengths: that of steps
    from one laser's keyframe to its next is 1; two lasers may see the same instant."""
    share = np.maximum(way / KEYFRAMES.step_m, turned / KEYFRAMES.turn_rad)
    return np.where(other_laser, np.clip(share, LEAST_STEP, 1.0), 1.0)


def odometry_motion(frames: Keyframes, first: IntArray, second: IntArray) -> FloatArray:
    """(p, 3) motion of the robot by its odometry."""
    pose = [compose(frames.odometry[k], inverse(frames.mount[k])) for k in (second, first)]
    return between(*pose)


def _inputs(frames: Keyframes, first: IntArray, second: IntArray, own: FloatArray) -> FloatArray:
    """(p, 3) distance forwards, rotation, and the change of the turning rate over each step."""
    return np.column_stack([own[:, 0], own[:, 2], frames.rate[first] - frames.rate[second]])


def _shifts(own: FloatArray, turn: FloatArray) -> FloatArray:
    """(p, 2, 4) derivatives of a motion's x and y with respect to the scale, the direction, and the
    centre's x and y."""
    (x, y), c, s = own[:, :2].T, np.cos(turn) - 1, np.sin(turn)
    out = np.stack([x, -y, c, -s, y, x, s, c], axis=1)
    return np.asarray(out.reshape(-1, 2, 4))


SHORT, LONG = STRETCH, 5 * STRETCH
"""Lengths of spans in keyframes, for distances (4 m: heading errors add little) and for headings
(20 m: errors of single keyframes add little)."""
SURER_ALONG = 0.4
"""Factor on the variance of distances by the weights of `alignment` (`benchmarks/laser.py`), which
assume more correlation between the points of a scan than there is."""


@dataclass(frozen=True, slots=True, eq=False)
class SpanErrors:
    """Spans of corrected odometry and their uncertainty.

    way: (q,) [m]; along: (q,) variance of the distance [m²]; far: (r,) [m], turned: (r,) absolute
    rotation [rad] and variance: (r,) its variance [rad²] of other, longer spans.
    """

    way: FloatArray
    along: FloatArray
    far: FloatArray
    turned: FloatArray
    variance: FloatArray


def span_errors(aligned: Aligned, rows: slice, lasers: int = 1) -> SpanErrors:
    """The errors of spans among the given rows of a window, in which keyframes of so many lasers
    come in turns."""
    pose = aligned.pose
    short, long = lasers * SHORT, lasers * LONG
    first, last = _spans(rows, short, short)
    begin, end = _spans(rows, min(long, max(rows.stop - rows.start - 1, short)), short)
    step = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(pose[:, :2], axis=0).T))])
    turn = np.concatenate([[0.0], np.cumsum(np.abs(wrap(np.diff(pose[:, 2]))))])
    return SpanErrors(
        step[last] - step[first],
        SURER_ALONG * aligned.ways(first, last),
        step[end] - step[begin],
        turn[end] - turn[begin],
        aligned.headings(begin, end),
    )


def _spans(rows: slice, length: int, apart: int) -> tuple[IntArray, IntArray]:
    """First and last rows of overlapping spans, `apart` keyframes apart."""
    first = np.arange(rows.start, max(rows.stop - length, rows.start), apart)
    return first, first + length
