"""Evidence [bits] for a match: agreeing junctions and corridors."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise, starmap

import numpy as np

from ...topology.arrays import ComplexArray, FloatArray, IntArray
from ...topology.matching.likelihood import BIT
from .atlas import cuts
from .growth import Grown
from .prepare import length_bits
from .settings import MATCH

NEAREST = slice(1, 13)
"""Columns of a junction's neighbours that are considered for links; the first is itself."""

CHOICE_BITS = float(np.log2(NEAREST.stop - NEAREST.start))
"""Deducted from the bits of a relative position: it is chosen among so many neighbours."""


@dataclass(frozen=True, slots=True, eq=False)
class Support:
    """The agreement of a match of k junctions.

    corridors: (c, 2) directed rows of corridors that both maps have. Links are those of the forest,
    best first, followed by corridors with different lengths: ends: (m, 2) rows of the match that
    each connects; along: (m,) its row of `corridors`, -1 for a relative position; links: (m,) its
    bits. branches: (k,) bits of each matched junction's branches; bits: sum of links and branches.
    """

    corridors: IntArray
    ends: IntArray
    along: IntArray
    links: FloatArray
    branches: FloatArray
    bits: float

    def bounded(self, bound: FloatArray) -> Support:
        """The same, with negative evidence bounded by `bound` (k,) at each matched junction [bits],
        and by the larger one of its two junctions at a link."""
        links = np.maximum(self.links, -bound[self.ends].max(axis=1, initial=0.0))
        branches = np.maximum(self.branches, -bound)
        change = (links - self.links).sum() + (branches - self.branches).sum()
        return replace(self, links=links, branches=branches, bits=self.bits + float(change))


_NONE, _NO_BITS = np.zeros(0, np.int64), np.zeros(0)
NO_SUPPORT = Support(_NONE.reshape(0, 2), _NONE.reshape(0, 2), _NONE, _NO_BITS, _NO_BITS, 0.0)
"""Of a placement without a matched junction."""


def supports(grown: Grown) -> list[Support]:
    """The support of the match in each lane: the branches of all matched junctions, and the best
    forest of links between them.

    A link is a corridor that both maps have (its length is compared), or two close matched
    junctions (their relative position is compared: the corridor between them may have been split by
    a junction that one run missed). A forest counts every place once; a corridor of both maps whose
    lengths differ counts against the match.
    """
    lanes, count = grown.lanes, len(grown.lanes)
    row_of = np.full(len(lanes.lane), -1)
    row_of[grown.row] = np.arange(len(grown.row))
    tail, head, corridors, corridor_bits = _corridor_links(grown, row_of)
    junction, neighbour, near_bits = _near_links(grown, row_of)
    source, target = np.concatenate([tail, junction]), np.concatenate([head, neighbour])
    bits = np.concatenate([corridor_bits, near_bits])
    lane = grown.lane[source]
    chosen = _forest(source, target, bits, _from_middle(grown))
    chosen = chosen[np.lexsort((-bits[chosen], lane[chosen]))]
    chosen_bits = _each_without_repeats(grown, source[chosen], target[chosen], bits[chosen])
    misfit = (corridor_bits < 0).nonzero()[0]
    misfit_bits = np.maximum(corridor_bits[misfit], -MATCH.most_bits)
    # One by one: the same sums however lanes and links are stored.
    total = np.zeros(count) + np.bincount(lane[chosen], chosen_bits, count)
    total = total + np.bincount(lane[misfit], misfit_bits, count)
    total = total + np.bincount(grown.lane, grown.branch, count)
    links = np.concatenate([chosen, misfit])
    by_lane = lane[links].argsort(kind="stable")
    links, link_bits = links[by_lane], np.concatenate([chosen_bits, misfit_bits])[by_lane]
    rows_of_lane = (grown.lane, grown.lane[tail], lane[links])
    matches_at, corridors_at, links_at = (
        list(starmap(slice, pairwise(cuts(rows, count)))) for rows in rows_of_lane
    )
    first, first_corridor = (
        np.array([rows.start for rows in at])[lane[links]] for at in (matches_at, corridors_at)
    )
    ends = np.array([source[links], target[links]]).T - first[:, None]
    along = np.where(links < len(corridor_bits), links - first_corridor, -1)
    return [
        Support(
            corridors=corridors[corridors_at[k]],
            ends=ends[links_at[k]],
            along=along[links_at[k]],
            links=link_bits[links_at[k]],
            branches=grown.branch[matches_at[k]],
            bits=bits_of_lane,
        )
        for k, bits_of_lane in enumerate(total.tolist())
    ]


def _from_middle(grown: Grown) -> FloatArray:
    """(k,) distance [m] of each matched vertex of b from the centroid of those of its lane."""
    z = grown.lanes.b.whole.z[grown.b]
    count = np.bincount(grown.lane, minlength=len(grown.lanes))
    matched = np.flatnonzero(count)
    middle = np.zeros(len(count), np.complex128)
    if len(matched):
        first = np.cumsum(count)[matched] - count[matched]
        middle[matched] = np.add.reduceat(z, first) / count[matched]
    return np.abs(z - middle[grown.lane])


def _corridor_links(
    grown: Grown, row_of: IntArray
) -> tuple[IntArray, IntArray, IntArray, FloatArray]:
    """Corridors of b between matched vertices that a has as well, found by bisection among a's.

    Returns the rows of the match at both ends, (k,) each, the corridors (k, 2) as numbered in each
    map, and bits (k,). row_of: (t,) row of the match of each row of `lanes`, or -1.
    """
    lanes, a, b = grown.lanes, grown.lanes.a.whole, grown.lanes.b.whole
    lane, rows = lanes.rows_of(lanes.b.corridor)
    forth = (rows < b.reverse[rows]).nonzero()[0]
    lane, rows = lane[forth], rows[forth]
    shift = lanes.shift[lane]
    i, j = row_of[b.tail[rows] + shift], row_of[b.head[rows] + shift]
    matched = ((i >= 0) & (j >= 0)).nonzero()[0]
    i, j, rows, lane = i[matched], j[matched], rows[matched], lane[matched]
    row_a, in_both = a.by_ends.find(grown.a[i] * len(a) + grown.a[j])
    i, j, row_a, rows, lane = (column[in_both] for column in (i, j, row_a, rows, lane))
    alike = (np.abs(a.sagitta[row_a] - b.sagitta[rows]) < MATCH.gate_m).nonzero()[0]
    i, j, row_a, rows, lane = (column[alike] for column in (i, j, row_a, rows, lane))
    difference = a.length[row_a] - b.length[rows]
    bits = length_bits(difference, a.variance[row_a] + b.variance[rows])
    bits = bits + np.minimum(a.rarity[row_a], b.rarity[rows])
    own_a = row_a - lanes.a.corridor[lanes.of_a[lane]]
    own_b = rows - lanes.b.corridor[lanes.of_b[lane]]
    return i, j, np.array([own_a, own_b]).T, bits


def _near_links(grown: Grown, row_of: IntArray) -> tuple[IntArray, IntArray, FloatArray]:
    """Links between matched vertices and up to three matched ones near each: rows of the match at
    both ends, and bits, (k,) each. row_of: as in `_corridor_links`.

    The null model is how common neighbours at that distance are. The direction must agree, but is
    no evidence: the branches have fixed it (§2.1).
    """
    lanes, a, b = grown.lanes, grown.lanes.a.whole, grown.lanes.b.whole
    vertices = grown.b
    beside = b.neighbours.index.take(vertices, axis=0)[:, NEAREST]
    neighbours = row_of.take(beside + lanes.shift[grown.lane][:, None])
    usable = (neighbours >= 0) & np.isfinite(
        b.neighbours.distance_m.take(vertices, axis=0)[:, NEAREST]
    )
    usable &= np.cumsum(usable, axis=1) <= 3
    junction, column = usable.nonzero()
    neighbour = neighbours[junction, column]
    vertex = vertices[junction]
    za, zb = a.z[grown.a], b.z[vertices]
    offset_a, offset_b = za[neighbour] - za[junction], zb[neighbour] - zb[junction]
    distance = np.abs(offset_b)
    unit = offset_a * (grown.turn[grown.row[junction]] * offset_b).conj()
    unit = unit / np.maximum(np.abs(unit), 1e-9)
    offset = np.abs(np.arctan2(unit.imag, unit.real)) * distance
    drift = MATCH.drift_per_m / MATCH.length_sigmas * distance
    centre_variance = lanes.a.centre_m[lanes.of_a] ** 2 + lanes.b.centre_m[lanes.of_b] ** 2
    variance = centre_variance[grown.lane[junction]] + drift**2
    bits = length_bits(np.abs(offset_a) - distance, variance)
    bits = bits - offset * offset / (2 * (variance + (2 * drift) ** 2)) / BIT
    return junction, neighbour, bits + b.neighbours.rarity[vertex, column + 1] - CHOICE_BITS


def _each_without_repeats(
    grown: Grown, source: IntArray, target: IntArray, bits: FloatArray
) -> FloatArray:
    """`_without_repeats` for the links of each lane, best first."""
    z = grown.lanes.a.whole.z[grown.a]
    start, end, values = z[source], z[target], bits.tolist()
    first = cuts(grown.lane[source], len(grown.lanes))
    counted: list[float] = []
    for k, stop in pairwise(first):
        counted += _without_repeats(start[k:stop], end[k:stop], values[k:stop])
    return np.array(counted)


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

    On a grid of corridors all those between two lines are equally long, and a diagonal follows from
    two of them: once these fit, the others fit by construction. So every place counts as the
    crossing of two lines, one along the best link and one across it. A link is evidence only if
    better ones do not determine the distance between the lines of its ends. Without this a row is
    merged with its mirror image, and offices fit theirs.
    """
    if not bits:
        return []
    # Plain numbers are faster than arrays for so few items.
    starts, ends = start.tolist(), end.tolist()
    axis = (ends[0] - starts[0]).conjugate() / max(abs(ends[0] - starts[0]), 1e-9)
    rotated = [z * axis for z in starts + ends]
    along = _joins(_lines([z.real for z in rotated]))
    across = _joins(_lines([z.imag for z in rotated]))
    return [
        min(value, MATCH.most_bits) if new_along or new_across else 0.0
        for value, new_along, new_across in zip(bits, along, across, strict=True)
    ]


def _lines(coordinates: list[float]) -> list[int]:
    """Index of the line on which each coordinate lies; a line is at most `gate_m` wide."""
    index, border, line = [0] * len(coordinates), -np.inf, -1
    for k in sorted(range(len(coordinates)), key=coordinates.__getitem__):
        if coordinates[k] > border:
            border, line = coordinates[k] + MATCH.gate_m, line + 1
        index[k] = line
    return index


def _joins(line: list[int]) -> list[bool]:
    """For k links, given by the lines of their starts and then of their ends: whether each connects
    lines that the previous ones have not connected (union-find)."""
    head, half = list(range(max(line) + 1)), len(line) // 2
    joins = []
    for k in range(half):
        u, v = line[k], line[half + k]
        while head[u] != u:
            head[u] = u = head[head[u]]
        while head[v] != v:
            head[v] = v = head[head[v]]
        head[u] = v
        joins.append(u != v)
    return joins
