"""Candidate links: pairs of corridors, one of each map, that could be the same (§2.1, §2.2)."""

from __future__ import annotations

import cmath
from dataclasses import dataclass
from math import isqrt

import numpy as np

from ...topology.arrays import BoolArray, ComplexArray, FloatArray, IntArray
from ...topology.se2 import wrap
from .branch_patterns import LENGTH_SCALE
from .prepare import Prepared, length_bits
from .settings import MATCH

COS_TURN = float(np.cos(MATCH.turn_rad))

KEY_STEP = 4 * np.pi
"""Distance between pairs of vertices in a sort key that adds a rotation [rad]."""


@dataclass(frozen=True, slots=True, eq=False)
class Links:
    """k candidate links: directed corridors a_row ~ b_row; theta: (k,) rotation from b to a [rad];
    bits: (k,) evidence of each by itself."""

    a_row: IntArray
    b_row: IntArray
    theta: FloatArray
    bits: FloatArray

    def __len__(self) -> int:
        return len(self.a_row)


@dataclass(frozen=True, slots=True, eq=False)
class Seed:
    """A hypothesis before growth.

    a, b: (k,) matched vertices; theta: rotation [rad]; shift: translation [m] of b's frame, x + iy;
    bits: evidence.
    """

    a: IntArray
    b: IntArray
    theta: float
    shift: complex
    bits: float

    @property
    def unit(self) -> complex:
        """The rotation as a unit number."""
        return cmath.exp(1j * self.theta)


def windows(low: IntArray, high: IntArray) -> tuple[IntArray, IntArray]:
    """All (i, j) with low[i] <= j < high[i], as two flat arrays."""
    count = np.maximum(high - low, 0)
    row = np.arange(len(low)).repeat(count)
    column = np.arange(len(row)) + (low - count.cumsum() + count)[row]
    return row, column


def candidate_links(a: Prepared, b: Prepared) -> Links:
    """Corridors of two maps with compatible lengths and sagittas and the same pattern of branches
    at both ends.

    Strategy: b's corridors are sorted by (pattern, length); two bisections per corridor of a find
    the window of compatible ones. Each corridor of a is looked up in one direction, b's in both.
    """
    half = len(a.tail) // 2
    tolerance = MATCH.length_sigmas * np.sqrt(a.variance[:half] + b.worst_variance)
    key = a.pattern[:half] * LENGTH_SCALE + a.length[:half]
    low = b.probe_key.searchsorted(key - tolerance)
    high = b.probe_key.searchsorted(key + tolerance)
    count = high - low
    if np.add.reduce(count) > MATCH.most_pairs:
        order = count.argsort(kind="stable")
        most_common = order[count[order].cumsum() > MATCH.most_pairs]
        high[most_common] = low[most_common]
    row_a, probe = windows(low, high)
    return compatible_links(a, b, row_a, b.probe_row[probe])


def compatible_links(a: Prepared, b: Prepared, row_a: IntArray, row_b: IntArray) -> Links:
    """Of pairs of corridors, (k,) each, those with compatible lengths and sagittas as links."""
    variance = a.variance[row_a] + b.variance[row_b]
    d = a.length[row_a] - b.length[row_b]
    bow = np.abs(a.sagitta[row_a] - b.sagitta[row_b])
    fits = ((d * d < MATCH.length_sigmas**2 * variance) & (bow < MATCH.gate_m)).nonzero()[0]
    row_a, row_b = row_a[fits], row_b[fits]
    theta = np.asarray(wrap(a.angle[row_a] - b.angle[row_b]))
    bits = length_bits(d[fits], variance[fits]) + np.minimum(a.rarity[row_a], b.rarity[row_b])
    ends = np.minimum(a.end_information[row_a], b.end_information[row_b])
    return Links(row_a, row_b, theta, np.minimum(bits, MATCH.most_bits) + 0.5 * ends)


def seeds(a: Prepared, b: Prepared, links: Links, most: int) -> list[Seed]:
    """The best `most` connected components of the association graph as seeds, best first.

    Nodes of the graph are (vertex a, vertex b, rotation), edges the links (§2.3). Inside a
    component the transforms of its links vote, so that one false link does not spoil a correct
    match.
    """
    if len(links) == 0:
        return []
    label = link_components(a, b, links)
    bits = np.bincount(label, weights=links.bits)
    best = (-bits).argsort(kind="stable")[:most]
    has_neighbour = np.bincount(label)[label] > 1
    mid_a, mid_b = a.middle[links.a_row], b.middle[links.b_row]
    found: list[Seed] = []
    for component in best[bits[best] > 0].tolist():
        inside = label == component
        rows, turn = _largest_consensus(links, mid_a, mid_b, inside.nonzero()[0])
        others = has_neighbour & ~inside
        seed = _seed(a, b, links, mid_a, mid_b, rows=rows, turn=turn, others=others)
        if all(_are_distinct(seed, other) for other in found):
            found.append(seed)
    found.sort(key=lambda s: -s.bits)
    return found


def link_components(a: Prepared, b: Prepared, links: Links) -> IntArray:
    """(k,) connected component of every link; links are adjacent if they share both vertices at an
    end, and the rotation.

    Strategy: equal (vertices, rotation) get one node number by sorting; then labels are propagated
    to the smallest one in reach, by scatter-minimum and pointer jumping, until nothing changes: of
    a hundred links in a sixth of the time of scipy's graphs.
    """
    k, i, j = len(links), links.a_row, links.b_row
    pairs = a.tail[i] * len(b) + b.tail[j], a.head[i] * len(b) + b.head[j]
    key = np.concatenate(pairs) * KEY_STEP + np.concatenate([links.theta, links.theta])
    order = key.argsort(kind="stable")
    is_new = np.zeros(2 * k, np.int64)
    is_new[1:] = np.diff(key[order]) > MATCH.turn_rad
    number = is_new.cumsum()
    node = np.empty(2 * k, np.int64)
    node[order] = number
    start, end = node[:k], node[k:]
    label = np.arange(int(number[-1]) + 1)
    while True:
        lowest = np.minimum(label[start], label[end])
        lowered = label.copy()
        np.minimum.at(lowered, label[start], lowest)
        np.minimum.at(lowered, label[end], lowest)
        lowered = lowered[lowered]
        if (lowered == label).all():
            return np.asarray(label[start])
        label = lowered


def _slack(apart_m: FloatArray) -> FloatArray:
    """Tolerance [m] between placements of b by two links of one alignment, `apart_m` from each
    other: that of growth, with twice its drift per metre, because both links may be rotated."""
    return MATCH.gate_m + 2 * MATCH.drift_per_m * apart_m


def _largest_consensus(
    links: Links, mid_a: ComplexArray, mid_b: ComplexArray, rows: IntArray
) -> tuple[IntArray, float]:
    """Of the links `rows` those that agree with the transform of one of them, chosen for the most
    bits in all; and their mean rotation [rad]. mid_a, mid_b: (k,) middles of all links' corridors,
    x + iy [m]."""
    if len(rows) == 1:
        return rows, float(links.theta[rows[0]])
    most = isqrt(MATCH.most_pairs)  # each votes on each
    if len(rows) > most:
        rows = rows[(-links.bits[rows]).argsort(kind="stable")[:most]]
    theta, za, zb = links.theta[rows], mid_a[rows], mid_b[rows]
    gap_b = zb[None, :] - zb[:, None]
    unit = np.exp(1j * theta)
    gap = np.abs(za[:, None] + unit[:, None] * gap_b - za)
    votes = (gap < _slack(np.abs(gap_b))) & ((unit[:, None] * unit.conj()).real > COS_TURN)
    best = int((votes @ links.bits[rows]).argmax())
    agreeing = rows[votes[best]]
    mean_offset = wrap(links.theta[agreeing] - theta[best]).sum() / len(agreeing)
    return agreeing, float(theta[best] + mean_offset)


def _seed(
    a: Prepared,
    b: Prepared,
    links: Links,
    mid_a: ComplexArray,
    mid_b: ComplexArray,
    *,
    rows: IntArray,
    turn: float,
    others: BoolArray,
) -> Seed:
    """The seed of some agreeing links, extended by those of the `others` that place b nearly alike:
    drift may have split one match into several components (§5)."""
    unit = cmath.exp(1j * turn)
    middle_a = sum(mid_a[rows].tolist()) / len(rows)
    middle_b = sum(mid_b[rows].tolist()) / len(rows)
    shift = middle_a - unit * middle_b
    strength = sum(links.bits[rows].tolist())
    if others.any():
        compatible = np.abs(unit * mid_b + shift - mid_a) < _slack(np.abs(mid_b - middle_b))
        alike = others & compatible & (np.abs(wrap(links.theta - turn)) < MATCH.turn_rad)
        rows = np.concatenate([rows, alike.nonzero()[0]])
    row_a, row_b = links.a_row[rows], links.b_row[rows]
    va = np.concatenate([a.tail[row_a], a.head[row_a]]).tolist()
    vb = np.concatenate([b.tail[row_b], b.head[row_b]]).tolist()
    # A vertex with two partners keeps the first: that of the component itself.
    partner_of_a = dict(zip(reversed(va), reversed(vb), strict=True))
    partner_of_b = {partner_of_a[u]: u for u in sorted(partner_of_a)}
    vertices_b = sorted(partner_of_b)
    vertices_a = [partner_of_b[v] for v in vertices_b]
    return Seed(np.array(vertices_a), np.array(vertices_b), turn, shift, strength)


def _are_distinct(x: Seed, y: Seed) -> bool:
    """Whether two seeds place b differently."""
    turned = abs(float(wrap(x.theta - y.theta)))
    return turned > MATCH.turn_rad or abs(x.shift - y.shift) > MATCH.place_m
