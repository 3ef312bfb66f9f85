"""Noise of a run's odometry and detector, estimated from the run itself.

Before loop closure (`estimate_noise`): readings of one branch scatter from message to message by
the detector's noise; between the first and the last third of a pass they turn by the odometry's
drift in between. In short runs the drift is a small difference of noisy values, so that it is
regularised by a prior (`NoiseSettings`).

After loop closure (`refine_noise`): repeated passes of one junction give the noise of a whole pass
and the rates of faults.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from ...topology.arrays import FloatArray, IntArray
from ...topology.circular import cluster_angles
from ...topology.closure.evidence import PRIOR_PASSES
from ...topology.digits import significant
from ...topology.odometry import Odometry
from ...topology.passes import ONE_WAY_RAD, Passes
from ...topology.run import Detections
from ...topology.se2 import wrap
from ...topology.topomap import RunNoise
from .within_passes import PRIOR_MESSAGES, WithinPasses


@dataclass(frozen=True, slots=True)
class NoiseSettings:
    """Priors."""

    prior: RunNoise = field(default_factory=RunNoise)
    """Centres of the priors, kept where a run has no data."""
    prior_spread: float = 0.7
    """Standard deviation of the logarithm of a random walk's rate: a factor of two."""


NOISE = NoiseSettings()


def estimate_noise(odometry: Odometry, detections: Detections, passes: Passes) -> RunNoise:
    """Noise of odometry and detector before closure; fault rates are those of the prior.

    odometry: calibrated, in the frame of `passes`. O(readings); does not raise on little data.
    """
    thirds = WithinPasses.of(odometry, detections, passes, NOISE.prior)
    if thirds is None:
        return NOISE.prior
    walk_m, walk_rad = _heading_walk(thirds)
    worse = drift_ratio(odometry, walk_m, walk_rad)
    # Half of the variance of a reading is assumed to be common to its pass (a junction is seen
    # askew from one side), which the scatter within a pass does not show.
    return _stated(
        NOISE.prior,
        along_m_per_sqrt_m=NOISE.prior.along_m_per_sqrt_m * worse,
        heading_rad_per_sqrt_m=walk_m,
        heading_rad_per_sqrt_rad=walk_rad,
        scale=NOISE.prior.scale * worse,
        centre_m=float(thirds.centre_sigma * np.sqrt(1 + 1 / thirds.messages)),
        branch_rad=float(thirds.branch_sigma * np.sqrt(1 + 1 / thirds.messages)),
    )


def refine_noise(
    passes: Passes,
    vertex: IntArray,
    turn_rad: FloatArray,
    noise: RunNoise,
    *,
    prior: RunNoise = NOISE.prior,
    drive_bys: int = 0,
) -> RunNoise:
    """Noise and fault rates after loop closure, from repeated passes of one place.

    vertex: (p,) place of each pass, negative for those removed as phantoms; turn_rad: (p,) rotation
    from the odometry's frame to the map's at each pass; noise: the estimate before, prior of
    `branch_rad`; drive_bys: number of times that the robot passed a known place without detecting
    it. prior: of the rates, with a weight of `PRIOR_PASSES`. O(b log b) for b branch readings.
    """
    seen = int(np.sum(vertex >= 0))
    legs = max(seen + drive_bys - 1, 0)
    invented = len(passes) - seen
    visits = Repeats.of(passes, np.asarray(vertex, np.int64), turn_rad)
    faulty, judged = visits.faults()
    return _stated(
        noise,
        branch_rad=visits.branch_sigma(noise.branch_rad, PRIOR_MESSAGES),
        miss_rate=_rate(drive_bys, seen + drive_bys, prior.miss_rate),
        phantom_rate=_rate(invented, legs, prior.phantom_rate),
        branch_fault_rate=_rate(faulty, judged, prior.branch_fault_rate),
    )


def _stated(before: RunNoise, **measured: float) -> RunNoise:
    """The noise with the measured values, rounded as in documents: the searches above amplify
    rounding errors, and results must be the same on every processor."""
    return replace(before, **{name: significant(value) for name, value in measured.items()})


def _rate(events: float, trials: float, prior: float) -> float:
    """Mean of the Beta posterior of a rate."""
    return (events + PRIOR_PASSES * prior) / (trials + PRIOR_PASSES)


def _heading_walk(thirds: WithinPasses) -> tuple[float, float]:
    """Random walk of the heading per √m and per √rad: the maximum a posteriori estimate."""
    from scipy.optimize import minimize

    prior = NOISE.prior
    seen = np.isfinite(thirds.turn_variance)
    centre = np.log([prior.heading_rad_per_sqrt_m, prior.heading_rad_per_sqrt_rad])

    def cost(x: FloatArray) -> float:
        variance = thirds.turn_variance + thirds.walked @ np.exp(2 * x)
        pull = (x - centre) / NOISE.prior_spread
        return _student_cost(thirds.turn[seen], variance[seen]) + 0.5 * float(pull @ pull)

    simplex = centre + NOISE.prior_spread * np.vstack([np.zeros(2), np.eye(2)])
    found = minimize(
        cost,
        centre,
        method="Nelder-Mead",
        options={"xatol": 0.02, "fatol": 0.02, "initial_simplex": simplex},
    )
    walk_m, walk_rad = np.exp(found.x)
    return float(walk_m), float(walk_rad)


def _student_cost(error: FloatArray, variance: FloatArray) -> float:
    """Negative log-likelihood of errors under Student's t with four degrees of freedom.

    Its scale is the best fit to normal errors of the given variance, so that estimates from data
    without outliers are unbiased.
    """
    nu, scale = 4.0, 0.6906 * variance
    tails = 0.5 * (nu + 1) * np.log1p(error**2 / scale / nu)
    return float(np.sum(0.5 * np.log(scale) + tails))


def drift_ratio(odometry: Odometry, walk_m: float, walk_rad: float) -> float:
    """Drift of the heading over a whole run with these random walks, over the usual one.

    An odometry is taken to be equally good at distances and at headings, as within passes only the
    latter shows (`variance_components.py` says the same of loops).
    """
    driven = np.array([odometry.step_m.sum() + 1e-9, np.abs(odometry.turn_rad).sum()])
    usual = (NOISE.prior.heading_rad_per_sqrt_m, NOISE.prior.heading_rad_per_sqrt_rad)
    return float(np.sqrt((np.square([walk_m, walk_rad]) @ driven) / (np.square(usual) @ driven)))


@dataclass(frozen=True, slots=True, eq=False)
class Repeats:
    """Branches of places that were passed at least twice.

    Flat over sightings (pass, cluster): visit, cluster, off [rad] from the cluster's mean. Per
    cluster: place, sightings. passes: (places,) number of passes of each.
    """

    visit: IntArray
    cluster: IntArray
    off: FloatArray
    place: IntArray
    sightings: IntArray
    passes: IntArray

    @classmethod
    def of(cls, passes: Passes, vertex: IntArray, turn_rad: FloatArray) -> Repeats:
        """From the passes with a place (`vertex` >= 0) that was passed at least twice.

        turn_rad: (p,) rotation from the odometry frame to the map frame; branches nearer than
        `ONE_WAY_RAD` are the same. O(b log b).
        """
        count = np.bincount(vertex[vertex >= 0], minlength=1)
        owner = passes.branches.owner
        home = vertex[owner]
        rows = np.flatnonzero((home >= 0) & (count[np.maximum(home, 0)] >= 2))
        heading = np.asarray(wrap(passes.branches.values[rows] + turn_rad[owner[rows]]))
        clusters = cluster_angles(heading, home[rows], ONE_WAY_RAD)
        # A pass that has two branches in one cluster saw it once.
        pairs, first = np.unique(np.stack([clusters.of, owner[rows]]), axis=1, return_index=True)
        off = np.asarray(wrap(heading - clusters.mean[clusters.of]))[first]
        sightings = np.bincount(pairs[0], minlength=len(clusters))
        return cls(pairs[1], pairs[0], off, clusters.owner, sightings, count)

    def faults(self) -> tuple[float, int]:
        """Number of passes with a branch missing or invented, and number of passes considered.

        The majority of a place's passes is right; of two passes that differ, one is wrong.
        """
        k = self.passes[self.place]
        absent = k - self.sightings
        # Of each cluster, the smaller side is at fault; a tie makes half of both.
        wrong = np.minimum(self.sightings, absent).astype(np.float64)
        judged = self.passes[self.passes >= 2]
        by_place = np.bincount(self.place, wrong, len(self.passes))[self.passes >= 2]
        # One pass with several wrong branches is one fault; fewer than half can be at fault.
        return float(np.minimum(by_place, judged / 2).sum()), int(judged.sum())

    def branch_sigma(self, prior: float, worth: float) -> float:
        """1 sigma of a branch heading in one pass [rad]: residuals after fitting the direction of
        every branch and the rotation of every pass.

        Robust: from the median, scaled for the degrees of freedom of the two means. prior: 1 sigma,
        with the weight `worth`.
        """
        visit = np.unique(self.visit, return_inverse=True)[1]
        size = np.bincount(visit)
        off = self.off - (np.bincount(visit, self.off) / np.maximum(size, 1))[visit]
        k, c = self.sightings[self.cluster], size[visit]
        free = (k >= 2) & (c >= 2)
        if not free.any():
            return prior
        freedom = (1 - 1 / k[free]) * (1 - 1 / c[free])
        scaled = np.abs(off[free]) / np.sqrt(freedom)
        weight = float(freedom.sum())
        found = float(np.median(scaled)) / 0.6745
        return float(np.sqrt((weight * found**2 + worth * prior**2) / (weight + worth)))
