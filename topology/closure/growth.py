"""Growth (§2.2) of the map against itself: evidence from the corridors around two places.

If two places are one, the corridors that leave them by the same branches are the same corridors,
and lead to places that are the same again. All hypotheses grow in parallel, hop by hop, in arrays.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import BoolArray, FloatArray, IntArray
from ..columns import take
from ..matching.likelihood import LIKELIHOOD
from ..se2 import turned
from .branches import Alignment, Branches, align
from .dead_reckoning import DeadReckoning
from .evidence import Background, length_odds
from .places import NOWHERE, ONE_WAY_RAD, Places


@dataclass(frozen=True, slots=True)
class GrowthSettings:
    """How far hypotheses grow and how steps count."""

    hops: int = 4
    discount: float = 0.85
    """Weight of each hop relative to the one before: legs are not independent of each other. Tried:
    with 1 a run on tiles is closed wrongly under three times the noise."""
    leg_cap: float = LIKELIHOOD.most
    """Bound on the evidence of one pair of legs [nats]."""
    branch_cap: float = LIKELIHOOD.most
    """Bound on the evidence of the branches at their far ends [nats]."""
    wobble_m: float = 0.08
    """1 sigma of the length driven through one corridor [m]. Tried: with 0 rows close less
    often."""
    line_m: float = LIKELIHOOD.gate_m
    """Tolerance within which legs begin and end at the same two lines [m]."""
    beside: int = 4
    """Number of gaps on either side, sorted by their middles, that a gap is compared with: few have
    their middle in one place."""


@dataclass(frozen=True, slots=True, eq=False)
class MapState:
    """The state of the map: places, their positions xy (n, 2) [m] and branches, and the run's
    statistics."""

    reckoning: DeadReckoning
    places: Places
    xy: FloatArray
    common: Background
    branches: Branches


@dataclass(frozen=True, slots=True, eq=False)
class Support:
    """Evidence [nats] of the surroundings of each hypothesis.

    gain: (k,) from corridors that agree; loss: (k,) positive, from those that disagree.
    """

    gain: FloatArray
    loss: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class _Front:
    """Pairs of places that hypotheses have reached: a and b, with b's branches rotated by `turn`
    [rad]."""

    hypothesis: IntArray
    a: IntArray
    b: IntArray
    turn: FloatArray
    partner: IntArray


@dataclass(frozen=True, slots=True, eq=False)
class _Reached:
    """Pairs of legs: the pair of places that they leave (`row` of the front), the pair of places
    qa, qb and slots ea, eb that they reach, and their lengths la, lb [m]."""

    row: IntArray
    qa: IntArray
    qb: IntArray
    ea: IntArray
    eb: IntArray
    la: FloatArray
    lb: FloatArray


def grow(
    state: MapState,
    a: IntArray,
    b: IntArray,
    aligned: Alignment,
    settings: GrowthSettings = GrowthSettings(),
) -> Support:
    """Support of the hypotheses "place a[k] is place b[k]", grown over `settings.hops`
    corridors."""
    places, common = state.places, state.common
    k = len(a)
    gain, loss = np.zeros(k), np.zeros(k)
    front = _Front(np.arange(k), a, b, aligned.turn, aligned.partner)
    seen = _keys(front.hypothesis, a, b, len(places))
    gaps = _Gaps(k, settings)
    weight, miss = 1.0, float(np.log(common.miss_rate))
    turn_sigma = float(np.sqrt(state.branches.variance))
    for _ in range(settings.hops):
        pairs = _leave(places, front)
        if len(pairs.row) == 0:
            break
        agree = _agree(state, front, pairs, settings)
        loss += weight * -miss * np.bincount(front.hypothesis[pairs.row[~agree]], minlength=k)
        reached = take(pairs, agree)
        h = front.hypothesis[reached.row]
        var = _leg_variance(state, reached.la, reached.lb, settings)
        odds = np.clip(length_odds(common, reached.la, reached.lb, var), 0.0, settings.leg_cap)
        odds[gaps.known(h, state.xy[front.a[reached.row]], state.xy[reached.qa])] = 0.0
        same = reached.qa == reached.qb
        # Both legs end at one place: by one branch they agree, by two branches they disagree.
        odds = np.where(same, np.where(reached.ea == reached.eb, odds - miss, miss), odds)
        further = np.flatnonzero(~same)
        ends = align(
            state.branches,
            reached.qa[further],
            reached.qb[further],
            turn_sigma=np.full(len(further), turn_sigma),
            turn_mean=front.turn[reached.row[further]],
        )
        fit = ends.odds
        odds[further] += np.clip(fit, 2 * miss, settings.branch_cap)
        gain += weight * np.bincount(h, np.maximum(odds, 0.0), minlength=k)
        loss += weight * np.bincount(h, np.maximum(-odds, 0.0), minlength=k)
        good = fit > 0.5 * miss
        next_ = further[good]
        keys = _keys(h[next_], reached.qa[next_], reached.qb[next_], len(places))
        fresh, at = np.unique(keys, return_index=True)
        at = at[~np.isin(fresh, seen)]
        seen = np.concatenate([seen, keys[at]])
        pick = next_[at]
        front = _Front(
            h[pick],
            reached.qa[pick],
            reached.qb[pick],
            front.turn[reached.row[pick]],
            ends.partner[np.flatnonzero(good)[at]],
        )
        weight *= settings.discount
    return Support(gain, loss)


class _Gaps:
    """Gaps between parallel lines that the legs of each hypothesis have spanned so far.

    Blocks between the same two streets are equally long, so that of parallel legs between the same
    two lines only the first counts by its length. As independent evidence they would support the
    place one street further as well.
    """

    def __init__(self, hypotheses: int, settings: GrowthSettings) -> None:
        self._axis = np.full(hypotheses, np.nan)
        self._settings = settings
        self._spans = np.zeros((0, 3))

    def known(self, hypothesis: IntArray, begin: FloatArray, end: FloatArray) -> BoolArray:
        """(m,) whether a leg from `begin` to `end` (m, 2) [m] spans a gap that was spanned before.

        Lines run along the first leg of a hypothesis or across it; other legs span no gap.
        """
        way = np.arctan2(*(end - begin).T[::-1])
        new, first = np.unique(hypothesis, return_index=True)
        first = first[np.isnan(self._axis[new])]
        self._axis[hypothesis[first]] = way[first]
        axis = self._axis[hypothesis]
        quarter = np.round((way - axis) / (np.pi / 2))
        across = axis + quarter % 2 * (np.pi / 2)
        line = np.stack([np.cos(across), np.sin(across)], axis=1)
        low, high = np.sort([(begin * line).sum(axis=1), (end * line).sum(axis=1)], axis=0)
        aslant = np.abs(way - axis - quarter * (np.pi / 2)) > ONE_WAY_RAD
        key = np.where(aslant, -1.0, 2.0 * hypothesis + quarter % 2)
        met = len(self._spans)
        spans = np.concatenate([self._spans, np.stack([key, low + high, high - low], axis=1)])
        self._spans = spans
        order = np.lexsort((spans[:, 1], spans[:, 0]))
        again = np.zeros(len(spans), bool)
        for k in range(1, min(self._settings.beside, len(spans) - 1) + 1):
            i, j = np.minimum(order[k:], order[:-k]), np.maximum(order[k:], order[:-k])
            off = np.abs(spans[i] - spans[j])
            same = (off[:, 0] == 0) & (spans[i, 0] >= 0)
            near = (off[:, 1] < 2 * self._settings.line_m) & (off[:, 2] < self._settings.line_m)
            again[j[same & near]] = True
        return again[met:]


def _keys(hypothesis: IntArray, a: IntArray, b: IntArray, n: int) -> IntArray:
    low, high = np.minimum(a, b), np.maximum(a, b)
    return (hypothesis * n + low) * n + high


def _leave(places: Places, front: _Front) -> _Reached:
    """All pairs of matching branches of the front that were both driven."""
    row, slot_a = np.nonzero(front.partner >= 0)
    slot_b = front.partner[row, slot_a]
    pa, pb = front.a[row], front.b[row]
    qa, qb = places.next_place[pa, slot_a], places.next_place[pb, slot_b]
    ea, eb = places.next_slot[pa, slot_a], places.next_slot[pb, slot_b]
    # The same leg seen from both of its ends, or twice from one place, is no evidence.
    own = (qa == pb) & (qb == pa) & (ea == slot_b) & (eb == slot_a)
    use = (qa != NOWHERE) & (qb != NOWHERE) & ~own & (pa != pb)
    la, lb = places.length[pa, slot_a], places.length[pb, slot_b]
    return _Reached(row[use], qa[use], qb[use], ea[use], eb[use], la[use], lb[use])


def _agree(state: MapState, front: _Front, pairs: _Reached, settings: GrowthSettings) -> BoolArray:
    """(m,) whether lengths are equal, and ends coincide if the two places do, within the gate."""
    var = _leg_variance(state, pairs.la, pairs.lb, settings)
    near = np.abs(pairs.la - pairs.lb) < LIKELIHOOD.gate_sigmas * np.sqrt(var)
    da = state.xy[pairs.qa] - state.xy[front.a[pairs.row]]
    db = state.xy[pairs.qb] - state.xy[front.b[pairs.row]]
    x, y = (da - turned(db, front.turn[pairs.row])).T
    room = LIKELIHOOD.gate_sigmas * np.sqrt(var + state.branches.variance * pairs.la**2)
    result: BoolArray = near & (np.hypot(x, y) < room)
    return result


def _leg_variance(
    state: MapState, la: FloatArray, lb: FloatArray, settings: GrowthSettings
) -> FloatArray:
    along = state.reckoning.noise.along_m_per_sqrt_m**2 * (la + lb)
    fixed = 2 * settings.wobble_m**2 + 4 * state.common.centre_sigma**2
    out: FloatArray = fixed + along
    return out
