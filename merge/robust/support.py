"""What speaks for a match: agreeing junctions and corridors, in bits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .growth import Match
from .links import length_bits
from .prepare import ComplexArray, FloatArray, IntArray, Prepared

LINK_BITS = 8.0
"""No single corridor or neighbourhood tells more."""

WORST_LINK_BITS = -5.0
"""No single corridor speaks louder against a match: one of the runs may have measured it badly."""

REPEAT_BITS = 0.5
BEARING_RAD = np.pi / 8
LINE_M = 0.8
"""Corridors whose ends lie on the same two lines, within about this, are repeats of each other."""

BEND_RAD = 0.04
NEAR_PENALTY_BITS = 3.0
SAG_M = 0.75


@dataclass(frozen=True, slots=True, eq=False)
class Support:
    """Agreement. bits: in all; corridors: (k, 2) directed rows of corridors that both maps have."""

    bits: float
    corridors: IntArray


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
    chosen = _forest(source, target, value, np.abs(b.z[match.b] - b.z[match.b].sum() / k))
    source, target, value = source[chosen], target[chosen], value[chosen]
    total = _without_repeats(a.z[match.a[source]], a.z[match.a[target]], value)
    misfit = float(np.maximum(bits[bits < 0], WORST_LINK_BITS).sum())
    return Support(total + misfit + float(match.branch.sum()), rows)


def _corridor_links(
    a: Prepared, b: Prepared, match: Match, order: IntArray
) -> tuple[IntArray, IntArray, IntArray, FloatArray]:
    """Corridors of b between matched vertices that a has too, by bisection among a's."""
    half = len(b.tail) // 2
    i, j = order[b.tail[:half]], order[b.head[:half]]
    rows = np.flatnonzero((i >= 0) & (j >= 0))
    i, j = i[rows], j[rows]
    key = match.a[i] * len(a) + match.a[j]
    at = np.searchsorted(a.pair_key, key)
    at = np.minimum(at, len(a.pair_key) - 1) if len(a.pair_key) else at
    there = a.pair_key[at] == key if len(a.pair_key) else np.zeros(0, np.bool_)
    i, j, rows, row_a = i[there], j[there], rows[there], a.pair_row[at[there]]
    same_bow = np.abs(a.sag[row_a] - b.sag[rows]) < SAG_M
    i, j, rows, row_a = i[same_bow], j[same_bow], rows[same_bow], row_a[same_bow]
    d = a.length[row_a] - b.length[rows]
    bits = length_bits(d, a.variance[row_a] + b.variance[rows])
    bits = bits + np.minimum(a.rarity[row_a], b.rarity[rows])
    return i, j, np.column_stack([row_a, rows]), bits


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
    near = order[b.neighbour[match.b, 1:13]]
    known = near >= 0
    known &= np.cumsum(known, axis=1) <= 3
    p, column = np.nonzero(known)
    q = near[p, column]
    offset_b = b.z[match.b[q]] - b.z[match.b[p]]
    offset_a = a.z[match.a[q]] - a.z[match.a[p]]
    d = np.abs(offset_b)
    unit = offset_a * (match.turn[match.b[p]] * offset_b).conj()
    unit = unit / np.maximum(np.abs(unit), 1e-9)
    bend = np.abs(np.angle(unit)) * d
    centres = 0.05**2 + a.noise.centre_m**2 + b.noise.centre_m**2 + (0.02 * d) ** 2
    bits = length_bits(np.abs(offset_a) - d, centres)
    bits = bits - bend * bend / (2 * (centres + (BEND_RAD * d) ** 2)) / np.log(2)
    return p, q, bits + b.near_rarity[match.b[p], column + 1] - NEAR_PENALTY_BITS


def _forest(source: IntArray, target: IntArray, bits: FloatArray, depth: FloatArray) -> IntArray:
    """The links of a forest: for every junction its best one to a junction nearer to the middle.

    `depth` (k,) orders the junctions, so no choice can close a cycle.
    """
    child = np.where(depth[source] > depth[target], source, target)
    order = np.lexsort((-bits, child))
    first = np.ones(len(order), np.bool_)
    first[1:] = np.diff(child[order]) != 0
    chosen = order[first]
    return np.asarray(chosen[bits[chosen] > 0])


def _without_repeats(start: ComplexArray, end: ComplexArray, bits: FloatArray) -> float:
    """Sum of the bits of links, where those that repeat another one's interval count little.

    In a building on a grid all corridors between the same two lines are equally long: once one of
    them fits, the others fit by construction. Links are told apart by direction and by the
    interval that they span in that direction; of equals only the best counts in full.
    """
    if len(bits) == 0:
        return 0.0
    bits = np.minimum(bits, LINK_BITS)
    order = np.argsort(-bits, kind="stable")
    bits, origin = bits[order], start[order[0]]
    start, offset = start[order] - origin, end[order] - start[order]
    axis = np.angle(offset[0])
    bearing = np.round((np.angle(offset) - axis) / BEARING_RAD).astype(np.int64)
    along = np.exp(-1j * (axis + bearing * BEARING_RAD))
    one, two = (start * along).real, ((start + offset) * along).real
    half = int(np.round(np.pi / BEARING_RAD))
    # Seen the other way round it is the same interval, mirrored.
    flip = (bearing % (2 * half)) >= half
    one, two = np.where(flip, -one, one), np.where(flip, -two, two)
    low, high = np.round(np.minimum(one, two) / LINE_M), np.round(np.maximum(one, two) / LINE_M)
    key = ((bearing % half) * 100_003 + low.astype(np.int64)) * 100_003 + high.astype(np.int64)
    first = np.zeros(len(key), np.bool_)
    first[np.unique(key, return_index=True)[1]] = True
    return float(np.where(first, bits, np.minimum(bits, REPEAT_BITS)).sum())
