"""How well the branches of two junctions agree, in bits."""

from __future__ import annotations

import numpy as np

from ...topology.se2 import wrap
from .prepare import NO_HEADING, BoolArray, ComplexArray, FloatArray, IntArray, Prepared

GATE_RAD = 0.45
MOST_BITS = 6.0


def branch_bits(
    a: Prepared, b: Prepared, va: IntArray, vb: IntArray, turn: ComplexArray
) -> FloatArray:
    """(k,) log2 odds of the branches of vertices va and vb: one junction against any two.

    turn: (k,) rotation b → a as unit numbers. Chance is how common such junctions are in both maps
    (`surprise`); each branch that only one side has costs what a fault costs in that run, an
    agreeing one tells the more, the more freely branches point in these maps (`turn_bits`).
    """
    nearest_b, nearest_a, pair, agree, meets = _pairing(a, b, va, vb, turn)
    lonely = a.count[va] + b.count[vb] - 2 * agree
    variance = (
        a.noise.branch_rad**2 * (0.5 + 1 / a.looks[va])
        + b.noise.branch_rad**2 * (0.5 + 1 / b.looks[vb])
        + 0.05**2
    )
    q = nearest_a**2 / variance[:, None]
    density = 0.95 * np.exp(-0.5 * q) + 0.0125 * np.exp(-q / 32)
    fit = np.log2(density) - 0.5 * np.log2(2 * np.pi * variance)[:, None]
    free = np.minimum(a.turn_bits[va], np.take_along_axis(b.turn_bits[vb], nearest_b, axis=1))
    angle = np.where(pair, np.minimum(fit + free, 3.0), 0.0).sum(axis=1)
    # One branch of each junction is taken up by the alignment itself.
    angle = angle * np.maximum(agree - 1, 0) / np.maximum(agree, 1)
    fault = np.log2(fault_rate(a)[va] + fault_rate(b)[vb])
    chance = np.minimum(a.surprise[va], b.surprise[vb])
    bits = chance + angle + lonely * fault - np.where(meets, 0.0, 4.0)
    return np.asarray(np.minimum(bits, MOST_BITS))


def fault_rate(m: Prepared) -> FloatArray:
    """(n,) chance that a junction shows a branch too many or too few: doors, and single looks."""
    per_look = m.noise.branch_fault_rate + 0.005
    return np.asarray(0.01 + per_look / np.minimum(m.looks, 3))


def lonely_branches(
    a: Prepared, b: Prepared, va: IntArray, vb: IntArray, turn: ComplexArray
) -> IntArray:
    """(k,) branches that only one of the two matched junctions has."""
    agree = _pairing(a, b, va, vb, turn)[3]
    return np.asarray(a.count[va] + b.count[vb] - 2 * agree)


def _pairing(
    a: Prepared, b: Prepared, va: IntArray, vb: IntArray, turn: ComplexArray
) -> tuple[IntArray, FloatArray, BoolArray, IntArray, BoolArray]:
    """Mutual nearest branches within the gate: for every branch of a its nearest of b, the angle to
    it, whether they pair; and per junction how many pair and whether any do."""
    ha, hb = a.heading[va], b.heading[vb] + np.angle(turn)[:, None]
    gap = np.abs(wrap(ha[:, :, None] - hb[:, None, :]))
    absent = (ha > NO_HEADING / 2)[:, :, None] | (b.heading[vb] > NO_HEADING / 2)[:, None, :]
    gap = np.where(absent, 9.0, gap)
    nearest_b, nearest_a = gap.argmin(axis=2), gap.min(axis=2)
    mutual = np.take_along_axis(gap.argmin(axis=1), nearest_b, axis=1)
    pair = (nearest_a < GATE_RAD) & (mutual == np.arange(gap.shape[1]))
    agree = pair.sum(axis=1)
    return nearest_b, nearest_a, pair, agree, agree > 0
