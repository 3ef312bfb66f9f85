"""Growth of a match across drifting maps: predict, match the nearest, refit, repeat (§2.3, §5)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .branches import branch_bits
from .links import Seed
from .prepare import ComplexArray, FloatArray, IntArray, Prepared
from .settings import MATCH, RobustSettings


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


_NONE = np.zeros(0, np.int64)
NO_MATCH = Match(
    _NONE, _NONE, np.zeros(0, np.complex128), np.zeros(0, np.complex128), np.zeros(0), np.zeros(0)
)
"""What becomes of a seed that does not grow."""


def grow(a: Prepared, b: Prepared, seed: Seed, settings: RobustSettings) -> Match:
    """Grow one seed."""
    return grow_all(a, b, [seed], settings)[0]


def grow_all(
    a: Prepared, b: Prepared, seeds: Sequence[Seed], settings: RobustSettings
) -> list[Match]:
    """Grow seeds, each by itself, until nothing changes. O(rounds · seeds · n_b · log n_a).

    Drift bends maps: every vertex of b is predicted by a rigid fit to the matches around it
    (moving least squares), so that a match follows the bend from where it is sure. In the end
    pairs whose branches contradict each other are dropped. Strategy: all seeds take each step at
    once, a row of every array for each that is still growing.
    """
    out = [NO_MATCH] * len(seeds)
    if not seeds:
        return out
    live = list(range(len(seeds)))
    partner = np.full((len(seeds), len(b)), -1)
    for mine, seed in zip(partner, seeds, strict=True):
        mine[seed.b] = seed.a
    for left in range(settings.growth_rounds - 1, -1, -1):
        place, turn, support = predict(a, b, partner, [seeds[k].unit for k in live])
        fresh, found, expected = _rematch(a, b, place, support, settings)
        going = []
        for row, k in enumerate(live):
            if found[row] < max(MATCH.fewest, MATCH.least_share * expected[row]):
                continue
            if left and (fresh[row] != partner[row]).any():
                going.append(row)
            else:
                out[k] = _grown(a, b, fresh[row], (place[row], turn[row], support[row]))
        if not going:
            break
        if len(going) < len(live):
            live, fresh = [live[row] for row in going], fresh[going]
        partner = fresh
    return out


def given_up(a: Prepared, b: Prepared, seed: Seed, settings: RobustSettings) -> tuple[int, int]:
    """Of a seed that does not grow: how many of the junctions of b that it lays where a has been
    were found in its last round, and how many there are."""
    partner = np.full((1, len(b)), -1)
    partner[0, seed.b] = seed.a
    found = expected = 0
    for _ in range(settings.growth_rounds):
        place, _, near = predict(a, b, partner, [seed.unit])
        partner, (found,), (expected,) = _rematch(a, b, place, near, settings)
        if found < max(MATCH.fewest, MATCH.least_share * expected):
            break
    return found, expected


def ungrown(a: Prepared, b: Prepared, seed: Seed) -> Match:
    """A seed as it is, as a match."""
    partner = np.full((1, len(b)), -1)
    partner[0, seed.b] = seed.a
    place, turn, near = predict(a, b, partner, [seed.unit])
    matched = np.sort(seed.b)
    theirs = partner[0, matched]
    bits = branch_bits(a, b, theirs, matched, turn[0, matched])
    return Match(theirs, matched, place[0], turn[0], near[0], bits)


def _grown(
    a: Prepared,
    b: Prepared,
    partner: IntArray,
    predicted: tuple[ComplexArray, ComplexArray, FloatArray],
) -> Match:
    """The match of a row, without the pairs whose branches contradict each other."""
    place, turn, support = predicted
    matched = (partner >= 0).nonzero()[0]
    bits = branch_bits(a, b, partner[matched], matched, turn[matched])
    fair = bits > -MATCH.contradicted_bits
    matched, bits = matched[fair], bits[fair]
    return Match(partner[matched], matched, place, turn, support, bits)


def predict(
    a: Prepared, b: Prepared, partner: IntArray, turn0: Sequence[complex]
) -> tuple[ComplexArray, ComplexArray, FloatArray]:
    """Where every vertex of b lies in a: (place, local turn, distance to the nearest match), each
    (s, n_b) like `partner`, by s matches independent of each other.

    Strategy: weighted complex Procrustes for all vertices at once. What a match adds to the sums
    is a row of eight numbers (1, position in a, position in b, their product); each vertex
    takes the weighted sum of the rows of its precomputed neighbours. The fit to all matches enters
    with a small weight, and alone where no neighbour is matched.
    """
    many, n = partner.shape
    has = partner >= 0
    rows = np.empty((many, n, 4), np.complex128)
    rows[:, :, 0] = has
    np.multiply(has, a.z[partner], out=rows[:, :, 1])
    np.multiply(has, b.z, out=rows[:, :, 2])
    np.multiply(rows[:, :, 1], b.z.conj(), out=rows[:, :, 3])
    fits = np.array([_fit(s, t) for s, t in zip(rows.sum(axis=1).tolist(), turn0, strict=True)])
    whole = fits[:, 0, None]
    place, support = whole * b.z + fits[:, 1, None], np.abs(b.z - fits[:, 2, None])
    turn = np.empty((many, n), np.complex128)
    turn[:] = whole
    # The nearest match beside each vertex: neighbours are sorted by their distance.
    beside = has.take(b.neighbour, axis=1).reshape(many * n, -1)
    nearest = beside.argmax(axis=1)
    spot = beside[np.arange(many * n), nearest].nonzero()[0]
    lane, at = spot // n, spot % n
    near = b.neighbour.take(at, axis=0) + (spot - at)[:, None]
    flat = rows.view(np.float64).reshape(-1, 8).take(near, axis=0)
    weights = b.near_weight.take(at, axis=0)[:, None, :]
    sums = np.matmul(weights, flat)[:, 0, :].view(np.complex128)
    weight = sums[:, 0].real
    ca, cb = sums[:, 1] / weight, sums[:, 2] / weight
    local = sums[:, 3] - sums[:, 1] * cb.conj() + fits[lane, 3]
    local /= np.maximum(np.abs(local), 1e-12)
    place.reshape(-1)[spot] = ca + local * (b.z[at] - cb)
    turn.reshape(-1)[spot] = local
    support.reshape(-1)[spot] = b.near_m[at, nearest[spot]]
    return place, turn, support


def _fit(sums: list[complex], start: complex) -> tuple[complex, complex, complex, complex]:
    """Of the sums over all matches of a seed: turn, shift, middle of the matches in b, and what the
    fit counts beside the local ones: like a match at the distance that parts two placements."""
    count = max(sums[0].real, 1.0)
    ma, mb, lever = sums[1] / count, sums[2] / count, sums[3] / count
    turn = count * (lever - mb.conjugate() * ma) + MATCH.start_weight * start
    turn = turn / abs(turn) if abs(turn) > 1e-9 else start
    return turn, ma - turn * mb, mb, MATCH.place_m**2 * turn


def _rematch(
    a: Prepared, b: Prepared, place: ComplexArray, support: FloatArray, settings: RobustSettings
) -> tuple[IntArray, list[int], list[int]]:
    """(s, n_b) the vertex of a nearest to each prediction, within the gate; where several choose
    the same one, it goes to the nearest. And for each of s matches how many were found, and how
    many of b's junctions lie where a has been."""
    many, n, n_a = len(place), len(b), len(a)
    partner = np.empty(place.shape, np.int64)
    partner.fill(-1)
    active = (support.reshape(-1) < MATCH.near_m).nonzero()[0]
    if n_a == 0 or len(active) == 0:
        return partner, [0] * many, [0] * many
    gate = settings.gate_m + settings.gate_per_m * support.reshape(-1)[active]
    gap, nearest = a.sites.nearest(place.reshape(-1)[active], MATCH.place_m)
    near = (gap < gate).nonzero()[0]
    near = near[(-gap[near]).argsort(kind="stable")]
    chooser = active[near]
    owner = np.empty(many * n_a, np.int64)
    owner.fill(-1)
    owner[nearest[near] + chooser // n * n_a] = chooser  # the last one written is the nearest
    taken = (owner >= 0).nonzero()[0]
    partner.reshape(-1)[owner[taken]] = taken % n_a
    found = np.bincount(taken // n_a, minlength=many)
    expected = np.bincount(active[gap < MATCH.place_m] // n, minlength=many)
    return partner, found.tolist(), expected.tolist()
