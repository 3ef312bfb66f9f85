"""Candidate links: pairs of corridors, one of each map, that could be the same one (§2.1, §2.2)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...topology.se2 import wrap
from .prepare import LENGTH_SCALE, BoolArray, ComplexArray, FloatArray, IntArray, Prepared

LENGTH_SIGMAS = 3.0
SAG_M = 0.75
MOST_LINKS = 20_000
"""Where more pairs of corridors than this look alike, those of the commonest patterns are left out:
a link to a corridor of which there are hundreds tells nothing."""

WEAK_SHARE = 0.3
"""Components with less than this share of the best one's bits are not grown."""

MOST_VOTES = 40
TORN_M = 1.0
TORN_PER_M = 0.1
"""Two components whose transforms differ by no more than this, seen from each other, may be one
match that drift has torn."""

TURN_RAD = 0.3
"""Links whose rotations differ by less may belong to one alignment."""


@dataclass(frozen=True, slots=True, eq=False)
class Links:
    """k candidate links: directed corridors a_row ~ b_row; theta: (k,) rotation from b to a [rad];
    bits: (k,) evidence of each alone."""

    a_row: IntArray
    b_row: IntArray
    theta: FloatArray
    bits: FloatArray

    def __len__(self) -> int:
        return len(self.a_row)


@dataclass(frozen=True, slots=True, eq=False)
class Seed:
    """A hypothesis before growth: (k,) vertices of a and of b, rotation, position shift, bits."""

    a: IntArray
    b: IntArray
    theta: float
    shift: complex
    bits: float


def windows(low: IntArray, high: IntArray) -> tuple[IntArray, IntArray]:
    """All (i, j) with low[i] <= j < high[i], as two flat arrays."""
    size = np.maximum(high - low, 0)
    left = np.repeat(np.arange(len(low)), size)
    right = np.arange(len(left)) - np.repeat(np.cumsum(size) - size, size) + low[left]
    return left, right


def candidate_links(a: Prepared, b: Prepared) -> Links:
    """Corridors with the same pattern of branches at both ends, as long and as bent as each other.

    Strategy: b's corridors are sorted by (pattern, length); two bisections per corridor of a find
    the window of compatible ones. Each corridor of a is looked up in one direction, b's in both.
    """
    rows = np.arange(len(a.tail) // 2)
    tolerance = LENGTH_SIGMAS * np.sqrt(
        a.variance[rows] + (b.variance.max(initial=0.0) if len(b.tail) else 0.0)
    )
    key = a.pattern[rows] * LENGTH_SCALE + a.length[rows]
    low = np.searchsorted(b.probe_key, key - tolerance)
    high = np.searchsorted(b.probe_key, key + tolerance)
    size = high - low
    if size.sum() > MOST_LINKS:
        order = np.argsort(size, kind="stable")
        kept = np.sort(order[np.cumsum(size[order]) <= MOST_LINKS])
        rows, low, high = rows[kept], low[kept], high[kept]
    left, right = windows(low, high)
    i, j = rows[left], b.probe_row[right]
    variance = a.variance[i] + b.variance[j]
    d = a.length[i] - b.length[j]
    ok = (d * d < LENGTH_SIGMAS**2 * variance) & (np.abs(a.sag[i] - b.sag[j]) < SAG_M)
    i, j, d, variance = i[ok], j[ok], d[ok], variance[ok]
    theta = np.asarray(wrap(a.angle[i] - b.angle[j]))
    fits = length_bits(d, variance) + np.minimum(a.rarity[i], b.rarity[j])
    ends = np.minimum(
        a.surprise[a.tail[i]] + a.surprise[a.head[i]], b.surprise[b.tail[j]] + b.surprise[b.head[j]]
    )
    return Links(i, j, theta, np.minimum(fits, 6.0) + 0.5 * ends)


def length_bits(difference: FloatArray, variance: FloatArray) -> FloatArray:
    """log2 density [1/m] of a length difference between two looks at one corridor.

    A normal distribution with 5 % of outliers of four times its width.
    """
    q = difference * difference / variance
    core = 0.95 * np.exp(-0.5 * q) + (0.05 / 4) * np.exp(-q / 32)
    return np.asarray(np.log2(core) - 0.5 * np.log2(2 * np.pi * variance))


def seeds(a: Prepared, b: Prepared, links: Links, most: int) -> list[Seed]:
    """The best `most` connected components of the association graph, as seeds of growth.

    Its nodes are (vertex a, vertex b, rotation), its edges the links (§2.3). Inside a component
    the transforms of its links vote, so that one false link does not spoil a correct match.
    """
    if len(links) == 0:
        return []
    label = _components(a, b, links)
    total = np.bincount(label, weights=links.bits)
    best = np.argsort(-total, kind="stable")[:most]
    best = best[total[best] > WEAK_SHARE * total[best[0]]]
    crowd = np.bincount(label)[label] > 1
    mid_a = (a.z[a.tail[links.a_row]] + a.z[a.head[links.a_row]]) / 2
    mid_b = (b.z[b.tail[links.b_row]] + b.z[b.head[links.b_row]]) / 2
    found: list[Seed] = []
    for component in best.tolist():
        mine = label == component
        rows, turn = _agreeing(links, mid_a, mid_b, np.flatnonzero(mine))
        seed = _seed(a, b, links, mid_a, mid_b, rows=rows, turn=turn, others=crowd & ~mine)
        if all(_differ(seed, other) for other in found):
            found.append(seed)
    found.sort(key=lambda s: -s.bits)
    return found


def _components(a: Prepared, b: Prepared, links: Links) -> IntArray:
    """(k,) component of every link. Links meet where they share both vertices and the rotation.

    Strategy: equal (vertex a, vertex b, rotation) get one node number by sorting; then labels sink
    to the least one within reach, by scatter-minimum and pointer jumping, until nothing moves.
    """
    k = len(links)
    pair = np.concatenate(
        [
            a.tail[links.a_row] * len(b) + b.tail[links.b_row],
            a.head[links.a_row] * len(b) + b.head[links.b_row],
        ]
    )
    key = pair * 8.0 + np.concatenate([links.theta, links.theta])
    order = np.argsort(key, kind="stable")
    fresh = np.zeros(2 * k, np.int64)
    fresh[1:] = np.diff(key[order]) > TURN_RAD
    node = np.empty(2 * k, np.int64)
    node[order] = np.cumsum(fresh)
    one, two = node[:k], node[k:]
    label = np.arange(int(node.max()) + 1)
    while True:
        low = np.minimum(label[one], label[two])
        sunk = label.copy()
        np.minimum.at(sunk, label[one], low)
        np.minimum.at(sunk, label[two], low)
        sunk = sunk[sunk]
        if np.array_equal(sunk, label):
            return np.asarray(label[one])
        label = sunk


def _agreeing(
    links: Links, mid_a: ComplexArray, mid_b: ComplexArray, rows: IntArray
) -> tuple[IntArray, float]:
    """Of a component's links those that share the transform with the most bits; its rotation."""
    if len(rows) == 1:
        return rows, float(links.theta[rows[0]])
    if len(rows) > MOST_VOTES:
        rows = rows[np.argsort(-links.bits[rows], kind="stable")[:MOST_VOTES]]
    theta, za, zb = links.theta[rows], mid_a[rows], mid_b[rows]
    gap_b = zb[None, :] - zb[:, None]
    apart = np.abs(za[:, None] + np.exp(1j * theta)[:, None] * gap_b - za)
    votes = (apart < 0.6 + 0.12 * np.abs(gap_b)) & (np.abs(wrap(theta[:, None] - theta)) < TURN_RAD)
    at = int((votes @ links.bits[rows]).argmax())
    agree = rows[votes[at]]
    return agree, float(theta[at] + wrap(links.theta[agree] - theta[at]).sum() / len(agree))


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
    """The seed of some agreeing links, joined by those of the `others` that lie nearly alike:
    drift may have torn one match into several components (§5)."""
    unit = complex(np.exp(1j * turn))
    k = len(rows)
    middle_a, middle_b = complex(mid_a[rows].sum() / k), complex(mid_b[rows].sum() / k)
    shift = middle_a - unit * middle_b
    strength = float(links.bits[rows].sum())
    if others.any():
        torn = np.abs(unit * mid_b + shift - mid_a) < TORN_M + TORN_PER_M * np.abs(mid_b - middle_b)
        near = others & torn & (np.abs(wrap(links.theta - turn)) < TURN_RAD)
        rows = np.concatenate([rows, np.flatnonzero(near)])
    va = np.concatenate([a.tail[links.a_row[rows]], a.head[links.a_row[rows]]])
    vb = np.concatenate([b.tail[links.b_row[rows]], b.head[links.b_row[rows]]])
    # Of vertices claimed twice the one keeps its partner that came first: the component's own.
    owner = np.full(len(a), -1)
    owner[va[::-1]] = vb[::-1]
    claimed = np.full(len(b), -1)
    pa = np.flatnonzero(owner >= 0)
    claimed[owner[pa]] = pa
    pb = np.flatnonzero(claimed >= 0)
    return Seed(claimed[pb], pb, turn, shift, strength)


def _differ(x: Seed, y: Seed) -> bool:
    """Do two seeds place b differently (seen from where the first one matches)?"""
    return abs(float(wrap(x.theta - y.theta))) > 0.2 or abs(x.shift - y.shift) > 3.0
