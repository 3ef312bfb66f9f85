"""Growth of matches between drifting maps: predict, match nearest neighbours, refit, repeat (§2.3,
§5)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...topology.arrays import BoolArray, ComplexArray, FloatArray, IntArray
from ...topology.se2 import rigid_from_sums
from .atlas import Lanes
from .branches import branch_bits
from .links import Seed
from .settings import MATCH, RobustSettings


@dataclass(frozen=True, slots=True, eq=False)
class Grown:
    """The grown match of every lane: k matched pairs of vertices, sorted by lane.

    lane: (k,); a: (k,) vertices of the first maps, numbered as in the atlas; row: (k,) rows of
    `lanes`, of the vertices of the second maps; branch: (k,) evidence of the branches of each pair
    [bits]. place: (t,) predicted position of each vertex of the second map in the frame of the
    first one; turn: (t,) local rotation b → a as unit numbers; support_m: (t,) distance to the
    nearest match that the prediction rests on (`predict`).
    """

    lanes: Lanes
    lane: IntArray
    a: IntArray
    row: IntArray
    branch: FloatArray
    place: ComplexArray
    turn: ComplexArray
    support_m: FloatArray

    @property
    def b(self) -> IntArray:
        """(k,) matched vertices of the second maps, numbered as in the atlas."""
        return self.lanes.vertex[self.row]


def grow(lanes: Lanes, seeds: Sequence[Seed], settings: RobustSettings) -> Grown:
    """Grow a seed in each lane until nothing changes. O(rounds · rows · log n_a).

    Drift bends maps: every vertex of b is predicted by a rigid fit to the matches around it (moving
    least squares), so that a match follows the bend from where it is certain. Finally pairs whose
    branches contradict each other are dropped. Lanes that do not grow, or end with fewer than two
    pairs, have no match. Strategy: all lanes take each step at once; finished ones leave.
    """
    rows = len(lanes.lane)
    partner, support = np.full(rows, -1), np.full(rows, np.inf)
    place, turn = np.zeros(rows, np.complex128), np.zeros(rows, np.complex128)
    live, at, now, unit = lanes, np.arange(rows), _sown(lanes, seeds), _units(seeds)
    for left in range(settings.growth_rounds - 1, -1, -1):
        if not len(live):
            break
        predicted = predict(live, now, unit)
        fresh, found, expected = _rematch(live, predicted)
        enough = found >= np.maximum(MATCH.fewest, MATCH.least_share * expected)
        moved = np.logical_or.reduceat(fresh != now, live.first[:-1])
        going = enough & moved if left else np.zeros(len(live), np.bool_)
        done = (enough & ~going)[live.lane].nonzero()[0]
        for out, new in zip((place, turn, support), predicted, strict=True):
            out[at[done]] = new[done]
        partner[at[done]] = fresh[done]
        if going.all():
            now = fresh
            continue
        stay = going[live.lane].nonzero()[0]
        live, at, now, unit = live.take(going.nonzero()[0]), at[stay], fresh[stay], unit[going]
    return _without_contradicted(lanes, partner, (place, turn, support))


def ungrown(lanes: Lanes, seeds: Sequence[Seed]) -> Grown:
    """The seed of each lane as a match, without growth."""
    partner = _sown(lanes, seeds)
    predicted = predict(lanes, partner, _units(seeds))
    return _matched(lanes, partner, predicted)


def _sown(lanes: Lanes, seeds: Sequence[Seed]) -> IntArray:
    """(t,) partner of each row in the seed of its lane, numbered as in the atlas, or -1."""
    partner = np.full(len(lanes.lane), -1)
    starts, firsts = lanes.first.tolist(), lanes.a.vertex[lanes.of_a].tolist()
    for seed, start, first in zip(seeds, starts, firsts, strict=False):
        partner[seed.b + start] = seed.a + first
    return partner


def _units(seeds: Sequence[Seed]) -> ComplexArray:
    return np.array([seed.unit for seed in seeds], np.complex128)


LEAST_WEIGHT = 1e-100
"""Weights of neighbours below are those of vertices too far away: their sums may be no numbers."""

Predicted = tuple[ComplexArray, ComplexArray, FloatArray]
"""Position, rotation and distance to the nearest support, of every row (`Grown`)."""


def _matched(lanes: Lanes, partner: IntArray, predicted: Predicted) -> Grown:
    """The partners (t,) of rows as matches."""
    row = (partner >= 0).nonzero()[0]
    a, b, turn = partner[row], lanes.vertex[row], predicted[1]
    bits = branch_bits(lanes.a.whole, lanes.b.whole, a, b, turn[row])
    return Grown(lanes, lanes.lane[row], a, row, bits, *predicted)


def _without_contradicted(lanes: Lanes, partner: IntArray, predicted: Predicted) -> Grown:
    """The matches without pairs whose branches contradict each other, and without matches of one
    pair."""
    if partner.max(initial=-1) < 0:
        none = np.zeros(0, np.int64)
        return Grown(lanes, none, none, none, np.zeros(0), *predicted)
    all_ = _matched(lanes, partner, predicted)
    fair = (all_.branch > -MATCH.contradicted_bits).nonzero()[0]
    lane = all_.lane[fair]
    kept = fair[(np.bincount(lane, minlength=len(lanes)) > 1)[lane]]
    return Grown(
        lanes, all_.lane[kept], all_.a[kept], all_.row[kept], all_.branch[kept], *predicted
    )


def predict(lanes: Lanes, partner: IntArray, turn0: ComplexArray) -> Predicted:
    """Predicted position of every vertex of b in the frame of a: (place, local turn, support), each
    (t,) like `partner`; turn0: (l,) initial rotation of each lane. The support is the distance [m]
    to the nearest match among the vertex's neighbours, or to the centroid of all matches if no
    neighbour is matched.

    Strategy: weighted complex Procrustes for all rows at once. A match contributes a row of eight
    numbers (1, position in a, position in b, their product) to the sums; each vertex takes the
    weighted sum of the rows of its precomputed neighbours. The fit to all matches enters with a
    small weight, and alone if no neighbour is matched.
    """
    a, b, lane = lanes.a.whole, lanes.b.whole, lanes.lane
    z = b.z.take(lanes.vertex)
    has = partner >= 0
    rows = np.zeros((len(partner), 4), np.complex128)
    there = has.nonzero()[0]
    z_a, z_b = a.z.take(partner[there]), z[there]
    rows[there, 0] = 1.0
    rows[there, 1] = z_a
    rows[there, 2] = z_b
    rows[there, 3] = z_a * z_b.conj()
    whole, shift, middle, lever = _fits(np.add.reduceat(rows, lanes.first[:-1]), turn0)
    turn = whole.take(lane)
    place, support = turn * z + shift.take(lane), np.abs(z - middle.take(lane))
    # The nearest match beside each vertex: neighbours are sorted by their distance.
    beside = b.neighbours.index.take(lanes.vertex, axis=0)
    beside += lanes.shift.take(lane)[:, None]
    known = has.take(beside)
    nearest = known.argmax(axis=1)
    spot = known[np.arange(len(known)), nearest].nonzero()[0]
    vertex = lanes.vertex.take(spot)
    flat = rows.view(np.float64).take(beside.take(spot, axis=0), axis=0)
    weights = b.neighbours.weight.take(vertex, axis=0)[:, None, :]
    sums = np.matmul(weights, flat)[:, 0, :].view(np.complex128)
    weight = sums[:, 0].real
    if not (weight > LEAST_WEIGHT).all():
        # Matches hundreds of metres away tell nothing here: the fit to all of them stands.
        enough = (weight > LEAST_WEIGHT).nonzero()[0]
        spot, vertex, sums, weight = spot[enough], vertex[enough], sums[enough], weight[enough]
    lever = lever.take(lane.take(spot))
    local, ca, cb = rigid_from_sums(weight, sums[:, 1], sums[:, 2], sums[:, 3], lever)
    place[spot] = ca + local * (z.take(spot) - cb)
    turn[spot] = local
    support[spot] = b.neighbours.distance_m[vertex, nearest.take(spot)]
    return place, turn, support


def _fits(
    sums: ComplexArray, start: ComplexArray
) -> tuple[ComplexArray, ComplexArray, ComplexArray, ComplexArray]:
    """Rigid fits to all matches of each lane, from their sums (l, 4): rotation, shift, centroid of
    the matches in b, and the weight of its rotation in local fits, that of a match at a distance of
    `place_m`."""
    count = np.maximum(sums[:, 0].real, 1.0)
    lever = MATCH.place_m**2 * start
    turn, ma, mb = rigid_from_sums(count, sums[:, 1], sums[:, 2], sums[:, 3], lever)
    return turn, ma - turn * mb, mb, MATCH.place_m**2 * turn


def _rematch(lanes: Lanes, predicted: Predicted) -> tuple[IntArray, IntArray, IntArray]:
    """(t,) the vertex of a nearest to each prediction within the gate, unique (the nearest one
    wins), else -1; and for each lane the number of matches found, and of vertices of b predicted
    near vertices of a and near previous matches."""
    place, turn, support = predicted
    partner = np.full(len(place), -1)
    active = (support < MATCH.near_m).nonzero()[0]
    lane = lanes.lane.take(active)
    gap, nearest = lanes.nearest(place.take(active), lane, MATCH.place_m)
    near = (gap < MATCH.gate_m + MATCH.drift_per_m * support.take(active)).nonzero()[0]
    near = near[(-gap[near]).argsort(kind="stable")]
    slot = nearest[near] + lanes.shift_a.take(lane[near])
    owner = np.full(int(lanes.first_a[-1]), -1)
    owner[slot] = active[near]  # the last one written is the nearest
    taken = (owner >= 0).nonzero()[0]
    chooser = owner[taken]
    theirs = lanes.lane.take(chooser)
    partner[chooser] = taken - lanes.shift_a.take(theirs)
    sure = support < MATCH.sure_m
    far = chooser[~sure[chooser]]
    partner[far[~_believed(lanes, partner, turn, far)]] = -1
    found = np.bincount(theirs[sure[chooser]], minlength=len(lanes))
    there = (gap < MATCH.place_m) & sure[active]
    expected = np.bincount(lane[there], minlength=len(lanes))
    return partner, found, expected


def _believed(lanes: Lanes, partner: IntArray, turn: ComplexArray, far: IntArray) -> BoolArray:
    """(f,) which rows far from previous matches keep their partners: those with agreeing branches
    and another such row nearby."""
    b, vertex = lanes.b.whole, lanes.vertex[far]
    agree = branch_bits(lanes.a.whole, b, partner[far], vertex, turn[far]) > 0
    kept = partner >= 0
    kept[far] = agree
    beside = b.neighbours.index[vertex, 1:] + lanes.shift[lanes.lane[far]][:, None]
    near = b.neighbours.distance_m[vertex, 1:] < MATCH.sure_m
    return np.asarray(agree & (kept[beside] & near).any(axis=1))
