"""Evidence [bits] for a match: agreeing junctions and corridors."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from ...topology.arrays import ComplexArray, FloatArray, IntArray
from ...topology.matching.likelihood import BIT
from .atlas import cuts
from .growth import Grown
from .prepare import length_bits
from .settings import MATCH

NEAREST = slice(1, 13)
"""Columns of a junction's neighbours (itself first) that are considered for links."""

CHOICE_BITS = float(np.log2(NEAREST.stop - NEAREST.start))
"""Deducted from a relative position, because it is chosen among so many neighbours."""


@dataclass(frozen=True, slots=True, eq=False)
class Support:
    """Agreement, and its parts.

    corridors: (c, 2) directed rows of corridors that both maps have. ends: (m, 2) rows of the match
    that each link connects; along: (m,) row of `corridors` or, for a relative position, -1; links:
    (m,) bits of each. Links are those of the forest, best first, followed by corridors with
    different lengths. branches: (k,) bits of each matched junction's branches; bits: sum of links
    and branches.
    """

    corridors: IntArray
    ends: IntArray
    along: IntArray
    links: FloatArray
    branches: FloatArray
    bits: float

    def bounded(self, bound: FloatArray) -> Support:
        """The same, what speaks against the match bounded by `most` (k,) at each matched junction,
        at a link by the larger of its two [bits]."""
        links = np.maximum(self.links, -bound[self.ends].max(axis=1, initial=0.0))
        branches = np.maximum(self.branches, -bound)
        change = (links - self.links).sum() + (branches - self.branches).sum()
        return replace(self, links=links, branches=branches, bits=self.bits + float(change))


_NONE, _NO_BITS = np.zeros(0, np.int64), np.zeros(0)
NO_SUPPORT = Support(_NONE.reshape(0, 2), _NONE.reshape(0, 2), _NONE, _NO_BITS, _NO_BITS, 0.0)
"""Of a placement without a matched junction."""


def supports(grown: Grown) -> list[Support]:
    """For each lane the evidence of the branches of all matched junctions and of the best forest of
    links between them.

    A link is a corridor that both maps have (its length is compared), or two close matched
    junctions (their relative position is compared: the corridor between them may have been split by
    a junction that one run missed). A forest counts every place once; a corridor of both maps whose
    lengths differ counts against the match.
    """
    lanes = grown.lanes
    count = len(lanes)
    order = np.full(len(lanes.lane), -1)
    order[grown.row] = np.arange(len(grown.row))
    i, j, rows, bits = _corridor_links(grown, order)
    p, q, near_bits = _near_links(grown, order)
    source, target = np.concatenate([i, p]), np.concatenate([j, q])
    value = np.concatenate([bits, near_bits])
    chosen = _forest(source, target, value, _from_middle(grown))
    lane = grown.lane[source]
    chosen = chosen[np.lexsort((-value[chosen], lane[chosen]))]
    counted = _each_without_repeats(grown, source[chosen], target[chosen], value[chosen])
    misfit = (bits < 0).nonzero()[0]
    against = np.maximum(bits[misfit], -MATCH.most_bits)
    # One by one: the same sums however lanes and links are stored.
    parts = ((lane[chosen], counted), (lane[misfit], against), (grown.lane, grown.branch))
    totals = sum((np.bincount(of, told, count) for of, told in parts), np.zeros(count))
    shown, links = np.concatenate([chosen, misfit]), np.concatenate([counted, against])
    by_lane = lane[shown].argsort(kind="stable")
    shown, links = shown[by_lane], links[by_lane]
    first, first_row = cuts(grown.lane, count), cuts(grown.lane[i], count)
    ends = np.array([source[shown], target[shown]]).T - np.array(first)[lane[shown], None]
    along = np.where(shown < len(bits), shown - np.array(first_row)[lane[shown]], -1)
    first_link = cuts(lane[shown], count)
    return [
        Support(
            corridors=rows[first_row[k] : first_row[k + 1]],
            ends=ends[first_link[k] : first_link[k + 1]],
            along=along[first_link[k] : first_link[k + 1]],
            links=links[first_link[k] : first_link[k + 1]],
            branches=grown.branch[first[k] : first[k + 1]],
            bits=total,
        )
        for k, total in enumerate(totals.tolist())
    ]


def _from_middle(grown: Grown) -> FloatArray:
    """(k,) distance [m] of each matched vertex of b from the centroid of those of its lane."""
    z = grown.lanes.b.whole.z[grown.b]
    count = np.bincount(grown.lane, minlength=len(grown.lanes))
    some = np.flatnonzero(count)
    middle = np.zeros(len(count), np.complex128)
    if len(some):
        first = np.cumsum(count)[some] - count[some]
        middle[some] = np.add.reduceat(z, first) / count[some]
    return np.abs(z - middle[grown.lane])


def _corridor_links(
    grown: Grown, order: IntArray
) -> tuple[IntArray, IntArray, IntArray, FloatArray]:
    """Corridors of b between matched vertices that a has as well, found by bisection among a's:
    which rows of the match they join (k,) each, the corridors (k, 2) as each map numbers them, and
    bits (k,)."""
    lanes, a, b = grown.lanes, grown.lanes.a.whole, grown.lanes.b.whole
    lane, rows = lanes.rows_of(lanes.b.corridor)
    forth = (rows < b.reverse[rows]).nonzero()[0]
    lane, rows = lane[forth], rows[forth]
    shift = lanes.shift[lane]
    i, j = order[b.tail[rows] + shift], order[b.head[rows] + shift]
    both = ((i >= 0) & (j >= 0)).nonzero()[0]
    i, j, rows, lane = i[both], j[both], rows[both], lane[both]
    row_a, there = a.by_ends.find(grown.a[i] * len(a) + grown.a[j])
    i, j, row_a, rows, lane = (column[there] for column in (i, j, row_a, rows, lane))
    same = (np.abs(a.sagitta[row_a] - b.sagitta[rows]) < MATCH.gate_m).nonzero()[0]
    i, j, row_a, rows, lane = (column[same] for column in (i, j, row_a, rows, lane))
    d = a.length[row_a] - b.length[rows]
    bits = length_bits(d, a.variance[row_a] + b.variance[rows])
    bits = bits + np.minimum(a.rarity[row_a], b.rarity[rows])
    own_a = row_a - lanes.a.corridor[lanes.of_a[lane]]
    own_b = rows - lanes.b.corridor[lanes.of_b[lane]]
    return i, j, np.array([own_a, own_b]).T, bits


def _near_links(grown: Grown, order: IntArray) -> tuple[IntArray, IntArray, FloatArray]:
    """Links between matched vertices and up to three matched ones near each: rows of the match they
    join and bits, (k,) each.

    The null model is how common neighbours at that distance are; the direction is no evidence of
    its own (§2.1: the branches have fixed it), it only must agree.
    """
    lanes, a, b = grown.lanes, grown.lanes.a.whole, grown.lanes.b.whole
    matched = grown.b
    beside = b.neighbours.index.take(matched, axis=0)[:, NEAREST]
    near = order.take(beside + lanes.shift[grown.lane][:, None])
    known = (near >= 0) & np.isfinite(b.neighbours.distance_m.take(matched, axis=0)[:, NEAREST])
    known &= np.cumsum(known, axis=1) <= 3
    p, column = known.nonzero()
    q = near[p, column]
    vertex = matched[p]
    za, zb = a.z[grown.a], b.z[matched]
    offset_a, offset_b = za[q] - za[p], zb[q] - zb[p]
    d = np.abs(offset_b)
    unit = offset_a * (grown.turn[grown.row[p]] * offset_b).conj()
    unit = unit / np.maximum(np.abs(unit), 1e-9)
    bend = np.abs(np.arctan2(unit.imag, unit.real)) * d
    drift = MATCH.drift_per_m / MATCH.length_sigmas * d
    seen = lanes.a.centre_m[lanes.of_a] ** 2 + lanes.b.centre_m[lanes.of_b] ** 2
    centres = seen[grown.lane[p]] + drift**2
    bits = length_bits(np.abs(offset_a) - d, centres)
    bits = bits - bend * bend / (2 * (centres + (2 * drift) ** 2)) / BIT
    return p, q, bits + b.neighbours.rarity[vertex, column + 1] - CHOICE_BITS


def _each_without_repeats(
    grown: Grown, source: IntArray, target: IntArray, bits: FloatArray
) -> FloatArray:
    """`_without_repeats` for the links of each lane, best first."""
    at = grown.lanes.a.whole.z[grown.a]
    start, end, told = at[source], at[target], bits.tolist()
    first = cuts(grown.lane[source], len(grown.lanes))
    out: list[float] = []
    for k, stop in pairwise(first):
        out += _without_repeats(start[k:stop], end[k:stop], told[k:stop])
    return np.array(out)


def _forest(source: IntArray, target: IntArray, bits: FloatArray, depth: FloatArray) -> IntArray:
    """The links of a forest: for every junction its best one to a junction nearer to the centroid.

    `depth` (k,) orders the junctions, so that no cycle can arise.
    """
    child = np.where(depth[source] > depth[target], source, target)
    order = np.lexsort((-bits, child))
    first = np.ones(len(order), np.bool_)
    sorted_child = child[order]
    first[1:] = sorted_child[1:] != sorted_child[:-1]
    chosen = order[first]
    return np.asarray(chosen[bits[chosen] > 0])


def _without_repeats(start: ComplexArray, end: ComplexArray, bits: list[float]) -> list[float]:
    """The bits of links, best first, with 0 for those that follow from better ones.

    In a building on a grid the corridors between two lines are all equally long, and a diagonal
    follows from two of them: once those fit, the others fit by construction. So every place counts
    as the crossing of two lines, one along the best link and one across it, and a link is evidence
    only if the better ones do not determine the distance between the lines of its ends. Without
    this a row is merged with its mirror image, and offices fit theirs.
    """
    if not bits:
        return []
    # Plain numbers are faster than arrays for so few items.
    one, two = start.tolist(), end.tolist()
    axis = (two[0] - one[0]).conjugate() / max(abs(two[0] - one[0]), 1e-9)
    places = [z * axis for z in one + two]
    along = _joins(_lines([z.real for z in places]))
    across = _joins(_lines([z.imag for z in places]))
    return [
        min(value, MATCH.most_bits) if x or y else 0.0
        for value, x, y in zip(bits, along, across, strict=True)
    ]


def _lines(at: list[float]) -> list[int]:
    """Index of the line on which each coordinate lies; a line is at most `gate_m` wide."""
    number, end, line = [0] * len(at), -np.inf, -1
    for k in sorted(range(len(at)), key=at.__getitem__):
        if at[k] > end:
            end, line = at[k] + MATCH.gate_m, line + 1
        number[k] = line
    return number


def _joins(line: list[int]) -> list[bool]:
    """For k links, given by the lines of their starts and then of their ends: whether each joins
    lines that the previous ones have not joined."""
    head, half = list(range(max(line) + 1)), len(line) // 2
    out = []
    for k in range(half):
        u, v = line[k], line[half + k]
        while head[u] != u:
            head[u] = u = head[head[u]]
        while head[v] != v:
            head[v] = v = head[head[v]]
        head[u] = v
        out.append(u != v)
    return out
