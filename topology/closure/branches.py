"""Evidence [nats] from the branches of two places that they are one place.

The terms are those of `matching/branches.py`. Unlike two maps, two places of one run share a frame
up to the error of dead reckoning. Therefore the rotation between them has a prior, the null model
of a single branch is uniform, and the null model of a set of branches is its frequency in this run,
directions included.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..arrays import ComplexArray, FloatArray, IntArray
from ..matching.branches import (
    COS_GATE,
    BranchPairs,
    agreement_odds,
    missing_odds,
    mutual_nearest,
    unit_headings,
)
from ..matching.likelihood import LIKELIHOOD, log_density
from .evidence import EVIDENCE, Background
from .places import Places

ANYWHERE = float(np.log(2 * np.pi))
"""-ln density [1/rad] of a uniformly distributed heading."""


@dataclass(frozen=True, slots=True, eq=False)
class Branches:
    """The branches of n places with up to s branches each.

    unit: (n, s) headings as unit complex numbers, 0 where there is no branch; lack: (n, s) evidence
    [nats] if the other place lacks the branch; common: (n,) log likelihood of each place's branches
    at another place of this run (null model); variance: of the difference of two readings of a
    branch [rad²].
    """

    unit: ComplexArray
    lack: FloatArray
    common: FloatArray
    variance: float


def branches_of(places: Places, common: Background) -> Branches:
    """The branches of all places. O(n · references)."""
    unit = unit_headings(places.heading)
    # Log rate at which a pass lacks the branch: as among the passes by this place, or by a fault.
    seldom = np.log(np.maximum(1.0 - places.share, common.fault_rate))
    lack = np.where(unit != 0, seldom * places.confidence[:, None], 0.0)
    variance = 2 * common.branch_sigma**2
    return Branches(unit, lack, _null_log_likelihood(unit, lack, variance), variance)


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """The best alignment of the branches of k pairs of places.

    odds: (k,) log likelihood ratio [nats], one place against any two; turn: (k,) rotation of b's
    headings that aligns them with a's [rad]; partner: (k, s) slot of b that each slot of a matches,
    -1 for none.
    """

    odds: FloatArray
    turn: FloatArray
    partner: IntArray


def align(
    branches: Branches,
    a: IntArray,
    b: IntArray,
    *,
    turn_sigma: FloatArray,
    turn_mean: FloatArray | None = None,
) -> Alignment:
    """Align the branches of places a and b (k,), whose rotation has the prior N(turn_mean,
    turn_sigma²) [rad].

    All pairs at once: every difference between a branch of a and one of b is tried as the rotation;
    the one with the largest likelihood wins.
    """
    k, s = len(a), branches.unit.shape[1]
    # The rotation of a standing robot has no variance.
    turn_sigma = np.maximum(turn_sigma, 1e-6)
    mean = np.zeros(k) if turn_mean is None else turn_mean
    unit_a, unit_b = branches.unit[a], branches.unit[b] * np.exp(1j * mean)[:, None]
    lack_a, lack_b = branches.lack[a], branches.lack[b]
    score, turn = np.full(k, -np.inf), np.zeros(k)
    partner = np.full((k, s), -1, np.int64)
    between = (unit_a[:, :, None] * unit_b.conj()[:, None, :]).reshape(k, s * s)
    reach = LIKELIHOOD.gate_sigmas * np.sqrt(turn_sigma**2 + branches.variance)
    for rows, trial in _trials(between, reach):
        turned_a, turned_b = unit_a[rows], unit_b[rows] * trial[:, None]
        pairs = mutual_nearest(turned_a, turned_b)
        rest = turned_a * np.take_along_axis(turned_b, pairs.nearest, axis=1).conj()
        odds, fitted = _best_turn(pairs, rest, trial, turn_sigma[rows], branches.variance)
        odds += missing_odds(pairs, lack_a[rows], lack_b[rows])
        better = odds > score[rows]
        improved = rows[better]
        score[improved], turn[improved] = odds[better], fitted[better] + mean[improved]
        partner[improved] = np.where(pairs.paired, pairs.nearest, -1)[better]
    return Alignment(score - np.maximum(branches.common[a], branches.common[b]), turn, partner)


def _trials(between: ComplexArray, reach: FloatArray) -> Iterator[tuple[IntArray, ComplexArray]]:
    """Yield rotations to try, by increasing angle: (rows, one unit complex number for each row).

    between: (k, m) rotations from branches of b to branches of a, as unit complex numbers, 0 for no
    branch; reach: (k,) largest angle [rad]. Rotations near one already tried are left out.
    """
    cosine = np.where(between != 0, between.real, -np.inf)
    limit = np.cos(np.minimum(reach, np.pi))
    rows = np.arange(len(between))
    while True:
        best = cosine.argmax(axis=1)
        within = cosine[np.arange(len(rows)), best] > limit
        rows, between, cosine, limit, best = (
            x[within] for x in (rows, between, cosine, limit, best)
        )
        if len(rows) == 0:
            return
        trial = between[np.arange(len(rows)), best]
        yield rows, trial
        # Rotations near this one give the same pairs.
        cosine[(between * trial.conj()[:, None]).real > COS_GATE] = -np.inf


def _best_turn(
    pairs: BranchPairs, rest: ComplexArray, trial: ComplexArray, sigma: FloatArray, variance: float
) -> tuple[FloatArray, FloatArray]:
    """(k,) log likelihood ratio of the paired branches at the most likely rotation, and this
    rotation [rad]: the mean over the pairs, with the prior N(0, sigma²).

    rest: (k, s) rotation of each pair after `trial`, as unit numbers.
    """
    rest = np.where(pairs.paired, rest, 0.0)
    weight = pairs.paired.sum(axis=1) / variance
    turn = (np.angle(trial) + np.angle(rest.sum(axis=1))) * weight / (weight + sigma**-2)
    cosine = (rest * (trial * np.exp(-1j * turn))[:, None]).real
    fitted = BranchPairs(pairs.paired, pairs.nearest, 2 - 2 * cosine)
    odds = agreement_odds(fitted, np.array([variance]), ANYWHERE)
    return odds - 0.5 * (turn / sigma) ** 2, turn


def _null_log_likelihood(unit: ComplexArray, lack: FloatArray, variance: float) -> FloatArray:
    """(n,) log likelihood of each place's branches at another place of this run.

    A kernel density estimate: the mean, over a fixed sample of places, of the likelihood of these
    branches there, without rotation; mixed with a share `outlier_share` for unique ones.
    """
    n = len(unit)
    sample = np.arange(0, n, max(1, n // EVIDENCE.references))
    kernel_variance = np.array([EVIDENCE.bandwidth_rad**2 + variance], np.float32)
    # Slots come first, and few places at a time: reductions over a short last axis and tables
    # larger than the cache are slow. Single precision suffices for odds.
    x, y = unit.real.T.astype(np.float32), unit.imag.T.astype(np.float32)
    cost = lack.T.astype(np.float32)
    log_likelihood = np.empty(n)
    for begin in range(0, n, EVIDENCE.references):
        rows = slice(begin, begin + EVIDENCE.references)
        cosine = x[:, None, rows, None] * x[None, :, None, sample]
        cosine += y[:, None, rows, None] * y[None, :, None, sample]
        nearest_b, nearest_a = cosine.max(axis=1), cosine.max(axis=0)
        odds = log_density((2 - 2 * nearest_b) / kernel_variance, kernel_variance) + ANYWHERE
        odds = np.where(nearest_b > COS_GATE, odds, cost[:, rows, None]).sum(axis=0)
        odds += np.where(nearest_a > COS_GATE, 0.0, cost[:, None, sample]).sum(axis=0)
        odds[np.arange(n)[rows, None] == sample] = -np.inf
        top = np.maximum(odds.max(axis=1), 0.0)
        mean = np.exp(odds - top[:, None]).sum(axis=1) / max(len(sample) - 1, 1)
        rare = LIKELIHOOD.outlier_share
        log_likelihood[rows] = np.log((1 - rare) * mean + rare * np.exp(-top)) + top
    return log_likelihood
