"""What speaks against a match: what one run drove through and the other says is there, in bits."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from .branches import common_branches
from .growth import Match
from .prepare import BoolArray, ComplexArray, FloatArray, IntArray, Prepared

TRUSTED_M = 10.0
"""Contradictions count only this near to a match: farther off the prediction is too vague."""

VAGUE_PER_M = 0.04
"""What a prediction may be off by, per metre to the nearest match."""

OFF_END_M = 1.2
"""Nearer than this to a junction a corridor is that junction's own."""

ON_ROAD_M = 0.45
CROSSING = 0.64
"""Cosine of the angle between two corridors (50°) from which on they cross, not run together."""

ELSEWHERE_SHARE = 0.25
"""Of the corridors that two runs drove by one branch of a falsely matched junction so many lead
elsewhere (mazes .45, tiles .28, offices .12, on maps made by `benchmarks/observed.py`)."""

ELSEWHERE_FAULT = 0.02
"""Of a rightly matched one, beside those that a missed or an invented junction explains."""

CONFLICT_BITS = 6.0
"""No single contradiction weighs more: each may be a fault that no rate foresaw."""


@dataclass(frozen=True, slots=True, eq=False)
class Conflicts:
    """Contradictions. extra_b: vertices of b inside corridors of a (extra_b_in: directed rows),
    unseen there; extra_a, extra_a_in: the reverse; extra_b_bits, extra_a_bits: the weight of each,
    positive; crossing: (k, 2) directed corridors of a and b that cross where neither has a
    junction, CONFLICT_BITS each; elsewhere: (k, 2) directed corridors of a and b that leave matched
    junctions by the same branch and lead to others; elsewhere_bits: the weight of one."""

    extra_b: IntArray
    extra_b_in: IntArray
    extra_b_bits: FloatArray
    extra_a: IntArray
    extra_a_in: IntArray
    extra_a_bits: FloatArray
    crossing: IntArray
    elsewhere: IntArray
    elsewhere_bits: float

    @property
    def bits(self) -> float:
        """Their weight in all, positive."""
        unseen = float(self.extra_b_bits.sum()) + float(self.extra_a_bits.sum())
        astray = self.elsewhere_bits * len(self.elsewhere)
        return unseen + CONFLICT_BITS * len(self.crossing) + astray

    def __len__(self) -> int:
        unseen = len(self.extra_b) + len(self.extra_a)
        return unseen + len(self.crossing) + len(self.elsewhere)


@dataclass(frozen=True, slots=True)
class Contradiction:
    """One of them. of_a, of_b: the vertices of the two maps that it is about, one or the two ends
    of a corridor; bits: its weight, positive."""

    kind: Literal["unseen", "crossing", "elsewhere"]
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
            Contradiction("crossing", _ends(a, row_a), _ends(b, row_b), CONFLICT_BITS)
            for row_a, row_b in found.crossing.tolist()
        ),
        *(
            Contradiction("elsewhere", _ends(a, row_a), _ends(b, row_b), found.elsewhere_bits)
            for row_a, row_b in found.elsewhere.tolist()
        ),
    ]


def _ends(m: Prepared, row: int) -> tuple[int, int]:
    return int(m.tail[row]), int(m.head[row])


_NONE, _FREE = np.zeros(0, np.int64), np.zeros(0)
_NO_PAIRS = np.zeros((0, 2), np.int64)
NO_CONFLICTS = Conflicts(_NONE, _NONE, _FREE, _NONE, _NONE, _FREE, _NO_PAIRS, _NO_PAIRS, 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class _Points:
    """Points of b laid into a. where: (k,) positions; vague: (k,) [m]; vertex, gap_v: nearest
    vertex of a and its distance; road, gap_r: nearest point of a corridor of a."""

    where: ComplexArray
    vague: FloatArray
    vertex: IntArray
    gap_v: FloatArray
    road: IntArray
    gap_r: FloatArray


def conflicts(a: Prepared, b: Prepared, match: Match) -> Conflicts:
    """The contradictions of a match. O(points · log points). A corridor tells one thing once: where
    it passes a junction unseen, or crosses another, it does not lead elsewhere as well.

    Strategy: the points of b's corridors and b's unmatched vertices are placed in a; one look into
    the tree of a's junctions and one into the tree of a's corridor points answer all questions.
    """
    near = match.support_m < TRUSTED_M
    alone = near.copy()
    alone[match.b] = False
    lone = alone.nonzero()[0]
    rows = (near[b.road_tail] & near[b.road_head]).nonzero()[0]
    if len(a.road) == 0 or len(lone) + len(rows) == 0:
        return _with_elsewhere(a, b, match, NO_CONFLICTS)
    place, vague = _placed_road(b, match, rows)
    inner = (b.road_end[rows] > OFF_END_M + vague).nonzero()[0]
    rows, place, vague = rows[inner], place[inner], vague[inner]
    spots = _look(
        a,
        np.concatenate([match.place[lone], place]),
        np.concatenate([VAGUE_PER_M * match.support_m[lone], vague]),
    )
    extra_b, in_a, bits_b = _extra_b(a, b, lone, spots)
    taken = np.zeros(len(a), np.bool_)
    taken[match.a] = True
    road = _tail_of(spots, len(lone))
    turned = match.turn[b.road_tail[rows]] * b.road_dir[rows]
    extra_a, in_b, bits_a = _extra_a(a, b, taken, rows=rows, turned=turned, road=road)
    crossing = _crossings(a, b, rows, turned, road)
    found = Conflicts(extra_b, in_a, bits_b, extra_a, in_b, bits_a, crossing, _NO_PAIRS, 0.0)
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
    told_a = np.concatenate([found.extra_b_in, found.crossing[:, 0]])
    told_b = np.concatenate([found.extra_a_in, found.crossing[:, 1]])
    half_a, half_b = max(len(a.tail) // 2, 1), max(len(b.tail) // 2, 1)
    explained = np.isin(leave_a % half_a, told_a % half_a) | np.isin(far_a, found.extra_a)
    explained |= np.isin(leave_b % half_b, told_b % half_b) | np.isin(far_b, found.extra_b)
    astray = (partner[far_b] != far_a) & ~explained
    fault = ELSEWHERE_FAULT + sum(m.noise.miss_rate + m.noise.phantom_rate for m in (a, b))
    weight = min(max(float(np.log2(ELSEWHERE_SHARE / fault)), 0.0), CONFLICT_BITS)
    rows = np.column_stack([leave_a[astray], leave_b[astray]])
    return replace(found, elsewhere=rows, elsewhere_bits=weight)


def _placed_road(b: Prepared, match: Match, rows: IntArray) -> tuple[ComplexArray, FloatArray]:
    """b's corridor points in a, between the predictions of their two ends, and how vague they are.

    Rows name points of directed corridors of the first half, tail to head.
    """
    tail, head, road = b.road_tail[rows], b.road_head[rows], b.road[rows]
    by_tail = match.place[tail] + match.turn[tail] * (road - b.z[tail])
    by_head = match.place[head] + match.turn[head] * (road - b.z[head])
    vague = VAGUE_PER_M * np.maximum(match.support_m[tail], match.support_m[head])
    return by_tail + b.road_share[rows] * (by_head - by_tail), vague


def _look(a: Prepared, where: ComplexArray, vague: FloatArray) -> _Points:
    gap_v, vertex = a.sites.nearest(where, 2.0)
    gap_r, road = a.road_sites.nearest(where, 0.8)
    return _Points(where, vague, vertex, gap_v, road, gap_r)


def _tail_of(p: _Points, k: int) -> _Points:
    return _Points(p.where[k:], p.vague[k:], p.vertex[k:], p.gap_v[k:], p.road[k:], p.gap_r[k:])


def _weight(missing: Prepared, edge: IntArray, extra: Prepared, vertex: IntArray) -> FloatArray:
    """(k,) bits against: the one run drove the corridor and missed it each time, or the other one
    invented it at each look."""
    missed = (missing.noise.miss_rate + 0.015) ** np.minimum(missing.traversals[edge], 3)
    invented = (extra.noise.phantom_rate + 0.01) ** np.minimum(extra.looks[vertex], 3)
    bits = -np.log2(np.minimum(missed + invented, 1.0))
    return np.asarray(np.minimum(bits, CONFLICT_BITS))


def _extra_b(
    a: Prepared, b: Prepared, lone: IntArray, spots: _Points
) -> tuple[IntArray, IntArray, FloatArray]:
    """Unmatched vertices of b (the first of the spots) well inside corridors of a."""
    k = len(lone)
    beside = (spots.gap_r[:k] < 0.8) & (spots.gap_v[:k] > OFF_END_M + spots.vague[:k])
    inside = beside.nonzero()[0]
    if len(inside) == 0:
        return inside, inside, _FREE
    r = spots.road[inside]
    across = np.abs(((spots.where[inside] - a.road[r]) * a.road_dir[r].conj()).imag)
    hit = across < ON_ROAD_M
    vertex, edge = lone[inside[hit]], a.road_edge[r[hit]]
    return vertex, edge, _weight(a, edge, b, vertex)


def _extra_a(
    a: Prepared,
    b: Prepared,
    taken: BoolArray,
    *,
    rows: IntArray,
    turned: ComplexArray,
    road: _Points,
) -> tuple[IntArray, IntArray, FloatArray]:
    """Unmatched vertices of a beside points of b's corridors."""
    near = (road.gap_v < 0.8).nonzero()[0]
    near = near[~taken[road.vertex[near]]]
    if len(near) == 0:
        return near, near, _FREE
    across = np.abs(((a.z[road.vertex[near]] - road.where[near]) * turned[near].conj()).imag)
    near = near[across < ON_ROAD_M]
    extra, first = np.unique(road.vertex[near], return_index=True)
    edge = b.road_edge[rows[near[first]]]
    return extra, edge, _weight(b, edge, a, extra)


def _crossings(
    a: Prepared, b: Prepared, rows: IntArray, turned: ComplexArray, road: _Points
) -> IntArray:
    """Corridors of a and b that cross away from every junction."""
    near = ((road.gap_r < 0.55) & (road.gap_v > OFF_END_M + 0.2 + road.vague)).nonzero()[0]
    r = road.road[near]
    along = np.abs((turned[near] * a.road_dir[r].conj()).real)
    across = along < CROSSING
    if not across.any():
        return NO_CONFLICTS.crossing
    key = np.unique(a.road_edge[r[across]] * len(b.tail) + b.road_edge[rows[near[across]]])
    return np.stack([key // max(len(b.tail), 1), key % max(len(b.tail), 1)], axis=1)
