"""Systematic heading errors of the odometry, estimated before any place is recognised.

    θ_true = θ + β·s + κ·θ + δ·ω

Real robots have constant heading biases of degrees per metre; loops close only after these are
removed. The evidence (`heading_evidence`) needs no place recognition. The likelihood of x = (β, κ,
δ) models outliers: readings within a pass have heavy tails; a branch is parallel or perpendicular
to an earlier one, or arbitrary. The share of inliers and the scales are estimated along with x, so
that a building without right angles has no influence. The likelihood has many local maxima (a bias
that rotates one leg by 90° more fits a grid as well): the bias is scanned first, and the best few
maxima are climbed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...topology.arrays import BoolArray, FloatArray
from ...topology.digits import significant
from ...topology.odometry import Odometry
from ...topology.run import Detections
from ...topology.se2 import wrap
from ..passes import fuse_passes
from .heading_evidence import TERMS, HeadingEvidence, heading_evidence
from .heading_likelihood import HeadingLikelihood

Terms = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class CalibrationSettings:
    """Settings of the heading calibration."""

    prior_bias_rad_per_m: float = 0.035
    prior_turn_scale: float = 0.03
    prior_lag_s: float = 0.3
    """Priors: 1 sigma of odometry in general, with mean zero."""
    apply_at_z: float = 3.0
    """A term, or a lever (`motion_errors.py`), is applied only if it is at least this many sigmas
    from zero."""
    floor_bias_rad_per_m: float = 0.0005
    floor_turn_scale: float = 0.001
    floor_lag_s: float = 0.01
    """Lower bounds of the estimates' sigmas, added in quadrature."""
    floor_turn_scale_per_s: float = 0.01
    floor_lag_per_s: float = 0.05
    """Further lower bounds, per second between two rows of the odometry, for rotations in
    between."""
    scan_bias_rad_per_m: float = 0.14
    """Largest bias considered."""
    scan_step_rad_per_m: float = 0.0044
    starts: int = 4
    """Number of maxima of the scan that are climbed."""
    rounds: int = 3
    """Corrections of the track, after each of which the passes are fused again."""
    looks_per_pass: float = 2.0
    """Weight of all readings of one branch in one pass, in independent observations."""

    @property
    def prior_sigma(self) -> Terms:
        """1 sigma of the prior of each term."""
        return self.prior_bias_rad_per_m, self.prior_turn_scale, self.prior_lag_s


CALIBRATION = CalibrationSettings()


@dataclass(frozen=True, slots=True)
class Shown:
    """A constant error as passes by junctions show it, 1 sigma of this, and what of it is taken
    off."""

    estimate: float
    sigma: float
    applied: float


@dataclass(frozen=True, slots=True)
class MotionErrors:
    """What passes show by how junctions seem to move.

    length_scale: share by which all lengths are too long; lever_x_m, lever_y_m: by how much centres
    are seen off, in the axes of the robot, as odometry and detector refer to different points.
    """

    length_scale: Shown
    lever_x_m: Shown
    lever_y_m: Shown


@dataclass(frozen=True, slots=True)
class Calibration:
    """Systematic errors of a run's odometry: estimates, 1 sigma, and which were applied.

    Each triple is (bias per metre [rad/m], scale of turns, lag [s]). `applied` values are zero
    where the data do not show the error at `apply_at_z` sigmas. `estimate` and `sigma` are those
    of the fit with all three free. motion: None where passes show nothing.
    """

    applied: Terms = (0.0, 0.0, 0.0)
    estimate: Terms = (0.0, 0.0, 0.0)
    sigma: Terms = CALIBRATION.prior_sigma
    motion: MotionErrors | None = None

    @property
    def too_long(self) -> float:
        """Share to be taken off all lengths."""
        return 0.0 if self.motion is None else self.motion.length_scale.applied

    @property
    def offset_m(self) -> tuple[float, float]:
        """By how much centres are to be moved, in the axes of the robot."""
        if self.motion is None:
            return 0.0, 0.0
        return -self.motion.lever_x_m.applied, -self.motion.lever_y_m.applied

    @property
    def moves(self) -> bool:
        """Whether lengths or centres are to be corrected."""
        return any((self.too_long, *self.offset_m))


def calibrate(odometry: Odometry, detections: Detections) -> Calibration:
    """Estimate the systematic heading errors of a run from its detections alone.

    Never raises on poor data: without passes or turns the estimate is the prior and nothing is
    applied. A few dozen times O(readings).
    """
    result = Calibration()
    if len(odometry) < 2:
        return result
    for _ in range(CALIBRATION.rounds):
        track = apply_calibration(odometry, result)
        passes = fuse_passes(track, detections)
        if len(passes) < 2:
            return result
        nominal = odometry.delayed(-result.applied[2])
        evidence = heading_evidence(track, nominal, detections, passes)
        before, result = result, _fit(evidence, np.array(result.applied), _floor(odometry))
        if np.allclose(before.applied, result.applied, rtol=0, atol=1e-4):
            break
    return result


def _floor(odometry: Odometry) -> FloatArray:
    """(3,) least sigmas of bias [rad/m], scale of turns and lag [s], added in quadrature."""
    spacing_s = float(np.median(np.diff(odometry.time_ns))) * 1e-9
    return np.array(
        [
            CALIBRATION.floor_bias_rad_per_m,
            np.hypot(CALIBRATION.floor_turn_scale, CALIBRATION.floor_turn_scale_per_s * spacing_s),
            np.hypot(CALIBRATION.floor_lag_s, CALIBRATION.floor_lag_per_s * spacing_s),
        ]
    )


def _fit(evidence: HeadingEvidence, already: FloatArray, floor: FloatArray) -> Calibration:
    """Calibration from evidence that was already corrected by `already` (3,)."""
    model = HeadingLikelihood.of(
        evidence,
        prior_sigma=np.array(CALIBRATION.prior_sigma),
        centre=-already,
        worth=CALIBRATION.looks_per_pass,
    )
    starts = _starting_points(model, already)
    every = np.ones(TERMS, bool)
    fitted, x = _best(model, starts, every)
    spread, total = np.hypot(fitted.sigma(x), floor), x + already
    shown = np.abs(total) >= CALIBRATION.apply_at_z * spread
    applied = total
    if not shown.all():
        # The most likely ones, with all errors zero that do not show.
        zero = [np.where(shown, start, -already) for start in (*starts, x)]
        applied = np.where(shown, _best(model, zero, shown)[1] + already, 0.0)
    return Calibration(_terms(applied), _terms(total), _terms(spread))


def _terms(values: FloatArray) -> Terms:
    # Rounded as in documents, so that the values applied are those stated, on every processor.
    a, b, c = (significant(float(v)) for v in values)
    return a, b, c


def _starting_points(model: HeadingLikelihood, already: FloatArray) -> list[FloatArray]:
    """Corrections (3,) that the optimisation starts from: the best local maxima over the bias, the
    one that takes back all that was corrected already (3,), and none."""
    steps = int(np.ceil(CALIBRATION.scan_bias_rad_per_m / CALIBRATION.scan_step_rad_per_m))
    bias = np.arange(-steps, steps + 1) * CALIBRATION.scan_step_rad_per_m - already[0]
    points = np.zeros((len(bias), TERMS))
    points[:, 0] = bias
    value = np.array([model.value(x) for x in points])
    padded = np.concatenate([[-np.inf], value, [-np.inf]])
    peaks = np.flatnonzero((value >= padded[:-2]) & (value >= padded[2:]))
    best = peaks[np.argsort(-value[peaks], kind="stable")][: CALIBRATION.starts]
    return [*points[best], -already, np.zeros(TERMS)]


def _best(
    model: HeadingLikelihood, starts: list[FloatArray], free: BoolArray
) -> tuple[HeadingLikelihood, FloatArray]:
    """The highest of the maxima reached from the starts."""
    # A few steps show which maxima compete; only the best two are climbed to the top.
    distinct = {tuple(x.tolist()): x for x in starts}.values()
    reached = [model.climb(x, free, most=6) for x in distinct]
    reached.sort(key=lambda found: -found[0].value(found[1]))
    final = [fitted.climb(x, free) for fitted, x in reached[:2]]
    value = [fitted.value(x) for fitted, x in final]
    return final[value.index(max(value))]


def apply_calibration(odometry: Odometry, calibration: Calibration) -> Odometry:
    """The track re-integrated with the applied errors of headings and stamps removed; same rows,
    breaks and frames.

    A lag shifts the times of the rows. Every step is rotated by the mean correction at its two
    ends; jumps at breaks are rotated along. The first position stays. O(n).
    """
    if not any(calibration.applied) or len(odometry) == 0:
        return odometry
    way, turned = np.cumsum(odometry.step_m), np.cumsum(odometry.turn_rad)
    bias_rad_per_m, turn_scale, lag_s = calibration.applied
    correction = bias_rad_per_m * way + turn_scale * turned
    step = np.diff(odometry.pose[:, 0] + 1j * odometry.pose[:, 1])
    step = step * np.exp(0.5j * (correction[1:] + correction[:-1]))
    start = complex(odometry.pose[0, 0], odometry.pose[0, 1])
    at = start + np.concatenate([[0.0], np.cumsum(step)])
    pose = np.column_stack([at.real, at.imag, wrap(odometry.pose[:, 2] + correction)])
    return replace(odometry.delayed(-lag_s), pose=pose)
