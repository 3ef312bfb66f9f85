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
    first one, x + iy [m]; turn: (t,) local rotation b → a as unit numbers; support_m: (t,) distance
    to the nearest match that the prediction depends on (`predict`).
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
    count = len(lanes.lane)
    partner, support = np.full(count, -1), np.full(count, np.inf)
    place, turn = np.zeros(count, np.complex128), np.zeros(count, np.complex128)
    live, live_rows = lanes, np.arange(count)
    current, start_turn = _seed_partners(lanes, seeds), _seed_turns(seeds)
    for rounds_left in range(settings.growth_rounds - 1, -1, -1):
        if not len(live):
            break
        predicted = predict(live, current, start_turn)
        rematched, found, expected = _rematch(live, predicted)
        enough = found >= np.maximum(MATCH.fewest, MATCH.least_share * expected)
        moved = np.logical_or.reduceat(rematched != current, live.first[:-1])
        growing = enough & moved if rounds_left else np.zeros(len(live), np.bool_)
        done = (enough & ~growing)[live.lane].nonzero()[0]
        for target, values in zip((place, turn, support), predicted, strict=True):
            target[live_rows[done]] = values[done]
        partner[live_rows[done]] = rematched[done]
        if growing.all():
            current = rematched
            continue
        kept = growing[live.lane].nonzero()[0]
        live, live_rows = live.take(growing.nonzero()[0]), live_rows[kept]
        current, start_turn = rematched[kept], start_turn[growing]
    return _without_contradicted(lanes, partner, (place, turn, support))


def ungrown(lanes: Lanes, seeds: Sequence[Seed]) -> Grown:
    """The seed of each lane as a match, without growth."""
    partner = _seed_partners(lanes, seeds)
    predicted = predict(lanes, partner, _seed_turns(seeds))
    return _as_matches(lanes, partner, predicted)


def _seed_partners(lanes: Lanes, seeds: Sequence[Seed]) -> IntArray:
    """(t,) partner of each row in the seed of its lane, numbered as in the atlas, or -1."""
    partner = np.full(len(lanes.lane), -1)
    starts, firsts = lanes.first.tolist(), lanes.a.vertex[lanes.of_a].tolist()
    for seed, start, first in zip(seeds, starts, firsts, strict=False):
        partner[seed.b + start] = seed.a + first
    return partner


def _seed_turns(seeds: Sequence[Seed]) -> ComplexArray:
    return np.array([seed.unit for seed in seeds], np.complex128)


LEAST_WEIGHT = 1e-100
"""Least sum of the weights of neighbours: those of farther vertices may underflow to 0."""

Predicted = tuple[ComplexArray, ComplexArray, FloatArray]
"""Position, rotation and distance to the nearest support, of every row (`Grown`)."""


def _as_matches(lanes: Lanes, partner: IntArray, predicted: Predicted) -> Grown:
    """The partners (t,) of rows as matches."""
    row = (partner >= 0).nonzero()[0]
    a, b, turn = partner[row], lanes.vertex[row], predicted[1]
    bits = branch_bits(lanes.a.whole, lanes.b.whole, a, b, turn[row])
    return Grown(lanes, lanes.lane[row], a, row, bits, *predicted)


def _without_contradicted(lanes: Lanes, partner: IntArray, predicted: Predicted) -> Grown:
    """The partners (t,) of rows as matches, without pairs whose branches contradict each other, and
    without matches of a single pair."""
    if partner.max(initial=-1) < 0:
        none = np.zeros(0, np.int64)
        return Grown(lanes, none, none, none, np.zeros(0), *predicted)
    matches = _as_matches(lanes, partner, predicted)
    compatible = (matches.branch > -MATCH.contradicted_bits).nonzero()[0]
    lane = matches.lane[compatible]
    kept = compatible[(np.bincount(lane, minlength=len(lanes)) > 1)[lane]]
    return Grown(
        lanes,
        matches.lane[kept],
        matches.a[kept],
        matches.row[kept],
        matches.branch[kept],
        *predicted,
    )


def predict(lanes: Lanes, partner: IntArray, start_turn: ComplexArray) -> Predicted:
    """Place, local rotation and support of every vertex of b in the frame of a, (t,) each.

    partner: (t,) matched vertices of a, or -1; start_turn: (l,) initial rotation of each lane, as
    unit numbers. The support is the distance [m] to the nearest match among the vertex's
    neighbours, or to the centroid of all matches if no neighbour is matched.

    Strategy: weighted complex Procrustes for all rows at once. A match contributes a row of eight
    numbers (1, position in a, position in b, their product) to the sums; each vertex takes the
    weighted sum of the rows of its precomputed neighbours. The fit to all matches enters with a
    small weight, and alone if no neighbour is matched.
    """
    a, b, lane = lanes.a.whole, lanes.b.whole, lanes.lane
    z = b.z.take(lanes.vertex)
    is_matched = partner >= 0
    rows = np.zeros((len(partner), 4), np.complex128)
    matched = is_matched.nonzero()[0]
    z_a, z_b = a.z.take(partner[matched]), z[matched]
    rows[matched, 0] = 1.0
    rows[matched, 1] = z_a
    rows[matched, 2] = z_b
    rows[matched, 3] = z_a * z_b.conj()
    sums_of_lane = np.add.reduceat(rows, lanes.first[:-1])
    lane_turn, shift, lane_centre, lever = _fit_lanes(sums_of_lane, start_turn)
    turn = lane_turn.take(lane)
    place, support = turn * z + shift.take(lane), np.abs(z - lane_centre.take(lane))
    # The nearest match beside each vertex: neighbours are sorted by their distance.
    neighbours = b.neighbours.index.take(lanes.vertex, axis=0)
    neighbours += lanes.shift.take(lane)[:, None]
    has_match = is_matched.take(neighbours)
    nearest = has_match.argmax(axis=1)
    near = has_match[np.arange(len(has_match)), nearest].nonzero()[0]
    vertex = lanes.vertex.take(near)
    neighbour_rows = rows.view(np.float64).take(neighbours.take(near, axis=0), axis=0)
    weights = b.neighbours.weight.take(vertex, axis=0)[:, None, :]
    sums = np.matmul(weights, neighbour_rows)[:, 0, :].view(np.complex128)
    weight = sums[:, 0].real
    if not (weight > LEAST_WEIGHT).all():
        # Matches hundreds of metres away do not count: the fit to all of the lane stands.
        enough = (weight > LEAST_WEIGHT).nonzero()[0]
        near, vertex, sums, weight = near[enough], vertex[enough], sums[enough], weight[enough]
    sum_a, sum_b, sum_ab = sums[:, 1:].T
    local_turn, centre_a, centre_b = rigid_from_sums(
        weight, sum_a, sum_b, sum_ab, lever.take(lane.take(near))
    )
    place[near] = centre_a + local_turn * (z.take(near) - centre_b)
    turn[near] = local_turn
    support[near] = b.neighbours.distance_m[vertex, nearest.take(near)]
    return place, turn, support


def _fit_lanes(
    sums: ComplexArray, start_turn: ComplexArray
) -> tuple[ComplexArray, ComplexArray, ComplexArray, ComplexArray]:
    """Rigid fits to all matches of each lane, from their sums (l, 4): rotation, shift, centroid
    of the matches in b, and the rotation as a term of local fits, with the weight of a match at
    `place_m`."""
    count = np.maximum(sums[:, 0].real, 1.0)
    lever = MATCH.place_m**2 * start_turn
    turn, centre_a, centre_b = rigid_from_sums(count, sums[:, 1], sums[:, 2], sums[:, 3], lever)
    return turn, centre_a - turn * centre_b, centre_b, MATCH.place_m**2 * turn


def _rematch(lanes: Lanes, predicted: Predicted) -> tuple[IntArray, IntArray, IntArray]:
    """(t,) the vertex of a nearest to each prediction within the gate, or -1; each vertex once, for
    the nearest prediction. For each lane the number of matches near previous ones, and the number
    expected: of vertices of b predicted near vertices of a and near previous matches."""
    place, turn, support = predicted
    partner = np.full(len(place), -1)
    active = (support < MATCH.near_m).nonzero()[0]
    lane = lanes.lane.take(active)
    gap, nearest = lanes.nearest(place.take(active), lane, MATCH.place_m)
    near = (gap < MATCH.gate_m + MATCH.drift_per_m * support.take(active)).nonzero()[0]
    near = near[(-gap[near]).argsort(kind="stable")]
    slot = nearest[near] + lanes.shift_a.take(lane[near])
    claimant = np.full(int(lanes.first_a[-1]), -1)
    claimant[slot] = active[near]  # the last one written is the nearest
    claimed = (claimant >= 0).nonzero()[0]
    claimants = claimant[claimed]
    claimant_lane = lanes.lane.take(claimants)
    partner[claimants] = claimed - lanes.shift_a.take(claimant_lane)
    sure = support < MATCH.sure_m
    far = claimants[~sure[claimants]]
    partner[far[~_confirmed(lanes, partner, turn, far)]] = -1
    found = np.bincount(claimant_lane[sure[claimants]], minlength=len(lanes))
    in_reach = (gap < MATCH.place_m) & sure[active]
    expected = np.bincount(lane[in_reach], minlength=len(lanes))
    return partner, found, expected


def _confirmed(lanes: Lanes, partner: IntArray, turn: ComplexArray, far: IntArray) -> BoolArray:
    """(f,) whether rows far from previous matches keep their partners: those with agreeing branches
    and another matched row nearby."""
    b, vertex = lanes.b.whole, lanes.vertex[far]
    agree = branch_bits(lanes.a.whole, b, partner[far], vertex, turn[far]) > 0
    kept = partner >= 0
    kept[far] = agree
    beside = b.neighbours.index[vertex, 1:] + lanes.shift[lanes.lane[far]][:, None]
    near = b.neighbours.distance_m[vertex, 1:] < MATCH.sure_m
    return np.asarray(agree & (kept[beside] & near).any(axis=1))
