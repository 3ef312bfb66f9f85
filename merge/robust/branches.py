"""How well the branches of two junctions agree, in bits."""

from __future__ import annotations

import numpy as np

from .prepare import BoolArray, ComplexArray, FloatArray, IntArray, Prepared, density_bits
from .settings import MATCH


def branch_bits(
    a: Prepared, b: Prepared, va: IntArray, vb: IntArray, turn: ComplexArray
) -> FloatArray:
    """(k,) log2 odds of the branches of vertices va and vb: one junction against any two.

    turn: (k,) rotation b → a as unit numbers. Chance is how common such junctions are in both maps
    (`surprise`); each branch that only one side has costs what a fault costs in that run, an
    agreeing one tells the more, the more freely branches point in these maps (`turn_bits`).
    """
    nearest_b, chord2, pair = _pairing(a, b, va, vb, turn)
    agree = np.add.reduce(pair, axis=1)
    of_a, of_b = a.traits.take(va, axis=0), b.traits.take(vb, axis=0)
    branches, variance, faults, _ = (of_a + of_b).T
    lonely = branches - 2 * agree
    q = chord2 / variance[:, None]
    fit = density_bits(q, variance[:, None])
    turn_b = b.turn_bits.reshape(-1).take(nearest_b + (vb * b.turn_bits.shape[1])[:, None])
    free = np.minimum(a.turn_bits.take(va, axis=0), turn_b)
    angle = np.add.reduce(np.where(pair, np.minimum(fit + free, MATCH.most_bits / 2), 0.0), axis=1)
    # One branch of each junction is taken up by the alignment itself.
    angle *= np.maximum(agree - 1, 0) / np.maximum(agree, 1)
    chance = np.minimum(of_a[:, 3], of_b[:, 3])
    bits = chance + angle + lonely * np.log2(faults)
    return np.asarray(np.minimum(bits, MATCH.most_bits))


def lonely_branches(
    a: Prepared, b: Prepared, va: IntArray, vb: IntArray, turn: ComplexArray
) -> IntArray:
    """(k,) branches that only one of the two matched junctions has."""
    agree = _pairing(a, b, va, vb, turn)[2].sum(axis=1)
    return np.asarray(a.count[va] + b.count[vb] - 2 * agree)


def common_branches(
    a: Prepared, b: Prepared, va: IntArray, vb: IntArray, turn: ComplexArray
) -> tuple[IntArray, IntArray, IntArray]:
    """Branches that matched junctions have in common: rows of the match, branches of a and of b."""
    nearest_b, _, pair = _pairing(a, b, va, vb, turn)
    row, branch = pair.nonzero()
    return row, branch, nearest_b[row, branch]


def _pairing(
    a: Prepared, b: Prepared, va: IntArray, vb: IntArray, turn: ComplexArray
) -> tuple[IntArray, FloatArray, BoolArray]:
    """For every branch of a: the nearest of b, the squared chord between them on the unit circle,
    and whether each is the other's nearest within the gate.

    Headings are unit numbers, 0 where there is no branch, so that the cosine of the angle between
    two is one product and no angle is ever wrapped.
    """
    k, d_a, d_b = len(va), a.branch_unit.shape[1], b.branch_unit.shape[1]
    turned = b.branch_unit.take(vb, axis=0) * turn[:, None]
    pairs_a = a.branch_unit.take(va, axis=0).view(np.float64).reshape(k, d_a, 2)
    pairs_b = turned.view(np.float64).reshape(k, d_b, 2)
    cosine = np.matmul(pairs_a, pairs_b.transpose(0, 2, 1))
    nearest_b, nearest_a = cosine.argmax(axis=2), cosine.argmax(axis=1)
    row = np.arange(k)[:, None]
    best = cosine[row, np.arange(d_a), nearest_b]
    mutual = nearest_a[row, nearest_b] == np.arange(d_a)
    return nearest_b, 2 - 2 * best, (best > COS_GATE) & mutual


COS_GATE = float(np.cos(MATCH.branch_gate_rad))
