"""Alternative closures of a run whose map lies over itself, and the choice among them.

Identifications are made one after the other. A wrong one, or a grid that the building does not
have, causes more wrong ones, and not all of them are taken back. Streets are then in the map twice,
one across the other. Closed loops give a better estimate of the run's noise. With it the run is
closed again, by the same odds, by stricter ones, and without a grid. The closure with the largest
marginal likelihood is chosen (`log_marginal_likelihood`).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..arrays import FloatArray
from ..posegraph.marginals import Marginals
from .branches import ANYWHERE
from .dead_reckoning import DeadReckoning, scale_noise
from .estimate import Estimate, optimise
from .evidence import background
from .incremental import ROUNDS, Closed, closure_without_grid, full_closure, map_state, needed_odds
from .variance_components import PRIOR

_STRIP = 256
"""Corridors that are compared with all others at a time, to bound memory."""

_LN_2PI = float(np.log(2 * np.pi))

_ZERO = 1e-13
"""Eigenvalues of an information matrix below this share of the largest one are rounding errors:
positions to 1 km beside headings to 1 mrad have 1e-12."""


def most_likely_closure(reckoning: DeadReckoning, first: Closed, fitted: DeadReckoning) -> Closed:
    """The most likely closure: `first`, unless many corridors of its map cross and an alternative
    leads by the odds that stricter identifications need, with a map that does not repeat itself.

    reckoning: with the noise before closure; fitted: with the noise estimated from `first`.
    """
    if crossing_share(first) < ROUNDS.most_crossing:
        return first
    strict = ROUNDS.strict_wrong_share
    best, best_odds = first, _log_likelihood(fitted, first)
    best_odds += needed_odds(len(reckoning), strict)
    others = [full_closure(fitted), full_closure(fitted, strict)]
    if any(closed.grid is not None for closed in (first, *others)):
        others.append(closure_without_grid(fitted))
    for other in others:
        odds = _log_likelihood(fitted, other)
        if odds > best_odds and not _repeats(other):
            best, best_odds = other, odds
    if best is first:
        return first
    # Matching uses the noise before closure, as after any other closure.
    return replace(best, reckoning=scale_noise(reckoning, ROUNDS.caution))


def _repeats(closed: Closed) -> bool:
    """Whether a map repeats itself: a closure one lattice step off would explain the run, too."""
    state = map_state(closed.reckoning, closed.place, closed.estimate)
    return state.common.lattice.repeats


def _log_likelihood(fitted: DeadReckoning, closed: Closed) -> float:
    """Log marginal likelihood of a closure's places, with the same noise for all and no grid."""
    estimate = optimise(fitted, closed.place, closed.estimate.pose)
    density = background(fitted, fitted.noise).density
    return log_marginal_likelihood(estimate, density)


def log_marginal_likelihood(estimate: Estimate, density: float) -> float:
    """Log density [nats] of the measurements given their places, up to a constant of the run.

    Different identifications of one run are different models of the same measurements. Their
    marginal likelihoods, with all positions integrated out, compare them (Kass, Raftery: Bayes
    Factors, 1995): more places fit better, and each costs the density at which it might have been
    anywhere. The integral is Laplace's approximation at the solved pose graph (MacKay: Information
    Theory, Inference, and Learning Algorithms, 2003, chapter 27).

    estimate: of the places, without a grid; density: of places per m². With n places of density ρ
    and any heading, factors of information Ω, and the normal matrix H of d unknowns:
    n ln(ρ / 2π) + ½ Σ ln |Ω / 2π| - ½ ln |H / 2π| - ½ f (ln s² + 1), f = Σ rank Ω - d. The level s²
    of the noise is the most likely one, χ² / f, as wrong identifications look like noise; its prior
    counts like `PRIOR.freedom` more measurements that fit the stated noise.
    """
    solution = estimate.solution
    factor = Marginals.of(estimate.graph, solution).factor
    of_measurements, measured_count = _log_density_of_no_error(estimate.graph.information)
    unknowns = factor.pattern.size
    prior_freedom = PRIOR.freedom
    freedom = measured_count - unknowns + prior_freedom
    noise_level = (solution.cost + prior_freedom) / freedom
    of_places = len(estimate.xy) * (np.log(density) - ANYWHERE)
    of_positions = -0.5 * (factor.log_determinant() - unknowns * _LN_2PI)
    return float(
        of_places + of_measurements + of_positions - 0.5 * freedom * (np.log(noise_level) + 1.0)
    )


def _log_density_of_no_error(information: FloatArray) -> tuple[float, int]:
    """½ Σ ln |Ω / 2π| of information matrices Ω (m, 3, 3), and the sum of their ranks."""
    values = np.linalg.eigvalsh(information)
    measured_values = values[values > _ZERO * values[:, -1:]]
    return 0.5 * float((np.log(measured_values) - _LN_2PI).sum()), len(measured_values)


def crossing_share(closed: Closed) -> float:
    """Number of crossings of chords of corridors, per corridor between different places: large in a
    map that lies over itself. O(corridors²)."""
    legs = np.flatnonzero(np.isfinite(closed.reckoning.leg))
    ends = np.sort(np.stack([closed.place[legs], closed.place[legs + 1]], axis=1), axis=1)
    ends = np.unique(ends[ends[:, 0] != ends[:, 1]], axis=0)
    a, b = closed.estimate.xy[ends.T]
    crossings = 0
    for begin in range(0, len(ends), _STRIP):
        strip = slice(begin, begin + _STRIP)
        p, q = a[strip, None], b[strip, None]
        crossing = (_side(p, q, a) * _side(p, q, b) < 0) & (_side(a, b, p) * _side(a, b, q) < 0)
        share_no_place = (ends[strip, None, :, None] != ends[None, :, None, :]).all(axis=(2, 3))
        crossings += int(np.count_nonzero(crossing & share_no_place))
    return crossings / 2 / max(len(ends), 1)


def _side(a: FloatArray, b: FloatArray, p: FloatArray) -> FloatArray:
    """Positive where points p lie to the left of the lines from a to b, negative to the right."""
    u, v = b - a, p - a
    return np.asarray(u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0])
