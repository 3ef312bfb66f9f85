"""Evidence that two places are one, in natural log odds: position, branches, corridors.

Every term compares "the same place" with "another place of this run", so that what is common in a
run is worth little.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.special import chndtr

from ..topomap import RunNoise
from .dead_reckoning import Walk
from .lattice import Pattern, PatternSettings, no_pattern, pattern_of, squared_mahalanobis
from .places import Places

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
Float = TypeVar("Float", np.float32, np.float64)

_STRIP = 64
"""Places whose rarity is worked out at once."""
MATCH_RAD = 0.61
"""Branches farther apart than this are never the same."""

SURE = 6.0
"""Standard deviations beyond which nothing is looked for."""

UNKNOWN = 0.1
"""Share of places whose branches look like those of no other place of the run."""

GATE = 3.5
"""Standard deviations beyond which two readings are not of one thing: one in 2,000 that are."""

BIN_M = 0.25
"""Width of the bins of leg lengths: about what two measurements of one leg differ by."""

SAME_TURN_RAD = 0.3
"""Turns nearer to each other than this pair the same branches."""


@dataclass(frozen=True, slots=True)
class EvidenceSettings:
    """Rates and widths that the noise of a run does not tell."""

    core_share: float = 0.8
    """Two junctions are seldom nearer to each other than this share of the shortest corridors."""
    core_quantile: float = 0.03
    core_exception: float = 0.02
    """… "seldom": how often they are all the same."""
    least_rate: float = 0.02
    """Branch faults and missed junctions are never taken to be rarer than this."""
    inflation: float = 1.2
    """Widths of the noise are taken this much larger than estimated."""
    bandwidth_rad: float = 0.12
    """Width of the kernels that say how common a set of branches is in this run."""
    references: int = 100
    """Places that stand for the run when asking how common a set of branches is."""
    pattern: PatternSettings = field(default_factory=PatternSettings)


@dataclass(frozen=True, slots=True, eq=False)
class Background:
    """What is common in a run.

    leg_m: typical length of a leg. core_m: radius within which no other junction is expected.
    length_edges, length_density: histogram of leg lengths [1/m]. pattern: where other junctions
    stand around a junction.
    """

    leg_m: float
    core_m: float
    length_edges: FloatArray
    length_density: FloatArray
    branch_sigma: float
    centre_sigma: float
    fault_rate: float
    miss_rate: float
    pattern: Pattern = field(default_factory=no_pattern)

    @property
    def density(self) -> float:
        """Places per m²: each is the middle of a cell about as wide as a typical leg."""
        return 1.0 / self.leg_m**2


def background(
    walk: Walk, noise: RunNoise, settings: EvidenceSettings = EvidenceSettings()
) -> Background:
    """Statistics of a run that evidence is measured against; `noise` as far as it is known."""
    legs = walk.leg[np.isfinite(walk.leg)]
    # Chords: a leg that turns back or winds says nothing about how close junctions lie.
    chord = np.hypot(*np.diff(walk.passes.centre, axis=0).T)
    chord = chord[np.isfinite(walk.leg)]
    moved = chord[chord > 0.8]
    shortest = float(np.quantile(moved, settings.core_quantile)) if len(moved) else 1.0
    core_m = settings.core_share * shortest
    typical = float(np.median(legs)) if len(legs) else 5.0
    edges = np.arange(0.0, max(4 * typical, 20.0) + BIN_M, BIN_M)
    counts = np.histogram(legs, edges)[0].astype(np.float64)
    smooth = np.convolve(counts, [0.1, 0.2, 0.4, 0.2, 0.1], mode="same") + 0.02
    density = smooth / (smooth.sum() * BIN_M)
    return Background(
        # Most legs of a robot that stands are of no length.
        leg_m=max(typical, core_m),
        core_m=core_m,
        length_edges=edges,
        length_density=density,
        branch_sigma=settings.inflation * noise.branch_rad,
        centre_sigma=settings.inflation * noise.centre_m,
        fault_rate=max(noise.branch_fault_rate, settings.least_rate),
        miss_rate=max(noise.miss_rate, settings.least_rate),
    )


def with_pattern(
    common: Background, places: Places, xy: FloatArray, settings: EvidenceSettings
) -> Background:
    """The background with what a map of so many places, at `xy` (n, 2), says of neighbours."""
    found = pattern_of(
        places, xy, core_m=common.core_m, typical_m=common.leg_m, settings=settings.pattern
    )
    return replace(common, pattern=found)


def position_odds(
    common: Background, shift: FloatArray, cov: FloatArray, settings: EvidenceSettings
) -> tuple[FloatArray, FloatArray]:
    """(k,) log odds of being apart by `shift` (k, 2) with covariance `cov` (k, 2, 2), and d².

    Against another junction, which would stand anywhere but within the core around this one.
    """
    x, y = shift.T
    d2, det = squared_mahalanobis(x, y, cov)
    s2 = np.sqrt(det)
    inside = chndtr(common.core_m**2 / s2, 2.0, np.minimum((x * x + y * y) / s2, 1e6))
    # Exceptions within the core are doors side by side, not one upon the other.
    apart = np.minimum((x * x + y * y + 2 * s2) / common.core_m**2, 1.0)
    rival = common.density * np.maximum(1.0 - inside, settings.core_exception * apart)
    odds = -0.5 * d2 - np.log(2 * np.pi * s2) - np.log(rival)
    return odds, d2


def among_neighbours(
    common: Background, odds: FloatArray, shift: FloatArray, cov: FloatArray
) -> FloatArray:
    """(k,) `odds` of `position_odds`, if the other junction may also stand where in this map
    junctions have their neighbours."""
    if not common.pattern.repeats:
        return odds
    # Neighbours are beyond the core: what is known much better than that cannot be one.
    room = common.core_m - np.hypot(*shift.T)
    vague = np.flatnonzero(room**2 < SURE**2 * (cov[:, 0, 0] + cov[:, 1, 1]))
    shift, cov = shift[vague], cov[vague]
    d2, det = squared_mahalanobis(shift[:, 0], shift[:, 1], cov)
    density = np.maximum(common.pattern.density(shift, cov), np.finfo(np.float64).tiny)
    out = odds.copy()
    against = -0.5 * d2 - np.log(2 * np.pi * np.sqrt(det)) - np.log(density)
    out[vague] = np.minimum(odds[vague], against)
    return out


def best_position_odds(
    common: Background, shift: FloatArray, settings: EvidenceSettings
) -> FloatArray:
    """(k,) what `position_odds` could be at most, whatever the covariance."""
    s2 = np.maximum(0.5 * (shift**2).sum(axis=1), 2 * common.centre_sigma**2)
    odds, _ = position_odds(common, shift, s2[:, None, None] * np.eye(2), settings)
    return odds


def length_odds(common: Background, a: FloatArray, b: FloatArray, var: FloatArray) -> FloatArray:
    """(k,) log odds that two legs of lengths a and b are one corridor."""
    at = np.searchsorted(common.length_edges, 0.5 * (a + b)) - 1
    density = common.length_density[np.clip(at, 0, len(common.length_density) - 1)]
    odds: FloatArray = -0.5 * (a - b) ** 2 / var - 0.5 * np.log(2 * np.pi * var) - np.log(density)
    return odds


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """How the branches of two places fit: log likelihood of b's given a's, and the turn used.

    partner: (k, s) slot of b that each slot of a matches, -1 for none. turn: (k,) [rad] to be
    added to b's headings to meet a's. extra: (k,) branches of either left over.
    """

    score: FloatArray
    turn: FloatArray
    partner: IntArray
    extra: FloatArray


def align(
    places: Places,
    common: Background,
    a: IntArray,
    b: IntArray,
    *,
    turn_sigma: FloatArray,
    turn_mean: FloatArray | None = None,
) -> Alignment:
    """Compare the branches of places a and b (k,), which may be turned by N(mean, sigma).

    All pairs at once: every difference of a branch of a and one of b is tried as the turn; the one
    that explains most wins.
    """
    ha, hb = places.heading[a], places.heading[b]
    k, s = ha.shape
    mean = np.zeros(k) if turn_mean is None else turn_mean
    sigma = np.maximum(turn_sigma, 1e-3)
    off = _wrapped(ha[:, :, None] - hb[:, None, :] - mean[:, None, None])  # (k, s, s)
    found = (np.full(k, -np.inf), np.zeros(k), np.full((k, s), -1, np.int64), np.zeros(k))
    for rows, trial in _trials(off.reshape(k, s * s), np.hypot(sigma, 1.5 * common.branch_sigma)):
        score, turn, partner, extra = _match(
            places, common, a[rows], b[rows], off=off[rows], trial=trial, sigma=sigma[rows]
        )
        better = score > found[0][rows]
        hit = rows[better]
        found[0][hit], found[1][hit] = score[better], turn[better] + mean[hit]
        found[2][hit], found[3][hit] = partner[better], extra[better]
    return Alignment(*found)


def _wrapped(angle: NDArray[Float]) -> NDArray[Float]:
    """Angles in [-pi, pi]; twice as fast as `wrap`, which this module would spend its time in."""
    turns = np.rint(angle * (0.5 / np.pi))
    return np.asarray(angle - 2 * np.pi * turns, angle.dtype)


def _trials(off: FloatArray, sigma: FloatArray) -> Iterator[tuple[IntArray, FloatArray]]:
    """Turns to try: (rows, turn of each row), the smallest turns first, no two of a row alike.

    off: (k, m) differences of branches, NaN where there is none; sigma: (k,) of the turn.
    """
    size = np.where(np.isfinite(off), np.abs(off), np.inf)
    rows = np.flatnonzero(size.min(axis=1) < GATE * sigma)
    off, size, limit = off[rows], size[rows], GATE * sigma[rows]
    for _ in range(6):
        if len(rows) == 0:
            return
        at = size.argmin(axis=1)
        trial = off[np.arange(len(rows)), at]
        yield rows, trial
        # Differences near this one lead to the same pairs.
        size = np.where(np.abs(off - trial[:, None]) < SAME_TURN_RAD, np.inf, size)
        keep = size.min(axis=1) < limit
        rows, off, size, limit = rows[keep], off[keep], size[keep], limit[keep]


def _match(
    places: Places,
    common: Background,
    a: IntArray,
    b: IntArray,
    *,
    off: FloatArray,
    trial: FloatArray,
    sigma: FloatArray,
) -> tuple[FloatArray, FloatArray, IntArray, FloatArray]:
    """Mutual nearest branches after a trial turn, then the turn and score that they say."""
    residual = _wrapped(off - trial[:, None, None])
    rest = np.abs(residual)
    rest = np.where(np.isfinite(rest), rest, np.inf)
    tolerance = min(max(GATE * 1.5 * common.branch_sigma, 0.2), MATCH_RAD)
    near = rest < tolerance
    near &= (rest == rest.min(axis=2, keepdims=True)) & (rest == rest.min(axis=1, keepdims=True))
    has_a, has_b = near.any(axis=2), near.any(axis=1)
    partner = np.where(has_a, near.argmax(axis=2), -1)
    residual = np.where(near, residual, 0.0)
    pairs = near.sum(axis=(1, 2))
    # Turn: mean of what the pairs say, held towards 0 by its own sigma.
    var_pair = 2 * common.branch_sigma**2
    mean = residual.sum(axis=(1, 2)) / np.maximum(pairs, 1) + trial
    weight = pairs / var_pair
    turn = mean * weight / (weight + sigma**-2)
    # Σ (residual + trial - turn)² over the pairs, without another pass over the table.
    rest_turn = trial - turn
    spread = (residual**2).sum(axis=(1, 2)) + 2 * rest_turn * residual.sum(axis=(1, 2))
    spread += pairs * rest_turn**2
    score = -0.5 * spread / var_pair - 0.5 * turn**2 / sigma**2
    score -= 0.5 * pairs * np.log(var_pair / (2 * np.pi))  # against uniform headings
    # A branch that one place has and the other not: a fault, unless it is itself uncertain.
    lone_a = np.where(has_a, 0.0, _sureness(places, a))
    lone_b = np.where(has_b, 0.0, _sureness(places, b))
    extra = lone_a.sum(axis=1) + lone_b.sum(axis=1)
    score += extra * np.log(common.fault_rate)
    return score, turn, partner, extra


def _sureness(places: Places, rows: IntArray) -> FloatArray:
    """(k, s) how much it means that another look lacks the branch: 0 for what few passes saw, and
    less for places whose branches are not sure."""
    share, visits = places.share[rows], places.visits[rows]
    sure: FloatArray = np.where(visits[:, None] > 1, np.clip(2 * share - 0.6, 0, 1), share > 0)
    sure = sure * places.confidence[rows, None]
    return np.where(np.isfinite(places.heading[rows]), sure, 0.0)


def rarity(places: Places, common: Background, settings: EvidenceSettings) -> FloatArray:
    """(n,) log likelihood of each place's branches at some other place of this run.

    Mean over a fixed sample of places of what `align` says without any turn, plus a floor for sets
    of branches seen nowhere else. O(n · references).
    """
    n = len(places)
    step = max(1, n // settings.references)
    sample = np.arange(0, n, step)
    out = np.empty(n)
    wide = settings.bandwidth_rad**2 + 2 * common.branch_sigma**2
    # Slots come first and few places at a time: reductions over a short last axis, and tables that
    # the processor cannot keep at hand, cost most. Odds need no more than single precision.
    heading = places.heading.T.astype(np.float32)
    sure = _sureness(places, np.arange(n)).T.astype(np.float32)
    there, sure_there = heading[:, sample], sure[:, sample]
    for begin in range(0, n, _STRIP):
        rows = np.arange(begin, min(begin + _STRIP, n))
        off = np.abs(_wrapped(heading[:, None, rows, None] - there[None, :, None, :]))
        near = np.fmin.reduce(off, axis=1)
        paired = near < MATCH_RAD
        back = ~(np.fmin.reduce(off, axis=0) < MATCH_RAD)
        lone = (sure[:, rows, None] * ~paired).sum(axis=0)
        lone += (sure_there[:, None, :] * back).sum(axis=0)
        score = -0.5 * np.square(np.where(paired, near, 0.0)).sum(axis=0) / wide
        score -= 0.5 * paired.sum(axis=0) * np.log(wide / (2 * np.pi))
        score += lone * np.log(common.fault_rate)
        score[rows[:, None] == sample[None, :]] = -np.inf
        top = np.maximum(score.max(axis=1), 0.0)
        mean = np.exp(score - top[:, None]).sum(axis=1) / max(len(sample) - 1, 1)
        out[rows] = np.log((1.0 - UNKNOWN) * mean + UNKNOWN * np.exp(-top)) + top
    return out
