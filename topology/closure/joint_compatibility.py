"""Identifications that are certain only jointly (joint compatibility).

At the end of a long loop several junctions are revisited, and none is certain by itself. But if one
is correct, all others lie at their expected positions. Neira, Tardós: Data Association in
Stochastic Mapping Using the Joint Compatibility Test (IEEE T-RA 17(6), 2001), here with odds
instead of gates.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ..arrays import BoolArray, FloatArray, IntArray
from ..columns import take
from ..posegraph.marginals import Marginals
from .candidates import Candidates
from .estimate import Estimate
from .evidence import EVIDENCE, Background, among_neighbours, position_odds
from .negative_information import DrivenGround

RIVALS = "sure together with others, but as many that exclude one of them are nearly as sure"


MOST = 30
"""Number of candidates that are considered jointly, the best; the time grows with its cube."""


class Agreement(NamedTuple):
    """Candidates that are jointly certain, or a set that was refused.

    rows: (k,) of the candidates; odds: (k,) log odds [nats] of each given the others, empty if
    refused; reason: of the refusal, empty if they are certain or there is no set.
    """

    rows: IntArray
    odds: FloatArray
    reason: str = ""


NO_AGREEMENT = Agreement(np.zeros(0, np.int64), np.zeros(0))


@dataclass(frozen=True, slots=True, eq=False)
class _JointShifts:
    """Joint Gaussian of the shifts between the two places of each candidate, given those accepted.

    shift: (2 k,) [m]; cov: (2 k, 2 k) [m²] without the noise of the two centres; alike: (k,) log
    odds [nats] of everything but position.
    """

    shift: FloatArray
    cov: FloatArray
    alike: FloatArray
    ground: DrivenGround
    common: Background

    def odds(self) -> FloatArray:
        """(k,) log odds of each candidate [nats]."""
        k = len(self.alike)
        row = np.arange(k)
        blocks = self.cov.reshape(k, 2, k, 2)[row, :, row, :]
        cov = blocks + 2 * self.common.centre_sigma**2 * np.eye(2)
        shift = self.shift.reshape(k, 2)
        odds, _ = position_odds(self.common, shift, cov, self.ground)
        return np.asarray(among_neighbours(self.common, odds, shift, cov) + self.alike)

    def given(self, row: int) -> _JointShifts:
        """The shifts if a candidate is one place: a Kalman update with shift 0."""
        at = slice(2 * row, 2 * row + 2)
        noise = 2 * self.common.centre_sigma**2 * np.eye(2)
        gain = np.linalg.solve(self.cov[at, at] + noise, self.cov[at]).T
        shift = self.shift - gain @ self.shift[at]
        cov = self.cov - gain @ self.cov[at]
        return replace(self, shift=shift, cov=cov)


def jointly_certain(
    estimate: Estimate, found: Candidates, common: Background, *, least_odds: float
) -> Agreement:
    """The candidates that are jointly certain: their joint log odds reach `least_odds` [nats].

    They are refused if another set that excludes one of them is nearly as likely.
    """
    rows = np.sort(np.argsort(-found.total, kind="stable")[:MOST])
    if len(rows) < 2:
        return NO_AGREEMENT
    a, b = found.a[rows], found.b[rows]
    prior = _JointShifts(
        *_shifts(estimate, a, b), found.alike[rows], take(found.ground, rows), common
    )
    shared, excluded = _sharing(a, b)
    # Candidates that share a place are not independent; each set holds one of them.
    sets = [_grow(prior, found.around.support[rows], seed, shared) for seed in range(len(rows))]
    set_odds = np.array([value for value, _ in sets])
    best = int(set_odds.argmax())
    members = np.sort(np.array(sets[best][1]))
    if len(members) < 2 or set_odds[best] < least_odds:
        return NO_AGREEMENT
    rivals = [value for value, other in sets if excluded[np.ix_(members, np.array(other))].any()]
    if set_odds[best] - max(rivals, default=-np.inf) < EVIDENCE.lead:
        return Agreement(rows[members], np.zeros(0), RIVALS)
    odds = [_odds_given(prior, k, members) for k in members.tolist()]
    return Agreement(rows[members], np.array(odds))


def _sharing(a: IntArray, b: IntArray) -> tuple[BoolArray, BoolArray]:
    """(k, k) each: whether two candidates share a place; and whether they also exclude each other.

    "a is b" and "a is c" exclude each other unless "b is c" is a candidate as well.
    """
    shared = (a[:, None] == a) | (b[:, None] == b) | (a[:, None] == b) | (b[:, None] == a)
    candidates = {frozenset(pair) for pair in zip(a.tolist(), b.tolist(), strict=True)}
    excluded = np.zeros_like(shared)
    for i, j in np.argwhere(shared).tolist():
        differing = frozenset((a[i], b[i])) ^ frozenset((a[j], b[j]))
        excluded[i, j] = i != j and differing not in candidates
    return shared, excluded


def _shifts(estimate: Estimate, a: IntArray, b: IntArray) -> tuple[FloatArray, FloatArray]:
    """(2 k,) positions of places a minus those of b [m], and their joint covariance (2 k, 2 k)."""
    nodes, column = np.unique(estimate.node[np.concatenate([a, b])], return_inverse=True)
    n, k = len(nodes), len(a)
    marginals = Marginals.of(estimate.graph, estimate.solution)
    first, second = np.divmod(np.arange(n * n), n)
    _, _, cross = marginals.joint(nodes[first], nodes[second])
    full = cross[:, :2, :2].reshape(n, n, 2, 2).transpose(0, 2, 1, 3).reshape(2 * n, 2 * n)
    difference = np.zeros((2 * k, 2 * n))
    for axis in (0, 1):
        difference[2 * np.arange(k) + axis, 2 * column[:k] + axis] = 1.0
        difference[2 * np.arange(k) + axis, 2 * column[k:] + axis] -= 1.0
    return (estimate.xy[a] - estimate.xy[b]).ravel(), difference @ full @ difference.T


def _grow(
    prior: _JointShifts, support: FloatArray, seed: int, shared: BoolArray
) -> tuple[float, list[int]]:
    """Joint log odds of the set that grows greedily from candidate `seed`, and its members. The
    next one is the most likely candidate that shares no place with a member (shared: (k, k)).

    support: (k,) part of the odds by the corridors around. It counts once, for the seed, because
    the members have these corridors in common.
    """
    total_odds, members, shifts = float(prior.odds()[seed]), [seed], prior.given(seed)
    allowed = ~shared[seed]
    while allowed.any():
        odds = np.where(allowed, shifts.odds() - support, -np.inf)
        best = int(odds.argmax())
        if odds[best] < EVIDENCE.lead:
            break
        total_odds += float(odds[best])
        members.append(best)
        allowed &= ~shared[best]
        shifts = shifts.given(best)
    return total_odds, members


def _odds_given(prior: _JointShifts, row: int, members: IntArray) -> float:
    """Log odds of one member given that all others are true [nats]."""
    shifts = prior
    for other in members.tolist():
        if other != row:
            shifts = shifts.given(other)
    return float(shifts.odds()[row])
