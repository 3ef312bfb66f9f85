"""Noise of a run's odometry and detector, estimated from the run itself.

Before loop closure (`estimate_noise`): readings of one branch scatter from message to message by
the detector's noise; between the first and the last third of a pass, readings move by the
odometry's drift in between; and where branches of different junctions are mostly square to each
other, their deviation from that grows with the distance driven in between. In short runs the drift
is a small difference of noisy values, so that it is regularised by a prior (`NoiseSettings`).

After loop closure (`refine_noise`): repeated passes of one junction give the noise of a whole pass
and the rates of faults.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from ...topology.arrays import FloatArray, IntArray
from ...topology.digits import LENGTH_SCALE, METRES, rounded, significant
from ...topology.odometry import Odometry
from ...topology.passes import Passes
from ...topology.quadratic_forms import ONE_SIGMA
from ...topology.run import Detections
from ...topology.se2 import apply, wrap
from ...topology.topomap import RunNoise
from ...topology.track import walked_at
from ...topology.walk_means import WalkMeans
from .calibration import MotionErrors, Shown
from .heading_evidence import assign_readings
from .revisits import Repeats
from .square_branches import SquareBranches

_STEPS = 8192
"""Points of the grid for the error of lengths, from a thousandth of the expected one to beyond all
that odometries err by: less than 0.3 % apart, below the digits stated."""


@dataclass(frozen=True, slots=True)
class NoiseSettings:
    """Priors, and limits on the data used."""

    prior: RunNoise = field(default_factory=RunNoise)
    """Centres of the priors, kept where a run has no data."""
    prior_spread: float = 0.7
    """Standard deviation of the logarithm of a random walk's rate: a factor of two."""
    prior_messages: float = 20.0
    """Weight of the prior of the detector's scatter, in messages."""
    prior_passes: float = 15.0
    """Weight of the prior of a fault rate, in passes."""
    scale_prior: float = 0.01
    """Standard deviation of the relative length error of odometries in general, used before
    closure."""
    detector_scale: float = 0.003
    """1 sigma of the share by which detectors see things too near or too far: a third of what
    odometries err by. Simulated ones do not; what is shown then is known to 1.2 times as much as
    it states (400 runs at high drift, where it is 0.005), which this covers."""
    told_scale: float = 0.07
    """Larger corrections of lengths are warned of: twice what recorded odometries err by."""
    most_scale: float = 0.2
    """No odometry's lengths are off by a larger share: what seems to be is the detector's fault, or
    its unit. What is known no better shows nothing."""
    match_rad: float = 0.35
    """Readings within this angle of a branch belong to it."""
    least_messages: int = 6
    """Passes with fewer messages are not used for drift."""
    straight_rad: float = 0.3
    """Passes with a larger turn are not used for the random walk along the path."""
    lever_at_z: float = 3.0
    """A lever is corrected where it is at least this many sigmas from zero, as headings are."""
    lever_m: float = 1.0
    """1 sigma of each coordinate of the point of the robot that an odometry refers to, in the frame
    of the detector: few robots are longer."""
    reach_passes: int = 6
    reach_m: float = 60.0
    """Branches are compared with those of this many passes before, within this distance along the
    path."""
    most_passes: int = 500
    """Limit on passes that are compared; more are thinned evenly."""


def estimate_noise(
    odometry: Odometry,
    detections: Detections,
    passes: Passes,
    settings: NoiseSettings = NoiseSettings(),
) -> RunNoise:
    """Noise of odometry and detector before closure; fault rates are those of the prior.

    odometry: calibrated, in the frame of `passes`. O(readings); does not raise on little data.
    """
    thirds = _WithinPasses.of(odometry, detections, passes, settings)
    if thirds is None:
        return settings.prior
    prior = settings.prior
    walk_m, walk_rad = _heading_walk(odometry, passes, thirds, settings)
    along, scale = _along(thirds, settings)
    # Half of the variance of a reading is assumed to be common to its pass (a junction is seen
    # askew from one side), which the scatter within a pass does not show.
    return _stated(
        prior,
        along_m_per_sqrt_m=along,
        heading_rad_per_sqrt_m=walk_m,
        heading_rad_per_sqrt_rad=walk_rad,
        scale=scale,
        centre_m=float(thirds.centre_sigma * np.sqrt(1 + 1 / thirds.messages)),
        branch_rad=float(thirds.branch_sigma * np.sqrt(1 + 1 / thirds.messages)),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _WithinPasses:
    """Differences between the first and the last third of each pass that is long enough.

    turn (q,) rotation of the branches [rad], turn_variance (q,) its variance by the detector's
    scatter; shift (q, 2) of the centre [m], shift_variance (q,) of each axis; motion (q, 2) of the
    robot [m], turned (q, 2, 2) difference of its mean rotation matrices, swung (q, 2, 2) covariance
    of the shift by a heading that errs by 1 rad, all in the odometry's frame; walked (q, 2) path
    length [m] and absolute rotation [rad] that determine the variance of a random walk averaged
    over both thirds; moved (q,) path length between the middles of the thirds [m].
    branch_sigma, centre_sigma: scatter of single messages; messages: median number in a pass;
    walks: averaged over whole passes.
    """

    turn: FloatArray
    turn_variance: FloatArray
    shift: FloatArray
    shift_variance: FloatArray
    motion: FloatArray
    turned: FloatArray
    swung: FloatArray
    walked: FloatArray
    moved: FloatArray
    branch_sigma: float
    centre_sigma: float
    messages: float
    walks: WalkMeans

    @classmethod
    def of(
        cls, odometry: Odometry, detections: Detections, passes: Passes, settings: NoiseSettings
    ) -> _WithinPasses | None:
        """None if no message belongs to a pass."""
        if len(passes) == 0:
            return None
        message_pass, order = _messages(detections, passes)
        rows = np.flatnonzero(message_pass >= 0)
        if len(rows) == 0:
            return None
        home, time_ns = message_pass[rows], detections.time_ns[rows]
        pose = odometry.at(time_ns)
        centre = apply(pose, detections.centre[rows])
        p = len(passes)
        n = np.bincount(home, minlength=p)
        centre_sigma = _scatter(centre, home, settings.prior.centre_m, settings)
        readings = assign_readings(odometry, detections, passes, settings.match_rad)
        reading_message = detections.branches.owner[readings.row]
        sequence = np.lexsort((reading_message, readings.branch))
        heading = np.asarray(wrap(readings.heading - passes.branches.values[readings.branch]))
        branch_sigma = _scatter(
            heading[sequence, None], readings.branch[sequence], settings.prior.branch_rad, settings
        )
        third = np.minimum(3 * order // np.maximum(n[message_pass], 1), 2)
        usable = np.flatnonzero(n >= settings.least_messages)

        def mean(values: FloatArray, which: int) -> FloatArray:
            chosen = third[rows] == which
            size = np.bincount(home[chosen], minlength=p)
            total = np.bincount(home[chosen], values[chosen], p)
            return np.asarray(total / np.maximum(size, 1))[usable]

        track = walked_at(odometry, time_ns)
        thirds = WalkMeans.of(track, 3 * home + third[rows], 3 * p)
        moved = thirds.middle[3 * usable + 2, 0] - thirds.middle[3 * usable, 0]

        def change(values: FloatArray) -> FloatArray:
            return np.column_stack([mean(v, 2) - mean(v, 0) for v in values.T])

        size = n[usable] / 3.0
        cos, sin = change(np.column_stack([np.cos(pose[:, 2]), np.sin(pose[:, 2])])).T
        aside = (centre - pose[:, :2]) @ [[0.0, 1.0], [-1.0, 0.0]]
        swung = (aside[:, :, None] * aside[:, None, :]).reshape(-1, 4)
        swung = np.column_stack([np.bincount(home, v, p)[usable] / n[usable] for v in swung.T])
        turn, variance = _branch_turn(readings.branch, heading, third[reading_message], passes)
        return cls(
            turn=turn[usable],
            turn_variance=branch_sigma**2 * variance[usable],
            shift=change(centre),
            shift_variance=centre_sigma**2 * 2 / size,
            motion=change(pose[:, :2]),
            turned=np.stack([cos, -sin, sin, cos], axis=1).reshape(-1, 2, 2),
            swung=swung.reshape(-1, 2, 2),
            walked=thirds.between(3 * usable, 3 * usable + 2),
            moved=moved,
            branch_sigma=branch_sigma,
            centre_sigma=centre_sigma,
            messages=float(np.median(n[n > 0])),
            walks=WalkMeans.of(track, home, p),
        )

    def straight(
        self, settings: NoiseSettings
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Of passes without turns, (k,) each: shift along the motion [m] and its variance [m²],
        moved, and way walked [m], neither negative."""
        rows = self.walked[:, 1] <= settings.straight_rad
        moved, walked = (np.maximum(x[rows], 0.0) for x in (self.moved, self.walked[:, 0]))
        along = self.motion[rows] / np.maximum(np.hypot(*self.motion[rows].T), 1e-9)[:, None]
        return (self.shift[rows] * along).sum(axis=1), self.shift_variance[rows], moved, walked


def refine_noise(
    passes: Passes,
    vertex: IntArray,
    turn_rad: FloatArray,
    noise: RunNoise,
    *,
    drive_bys: int = 0,
    settings: NoiseSettings = NoiseSettings(),
) -> RunNoise:
    """Noise and fault rates after loop closure, from repeated passes of one place.

    vertex: (p,) place of each pass, negative for those removed as phantoms; turn_rad: (p,) rotation
    from the odometry's frame to the map's at each pass; noise: the estimate before, prior of
    `branch_rad`; drive_bys: number of times that the robot passed a known place without detecting
    it. Every rate has a prior of weight `settings.prior_passes`. O(b log b) for b branch readings.
    """
    prior, worth = settings.prior, settings.prior_passes
    seen = int(np.sum(vertex >= 0))
    legs = max(seen + drive_bys - 1, 0)
    invented = len(passes) - seen
    visits = Repeats.of(passes, np.asarray(vertex, np.int64), turn_rad, settings.match_rad)
    faulty, judged = visits.faults()
    return _stated(
        noise,
        branch_rad=visits.branch_sigma(noise.branch_rad, settings.prior_messages),
        miss_rate=_rate(drive_bys, seen + drive_bys, prior.miss_rate, worth),
        phantom_rate=_rate(invented, legs, prior.phantom_rate, worth),
        branch_fault_rate=_rate(faulty, judged, prior.branch_fault_rate, worth),
    )


def _stated(before: RunNoise, **measured: float) -> RunNoise:
    """The noise with the measured values, rounded as in documents: the searches above amplify
    rounding errors, and results must be the same on every processor."""
    return replace(before, **{name: significant(value) for name, value in measured.items()})


def motion_errors(
    odometry: Odometry,
    detections: Detections,
    passes: Passes,
    noise: RunNoise,
    settings: NoiseSettings = NoiseSettings(),
) -> MotionErrors | None:
    """What passes show of all lengths, and of the points of the robot to which odometry and
    detector refer; None where they show nothing.

    No loop tells the scale, since loops close at any. But where lengths are too long, junctions
    move along with the robot that passes them, and where the points differ, they turn with it
    (`_shown_motion`). A detector that sees things too near shows as a scale, too
    (`detector_scale`). Applied are the mean of the scale's posterior (`_Scale`), and of the lever
    what is `lever_at_z` sigmas from zero.
    """
    thirds = _WithinPasses.of(odometry, detections, passes, settings)
    shown = None if thirds is None else _shown_motion(thirds, noise, settings)
    if shown is None:
        return None
    (too_long, x, y), (scale_sigma, x_sigma, y_sigma) = (values.tolist() for values in shown)
    mean = _Scale.of(_expected(odometry, noise, settings), too_long, scale_sigma).mean
    return MotionErrors(
        Shown(
            rounded(too_long, LENGTH_SCALE), significant(scale_sigma), rounded(mean, LENGTH_SCALE)
        ),
        _lever(x, x_sigma, settings),
        _lever(y, y_sigma, settings),
    )


def _lever(metres: float, sigma: float, settings: NoiseSettings) -> Shown:
    applied = metres if abs(metres) >= settings.lever_at_z * sigma else 0.0
    return Shown(rounded(metres, METRES), significant(sigma), rounded(applied, METRES))


def scale_told(errors: MotionErrors | None, settings: NoiseSettings) -> list[str]:
    """A warning on lengths that were corrected by much, if they were."""
    share = 0.0 if errors is None else errors.length_scale.applied
    if abs(share) <= settings.told_scale:
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
    settings: NoiseSettings = NoiseSettings(),
    *,
    too_long: float = 0.0,
) -> float:
    """Standard deviation of the relative length error, after loop closure has estimated the
    heading's drift: the bound that holds 68.3 % of the posterior of what is left.

    odometry: calibrated; too_long: the share that was taken off its lengths.
    """
    expected = _expected(odometry, noise, settings)
    thirds = _WithinPasses.of(odometry, detections, passes, settings)
    left = None if thirds is None else _shown_motion(thirds, noise, settings)
    if left is None:
        return expected
    error, sigma = float(left[0][0]), float(left[1][0])
    return _Scale.of(expected, too_long + error * (1 - too_long), sigma).radius(too_long)


def _expected(odometry: Odometry, noise: RunNoise, settings: NoiseSettings) -> float:
    """The usual error of lengths, times the ratio of this run's heading drift to the usual one."""
    worse = np.sqrt(_turned(odometry, noise) / _turned(odometry, settings.prior))
    return float(settings.prior.scale * worse)


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


def _rate(events: float, trials: float, prior: float, worth: float) -> float:
    """Mean of the Beta posterior of a rate."""
    return (events + worth * prior) / (trials + worth)


def _messages(detections: Detections, passes: Passes) -> tuple[IntArray, IntArray]:
    """(k,) pass of every message, -1 for none, and its index within the pass."""
    home = np.searchsorted(passes.start_ns, detections.time_ns, side="right") - 1
    inside = (home >= 0) & (detections.time_ns <= passes.end_ns[np.maximum(home, 0)])
    home = np.where(inside, home, -1)
    first = np.searchsorted(detections.time_ns, passes.start_ns)
    return home, np.arange(len(home)) - first[home]


def _scatter(values: FloatArray, group: IntArray, prior: float, settings: NoiseSettings) -> float:
    """Standard deviation of single readings (k, d) about their group's mean, from differences of
    successive ones.

    Differences are insensitive to slow drift, their median to outliers.
    """
    same = np.diff(group) == 0
    step = np.abs(np.diff(values, axis=0)[same]).ravel()
    if len(step) == 0:
        return float(prior / np.sqrt(2))
    # Median of |N(0, 2σ²)| = 0.6745 √2 σ.
    found = float(np.median(step)) / (0.6745 * np.sqrt(2))
    weight, expected = float(len(step)), prior**2 / 2
    total = weight + settings.prior_messages
    variance = (weight * found**2 + settings.prior_messages * expected) / total
    return float(np.sqrt(variance))


def _branch_turn(
    branch: IntArray, heading: FloatArray, third: IntArray, passes: Passes
) -> tuple[FloatArray, FloatArray]:
    """(p,) mean rotation of a pass's branches from its first to its last third, and its variance
    for unit noise.

    The variance is infinite if no branch was seen in both.
    """
    count, p = len(passes.branches.values), len(passes)
    total = np.bincount(branch * 3 + third, heading, 3 * count).reshape(-1, 3)
    size = np.bincount(branch * 3 + third, minlength=3 * count).reshape(-1, 3)
    both = (size[:, 0] > 0) & (size[:, 2] > 0)
    n0, n2 = np.maximum(size[:, 0], 1), np.maximum(size[:, 2], 1)
    weight = np.where(both, 1 / (1 / n0 + 1 / n2), 0.0)
    owner = passes.branches.owner
    sums = np.bincount(owner, weight, p)
    moved = np.bincount(owner, weight * (total[:, 2] / n2 - total[:, 0] / n0), p)
    safe = np.where(sums > 0, sums, 1.0)
    return moved / safe, np.where(sums > 0, 1 / safe, np.inf)


def _heading_walk(
    odometry: Odometry, passes: Passes, thirds: _WithinPasses, settings: NoiseSettings
) -> tuple[float, float]:
    """Random walk of the heading per √m and per √rad: the maximum a posteriori estimate."""
    from scipy.optimize import minimize

    prior = settings.prior
    seen = np.isfinite(thirds.turn_variance)
    pairs = SquareBranches.of(
        odometry,
        passes,
        thirds.walks,
        reach_passes=settings.reach_passes,
        reach_m=settings.reach_m,
        most_passes=settings.most_passes,
    )
    centre = np.log([prior.heading_rad_per_sqrt_m, prior.heading_rad_per_sqrt_rad])
    branch = np.log(thirds.branch_sigma * np.sqrt(1 + 1 / thirds.messages))

    def cost(x: FloatArray) -> float:
        walk = np.exp(2 * x[:2])
        variance = thirds.turn_variance + thirds.walked @ walk
        out = _student_cost(thirds.turn[seen], variance[seen])
        out += pairs.cost(walk, float(np.exp(x[2])), float(1 / (1 + np.exp(-x[3]))))
        pull = (x[:2] - centre) / settings.prior_spread
        out += 0.5 * float(pull @ pull) + 2.0 * float((x[2] - branch) ** 2)
        return out + 0.05 * float(x[3] ** 2)

    start = np.array([*centre, branch, 0.0])
    # The default simplex has a relative step, almost none for a start of 0.
    simplex = start + settings.prior_spread * np.vstack([np.zeros(4), np.eye(4)])
    found = minimize(
        cost,
        start,
        method="Nelder-Mead",
        options={"xatol": 0.02, "fatol": 0.02, "initial_simplex": simplex},
    )
    walk_m, walk_rad = np.exp(found.x[:2])
    return float(walk_m), float(walk_rad)


def _student_cost(error: FloatArray, variance: FloatArray) -> float:
    """Negative log-likelihood of errors under Student's t with four degrees of freedom.

    Its scale is the best fit to normal errors of the given variance, so that estimates from data
    without outliers are unbiased.
    """
    nu, scale = 4.0, 0.6906 * variance
    tails = 0.5 * (nu + 1) * np.log1p(error**2 / scale / nu)
    return float(np.sum(0.5 * np.log(scale) + tails))


def _along(thirds: _WithinPasses, settings: NoiseSettings) -> tuple[float, float]:
    """Random walk along the path [m/√m], and the size of the constant relative error of lengths.

    If junctions appear to move along with the robot, lengths are wrong; but the detector may cause
    the same, so that this gives the size of the error and no correction. Turns are excluded, since
    odometry and detector may refer to different points of the robot.
    """
    from scipy.optimize import minimize_scalar

    along, variance, moved, walked = thirds.straight(settings)
    belief = moved @ (moved / variance) + settings.scale_prior**-2
    scale = float(moved @ (along / variance) / belief)
    centre = np.log(settings.prior.along_m_per_sqrt_m)

    def cost(x: float) -> float:
        spread = variance + np.exp(2 * x) * walked
        pull = (x - centre) / settings.prior_spread
        return _student_cost(along - scale * moved, spread) + 0.5 * float(pull**2)

    found = minimize_scalar(cost, bounds=(centre - 3, centre + 3), method="bounded")
    return float(np.exp(found.x)), float(np.hypot(scale, belief**-0.5))


def _shown_motion(
    thirds: _WithinPasses, noise: RunNoise, settings: NoiseSettings
) -> tuple[FloatArray, FloatArray] | None:
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
    normal[1:, 1:] += np.eye(2) / settings.lever_m**2
    if normal[0, 0] <= 0:
        return None
    covariance = np.linalg.inv(normal)
    shown, sigma = covariance @ right, np.sqrt(np.diag(covariance))
    if max(abs(shown[0]), sigma[0]) > settings.most_scale:
        return None
    sigma[0] = np.hypot(sigma[0], settings.detector_scale)
    return shown, sigma
