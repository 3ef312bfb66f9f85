"""Growth of a match across drifting maps: predict, match the nearest, refit, repeat (§2.3, §5)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .branches import branch_bits
from .links import Seed
from .prepare import ComplexArray, FloatArray, IntArray, Prepared
from .settings import RobustSettings

FEWEST = 3
"""A match that does not reach this many junctions in a round is given up."""

LEAST_SHARE = 0.5
"""So is one in which fewer of the junctions that lie where the other run has been are found: chance
alone finds about a fifth of them."""

COVERED_M = 3.5
"""A junction this near to one of the other map lies where that run has been."""

ACTIVE_M = 15.0
"""Predictions farther from a match than this are not looked at yet."""

NONE = np.zeros(0, np.int64)
FAR_M = 1e6
MOST_GATE_M = 2.5
WORST_BRANCH_BITS = -7.0
"""Two junctions whose branches disagree more than this are not the same one."""


@dataclass(frozen=True, slots=True, eq=False)
class Match:
    """A grown hypothesis. a, b: (k,) matched vertices; place: (n_b,) where each vertex of b lies
    in a's frame; turn: (n_b,) local rotation b → a as unit numbers; support_m: (n_b,) distance to
    the nearest match; branch: (k,) bits of the branches of each matched pair."""

    a: IntArray
    b: IntArray
    place: ComplexArray
    turn: ComplexArray
    support_m: FloatArray
    branch: FloatArray

    def __len__(self) -> int:
        return len(self.a)


def grow(a: Prepared, b: Prepared, seed: Seed, settings: RobustSettings) -> Match:
    """Grow a seed until nothing changes. O(rounds · n_b · log n_a).

    Drift bends maps: every vertex of b is predicted by a rigid fit to the matches around it
    (moving least squares), so that a match follows the bend from where it is sure. In the end
    pairs whose branches contradict each other are dropped.
    """
    partner = np.full(len(b), -1)
    partner[seed.b] = seed.a
    turn0 = complex(np.exp(1j * seed.theta))
    for _ in range(settings.growth_rounds):
        place, turn, support = predict(a, b, partner, turn0)
        fresh, expected = _rematch(a, b, place, support, settings)
        found = np.count_nonzero(fresh >= 0)
        if found < max(FEWEST, LEAST_SHARE * expected):
            return Match(NONE, NONE, place, turn, support, np.zeros(0))
        if np.array_equal(fresh, partner):
            break
        partner = fresh
    matched = np.flatnonzero(partner >= 0)
    bits = branch_bits(a, b, partner[matched], matched, turn[matched])
    fair = bits > WORST_BRANCH_BITS
    matched, bits = matched[fair], bits[fair]
    return Match(partner[matched], matched, place, turn, support, bits)


def predict(
    a: Prepared, b: Prepared, partner: IntArray, turn0: complex
) -> tuple[ComplexArray, ComplexArray, FloatArray]:
    """Where every vertex of b lies in a: (place, local turn, distance to the nearest match).

    Strategy: weighted complex Procrustes for all vertices at once. What a match adds to the sums
    is a row of eight numbers; each vertex takes the weighted sum of the rows of its precomputed
    neighbours. The fit to all matches enters with a small weight, and alone where no neighbour
    is matched.
    """
    has = partner >= 0
    matched = np.flatnonzero(has)
    pa, pb = a.z[partner[matched]], b.z[matched]
    rows = np.zeros((len(b), 4), np.complex128)
    rows[matched] = np.stack([np.ones(len(matched)), pa, pb, pb.conj() * pa], axis=1)
    k = max(len(matched), 1)
    _, ma, mb, lever = (rows.sum(axis=0) / k).tolist()
    spread = float(np.vdot(pb, pb).real) - k * abs(mb) ** 2
    whole = k * (lever - mb.conjugate() * ma) + 4.0 * turn0
    whole = whole / abs(whole) if abs(whole) > 1e-9 else turn0
    place = ma + whole * (b.z - mb)
    turn = np.full(len(b), whole)
    support = np.abs(b.z - mb)
    beside = has[b.neighbour]
    active = np.flatnonzero(beside.any(axis=1))
    near = b.neighbour[active]
    flat = rows.view(np.float64)[near]
    sums = np.matmul(b.near_weight[active, None, :], flat)[:, 0, :].view(np.complex128)
    weight = sums[:, 0].real
    ca, cb = sums[:, 1] / weight, sums[:, 2] / weight
    # The whole match counts like a spread of 3 m and of a share of its own extent.
    local = sums[:, 3] - sums[:, 1] * cb.conj() + (9.0 + 0.02 * min(spread, 2000.0)) * whole
    local /= np.maximum(np.abs(local), 1e-12)
    place[active] = ca + local * (b.z[active] - cb)
    turn[active] = local
    support[active] = np.where(beside[active], b.near_m[active], FAR_M).min(axis=1)
    return place, turn, support


def _rematch(
    a: Prepared, b: Prepared, place: ComplexArray, support: FloatArray, settings: RobustSettings
) -> tuple[IntArray, int]:
    """(n_b,) the vertex of a nearest to each prediction, within the gate; where several choose the
    same one, it goes to the nearest. And how many of b's junctions lie where a has been."""
    partner = np.full(len(b), -1)
    active = np.flatnonzero(support < ACTIVE_M)
    if a.tree is None or len(active) == 0:
        return partner, 0
    gate = np.minimum(settings.gate_m + settings.gate_per_m * support[active], MOST_GATE_M)
    where = place[active].view(np.float64).reshape(-1, 2)
    query = a.tree.query(where, distance_upper_bound=COVERED_M)
    gap, nearest = np.asarray(query[0]), np.asarray(query[1])
    near = np.flatnonzero(gap < gate)
    near = near[np.argsort(-gap[near], kind="stable")]
    owner = np.full(len(a), -1)
    owner[nearest[near]] = active[near]  # the last one written is the nearest
    taken = np.flatnonzero(owner >= 0)
    partner[owner[taken]] = taken
    return partner, int(np.count_nonzero(gap < COVERED_M))
