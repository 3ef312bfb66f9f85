"""What speaks against a match: what one run drove through and the other says is there, in bits."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from .branches import common_branches
from .growth import Match
from .prepare import BoolArray, ComplexArray, FloatArray, IntArray, Prepared
from .settings import MATCH

BESIDE_M = float(np.hypot(MATCH.sample_m / 2, MATCH.beside_m))
"""What lies in a corridor lies so near to one of the points that stand for it."""


@dataclass(frozen=True, slots=True, eq=False)
class Conflicts:
    """Contradictions. extra_b: vertices of b inside corridors of a (extra_b_in: directed rows),
    unseen there; extra_a, extra_a_in: the reverse; extra_b_bits, extra_a_bits: the weight of each,
    positive; elsewhere: (k, 2) directed corridors of a and b that leave matched
    junctions by the same branch and lead to others; elsewhere_bits: the weight of one."""

    extra_b: IntArray
    extra_b_in: IntArray
    extra_b_bits: FloatArray
    extra_a: IntArray
    extra_a_in: IntArray
    extra_a_bits: FloatArray
    elsewhere: IntArray
    elsewhere_bits: float

    @property
    def bits(self) -> float:
        """Their weight in all, positive."""
        unseen = float(self.extra_b_bits.sum()) + float(self.extra_a_bits.sum())
        return unseen + self.elsewhere_bits * len(self.elsewhere)

    def __len__(self) -> int:
        return len(self.extra_b) + len(self.extra_a) + len(self.elsewhere)


@dataclass(frozen=True, slots=True)
class Contradiction:
    """One of them. of_a, of_b: the vertices of the two maps that it is about, one or the two ends
    of a corridor; bits: its weight, positive."""

    kind: Literal["unseen", "elsewhere"]
    of_a: tuple[int, ...]
    of_b: tuple[int, ...]
    bits: float


def one_by_one(found: Conflicts, a: Prepared, b: Prepared) -> list[Contradiction]:
    """All contradictions of a match, unseen junctions first."""
    extra_b = zip(
        found.extra_b.tolist(), found.extra_b_in.tolist(), found.extra_b_bits, strict=True
    )
    extra_a = zip(
        found.extra_a.tolist(), found.extra_a_in.tolist(), found.extra_a_bits, strict=True
    )
    return [
        *(Contradiction("unseen", _ends(a, row), (v,), float(bits)) for v, row, bits in extra_b),
        *(Contradiction("unseen", (v,), _ends(b, row), float(bits)) for v, row, bits in extra_a),
        *(
            Contradiction("elsewhere", _ends(a, row_a), _ends(b, row_b), found.elsewhere_bits)
            for row_a, row_b in found.elsewhere.tolist()
        ),
    ]


def _ends(m: Prepared, row: int) -> tuple[int, int]:
    return int(m.tail[row]), int(m.head[row])


_NONE, _FREE = np.zeros(0, np.int64), np.zeros(0)
_NO_PAIRS = np.zeros((0, 2), np.int64)
NO_CONFLICTS = Conflicts(_NONE, _NONE, _FREE, _NONE, _NONE, _FREE, _NO_PAIRS, 0.0)


def conflicts(a: Prepared, b: Prepared, match: Match) -> Conflicts:
    """The contradictions of a match. O(points · log points). A corridor tells one thing once: where
    it passes a junction unseen, it does not lead elsewhere as well."""
    near = match.support_m < MATCH.near_m
    extra_b, in_a, bits_b = _extra_b(a, b, match, near)
    extra_a, in_b, bits_a = _extra_a(a, b, match, near)
    found = Conflicts(extra_b, in_a, bits_b, extra_a, in_b, bits_a, _NO_PAIRS, 0.0)
    return _with_elsewhere(a, b, match, found)


def _with_elsewhere(a: Prepared, b: Prepared, match: Match, found: Conflicts) -> Conflicts:
    """The contradictions, with the corridors that lead elsewhere and that none of them explains."""
    row, branch_a, branch_b = common_branches(a, b, match.a, match.b, match.turn[match.b])
    leave_a = a.by_branch[match.a[row], branch_a]
    leave_b = b.by_branch[match.b[row], branch_b]
    driven = (leave_a >= 0) & (leave_b >= 0)
    leave_a, leave_b = leave_a[driven], leave_b[driven]
    partner = np.full(len(b), -1)
    partner[match.b] = match.a
    far_a, far_b = a.head[leave_a], b.head[leave_b]
    told_a, told_b = found.extra_b_in, found.extra_a_in
    half_a, half_b = max(len(a.tail) // 2, 1), max(len(b.tail) // 2, 1)
    explained = np.isin(leave_a % half_a, told_a % half_a) | np.isin(far_a, found.extra_a)
    explained |= np.isin(leave_b % half_b, told_b % half_b) | np.isin(far_b, found.extra_b)
    astray = (partner[far_b] != far_a) & ~explained
    fault = sum(MATCH.fault_floor + m.noise.miss_rate + m.noise.phantom_rate for m in (a, b))
    weight = min(max(float(np.log2(MATCH.elsewhere_share / fault)), 0.0), MATCH.most_bits)
    rows = np.column_stack([leave_a[astray], leave_b[astray]])
    return replace(found, elsewhere=rows, elsewhere_bits=weight)


def _placed_road(b: Prepared, match: Match, rows: IntArray) -> tuple[ComplexArray, FloatArray]:
    """b's corridor points in a, between the predictions of their two ends, and how vague they are.

    Rows name points of directed corridors of the first half, tail to head.
    """
    tail, head, road = b.road_tail[rows], b.road_head[rows], b.road[rows]
    by_tail = match.place[tail] + match.turn[tail] * (road - b.z[tail])
    by_head = match.place[head] + match.turn[head] * (road - b.z[head])
    vague = MATCH.drift_per_m * np.maximum(match.support_m[tail], match.support_m[head])
    return by_tail + b.road_share[rows] * (by_head - by_tail), vague


def _weight(missing: Prepared, edge: IntArray, extra: Prepared, vertex: IntArray) -> FloatArray:
    """(k,) bits against: the one run drove the corridor and missed it each time, or the other one
    invented it at each look."""
    missed = (missing.noise.miss_rate + MATCH.fault_floor) ** np.minimum(
        missing.traversals[edge], 3
    )
    invented = (extra.noise.phantom_rate + MATCH.fault_floor) ** np.minimum(extra.looks[vertex], 3)
    bits = -np.log2(np.minimum(missed + invented, 1.0))
    return np.asarray(np.minimum(bits, MATCH.most_bits))


def _extra_b(
    a: Prepared, b: Prepared, match: Match, near: BoolArray
) -> tuple[IntArray, IntArray, FloatArray]:
    """Unmatched vertices of b well inside corridors of a."""
    alone = near.copy()
    alone[match.b] = False
    lone = alone.nonzero()[0]
    if len(lone) == 0 or len(a.road) == 0:
        return _NONE, _NONE, _FREE
    where = match.place[lone]
    off_end = MATCH.clear_m + MATCH.drift_per_m * match.support_m[lone]
    gap, road = a.road_sites.nearest(where, BESIDE_M)
    beside = (gap < BESIDE_M).nonzero()[0]
    lone, where, road, off_end = lone[beside], where[beside], road[beside], off_end[beside]
    across = np.abs(((where - a.road[road]) * a.road_dir[road].conj()).imag)
    inside = (across < MATCH.beside_m) & (
        a.sites.nearest(where, float(off_end.max(initial=0)))[0] > off_end
    )
    vertex, edge = lone[inside], a.road_edge[road[inside]]
    return vertex, edge, _weight(a, edge, b, vertex)


def _extra_a(
    a: Prepared, b: Prepared, match: Match, near: BoolArray
) -> tuple[IntArray, IntArray, FloatArray]:
    """Unmatched vertices of a beside points of b's corridors."""
    rows = (near[b.road_tail] & near[b.road_head]).nonzero()[0]
    place, vague = _placed_road(b, match, rows)
    inner = b.road_end[rows] > MATCH.clear_m + vague
    rows, place = rows[inner], place[inner]
    gap, vertex = a.sites.nearest(place, BESIDE_M)
    taken = np.zeros(len(a) + 1, np.bool_)  # the last is what the search calls none
    taken[match.a] = True
    beside = ((gap < BESIDE_M) & ~taken[vertex]).nonzero()[0]
    rows, place, vertex = rows[beside], place[beside], vertex[beside]
    turned = match.turn[b.road_tail[rows]] * b.road_dir[rows]
    hit = np.abs(((a.z[vertex] - place) * turned.conj()).imag) < MATCH.beside_m
    extra, first = np.unique(vertex[hit], return_index=True)
    edge = b.road_edge[rows[hit][first]]
    return extra, edge, _weight(b, edge, a, extra)
