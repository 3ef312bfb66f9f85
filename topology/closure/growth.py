"""Growth (§2.2) of the map against itself: evidence from the corridors around two places.

If two places are one, the corridors that leave them by the same branches are the same corridors,
and lead to places that are the same again. All hypotheses grow in parallel, hop by hop, in arrays.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import BoolArray, FloatArray, IntArray
from ..columns import joined, take
from ..matching.likelihood import LIKELIHOOD
from ..se2 import turned
from .branches import Alignment, Branches, align
from .dead_reckoning import DeadReckoning
from .evidence import Background, length_odds
from .places import HOPS, NOWHERE, Places


@dataclass(frozen=True, slots=True)
class GrowthSettings:
    """How the steps of growth count."""

    discount: float = 0.85
    """Weight of each hop relative to the one before: legs are not independent of each other. Tried:
    with 1 a run on tiles is closed wrongly under three times the noise."""
    wobble_m: float = 0.08
    """1 sigma of the length driven through one corridor [m]. Tried: with 0 rows close less
    often."""


GROWTH = GrowthSettings()


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
    missed: IntArray
    """Junctions that must have been missed in one of the two."""


def grow(
    state: MapState,
    a: IntArray,
    b: IntArray,
    aligned: Alignment,
) -> tuple[FloatArray, FloatArray]:
    """Evidence [nats] for and against the hypotheses "place a[k] is place b[k]", both (k,) and
    positive, from the corridors around them that agree and that disagree, over `HOPS` corridors.

    aligned: the branches of a and b.
    """
    places, common = state.places, state.common
    k = len(a)
    gain, loss = np.zeros(k), np.zeros(k)
    front = _Front(np.arange(k), a, b, aligned.turn, aligned.partner)
    seen = _keys(front.hypothesis, a, b, len(places))
    weight, miss = 1.0, float(np.log(common.miss_rate))
    turn_sigma = float(np.sqrt(state.branches.variance))
    for _ in range(HOPS):
        pairs = _leave(places, front)
        if len(pairs.row) == 0:
            break
        reached, torn = _compare(state, front, pairs)
        loss += weight * -miss * np.bincount(front.hypothesis[torn], minlength=k)
        h = front.hypothesis[reached.row]
        var = _leg_variance(state, reached.la, reached.lb)
        odds = np.clip(length_odds(common, reached.la, reached.lb, var), 0.0, LIKELIHOOD.most)
        odds = odds + miss * reached.missed
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
        odds[further] += np.clip(fit, 2 * miss, LIKELIHOOD.most)
        gain += weight * np.bincount(h, np.maximum(odds, 0.0), minlength=k)
        loss += weight * np.bincount(h, np.maximum(-odds, 0.0), minlength=k)
        good = (fit > 0.5 * miss) & (reached.missed[further] < 2)
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
        weight *= GROWTH.discount
    return gain, loss


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
    none = np.zeros(int(use.sum()), np.int64)
    return _Reached(row[use], qa[use], qb[use], ea[use], eb[use], la[use], lb[use], none)


def _compare(state: MapState, front: _Front, pairs: _Reached) -> tuple[_Reached, IntArray]:
    """Pairs of legs that agree, possibly past one missed junction; and rows of the front of the
    others."""
    agree = _agree(state, front, pairs)
    rest = np.flatnonzero(~agree)
    through = _past_missed(state, front, take(pairs, rest))
    found = np.zeros(len(rest), bool)
    found[through[1]] = True
    torn = pairs.row[rest[~found]]
    return joined([take(pairs, np.flatnonzero(agree)), through[0]]), torn


def _agree(state: MapState, front: _Front, pairs: _Reached) -> BoolArray:
    """(m,) whether lengths are equal, and ends coincide if the two places do, within the gate."""
    var = _leg_variance(state, pairs.la, pairs.lb)
    near = np.abs(pairs.la - pairs.lb) < LIKELIHOOD.gate_sigmas * np.sqrt(var)
    da = state.xy[pairs.qa] - state.xy[front.a[pairs.row]]
    db = state.xy[pairs.qb] - state.xy[front.b[pairs.row]]
    x, y = (da - turned(db, front.turn[pairs.row])).T
    room = LIKELIHOOD.gate_sigmas * np.sqrt(var + state.branches.variance * pairs.la**2)
    result: BoolArray = near & (np.hypot(x, y) < room)
    return result


def _past_missed(state: MapState, front: _Front, pairs: _Reached) -> tuple[_Reached, IntArray]:
    """Pairs of legs that agree after extending the shorter leg past its end by one more leg.

    Returns these pairs, and for each the index into `pairs` that it came from.
    """
    short_a = pairs.la < pairs.lb
    middle, entry = np.where(short_a, pairs.qa, pairs.qb), np.where(short_a, pairs.ea, pairs.eb)
    index, slot = np.nonzero(state.places.next_place[middle] != NOWHERE)
    keep = slot != entry[index]
    index, slot = index[keep], slot[keep]
    m, first = middle[index], short_a[index]
    on, onto = state.places.next_place[m, slot], state.places.next_slot[m, slot]
    more = state.places.length[m, slot]
    tried = _Reached(
        row=pairs.row[index],
        qa=np.where(first, on, pairs.qa[index]),
        qb=np.where(first, pairs.qb[index], on),
        ea=np.where(first, onto, pairs.ea[index]),
        eb=np.where(first, pairs.eb[index], onto),
        la=pairs.la[index] + np.where(first, more, 0.0),
        lb=pairs.lb[index] + np.where(first, 0.0, more),
        missed=np.ones(len(index), np.int64),
    )
    fine = np.flatnonzero(_agree(state, front, tried))
    # One continuation per pair: the one nearest in length.
    off = np.abs(tried.la[fine] - tried.lb[fine])
    order = fine[np.lexsort((off, index[fine]))]
    once = order[np.diff(index[order], prepend=-1) > 0]
    return take(tried, once), index[once]


def _leg_variance(state: MapState, la: FloatArray, lb: FloatArray) -> FloatArray:
    along = state.reckoning.noise.along_m_per_sqrt_m**2 * (la + lb)
    fixed = 2 * GROWTH.wobble_m**2 + 4 * state.common.centre_sigma**2
    out: FloatArray = fixed + along
    return out
