"""Growth of a match across drifting maps: predict, match the nearest, refit, repeat (§2.3, §5)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .branches import branch_bits
from .links import Seed
from .prepare import ComplexArray, FloatArray, IntArray, Prepared
from .settings import RobustSettings

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
        fresh = _rematch(a, b, place, support, settings)
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
    matched = np.flatnonzero(partner >= 0)
    pa, pb = a.z[partner[matched]], b.z[matched]
    rows = np.zeros((len(b), 4), np.complex128)
    rows[matched, 0] = 1.0
    rows[matched, 1] = pa
    rows[matched, 2] = pb
    rows[matched, 3] = pb.conj() * pa
    k = max(len(matched), 1)
    _, ma, mb, lever = (rows.sum(axis=0) / k).tolist()
    spread = float(np.vdot(pb, pb).real) - k * abs(mb) ** 2
    whole = k * (lever - mb.conjugate() * ma) + 4.0 * turn0
    whole = whole / abs(whole) if abs(whole) > 1e-9 else turn0
    flat = rows.view(np.float64)[b.neighbour]
    sums = np.matmul(b.near_weight[:, None, :], flat)[:, 0, :].view(np.complex128)
    weight = sums[:, 0].real
    some = weight > 0
    weight = np.where(some, weight, 1.0)
    ca, cb = sums[:, 1] / weight, sums[:, 2] / weight
    # The whole match counts like a spread of 3 m and of a share of its own extent.
    turn = sums[:, 3] - weight * cb.conj() * ca + (9.0 + 0.02 * min(spread, 2000.0)) * whole
    turn /= np.maximum(np.abs(turn), 1e-12)
    place = np.where(some, ca + turn * (b.z - cb), ma + whole * (b.z - mb))
    near = np.where(rows[b.neighbour, 0].real > 0, b.near_m, FAR_M).min(axis=1)
    return place, turn, np.where(some, near, np.abs(b.z - mb))


def _rematch(
    a: Prepared, b: Prepared, place: ComplexArray, support: FloatArray, settings: RobustSettings
) -> IntArray:
    """(n_b,) the vertex of a nearest to each prediction, within the gate; where several choose the
    same one, it goes to the nearest."""
    partner = np.full(len(b), -1)
    if a.tree is None:
        return partner
    gate = np.minimum(settings.gate_m + settings.gate_per_m * support, MOST_GATE_M)
    found = a.tree.query(place.view(np.float64).reshape(-1, 2))
    gap, nearest = np.asarray(found[0]), np.asarray(found[1])
    near = np.flatnonzero(gap < gate)
    near = near[np.argsort(-gap[near], kind="stable")]
    owner = np.full(len(a), -1)
    owner[nearest[near]] = near  # the last one written is the nearest
    taken = np.flatnonzero(owner >= 0)
    partner[owner[taken]] = taken
    return partner
