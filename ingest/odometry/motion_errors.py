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
from ...topology.se2 import apply
from ...topology.topomap import RunNoise
from ...topology.track import walked_at
from .calibration import CALIBRATION, MotionErrors, Shown
from .heading_evidence import PARTS
from .noise import NOISE, drift_ratio
from .within_passes import messages_of, scatter

_STEPS = 8192
"""Points of the grid for the error of lengths, from a thousandth of the expected one to beyond all
that odometries err by: less than 0.3 % apart, below the digits stated."""


@dataclass(frozen=True, slots=True)
class MotionSettings:
    """What odometries and detectors are known to err by."""

    detector_scale: float = 0.01
    """1 sigma of the share by which detectors see things too near or too far, which passes cannot
    tell from an odometry's. Those that report what they measure to be within a distance show 0.02
    too much, those that see both sides alike 0.003 (six runs each, at mid drift)."""
    range_m: float = 0.05
    """1 sigma of the distance by which detectors see everything too far: the noise of single
    messages."""
    least_scale: float = 0.07
    """Larger corrections of lengths are warned of: twice what recorded odometries err by."""
    most_scale: float = 0.2
    """No odometry's lengths are off by a larger share: what seems to be is the detector's fault, or
    its unit, and is not corrected."""
    lever_m: float = 1.0
    """1 sigma of each coordinate of the point of the robot that an odometry refers to, in the frame
    of the detector: few robots are longer."""


MOTION = MotionSettings()


def motion_errors(
    odometry: Odometry, detections: Detections, passes: Passes, noise: RunNoise
) -> MotionErrors | None:
    """What passes show of all lengths, and of the points of the robot to which odometry and
    detector refer; None where they show nothing.

    No loop tells the scale, since loops close at any. But where lengths are too long, junctions
    move along with the robot that passes them, and where the points differ, they turn with it
    (`_shown_motion`). A detector whose readings are too small by a share shows as a scale, too
    (`detector_scale`). Applied are the mean of the scale's posterior (`_Scale`), and of the lever
    what is `apply_at_z` sigmas from zero.
    """
    shown = _shown_motion(odometry, detections, passes, noise)
    if shown is None:
        return None
    (too_long, x, y), (scale_sigma, x_sigma, y_sigma) = (values.tolist() for values in shown)
    mean = 0.0
    if abs(too_long) <= MOTION.most_scale:
        mean = _Scale.of(_expected(odometry, noise), too_long, scale_sigma).mean
    return MotionErrors(
        Shown(
            rounded(too_long, LENGTH_SCALE), significant(scale_sigma), rounded(mean, LENGTH_SCALE)
        ),
        _lever(x, x_sigma),
        _lever(y, y_sigma),
    )


def _lever(metres: float, sigma: float) -> Shown:
    applied = metres if abs(metres) >= CALIBRATION.apply_at_z * sigma else 0.0
    return Shown(rounded(metres, METRES), significant(sigma), rounded(applied, METRES))


def describe_scale(errors: MotionErrors | None) -> list[str]:
    """A warning on lengths that were corrected by much, or are off by too much to be, if any."""
    if errors is None:
        return []
    shown, share = errors.length_scale.estimate, errors.length_scale.applied
    if abs(shown) > MOTION.most_scale:
        return [
            f"lengths of the odometry and of the detector differ by {100 * abs(shown):.0f} %, by "
            "how junctions move while the robot passes them: more than odometries err by, so that "
            "nothing is corrected; if both are in metres, lengths of the map are as unsure"
        ]
    if abs(share) <= MOTION.least_scale:
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
    *,
    too_long: float = 0.0,
) -> float:
    """Standard deviation of the relative length error, after loop closure has estimated the
    heading's drift: the bound that holds 68.3 % of the posterior of what is left.

    odometry: calibrated; too_long: the share that was taken off its lengths.
    """
    expected = _expected(odometry, noise)
    left = _shown_motion(odometry, detections, passes, noise)
    if left is None:
        return expected
    error, sigma = float(left[0][0]), float(left[1][0])
    if abs(error) > MOTION.most_scale:
        return max(expected, abs(error))
    return _Scale.of(expected, too_long + error * (1 - too_long), sigma).radius(too_long)


def _expected(odometry: Odometry, noise: RunNoise) -> float:
    """The usual error of lengths, times the ratio of this run's heading drift to the usual one."""
    return NOISE.prior.scale * drift_ratio(
        odometry, noise.heading_rad_per_sqrt_m, noise.heading_rad_per_sqrt_rad
    )


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


@dataclass(frozen=True, slots=True, eq=False)
class _Sections:
    """Every pass that is long enough, cut into `PARTS` of as many messages, its means
    less those of its first section, in the odometry's frame.

    centre (q, k, 2) of the junction [m]; design (q, k, 2, 4) its derivatives by the share by which
    lengths are too long, by x and y of the lever, and by how much too far everything is seen;
    covariance (q, 2k, 2k) of the centres [m²].
    """

    centre: FloatArray
    design: FloatArray
    covariance: FloatArray

    @classmethod
    def of(
        cls, odometry: Odometry, detections: Detections, passes: Passes, noise: RunNoise
    ) -> _Sections | None:
        """None if no pass is long enough. O(messages)."""
        if len(passes) == 0:
            return None
        home, order = messages_of(detections, passes)
        size = np.bincount(home[home >= 0], minlength=len(passes))
        number = np.cumsum(size >= PARTS) - 1
        rows = np.flatnonzero((home >= 0) & (size[home] >= PARTS))
        if len(rows) == 0:
            return None
        home, order = home[rows], order[rows]
        section = number[home] * PARTS + PARTS * order // size[home]
        messages = np.bincount(section)

        def means(values: FloatArray) -> FloatArray:
            """(q, sections, d) of values (rows, d)."""
            sums = np.column_stack([np.bincount(section, v) for v in values.T])
            return np.reshape(sums / messages[:, None], (-1, PARTS, values.shape[1]))

        pose = odometry.at(detections.time_ns[rows])
        centre = apply(pose, detections.centre[rows])
        sigma = scatter(centre, home, NOISE.prior.centre_m)
        middle = np.column_stack([np.bincount(home, c, len(passes)) for c in centre.T])
        # By the mean of the pass: noise of single messages would be taken for a bias.
        away = (middle / np.maximum(size, 1)[:, None])[home] - pose[:, :2]
        toward = away / np.hypot(np.hypot(*away.T), sigma)[:, None]
        cos, sin = means(np.column_stack([np.cos(pose[:, 2]), np.sin(pose[:, 2])])).transpose(
            2, 0, 1
        )
        lever = np.stack([cos, -sin, sin, cos], axis=2).reshape(*cos.shape, 2, 2)
        by_scale, by_range = means(pose[:, :2])[..., None], means(toward)[..., None]
        design = np.concatenate([by_scale, lever, by_range], axis=3)
        walked = means(walked_at(odometry, detections.time_ns[rows]))
        covariance = _walk_covariance(walked, means(away), noise)
        white = sigma**2 / messages.reshape(-1, PARTS)
        both = white[:, :1, None] + white[:, :, None] * np.eye(PARTS)
        covariance += both[:, :, None, :, None] * np.eye(2)[:, None, :]
        found = means(centre)
        left = 2 * (PARTS - 1)
        return cls(
            centre=found[:, 1:] - found[:, :1],
            design=design[:, 1:] - design[:, :1],
            covariance=covariance[:, 1:, :, 1:].reshape(-1, left, left),
        )


def _walk_covariance(walked: FloatArray, away: FloatArray, noise: RunNoise) -> FloatArray:
    """(q, k, 2, k, 2) covariance of centres by the odometry's random walk since the first of k
    sections of a pass [m²]. walked (q, k, 2): path length [m] and rotation [rad] up to each; away
    (q, k, 2): from the robot to the centre [m]."""
    since = np.maximum(walked - walked[:, :1], 0.0)
    heading = (noise.heading_rad_per_sqrt_m**2, noise.heading_rad_per_sqrt_rad**2)
    together = np.minimum(since[:, :, None], since[:, None, :])
    aside = away @ [[0.0, 1.0], [-1.0, 0.0]]
    covariance = np.einsum("qij,qia,qjb->qiajb", together @ heading, aside, aside)
    along = noise.along_m_per_sqrt_m**2 * together[..., 0]
    covariance += along[:, :, None, :, None] * np.eye(2)[:, None, :]
    return np.asarray(covariance)


def _shown_motion(
    odometry: Odometry, detections: Detections, passes: Passes, noise: RunNoise
) -> tuple[FloatArray, FloatArray] | None:
    """(3,) relative length error by how junctions move along with the robot, and x and y of the
    detector's point less the odometry's in the axes of the robot [m], by how they turn with it;
    (3,) standard deviations. None if no pass is long enough.

    Generalised least squares over all passes, with the distance by which everything is seen too far
    as a fourth unknown: of a detector that sees junctions too near, they jump as the robot passes
    them, where those of wrong lengths move evenly. Where the residuals are larger than the noise,
    so are the standard deviations.
    """
    sections = _Sections.of(odometry, detections, passes, noise)
    if sections is None:
        return None
    weight = np.linalg.inv(sections.covariance)
    design = sections.design.reshape(*weight.shape[:2], -1)
    shift = sections.centre.reshape(weight.shape[:2])
    normal = np.einsum("qij,qik,qkl->jl", design, weight, design)
    right = np.einsum("qij,qik,qk->j", design, weight, shift)
    believed = np.diag([MOTION.most_scale, MOTION.lever_m, MOTION.lever_m, MOTION.range_m])
    covariance = np.linalg.inv(normal + np.linalg.inv(believed**2))
    shown = covariance @ right
    error = float(np.einsum("qi,qij,qj->", shift, weight, shift) - shown @ right)
    covariance *= max(1.0, error / shift.size)
    sigma = np.sqrt(np.diag(covariance))
    sigma[0] = np.hypot(sigma[0], MOTION.detector_scale)
    return shown[:3], sigma[:3]
