"""How well the branches of two junctions agree, in bits."""

from __future__ import annotations

import numpy as np

from .prepare import BoolArray, ComplexArray, FloatArray, IntArray, Prepared

GATE_RAD = 0.45
"""Branches this close in heading may be the same."""

MOST_BITS = 6.0
FOREIGN_BITS = 4.0
"""Against two junctions of which no branch agrees."""


def branch_bits(
    a: Prepared, b: Prepared, va: IntArray, vb: IntArray, turn: ComplexArray
) -> FloatArray:
    """(k,) log2 odds of the branches of vertices va and vb: one junction against any two.

    turn: (k,) rotation b → a as unit numbers. Chance is how common such junctions are in both maps
    (`surprise`); each branch that only one side has costs what a fault costs in that run, an
    agreeing one tells the more, the more freely branches point in these maps (`turn_bits`).
    """
    nearest_b, chord2, pair = _pairing(a, b, va, vb, turn)
    agree = pair.sum(axis=1)
    lonely = a.count[va] + b.count[vb] - 2 * agree
    variance = a.branch_variance[va] + b.branch_variance[vb]
    q = chord2 / variance[:, None]
    density = 0.95 * np.exp(-0.5 * q) + 0.0125 * np.exp(-q / 32)
    fit = np.log2(density) - 0.5 * np.log2(2 * np.pi * variance)[:, None]
    free = np.minimum(a.turn_bits[va], b.turn_bits[vb[:, None], nearest_b])
    angle = np.where(pair, np.minimum(fit + free, 3.0), 0.0).sum(axis=1)
    # One branch of each junction is taken up by the alignment itself.
    angle *= np.maximum(agree - 1, 0) / np.maximum(agree, 1)
    fault = np.log2(a.fault_rate[va] + b.fault_rate[vb])
    chance = np.minimum(a.surprise[va], b.surprise[vb])
    bits = chance + angle + lonely * fault - FOREIGN_BITS * (agree == 0)
    return np.asarray(np.minimum(bits, MOST_BITS))


def lonely_branches(
    a: Prepared, b: Prepared, va: IntArray, vb: IntArray, turn: ComplexArray
) -> IntArray:
    """(k,) branches that only one of the two matched junctions has."""
    agree = _pairing(a, b, va, vb, turn)[2].sum(axis=1)
    return np.asarray(a.count[va] + b.count[vb] - 2 * agree)


def _pairing(
    a: Prepared, b: Prepared, va: IntArray, vb: IntArray, turn: ComplexArray
) -> tuple[IntArray, FloatArray, BoolArray]:
    """For every branch of a: the nearest of b, the squared chord between them on the unit circle,
    and whether each is the other's nearest within the gate.

    Headings are unit numbers, 0 where there is no branch, so that the cosine of the angle between
    two is one product and no angle is ever wrapped.
    """
    cosine = (
        a.branch_unit[va][:, :, None] * (b.branch_unit[vb] * turn[:, None]).conj()[:, None, :]
    ).real
    nearest_b = cosine.argmax(axis=2)
    best_a, best_b = cosine.max(axis=2), cosine.max(axis=1)
    back = best_b[np.arange(len(va))[:, None], nearest_b]
    return nearest_b, 2 - 2 * best_a, (best_a > COS_GATE) & (best_a == back)


COS_GATE = float(np.cos(GATE_RAD))
