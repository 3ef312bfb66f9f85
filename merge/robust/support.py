"""What speaks for a match: agreeing junctions and corridors, in bits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .growth import Match
from .prepare import ComplexArray, FloatArray, IntArray, Prepared, length_bits
from .settings import MATCH

UP_TO = np.triu(np.ones((12, 12)))
"""Times this, a row becomes its running sum."""


@dataclass(frozen=True, slots=True, eq=False)
class Support:
    """Agreement, and what it is made of.

    corridors: (c, 2) directed rows of corridors that both maps have. ends: (m, 2) rows of the match
    that each link ties, along: (m,) row of `corridors` or, for a relative position, -1; links: (m,)
    bits of each. Links are the forest, the best first, and then the corridors that do not fit.
    branches: (k,) bits of each matched junction's branches; bits: the sum of links and branches.
    """

    corridors: IntArray
    ends: IntArray
    along: IntArray
    links: FloatArray
    branches: FloatArray
    bits: float


def support(a: Prepared, b: Prepared, match: Match) -> Support:
    """Bits of the branches of all matched junctions and of the best forest of links between them.

    A link is a corridor that both maps have (its length is compared), or two matched junctions
    near each other (their relative position is compared: the corridor between them may have been
    split by a junction that one run missed). A forest counts every place once; a corridor of both
    maps whose lengths do not fit counts against the match.
    """
    k = len(match)
    order = np.full(len(b), -1)
    order[match.b] = np.arange(k)
    i, j, rows, bits = _corridor_links(a, b, match, order)
    p, q, near_bits = _near_links(a, b, match, order)
    source, target = np.concatenate([i, p]), np.concatenate([j, q])
    value = np.concatenate([bits, near_bits])
    zb = b.z[match.b]
    chosen = _forest(source, target, value, np.abs(zb - np.add.reduce(zb) / k))
    chosen = chosen[(-value[chosen]).argsort(kind="stable")]
    at = a.z[match.a]
    counted = _without_repeats(at[source[chosen]], at[target[chosen]], value[chosen].tolist())
    misfit = (bits < 0).nonzero()[0]
    against = np.maximum(bits[misfit], -MATCH.most_bits)
    total = 0.0
    for link in counted:  # one by one: the same sum however links are stored
        total += link
    shown = np.concatenate([chosen, misfit])
    return Support(
        corridors=rows,
        ends=np.array([source[shown], target[shown]]).T,
        along=np.where(shown < len(bits), shown, -1),
        links=np.concatenate([counted, against]),
        branches=match.branch,
        bits=total + float(np.add.reduce(against)) + float(np.add.reduce(match.branch)),
    )


def _corridor_links(
    a: Prepared, b: Prepared, match: Match, order: IntArray
) -> tuple[IntArray, IntArray, IntArray, FloatArray]:
    """Corridors of b between matched vertices that a has too, by bisection among a's."""
    half = len(b.tail) // 2
    i, j = order[b.tail[:half]], order[b.head[:half]]
    rows = ((i >= 0) & (j >= 0)).nonzero()[0]
    i, j = i[rows], j[rows]
    key = match.a[i] * len(a) + match.a[j]
    if len(a.pair_key) == 0:
        rows = key = key[:0]
    at = np.minimum(a.pair_key.searchsorted(key), len(a.pair_key) - 1)
    row_a = a.pair_row[at]
    bent_alike = np.abs(a.sag[row_a] - b.sag[rows]) < MATCH.sag_m
    same = ((a.pair_key[at] == key) & bent_alike).nonzero()[0]
    i, j, row_a, rows = i[same], j[same], row_a[same], rows[same]
    d = a.length[row_a] - b.length[rows]
    bits = length_bits(d, a.variance[row_a] + b.variance[rows])
    bits = bits + np.minimum(a.rarity[row_a], b.rarity[rows])
    return i, j, np.array([row_a, rows]).T, bits


def _near_links(
    a: Prepared, b: Prepared, match: Match, order: IntArray
) -> tuple[IntArray, IntArray, FloatArray]:
    """Matched vertices and up to three matched ones near each: does the offset agree?

    Chance is how common neighbours so far away are; the direction tells nothing of its own (§2.1:
    the branches have told it), it only must agree.
    """
    none = np.zeros(0, np.int64)
    if len(match) < 2:
        return none, none, np.zeros(0)
    near = order.take(b.neighbour.take(match.b, axis=0)[:, 1:13])
    known = near >= 0
    known &= np.matmul(known, UP_TO[: near.shape[1], : near.shape[1]]) <= 3
    p, column = known.nonzero()
    q = near[p, column]
    vertex = match.b[p]
    za, zb = a.z[match.a], b.z[match.b]
    offset_a, offset_b = za[q] - za[p], zb[q] - zb[p]
    d = np.abs(offset_b)
    unit = offset_a * (match.turn[vertex] * offset_b).conj()
    unit = unit / np.maximum(np.abs(unit), 1e-9)
    bend = np.abs(np.arctan2(unit.imag, unit.real)) * d
    across = MATCH.offset_per_m * d
    centres = MATCH.offset_floor_m**2 + a.noise.centre_m**2 + b.noise.centre_m**2 + across**2
    bits = length_bits(np.abs(offset_a) - d, centres)
    bits = bits - bend * bend / (2 * (centres + (2 * across) ** 2)) / np.log(2)
    return p, q, bits + b.near_rarity[vertex, column + 1] - MATCH.offset_bits


def _forest(source: IntArray, target: IntArray, bits: FloatArray, depth: FloatArray) -> IntArray:
    """The links of a forest: for every junction its best one to a junction nearer to the middle.

    `depth` (k,) orders the junctions, so no choice can close a cycle.
    """
    child = np.where(depth[source] > depth[target], source, target)
    order = np.lexsort((-bits, child))
    first = np.ones(len(order), np.bool_)
    sorted_child = child[order]
    first[1:] = sorted_child[1:] != sorted_child[:-1]
    chosen = order[first]
    return np.asarray(chosen[bits[chosen] > 0])


def _without_repeats(start: ComplexArray, end: ComplexArray, bits: list[float]) -> list[float]:
    """The bits of links, best first, where those that follow from better ones count nothing.

    In a building on a grid the corridors between two lines are all equally long, and a diagonal is
    as long as two of them say: once those fit, the others fit by construction. So every place
    counts as the crossing of two lines, one along the best link and one across it, and a link
    tells something only if the better ones leave the lines of its two ends free to move. Without
    this a row is merged with its mirror image, and offices fit theirs.
    """
    if not bits:
        return []
    # Few and small steps: plain numbers are faster than arrays here.
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
    """Number of the line on which each coordinate lies; a line is `line_m` wide at most."""
    number, end, line = [0] * len(at), -np.inf, -1
    for k in sorted(range(len(at)), key=at.__getitem__):
        if at[k] > end:
            end, line = at[k] + MATCH.line_m, line + 1
        number[k] = line
    return number


def _joins(line: list[int]) -> list[bool]:
    """Of k links, whose starts and then ends lie on these lines, in turn: does it join lines that
    those before it have not?"""
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
