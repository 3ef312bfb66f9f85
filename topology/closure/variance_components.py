"""The noise of a run from its closed estimate: variance components of the pose graph.

Before closure little is known of an odometry's drift (`ingest/odometry/noise.py`). The residuals of
loops show it: each variance is the sum of its squared residuals over their degrees of freedom
(Förstner, Ein Verfahren zur Schätzung von Varianz- und Kovarianzkomponenten, 1979; iterated, it is
REML). How an odometry's error divides among its random
walks is hardly observable; its overall level is.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..arrays import FloatArray, IntArray
from ..columns import take
from ..odometry import Odometry
from ..posegraph.graph import edge_errors, prior_errors
from ..posegraph.samples import SampledMarginals, square_root
from ..topomap import RunNoise
from .dead_reckoning import DeadReckoning, about_centroids, walk_sums
from .estimate import ESTIMATE, Estimate, leg_covariance, optimise
from .manhattan import GridHeadings, with_spread

COMPONENTS = (
    "along_m_per_sqrt_m",
    "heading_rad_per_sqrt_m",
    "heading_rad_per_sqrt_rad",
    "centre_m",
    "branch_rad",
)
"""Fields of RunNoise that are estimated, in this order; the last component is the deviation of
corridors from the grid, if there is one."""

_WALKS, _BRANCH, _GRID = 3, 4, 5
"""Number of components that are random walks of the odometry, and indices of two others."""


@dataclass(frozen=True, slots=True)
class ComponentSettings:
    """Priors and iteration of the estimate."""

    freedom: float = 4.0
    """Degrees of freedom of the prior for the detector, the grid, and the ratios of the odometry's
    random walks: their variances are known to √(2 / freedom) of themselves. The prior of the
    odometry's level is much weaker (`_odometry_level`)."""
    rounds: int = 8
    """Each round estimates the components with the weights of the round before. All but the last
    take double steps in the level of the odometry, which otherwise converges slowly where the data
    hardly determine it. In 45 walks the eighth changes sigmas by 2 % or less."""
    most_spread_rad: float = 0.06
    """Largest deviation of corridors from their grid [rad]; beyond it there is taken to be none:
    streets bend together, while the model assumes independent deviations. In 60 walks of mazes,
    offices and rows at high and real drift 0.010 to 0.044, in three of streets taken for a grid
    0.09 to 0.15."""


PRIOR = ComponentSettings()


@dataclass(frozen=True, slots=True, eq=False)
class Fitted:
    """reckoning and estimate with the most likely noise; grid with its estimated spread."""

    reckoning: DeadReckoning
    estimate: Estimate
    grid: GridHeadings | None


def fitted_noise(
    reckoning: DeadReckoning,
    odometry: Odometry,
    place: IntArray,
    estimate: Estimate,
    *,
    grid: GridHeadings | None = None,
) -> Fitted:
    """Dead reckoning with its most likely noise, and the estimate with that noise.

    reckoning: with the noise estimated before closure, which is the prior; odometry: that of the
    reckoning; estimate: initial one of the places; grid: headings that constrain it. Each round
    solves one estimate, and samples the trace of each component.
    """
    unfitted = reckoning
    prior = np.array([getattr(reckoning.noise, name) for name in COMPONENTS]) ** 2
    if grid is not None:
        prior = np.append(prior, grid.spread_rad**2)
    unit_walks = _reckonings_by_walk(reckoning, odometry)
    legs = np.flatnonzero(np.diff(reckoning.piece) == 0)
    legs_by_walk = np.stack([leg_covariance(unit, legs) for unit in unit_walks])
    variance = prior
    estimate = optimise(reckoning, place, estimate.pose, grid=grid)
    for rounds_left in reversed(range(PRIOR.rounds)):
        energy, freedom = _energy_and_freedom(estimate, legs_by_walk, variance, grid)
        step = _variance_factors(
            energy, freedom, variance / prior, PRIOR.freedom, 2 if rounds_left else 1
        )
        if len(reckoning.loops):
            # The odometry was corrected by its loops: the residuals do not show its errors.
            step[:_WALKS] = 1.0
        variance = variance * step
        reckoning = _with_variances(reckoning, unit_walks, variance)
        if grid is not None:
            spread_rad = float(np.sqrt(variance[_GRID]))
            grid = with_spread(grid, reckoning.passes, reckoning.noise.branch_rad, spread_rad)
        estimate = optimise(reckoning, place, estimate.pose, grid=grid)
    if grid is not None and grid.spread_rad > PRIOR.most_spread_rad:
        return fitted_noise(unfitted, odometry, place, estimate)
    return Fitted(reckoning, estimate, grid)


def _variance_factors(
    energy: FloatArray, freedom: FloatArray, ratio: FloatArray, f: float, power: int
) -> FloatArray:
    """(c,) factors on the variances: squared errors over degrees of freedom, both including the
    prior's.

    ratio: (c,) variances in units of the prior's, which has f degrees of freedom (inverse χ²).
    Variances of the detector and of the grid have priors of their own. Those of the
    odometry's random walks have a common level, which takes a step of its own, raised to `power`.
    """
    level = np.ones(len(ratio))
    t = level[:_WALKS] = _odometry_level(ratio[:_WALKS], f)
    expected = energy + f * level / ratio
    factor: FloatArray = expected / (freedom + f)
    common = (energy[:_WALKS].sum() + 1 / (1 + t)) / (freedom[:_WALKS].sum() + t / (1 + t))
    factor[:_WALKS] *= common**power * (freedom[:_WALKS] + f).sum() / expected[:_WALKS].sum()
    return factor


def _odometry_level(ratio: FloatArray, f: float) -> float:
    """The most likely level of an odometry's variances, in units of the prior's.

    ratio: (k,) variances in the same units, each distributed about the level with f degrees of
    freedom (inverse χ²), because an odometry is taken to be equally good at distances and at
    headings. The prior of the level t is weak and allows none at all: its sigma has the density 1 /
    (1 + t) (half-Cauchy; Gelman, Prior distributions for variance parameters, 2006), where an
    inverse χ² would exclude zero. With h = Σ 1 / ratio, the derivative by ln t vanishes where f (k
    - t h) + (1 - t) / (1 + t) = 0.
    """
    h, k = float((1 / ratio).sum()), len(ratio)
    b = f * (k - h) - 1
    return float(b + np.sqrt(b * b + 4 * f * h * (f * k + 1))) / (2 * f * h)


def _reckonings_by_walk(reckoning: DeadReckoning, odometry: Odometry) -> list[DeadReckoning]:
    """Dead reckoning with a single random walk of the odometry of unit variance, one for each
    walk."""
    none = RunNoise(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    noises = [replace(none, **{name: 1.0}) for name in COMPONENTS[:_WALKS]]
    _, centred = about_centroids(odometry)
    sums = (walk_sums(odometry, reckoning.passes, noise, centred) for noise in noises)
    # Errors of jumps are not noise, and would be counted once for every component.
    return [replace(reckoning, sums=s, jumps=np.zeros_like(reckoning.jumps)) for s in sums]


def _with_variances(
    reckoning: DeadReckoning, units: list[DeadReckoning], variance: FloatArray
) -> DeadReckoning:
    """Dead reckoning with other variances of its components, in which its sums are linear."""
    sigma = dict(zip(COMPONENTS, np.sqrt(variance).tolist(), strict=False))
    sums = np.zeros_like(reckoning.sums)
    for walk_variance, unit in zip(variance[:_WALKS].tolist(), units, strict=True):
        sums += walk_variance * unit.sums
    return replace(reckoning, noise=replace(reckoning.noise, **sigma), sums=sums)


@dataclass(frozen=True, slots=True, eq=False)
class _Edges:
    """Edges of one kind.

    error: (k, 3); information: (k, 3, 3); residual: (k, 3, s) samples of the residuals after
    solving, whitened; weight: (k,) at the solution, by which information counts.
    """

    error: FloatArray
    information: FloatArray
    residual: FloatArray
    weight: FloatArray

    def shares(self, part: FloatArray) -> tuple[float, float]:
        """Squared error by one component, in units of its variance, and its degrees of freedom.

        part: (k, 3, 3) V, the covariance by the component. With e the error, Ω its information and
        C the covariance of e at the solution: eᵀ Ω V Ω e, and tr(Ω V) - tr(Ω V Ω C).
        """
        root = square_root(self.information)
        whitened_part = root.transpose(0, 2, 1) @ part @ root
        whitened = (root.transpose(0, 2, 1) @ self.error[:, :, None])[:, :, 0]
        energy = self.weight @ np.einsum("ki,kij,kj->k", whitened, whitened_part, whitened)
        trace = self.weight @ np.einsum(
            "kis,kij,kjs->k", self.residual, whitened_part, self.residual
        )
        return float(energy), float(trace) / self.residual.shape[2]


def _energy_and_freedom(
    estimate: Estimate, legs_by_walk: FloatArray, variance: FloatArray, grid: GridHeadings | None
) -> tuple[FloatArray, FloatArray]:
    """(c,) each: squared error of each component in units of its variance, and degrees of
    freedom."""
    legs, sightings, headings = _edges_by_kind(estimate, legs_by_walk.shape[1])
    shares = [legs.shares(variance[k] * legs_by_walk[k]) for k in range(_WALKS)]
    for axes in ((0, 1), (2,)):
        covariance = np.zeros_like(sightings.information)
        for axis in axes:
            covariance[:, axis, axis] = 1.0 / sightings.information[:, axis, axis]
        shares.append(sightings.shares(covariance))
    if grid is not None:
        spread, reading = np.zeros((2, len(headings.error), 3, 3))
        spread[:, 2, 2] = variance[_GRID]
        reading[:, 2, 2] = grid.sigma**2 - variance[_GRID]
        shares.append(headings.shares(spread))
        # Reading errors of branches show in both observations and grid headings.
        shares[_BRANCH] = tuple(np.add(shares[_BRANCH], headings.shares(reading)).tolist())
    energy, freedom = np.array(shares).T
    return energy, freedom


def _edges_by_kind(estimate: Estimate, legs: int) -> tuple[_Edges, _Edges, _Edges]:
    """The edges of an estimate: `legs` of odometry, observations of places, and headings by the
    grid."""
    graph, solution = estimate.graph, estimate.solution
    sampled = SampledMarginals.of(graph, solution, ESTIMATE.samples)
    error = edge_errors(graph, solution.pose, solution.shared)
    edges = _Edges(error, graph.information, sampled.edge_residual, solution.edge_weight)
    headings = _Edges(
        prior_errors(graph, solution.pose),
        graph.priors.information,
        sampled.prior_residual,
        solution.prior_weight,
    )
    sightings = slice(legs, legs + len(estimate.sighting))
    return take(edges, slice(legs)), take(edges, sightings), headings
