"""Evidence [bits] against a match: junctions inside corridors that the other run drove without
detecting them, and corridors that lead elsewhere."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

import numpy as np

from ...topology.arrays import BoolArray, ComplexArray, FloatArray, IntArray
from ...topology.columns import take
from ...topology.matching.likelihood import BIT, LIKELIHOOD, doubted
from .atlas import Atlas, cuts
from .branches import common_branches
from .growth import Grown
from .prepare import Prepared
from .settings import MATCH

BESIDE_M = float(np.hypot(MATCH.clear_m / 2, MATCH.gate_m))
"""Upper bound of the distance [m] of a point in a corridor from its nearest sample."""


@dataclass(frozen=True, slots=True, eq=False)
class Unseen:
    """Vertices (k,) of one map inside directed corridors (edge) of the other, which did not detect
    them. bits: (k,) weight of each, positive."""

    vertex: IntArray
    edge: IntArray
    bits: FloatArray

    def __len__(self) -> int:
        return len(self.vertex)


@dataclass(frozen=True, slots=True, eq=False)
class Conflicts:
    """The contradictions of a match.

    in_a: vertices of b inside corridors of a; in_b: vertices of a inside corridors of b; elsewhere:
    (k, 2) directed corridors of a and b that leave matched junctions by the same branch and lead to
    different ones; elsewhere_bits: the weight of one.
    """

    in_a: Unseen
    in_b: Unseen
    elsewhere: IntArray
    elsewhere_bits: float

    @property
    def bits(self) -> float:
        """Their total weight, positive."""
        unseen = float(self.in_a.bits.sum()) + float(self.in_b.bits.sum())
        return unseen + self.elsewhere_bits * len(self.elsewhere)

    @property
    def junctions(self) -> float:
        """The number of matched junctions that they outweigh: each its bits divided by
        `MATCH.junction_bits`, at most one."""
        unseen = np.concatenate([self.in_a.bits, self.in_b.bits]) / MATCH.junction_bits
        elsewhere = min(self.elsewhere_bits / MATCH.junction_bits, 1.0)
        return float(np.minimum(unseen, 1.0).sum()) + elsewhere * len(self.elsewhere)

    def __len__(self) -> int:
        return len(self.in_a) + len(self.in_b) + len(self.elsewhere)

    def exchanged(self) -> Conflicts:
        """The same with a and b exchanged."""
        return replace(self, in_a=self.in_b, in_b=self.in_a, elsewhere=self.elsewhere[:, ::-1])

    def bounded(self, bound_a: FloatArray, bound_b: FloatArray) -> Conflicts:
        """The same, with upper bounds of the weights of undetected junctions [bits]."""
        bounded = ((self.in_a, bound_a), (self.in_b, bound_b))
        unseen = [replace(x, bits=np.minimum(x.bits, bound)) for x, bound in bounded]
        return replace(self, in_a=unseen[0], in_b=unseen[1])


@dataclass(frozen=True, slots=True)
class Contradiction:
    """A single contradiction.

    of_a, of_b: a vertex of either map, or the two ends of a corridor; bits: its weight, positive.
    """

    kind: Literal["unseen", "elsewhere"]
    of_a: tuple[int, ...]
    of_b: tuple[int, ...]
    bits: float

    def sentence(self, run_a: str, run_b: str) -> str:
        """The contradiction in words."""
        ends_a, ends_b = (" to ".join(map(str, ends)) for ends in (self.of_a, self.of_b))
        if self.kind == "elsewhere":
            return (
                f"corridor {ends_a} of {run_a} and corridor {ends_b} of {run_b} "
                "leave the same junction by the same branch and lead to different ones"
            )
        if len(self.of_a) > 1:
            ends_a, ends_b, run_a, run_b = ends_b, ends_a, run_b, run_a
        return (
            f"junction {ends_a} of {run_a} falls inside corridor {ends_b} of {run_b}, unseen there"
        )


def contradictions(found: Conflicts, a: Prepared, b: Prepared) -> list[Contradiction]:
    """All contradictions of a match, undetected junctions first."""

    def rows(x: Unseen) -> Iterator[tuple[int, int, float]]:
        return zip(x.vertex.tolist(), x.edge.tolist(), x.bits.tolist(), strict=True)

    return [
        *(Contradiction("unseen", _ends(a, e), (v,), bits) for v, e, bits in rows(found.in_a)),
        *(Contradiction("unseen", (v,), _ends(b, e), bits) for v, e, bits in rows(found.in_b)),
        *(
            Contradiction("elsewhere", _ends(a, row_a), _ends(b, row_b), found.elsewhere_bits)
            for row_a, row_b in found.elsewhere.tolist()
        ),
    ]


def _ends(m: Prepared, row: int) -> tuple[int, int]:
    return int(m.tail[row]), int(m.head[row])


_NONE = Unseen(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0))
NO_CONFLICTS = Conflicts(_NONE, _NONE, np.zeros((0, 2), np.int64), 0.0)


AllUnseen = tuple[IntArray, Unseen]
"""Lane of each vertex, ascending, and the vertices of all lanes, numbered as in the atlases."""


def _by_lane(unseen: AllUnseen, first_vertex: IntArray, first_edge: IntArray) -> list[Unseen]:
    """Those of each lane with a weight above 0, numbered as in its maps. first_vertex, first_edge:
    (l,) first rows of its two maps in the atlases."""
    lane, found = unseen
    positive = found.bits.nonzero()[0]
    lane, found = lane[positive], take(found, positive)
    found = replace(
        found, vertex=found.vertex - first_vertex[lane], edge=found.edge - first_edge[lane]
    )
    first = cuts(lane, len(first_vertex))
    return [take(found, slice(*ends)) for ends in pairwise(first)]


def conflicts(grown: Grown, searched: BoolArray) -> list[Conflicts]:
    """The contradictions of the match in each lane of `searched`; none for the others.

    O(points · log points). A corridor counts once: one that passes an undetected junction does not
    also lead elsewhere.
    """
    lanes = grown.lanes
    near = (grown.support_m < MATCH.near_m) & searched[lanes.lane]
    unseen_b, unseen_a = _unseen_b(grown, near), _unseen_a(grown, near)
    lane, leave_a, leave_b = _elsewhere(grown, searched, unseen_b, unseen_a)
    corridor_a, corridor_b = lanes.a.corridor[lanes.of_a], lanes.b.corridor[lanes.of_b]
    in_a = _by_lane(unseen_b, lanes.b.vertex[lanes.of_b], corridor_a)
    in_b = _by_lane(unseen_a, lanes.a.vertex[lanes.of_a], corridor_b)
    elsewhere = np.column_stack([leave_a - corridor_a[lane], leave_b - corridor_b[lane]])
    weight, first = _elsewhere_bits(grown).tolist(), cuts(lane, len(lanes))
    found = [NO_CONFLICTS] * len(lanes)
    for k in searched.nonzero()[0].tolist():
        found[k] = Conflicts(in_a[k], in_b[k], elsewhere[first[k] : first[k + 1]], weight[k])
    return found


def _elsewhere(
    grown: Grown, searched: BoolArray, unseen_b: AllUnseen, unseen_a: AllUnseen
) -> tuple[IntArray, IntArray, IntArray]:
    """Corridors that leave matched junctions by one branch and lead to different ones: lane,
    directed rows of both maps. Left out are those that an undetected junction explains, inside them
    or at their end, and those that end at a bend which the other detector does not report."""
    lanes, a, b = grown.lanes, grown.lanes.a.whole, grown.lanes.b.whole
    lane, leave_a, leave_b = _diverging(grown, searched)
    end_a, end_b = a.head[leave_a], b.head[leave_b]

    (lane_b, in_a), (lane_a, in_b) = unseen_b, unseen_a

    def explained(rows: IntArray, lane_by: IntArray, by: IntArray, count: int) -> BoolArray:
        """Whether rows of the corridors' lanes are among `by`, both below `count`."""
        return np.isin(lane * count + rows, lane_by * count + by)

    vertices, corridors = max(len(a), len(b)), max(len(a.tail), len(b.tail))
    left_a, passed_a = (np.minimum(row, a.reverse[row]) for row in (leave_a, in_a.edge))
    left_b, passed_b = (np.minimum(row, b.reverse[row]) for row in (leave_b, in_b.edge))
    left_out = explained(left_a, lane_b, passed_a, corridors)
    left_out |= explained(end_a, lane_a, in_b.vertex, vertices)
    left_out |= explained(left_b, lane_a, passed_b, corridors)
    left_out |= explained(end_b, lane_b, in_a.vertex, vertices)
    of_a, of_b = (lanes.a, lanes.of_a[lane]), (lanes.b, lanes.of_b[lane])
    left_out |= _unreported_bends(of_a, of_b, end_b) | _unreported_bends(of_b, of_a, end_a)
    return lane[~left_out], leave_a[~left_out], leave_b[~left_out]


def _diverging(grown: Grown, searched: BoolArray) -> tuple[IntArray, IntArray, IntArray]:
    """Pairs of corridors that leave matched junctions by the same branch, but end at vertices that
    are not matched: (k,) lane, directed rows of a and of b. searched: (l,) lanes to look at."""
    lanes, a, b = grown.lanes, grown.lanes.a.whole, grown.lanes.b.whole
    matches = searched[grown.lane].nonzero()[0]
    va, row, lane = grown.a[matches], grown.row[matches], grown.lane[matches]
    vb = lanes.vertex[row]
    k, branch_a, branch_b = common_branches(a, b, va, vb, grown.turn[row])
    leave_a, leave_b = a.by_branch[va[k], branch_a], b.by_branch[vb[k], branch_b]
    driven = ((leave_a >= 0) & (leave_b >= 0)).nonzero()[0]
    lane, leave_a, leave_b = lane[k[driven]], leave_a[driven], leave_b[driven]
    partner = np.full(len(lanes.lane), -1)
    partner[grown.row] = grown.a
    differ = partner[b.head[leave_b] + lanes.shift[lane]] != a.head[leave_a]
    return lane[differ], leave_a[differ], leave_b[differ]


def _elsewhere_bits(grown: Grown) -> FloatArray:
    """(l,) weight of a corridor that leads elsewhere."""
    fault = sum(
        MATCH.fault_floor + (atlas.miss_rate + atlas.phantom_rate)[of]
        for atlas, of in ((grown.lanes.a, grown.lanes.of_a), (grown.lanes.b, grown.lanes.of_b))
    )
    bits = np.log2(MATCH.elsewhere_share / np.asarray(fault))
    return np.minimum(np.maximum(bits, 0.0), MATCH.most_bits)


def _predicted_points(
    grown: Grown, lane: IntArray, rows: IntArray
) -> tuple[ComplexArray, FloatArray]:
    """Points of b's corridors in the frame of a, x + iy [m], interpolated between the predictions
    of both ends, and their uncertainty [m], (k,) each.

    lane: (k,); rows: (k,) rows of b's `points`.
    """
    b, shift = grown.lanes.b.whole, grown.lanes.shift[lane]
    tail, head, z = b.points.tail[rows], b.points.head[rows], b.points.z[rows]
    at_tail, at_head = tail + shift, head + shift
    by_tail = grown.place[at_tail] + grown.turn[at_tail] * (z - b.z[tail])
    by_head = grown.place[at_head] + grown.turn[at_head] * (z - b.z[head])
    drift_m = MATCH.drift_per_m * np.maximum(grown.support_m[at_tail], grown.support_m[at_head])
    return by_tail + b.points.share[rows] * (by_head - by_tail), drift_m


def _unseen_bits(
    blind: tuple[Atlas, IntArray], edge: IntArray, seeing: tuple[Atlas, IntArray], vertex: IntArray
) -> FloatArray:
    """(k,) weight [bits] of a junction that only one run detected: the one run missed it on every
    traversal, or the other one invented it on every pass; less for a junction of low confidence.

    blind, seeing: an atlas, and the rows (k,) of the maps in it; edge: (k,) corridors of the blind
    maps; vertex: (k,) junctions of the seeing maps.
    """
    (blind_atlas, blind_map), (seeing_atlas, seeing_map) = blind, seeing
    miss, invent = blind_atlas.miss_rate[blind_map], seeing_atlas.phantom_rate[seeing_map]
    traversals, passes = blind_atlas.whole.traversals[edge], seeing_atlas.whole.observations[vertex]
    missed = (miss + MATCH.fault_floor) ** np.minimum(traversals, 3)
    invented = (invent + MATCH.fault_floor) ** np.minimum(passes, 3)
    nats = np.maximum(np.log(np.minimum(missed + invented, 1.0)), -LIKELIHOOD.most)
    nats[_unreported_bends(blind, seeing, vertex)] = 0.0
    return -doubted(nats, np.log(seeing_atlas.whole.confidence[vertex])) / BIT


def _unreported_bends(
    blind: tuple[Atlas, IntArray], seeing: tuple[Atlas, IntArray], vertex: IntArray
) -> BoolArray:
    """(k,) whether vertices of the seeing maps are bends, which the blind maps do not report."""
    bend = seeing[0].whole.count[vertex] == 2
    return np.asarray(bend & ~blind[0].shows_bends[blind[1]])


def _unseen_b(grown: Grown, near: BoolArray) -> AllUnseen:
    """Unmatched vertices of b well inside corridors of a. near: (t,) rows whose predictions are
    certain enough, and that are searched."""
    lanes, a = grown.lanes, grown.lanes.a.whole
    unmatched = near.copy()
    unmatched[grown.row] = False
    rows = unmatched.nonzero()[0]
    place, lane = grown.place[rows], lanes.lane[rows]
    end_m = MATCH.clear_m + MATCH.drift_per_m * grown.support_m[rows]
    gap, point = lanes.nearest(place, lane, BESIDE_M, corridors=True)
    near_corridor = (gap < BESIDE_M).nonzero()[0]
    rows, lane, point = rows[near_corridor], lane[near_corridor], point[near_corridor]
    place, end_m = place[near_corridor], end_m[near_corridor]
    across_m = np.abs(((place - a.points.z[point]) * a.points.direction[point].conj()).imag)
    farthest_m = np.zeros(len(lanes))
    np.maximum.at(farthest_m, lane, end_m)
    inside = (across_m < MATCH.gate_m) & (lanes.nearest(place, lane, farthest_m)[0] > end_m)
    vertex, edge, lane = lanes.vertex[rows[inside]], a.points.edge[point[inside]], lane[inside]
    bits = _unseen_bits((lanes.a, lanes.of_a[lane]), edge, (lanes.b, lanes.of_b[lane]), vertex)
    return lane, Unseen(vertex, edge, bits)


def _unseen_a(grown: Grown, near: BoolArray) -> AllUnseen:
    """Unmatched vertices of a well inside corridors of b. near: as in `_unseen_b`."""
    lanes, a, b = grown.lanes, grown.lanes.a.whole, grown.lanes.b.whole
    lane, rows = lanes.rows_of(lanes.b.point)
    shift = lanes.shift[lane]
    believed = (near[b.points.tail[rows] + shift] & near[b.points.head[rows] + shift]).nonzero()[0]
    lane, rows = lane[believed], rows[believed]
    place, drift_m = _predicted_points(grown, lane, rows)
    inside = (b.points.end_m[rows] > MATCH.clear_m + drift_m).nonzero()[0]
    lane, rows, place = lane[inside], rows[inside], place[inside]
    gap, vertex = lanes.nearest(place, lane, BESIDE_M)
    beside = (gap < BESIDE_M).nonzero()[0]
    slot = vertex[beside] + lanes.shift_a[lane[beside]]
    matched = np.zeros(int(lanes.first_a[-1]), np.bool_)
    matched[grown.a + lanes.shift_a[grown.lane]] = True
    unmatched = ~matched[slot]
    beside, slot = beside[unmatched], slot[unmatched]
    lane, rows, place, vertex = lane[beside], rows[beside], place[beside], vertex[beside]
    direction = grown.turn[b.points.tail[rows] + lanes.shift[lane]] * b.points.direction[rows]
    crossed = np.abs(((a.z[vertex] - place) * direction.conj()).imag) < MATCH.gate_m
    once = crossed.nonzero()[0][np.unique(slot[crossed], return_index=True)[1]]
    lane, vertex, edge = lane[once], vertex[once], b.points.edge[rows[once]]
    bits = _unseen_bits((lanes.b, lanes.of_b[lane]), edge, (lanes.a, lanes.of_a[lane]), vertex)
    return lane, Unseen(vertex, edge, bits)
