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
    """Weight of each hop relative to the hop before: legs are not independent. Tried: with 1 a run
    on tiles is closed wrongly under three times the noise."""
    wobble_m: float = 0.08
    """1 sigma of the length driven through one corridor [m]. Tried: with 0 rows close less
    often."""


GROWTH = GrowthSettings()


@dataclass(frozen=True, slots=True, eq=False)
class MapState:
    """The state of the map: places, positions xy (n, 2) [m], branches, and statistics."""

    reckoning: DeadReckoning
    places: Places
    xy: FloatArray
    common: Background
    branches: Branches


@dataclass(frozen=True, slots=True, eq=False)
class _Front:
    """Pairs of places a, b (k,) that hypotheses (k,) have reached. turn: (k,) rotation of b's
    branches that aligns them with a's [rad]; partner: (k, s) slot of b of each slot of a, or -1."""

    hypothesis: IntArray
    a: IntArray
    b: IntArray
    turn: FloatArray
    partner: IntArray


@dataclass(frozen=True, slots=True, eq=False)
class _Reached:
    """Pairs of legs. row: (m,) of the front, the pair of places that they leave; qa, qb: (m,)
    places that they reach; ea, eb: (m,) slots there; la, lb: (m,) lengths [m]."""

    row: IntArray
    qa: IntArray
    qb: IntArray
    ea: IntArray
    eb: IntArray
    la: FloatArray
    lb: FloatArray
    missed: IntArray
    """(m,) number of junctions that must have been missed on one of the two."""


def grow(
    state: MapState, a: IntArray, b: IntArray, aligned: Alignment
) -> tuple[FloatArray, FloatArray]:
    """Evidence [nats] for and against the hypotheses "place a[k] is place b[k]", both (k,) and
    positive, from the corridors around that agree and that disagree, over `HOPS` hops.

    aligned: the branches of a and b.
    """
    places, common = state.places, state.common
    k = len(a)
    gain, loss = np.zeros(k), np.zeros(k)
    front = _Front(np.arange(k), a, b, aligned.turn, aligned.partner)
    visited = _keys(front.hypothesis, a, b, len(places))
    weight, miss = 1.0, float(np.log(common.miss_rate))
    turn_sigma = float(np.sqrt(state.branches.variance))
    for _ in range(HOPS):
        pairs = _leave(places, front)
        if len(pairs.row) == 0:
            break
        reached, contradicted = _compare(state, front, pairs)
        loss += weight * -miss * np.bincount(front.hypothesis[contradicted], minlength=k)
        hypothesis = front.hypothesis[reached.row]
        variance = _leg_variance(state, reached.la, reached.lb)
        odds = np.clip(length_odds(common, reached.la, reached.lb, variance), 0.0, LIKELIHOOD.most)
        odds = odds + miss * reached.missed
        closes = reached.qa == reached.qb
        # Both legs end at one place: by one branch they agree, by two branches they disagree.
        odds = np.where(closes, np.where(reached.ea == reached.eb, odds - miss, miss), odds)
        open_ends = np.flatnonzero(~closes)
        alignment = align(
            state.branches,
            reached.qa[open_ends],
            reached.qb[open_ends],
            turn_sigma=np.full(len(open_ends), turn_sigma),
            turn_mean=front.turn[reached.row[open_ends]],
        )
        fit = alignment.odds
        odds[open_ends] += np.clip(fit, 2 * miss, LIKELIHOOD.most)
        gain += weight * np.bincount(hypothesis, np.maximum(odds, 0.0), minlength=k)
        loss += weight * np.bincount(hypothesis, np.maximum(-odds, 0.0), minlength=k)
        good = (fit > 0.5 * miss) & (reached.missed[open_ends] < 2)
        front, visited = _next_front(
            front, reached, open_ends[good], alignment.partner[good], visited=visited, n=len(places)
        )
        weight *= GROWTH.discount
    return gain, loss


def _next_front(
    front: _Front,
    reached: _Reached,
    rows: IntArray,
    partner: IntArray,
    *,
    visited: IntArray,
    n: int,
) -> tuple[_Front, IntArray]:
    """The pairs of places that legs `rows` of `reached` lead to, each once and not visited before;
    and the keys of all visited pairs. partner: (r, s) slots there, as in `_Front`."""
    hypothesis = front.hypothesis[reached.row[rows]]
    keys = _keys(hypothesis, reached.qa[rows], reached.qb[rows], n)
    new_keys, first = np.unique(keys, return_index=True)
    first = first[~np.isin(new_keys, visited)]
    chosen = rows[first]
    turn = front.turn[reached.row[chosen]]
    pairs = _Front(hypothesis[first], reached.qa[chosen], reached.qb[chosen], turn, partner[first])
    return pairs, np.concatenate([visited, keys[first]])


def _keys(hypothesis: IntArray, a: IntArray, b: IntArray, n: int) -> IntArray:
    """(k,) numbers of hypotheses with unordered pairs of places, of n."""
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
    is_same_leg = (qa == pb) & (qb == pa) & (ea == slot_b) & (eb == slot_a)
    usable = (qa != NOWHERE) & (qb != NOWHERE) & ~is_same_leg & (pa != pb)
    la, lb = places.length[pa, slot_a], places.length[pb, slot_b]
    columns = (row, qa, qb, ea, eb, la, lb, np.zeros(len(row), np.int64))
    return _Reached(*(column[usable] for column in columns))


def _compare(state: MapState, front: _Front, pairs: _Reached) -> tuple[_Reached, IntArray]:
    """Pairs of legs that agree, possibly past one missed junction; and rows of the others."""
    agree = _agree(state, front, pairs)
    disagreeing = np.flatnonzero(~agree)
    past_missed = _past_missed(state, front, take(pairs, disagreeing))
    is_through = np.zeros(len(disagreeing), bool)
    is_through[past_missed[1]] = True
    contradicted = pairs.row[disagreeing[~is_through]]
    return joined([take(pairs, np.flatnonzero(agree)), past_missed[0]]), contradicted


def _agree(state: MapState, front: _Front, pairs: _Reached) -> BoolArray:
    """(m,) whether lengths agree, and the ends coincide if the starts do, within the gate."""
    variance = _leg_variance(state, pairs.la, pairs.lb)
    lengths_agree = np.abs(pairs.la - pairs.lb) < LIKELIHOOD.gate_sigmas * np.sqrt(variance)
    chord_a = state.xy[pairs.qa] - state.xy[front.a[pairs.row]]
    chord_b = state.xy[pairs.qb] - state.xy[front.b[pairs.row]]
    dx, dy = (chord_a - turned(chord_b, front.turn[pairs.row])).T
    tolerance = LIKELIHOOD.gate_sigmas * np.sqrt(variance + state.branches.variance * pairs.la**2)
    return np.asarray(lengths_agree & (np.hypot(dx, dy) < tolerance))


def _past_missed(state: MapState, front: _Front, pairs: _Reached) -> tuple[_Reached, IntArray]:
    """Pairs of legs that agree after the shorter leg is extended by one more leg, past a junction
    that the other one missed. Returns them, and the row of `pairs` of each."""
    short_a = pairs.la < pairs.lb
    missed = np.where(short_a, pairs.qa, pairs.qb)
    entry = np.where(short_a, pairs.ea, pairs.eb)
    index, slot = np.nonzero(state.places.next_place[missed] != NOWHERE)
    is_onward = slot != entry[index]
    index, slot = index[is_onward], slot[is_onward]
    place, extends_a = missed[index], short_a[index]
    onward = state.places.next_place[place, slot]
    onward_slot = state.places.next_slot[place, slot]
    added_m = state.places.length[place, slot]
    extended = _Reached(
        row=pairs.row[index],
        qa=np.where(extends_a, onward, pairs.qa[index]),
        qb=np.where(extends_a, pairs.qb[index], onward),
        ea=np.where(extends_a, onward_slot, pairs.ea[index]),
        eb=np.where(extends_a, pairs.eb[index], onward_slot),
        la=pairs.la[index] + np.where(extends_a, added_m, 0.0),
        lb=pairs.lb[index] + np.where(extends_a, 0.0, added_m),
        missed=np.ones(len(index), np.int64),
    )
    agreeing = np.flatnonzero(_agree(state, front, extended))
    # One continuation per pair: the one nearest in length.
    difference = np.abs(extended.la[agreeing] - extended.lb[agreeing])
    order = agreeing[np.lexsort((difference, index[agreeing]))]
    best = order[np.diff(index[order], prepend=-1) > 0]
    return take(extended, best), index[best]


def _leg_variance(state: MapState, la: FloatArray, lb: FloatArray) -> FloatArray:
    along = state.reckoning.noise.along_m_per_sqrt_m**2 * (la + lb)
    constant = 2 * GROWTH.wobble_m**2 + 4 * state.common.centre_sigma**2
    return np.asarray(constant + along)
