"""Evidence [bits] against a match: junctions of one run inside corridors that the other drove
without detecting them, and corridors that lead elsewhere."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise, starmap
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
"""Upper bound of the distance of a point in a corridor from the nearest sample point of it [m]."""


@dataclass(frozen=True, slots=True, eq=False)
class Unseen:
    """Vertices of one map (k,) inside directed corridors of the other (edge), undetected there, and
    the weight of each, positive [bits]."""

    vertex: IntArray
    edge: IntArray
    bits: FloatArray

    def __len__(self) -> int:
        return len(self.vertex)


@dataclass(frozen=True, slots=True, eq=False)
class Conflicts:
    """Contradictions.

    in_a: vertices of b inside corridors of a; in_b: the reverse; elsewhere: (k, 2) directed
    corridors of a and b that leave matched junctions by the same branch and lead to different ones;
    elsewhere_bits: the weight of one.
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
        """As how many junctions they weigh: each as its bits, of which `MATCH.junction_bits` are
        one, at most one."""
        unseen = np.concatenate([self.in_a.bits, self.in_b.bits]) / MATCH.junction_bits
        elsewhere = min(self.elsewhere_bits / MATCH.junction_bits, 1.0)
        return float(np.minimum(unseen, 1.0).sum()) + elsewhere * len(self.elsewhere)

    def __len__(self) -> int:
        return len(self.in_a) + len(self.in_b) + len(self.elsewhere)

    def bounded(self, in_a: FloatArray, in_b: FloatArray) -> Conflicts:
        """The same, undetected junctions with bounded weights [bits]."""
        bounded = ((self.in_a, in_a), (self.in_b, in_b))
        unseen = [replace(x, bits=np.minimum(x.bits, most)) for x, most in bounded]
        return replace(self, in_a=unseen[0], in_b=unseen[1])


@dataclass(frozen=True, slots=True)
class Contradiction:
    """A single contradiction.

    of_a, of_b: the vertices of the two maps that it concerns, one or the two ends of a corridor;
    bits: its weight, positive.
    """

    kind: Literal["unseen", "elsewhere"]
    of_a: tuple[int, ...]
    of_b: tuple[int, ...]
    bits: float

    def sentence(self, run_a: str, run_b: str) -> str:
        """What contradicts the match of two runs."""
        one, two = (" to ".join(map(str, ends)) for ends in (self.of_a, self.of_b))
        if self.kind == "elsewhere":
            return (
                f"corridor {one} of {run_a} and corridor {two} of {run_b} "
                "leave the same junction by the same branch and lead to different ones"
            )
        if len(self.of_a) > 1:
            one, two, run_a, run_b = two, one, run_b, run_a
        return f"junction {one} of {run_a} falls inside corridor {two} of {run_b}, unseen there"


def one_by_one(found: Conflicts, a: Prepared, b: Prepared) -> list[Contradiction]:
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


@dataclass(frozen=True, slots=True, eq=False)
class _Found:
    """Vertices inside corridors of all lanes, numbered as in the atlases, as `Unseen`; sorted by
    lane."""

    lane: IntArray
    vertex: IntArray
    edge: IntArray
    bits: FloatArray

    def by_lane(self, first_vertex: IntArray, first_edge: IntArray) -> list[Unseen]:
        """Those of each lane with a weight above 0, as its maps number them; first_vertex,
        first_edge: (l,) first rows of its two maps."""
        own = take(self, self.bits.nonzero()[0])
        vertex, edge = own.vertex - first_vertex[own.lane], own.edge - first_edge[own.lane]
        rows = starmap(slice, pairwise(cuts(own.lane, len(first_vertex))))
        return [Unseen(vertex[k], edge[k], own.bits[k]) for k in rows]


def conflicts(grown: Grown, searched: BoolArray) -> list[Conflicts]:
    """The contradictions of the match in each lane of `searched`; none for the others.

    O(points · log points). A corridor counts once: one that passes an undetected junction does not
    also lead elsewhere.
    """
    lanes = grown.lanes
    near = (grown.support_m < MATCH.near_m) & searched[lanes.lane]
    extra_b, extra_a = _extra_b(grown, near), _extra_a(grown, near)
    lane, leave_a, leave_b = _elsewhere(grown, searched, extra_b, extra_a)
    corridor_a, corridor_b = lanes.a.corridor[lanes.of_a], lanes.b.corridor[lanes.of_b]
    in_a = extra_b.by_lane(lanes.b.vertex[lanes.of_b], corridor_a)
    in_b = extra_a.by_lane(lanes.a.vertex[lanes.of_a], corridor_b)
    rows = np.column_stack([leave_a - corridor_a[lane], leave_b - corridor_b[lane]])
    weight, first = _elsewhere_bits(grown).tolist(), cuts(lane, len(lanes))
    out = [NO_CONFLICTS] * len(lanes)
    for k in searched.nonzero()[0].tolist():
        out[k] = Conflicts(in_a[k], in_b[k], rows[first[k] : first[k + 1]], weight[k])
    return out


def _elsewhere(
    grown: Grown, searched: BoolArray, extra_b: _Found, extra_a: _Found
) -> tuple[IntArray, IntArray, IntArray]:
    """Corridors that leave matched junctions by one branch and lead to different ones: lane,
    directed rows of both maps. Without those that an undetected junction explains, on the way or at
    the end, and those that end at a bend which the other detector does not report."""
    lanes, a, b = grown.lanes, grown.lanes.a.whole, grown.lanes.b.whole
    lane, leave_a, leave_b = _astray(grown, searched)
    far_a, far_b = a.head[leave_a], b.head[leave_b]

    def concerned(of_lane: IntArray, what: IntArray, wanted: IntArray, most: int) -> BoolArray:
        """Whether a contradiction (`of_lane`, `what`) of the same lane concerns `wanted`
        already; indices are below `most`."""
        return np.isin(lane * most + wanted, of_lane * most + what)

    vertices, corridors = max(len(a), len(b)), max(len(a.tail), len(b.tail))
    either_a, passed_a = (np.minimum(row, a.reverse[row]) for row in (leave_a, extra_b.edge))
    either_b, passed_b = (np.minimum(row, b.reverse[row]) for row in (leave_b, extra_a.edge))
    explained = concerned(extra_b.lane, passed_a, either_a, corridors)
    explained |= concerned(extra_a.lane, extra_a.vertex, far_a, vertices)
    explained |= concerned(extra_a.lane, passed_b, either_b, corridors)
    explained |= concerned(extra_b.lane, extra_b.vertex, far_b, vertices)
    of_a, of_b = (lanes.a, lanes.of_a[lane]), (lanes.b, lanes.of_b[lane])
    explained |= _never_shown(of_a, of_b, far_b) | _never_shown(of_b, of_a, far_a)
    left = ~explained
    return lane[left], leave_a[left], leave_b[left]


def _astray(grown: Grown, searched: BoolArray) -> tuple[IntArray, IntArray, IntArray]:
    """All corridors that both runs drove from matched junctions by one branch, and that lead to
    vertices which are not matched with each other: lane, directed rows of both maps."""
    lanes, a, b = grown.lanes, grown.lanes.a.whole, grown.lanes.b.whole
    some = searched[grown.lane].nonzero()[0]
    va, row, lane = grown.a[some], grown.row[some], grown.lane[some]
    vb = lanes.vertex[row]
    k, branch_a, branch_b = common_branches(a, b, va, vb, grown.turn[row])
    leave_a, leave_b = a.by_branch[va[k], branch_a], b.by_branch[vb[k], branch_b]
    driven = ((leave_a >= 0) & (leave_b >= 0)).nonzero()[0]
    lane, leave_a, leave_b = lane[k[driven]], leave_a[driven], leave_b[driven]
    partner = np.full(len(lanes.lane), -1)
    partner[grown.row] = grown.a
    astray = partner[b.head[leave_b] + lanes.shift[lane]] != a.head[leave_a]
    return lane[astray], leave_a[astray], leave_b[astray]


def _elsewhere_bits(grown: Grown) -> FloatArray:
    """(l,) weight of a corridor that leads elsewhere."""
    fault = sum(
        MATCH.fault_floor + (atlas.miss_rate + atlas.phantom_rate)[of]
        for atlas, of in ((grown.lanes.a, grown.lanes.of_a), (grown.lanes.b, grown.lanes.of_b))
    )
    bits = np.log2(MATCH.elsewhere_share / np.asarray(fault))
    return np.minimum(np.maximum(bits, 0.0), MATCH.most_bits)


def _placed_points(grown: Grown, lane: IntArray, rows: IntArray) -> tuple[ComplexArray, FloatArray]:
    """Points of b's corridors in the frame of a, interpolated between the predictions of both ends,
    and their uncertainty [m], (k,) each.

    lane: (k,); rows: (k,) rows of b's `points`.
    """
    b, shift = grown.lanes.b.whole, grown.lanes.shift[lane]
    tail, head, z = b.points.tail[rows], b.points.head[rows], b.points.z[rows]
    at_tail, at_head = tail + shift, head + shift
    by_tail = grown.place[at_tail] + grown.turn[at_tail] * (z - b.z[tail])
    by_head = grown.place[at_head] + grown.turn[at_head] * (z - b.z[head])
    vague = MATCH.drift_per_m * np.maximum(grown.support_m[at_tail], grown.support_m[at_head])
    return by_tail + b.points.share[rows] * (by_head - by_tail), vague


def _weight(
    missing: tuple[Atlas, IntArray], edge: IntArray, extra: tuple[Atlas, IntArray], vertex: IntArray
) -> FloatArray:
    """(k,) weight [bits] of a junction that only one run detected: the one run missed it on every
    traversal, or the other one invented it on every pass; less for a junction of low confidence.

    missing, extra: an atlas, and the map of it in each case.
    """
    blind, seeing = missing[0], extra[0]
    miss, invent = blind.miss_rate[missing[1]], seeing.phantom_rate[extra[1]]
    driven, seen = blind.whole.traversals[edge], seeing.whole.observations[vertex]
    missed = (miss + MATCH.fault_floor) ** np.minimum(driven, 3)
    invented = (invent + MATCH.fault_floor) ** np.minimum(seen, 3)
    nats = np.maximum(np.log(np.minimum(missed + invented, 1.0)), -LIKELIHOOD.most)
    nats[_never_shown(missing, extra, vertex)] = 0.0
    return -doubted(nats, np.log(seeing.whole.confidence[vertex])) / BIT


def _never_shown(
    blind: tuple[Atlas, IntArray], seeing: tuple[Atlas, IntArray], vertex: IntArray
) -> BoolArray:
    """(k,) whether vertices of one map are bends and the detector of the other does not report
    bends."""
    bend = seeing[0].whole.count[vertex] == 2
    return np.asarray(bend & ~blind[0].shows_bends[blind[1]])


def _extra_b(grown: Grown, near: BoolArray) -> _Found:
    """Unmatched vertices of b well inside corridors of a."""
    lanes, a = grown.lanes, grown.lanes.a.whole
    alone = near.copy()
    alone[grown.row] = False
    lone = alone.nonzero()[0]
    where, lane = grown.place[lone], lanes.lane[lone]
    off_end = MATCH.clear_m + MATCH.drift_per_m * grown.support_m[lone]
    gap, point = lanes.nearest(where, lane, BESIDE_M, corridors=True)
    beside = (gap < BESIDE_M).nonzero()[0]
    lone, lane, point = lone[beside], lane[beside], point[beside]
    where, off_end = where[beside], off_end[beside]
    across = np.abs(((where - a.points.z[point]) * a.points.direction[point].conj()).imag)
    farthest = np.zeros(len(lanes))
    np.maximum.at(farthest, lane, off_end)
    inside = (across < MATCH.gate_m) & (lanes.nearest(where, lane, farthest)[0] > off_end)
    vertex, edge, lane = lanes.vertex[lone[inside]], a.points.edge[point[inside]], lane[inside]
    bits = _weight((lanes.a, lanes.of_a[lane]), edge, (lanes.b, lanes.of_b[lane]), vertex)
    return _Found(lane, vertex, edge, bits)


def _extra_a(grown: Grown, near: BoolArray) -> _Found:
    """Unmatched vertices of a beside points of b's corridors."""
    lanes, a, b = grown.lanes, grown.lanes.a.whole, grown.lanes.b.whole
    lane, rows = lanes.rows_of(lanes.b.point)
    shift = lanes.shift[lane]
    seen = (near[b.points.tail[rows] + shift] & near[b.points.head[rows] + shift]).nonzero()[0]
    lane, rows = lane[seen], rows[seen]
    place, vague = _placed_points(grown, lane, rows)
    inner = (b.points.end_m[rows] > MATCH.clear_m + vague).nonzero()[0]
    lane, rows, place = lane[inner], rows[inner], place[inner]
    gap, vertex = lanes.nearest(place, lane, BESIDE_M)
    beside = (gap < BESIDE_M).nonzero()[0]
    slot = vertex[beside] + lanes.shift_a[lane[beside]]
    taken = np.zeros(int(lanes.first_a[-1]), np.bool_)
    taken[grown.a + lanes.shift_a[grown.lane]] = True
    free = ~taken[slot]
    beside, slot = beside[free], slot[free]
    lane, rows, place, vertex = lane[beside], rows[beside], place[beside], vertex[beside]
    turned = grown.turn[b.points.tail[rows] + lanes.shift[lane]] * b.points.direction[rows]
    hit = np.abs(((a.z[vertex] - place) * turned.conj()).imag) < MATCH.gate_m
    first = np.unique(slot[hit], return_index=True)[1]
    lane, extra, edge = lane[hit][first], vertex[hit][first], b.points.edge[rows[hit][first]]
    bits = _weight((lanes.b, lanes.of_b[lane]), edge, (lanes.a, lanes.of_a[lane]), extra)
    return _Found(lane, extra, edge, bits)
