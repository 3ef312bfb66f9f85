"""Closing a run again where its map lies over itself, and which closure stands.

Identifications are made one after the other. A wrong one, or a grid that is none, leads later ones
astray, and not all of them are taken back: streets then stand twice, one across the other. Closed
loops tell the noise of the run better than was known before. With it the run is closed again, by
the same odds, by stricter ones, and without a grid; of all these closures the one that explains the
run best stands (`marginal_likelihood.py`).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..arrays import FloatArray
from .dead_reckoning import DeadReckoning, scale_noise
from .estimate import optimise
from .evidence import background
from .incremental import Closed, RoundSettings, closure_without_grid, full_closure, map_state
from .marginal_likelihood import log_marginal_likelihood

_STRIP = 256
"""Corridors that are compared with all others at once, to bound memory."""


def most_likely_closure(
    reckoning: DeadReckoning,
    first: Closed,
    fitted: DeadReckoning,
    settings: RoundSettings,
) -> Closed:
    """The closure that explains the run best: `first`, unless many corridors of its map cross and
    another one leads by the odds that identifications need by stricter rules, on a map that does
    not repeat itself.

    reckoning: with the noise known before closure; fitted: with that shown by `first`.
    """
    if crossing_share(first) < settings.most_crossing:
        return first
    strict = replace(settings, wrong_share=settings.strict_wrong_share)
    best, best_odds = first, _log_likelihood(fitted, first, settings)
    best_odds += strict.least_odds(len(reckoning))
    others = [full_closure(fitted, settings), full_closure(fitted, strict)]
    if any(closed.grid is not None for closed in (first, *others)):
        others.append(closure_without_grid(fitted, settings))
    for other in others:
        odds = _log_likelihood(fitted, other, settings)
        if odds > best_odds and not _repeats(other, settings):
            best, best_odds = other, odds
    if best is first:
        return first
    # Matching counts with the noise known before closure, as after any other closure.
    return replace(best, reckoning=scale_noise(reckoning, settings.caution))


def _repeats(closed: Closed, settings: RoundSettings) -> bool:
    """Whether a map repeats itself: then a closure one step of its pattern off explains the run as
    well, and is not among those compared."""
    state = map_state(closed.reckoning, closed.place, closed.estimate, settings)
    return state.common.lattice.repeats


def _log_likelihood(fitted: DeadReckoning, closed: Closed, settings: RoundSettings) -> float:
    """Log marginal likelihood of a closure's places, all with one noise and without a grid, which
    not all of them have."""
    estimate = optimise(fitted, closed.place, closed.estimate.pose, settings=settings.estimate)
    density = background(fitted, fitted.noise, settings.candidates.evidence).density
    return log_marginal_likelihood(estimate, density)


def crossing_share(closed: Closed) -> float:
    """How many corridors between different places cross each other as the crow flies, beside the
    number of corridors: many in a map that lies over itself. O(corridors²)."""
    legs = np.flatnonzero(np.isfinite(closed.reckoning.leg))
    ends = np.sort(np.stack([closed.place[legs], closed.place[legs + 1]], axis=1), axis=1)
    ends = np.unique(ends[ends[:, 0] != ends[:, 1]], axis=0)
    a, b = closed.estimate.xy[ends.T]
    both_ways = 0
    for begin in range(0, len(ends), _STRIP):
        some = slice(begin, begin + _STRIP)
        p, q = a[some, None], b[some, None]
        crossing = (_side(p, q, a) * _side(p, q, b) < 0) & (_side(a, b, p) * _side(a, b, q) < 0)
        apart = (ends[some, None, :, None] != ends[None, :, None, :]).all(axis=(2, 3))
        both_ways += int(np.count_nonzero(crossing & apart))
    return both_ways / 2 / max(len(ends), 1)


def _side(a: FloatArray, b: FloatArray, p: FloatArray) -> FloatArray:
    """Positive where points p lie to the left of the lines from a to b, negative to the right."""
    u, v = b - a, p - a
    out: FloatArray = u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]
    return out
