"""Constant errors of motion that passes show: the scale of all lengths, and the lever between the
points of the robot that odometry and detector refer to."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...topology.arrays import FloatArray
from ...topology.digits import LENGTH_SCALE, METRES, rounded, significant
from ...topology.odometry import Odometry
from ...topology.passes import Passes
from ...topology.quadratic_forms import ONE_SIGMA
from ...topology.run import Detections
from ...topology.topomap import RunNoise
from .calibration import MotionErrors, Shown
from .within_passes import WithinPasses

_STEPS = 8192
"""Points of the grid for the error of lengths, from a thousandth of the expected one to beyond all
that odometries err by: less than 0.3 % apart, below the digits stated."""


@dataclass(frozen=True, slots=True)
class MotionSettings:
    """What odometries and detectors are known to err by."""

    detector_scale: float = 0.003
    """1 sigma of the share by which detectors see things too near or too far: a third of what
    odometries err by. Simulated ones do not; what is shown then is known to 1.2 times as much as
    it states (400 runs at high drift, where it is 0.005), which this covers."""
    told_scale: float = 0.07
    """Larger corrections of lengths are warned of: twice what recorded odometries err by."""
    most_scale: float = 0.2
    """No odometry's lengths are off by a larger share: what seems to be is the detector's fault, or
    its unit. What is known no better shows nothing."""
    lever_at_z: float = 3.0
    """A lever is corrected where it is at least this many sigmas from zero, as headings are."""
    lever_m: float = 1.0
    """1 sigma of each coordinate of the point of the robot that an odometry refers to, in the frame
    of the detector: few robots are longer."""


MOTION = MotionSettings()


def motion_errors(
    odometry: Odometry,
    detections: Detections,
    passes: Passes,
    noise: RunNoise,
    prior: RunNoise,
) -> MotionErrors | None:
    """What passes show of all lengths, and of the points of the robot to which odometry and
    detector refer; None where they show nothing.

    No loop tells the scale, since loops close at any. But where lengths are too long, junctions
    move along with the robot that passes them, and where the points differ, they turn with it
    (`_shown_motion`). A detector that sees things too near shows as a scale, too
    (`detector_scale`). Applied are the mean of the scale's posterior (`_Scale`), and of the lever
    what is `lever_at_z` sigmas from zero. prior: the noise of odometries in general.
    """
    thirds = WithinPasses.of(odometry, detections, passes, prior)
    shown = None if thirds is None else _shown_motion(thirds, noise)
    if shown is None:
        return None
    (too_long, x, y), (scale_sigma, x_sigma, y_sigma) = (values.tolist() for values in shown)
    mean = _Scale.of(_expected(odometry, noise, prior), too_long, scale_sigma).mean
    return MotionErrors(
        Shown(
            rounded(too_long, LENGTH_SCALE), significant(scale_sigma), rounded(mean, LENGTH_SCALE)
        ),
        _lever(x, x_sigma),
        _lever(y, y_sigma),
    )


def _lever(metres: float, sigma: float) -> Shown:
    applied = metres if abs(metres) >= MOTION.lever_at_z * sigma else 0.0
    return Shown(rounded(metres, METRES), significant(sigma), rounded(applied, METRES))


def scale_told(errors: MotionErrors | None) -> list[str]:
    """A warning on lengths that were corrected by much, if they were."""
    share = 0.0 if errors is None else errors.length_scale.applied
    if abs(share) <= MOTION.told_scale:
        return []
    wrong, near = ("long", "near") if share > 0 else ("short", "far")
    return [
        f"lengths of the odometry are {100 * abs(share):.0f} % too {wrong}, by how junctions move "
        "while the robot passes them, and are corrected: if the detector sees junctions too "
        f"{near} instead, lengths of the map are wrong"
    ]


def refine_scale(
    odometry: Odometry,
    detections: Detections,
    passes: Passes,
    noise: RunNoise,
    prior: RunNoise,
    *,
    too_long: float = 0.0,
) -> float:
    """Standard deviation of the relative length error, after loop closure has estimated the
    heading's drift: the bound that holds 68.3 % of the posterior of what is left.

    odometry: calibrated; prior: as in `motion_errors`; too_long: the share that was taken off its
    lengths.
    """
    expected = _expected(odometry, noise, prior)
    thirds = WithinPasses.of(odometry, detections, passes, prior)
    left = None if thirds is None else _shown_motion(thirds, noise)
    if left is None:
        return expected
    error, sigma = float(left[0][0]), float(left[1][0])
    return _Scale.of(expected, too_long + error * (1 - too_long), sigma).radius(too_long)


def _expected(odometry: Odometry, noise: RunNoise, prior: RunNoise) -> float:
    """The usual error of lengths, times the ratio of this run's heading drift to the usual one."""
    worse = np.sqrt(_turned(odometry, noise) / _turned(odometry, prior))
    return float(prior.scale * worse)


@dataclass(frozen=True, slots=True, eq=False)
class _Scale:
    """Posterior of the share by which lengths are too long: error (k,) ascending, weight (k,)."""

    error: FloatArray
    weight: FloatArray

    @classmethod
    def of(cls, expected: float, shown: float, sigma: float) -> _Scale:
        """Prior: Student's t with two degrees of freedom about 0, of which 68.3 % lie within
        `expected`; likelihood normal about what passes show, `sigma` its standard deviation."""
        expected = max(expected, 1e-9)
        size = np.geomspace(1e-3 * expected, max(1e3 * expected, 1.0), _STEPS)
        ratio = size / expected
        # Steps are as wide as the ratio is large.
        prior = (1 + ratio**2 * ONE_SIGMA**2 / (1 - ONE_SIGMA**2)) ** -1.5 * ratio
        error = np.concatenate([-size[::-1], size])
        off = ((error - shown) / sigma) ** 2
        return cls(error, np.concatenate([prior[::-1], prior]) * np.exp(-0.5 * (off - off.min())))

    @property
    def mean(self) -> float:
        return float(self.weight @ self.error / self.weight.sum())

    def radius(self, about: float) -> float:
        """The bound r with P(|error - about| <= r) = 68.3 %."""
        off = np.abs(self.error - about)
        order = np.argsort(off)
        below = np.cumsum(self.weight[order])
        return float(np.interp(ONE_SIGMA * below[-1], below, off[order]))


def _turned(odometry: Odometry, noise: RunNoise) -> float:
    """Variance of the heading at the end of a run, by its path length and rotations [rad²]."""
    way, turned = odometry.step_m.sum(), np.abs(odometry.turn_rad).sum()
    both = np.array([noise.heading_rad_per_sqrt_m, noise.heading_rad_per_sqrt_rad]) ** 2
    return float(both @ [way, turned])


def _shown_motion(thirds: WithinPasses, noise: RunNoise) -> tuple[FloatArray, FloatArray] | None:
    """(3,) relative length error by how junctions move along with the robot, and x and y of the
    detector's point less the odometry's in the axes of the robot [m], by how they turn with it;
    (3,) standard deviations. None where lengths show no error, or more than any odometry errs by.

    Generalised least squares over all passes. O(q).
    """
    walk_m, walk_rad = np.maximum(thirds.walked, 0.0).T
    white = thirds.shift_variance + noise.along_m_per_sqrt_m**2 * walk_m
    turn = noise.heading_rad_per_sqrt_m**2 * walk_m + noise.heading_rad_per_sqrt_rad**2 * walk_rad
    weight = np.linalg.inv(white[:, None, None] * np.eye(2) + turn[:, None, None] * thirds.swung)
    design = np.concatenate([thirds.motion[:, :, None], thirds.turned], axis=2)
    normal = np.einsum("qij,qik,qkl->jl", design, weight, design)
    right = np.einsum("qij,qik,qk->j", design, weight, thirds.shift)
    normal[1:, 1:] += np.eye(2) / MOTION.lever_m**2
    if normal[0, 0] <= 0:
        return None
    covariance = np.linalg.inv(normal)
    shown, sigma = covariance @ right, np.sqrt(np.diag(covariance))
    if max(abs(shown[0]), sigma[0]) > MOTION.most_scale:
        return None
    sigma[0] = np.hypot(sigma[0], MOTION.detector_scale)
    return shown, sigma
