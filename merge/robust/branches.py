"""How well the branches of two junctions of two maps agree, in bits."""

from __future__ import annotations

import numpy as np

from ...topology.matching.branches import BranchPairs, agreeing, mutual_nearest
from ...topology.matching.likelihood import BIT, LIKELIHOOD, doubted
from .prepare import ComplexArray, FloatArray, IntArray, Prepared


def branch_bits(
    a: Prepared, b: Prepared, va: IntArray, vb: IntArray, turn: ComplexArray
) -> FloatArray:
    """(k,) log2 odds of the branches of vertices va and vb: one junction against any two.

    turn: (k,) rotation b → a as unit numbers. Chance is how common such junctions are in both maps
    (`surprise`); each branch that only one side has costs what a fault costs in that run, an
    agreeing one tells the more, the more freely branches point in these maps (`turn_rarity`).
    """
    pairs = _pairs(a, b, va, vb, turn)
    agree = np.add.reduce(pairs.paired, axis=1)
    of_a, of_b = a.traits.take(va, axis=0), b.traits.take(vb, axis=0)
    branches, variance, faults, _, sure = (of_a + of_b).T
    lonely = branches - 2 * agree
    turn_b = b.turn_rarity.reshape(-1).take(pairs.nearest + (vb * b.turn_rarity.shape[1])[:, None])
    free = np.minimum(a.turn_rarity.take(va, axis=0), turn_b)
    angle = agreeing(pairs, variance, free, LIKELIHOOD.most / 2)
    # One branch of each junction is taken up by the alignment itself.
    angle *= np.maximum(agree - 1, 0) / np.maximum(agree, 1)
    chance = np.minimum(of_a[:, 3], of_b[:, 3]) * BIT
    told = np.minimum(chance + angle + lonely * np.log(faults), LIKELIHOOD.most)
    return doubted(told, sure) / BIT


def lonely_branches(
    a: Prepared, b: Prepared, va: IntArray, vb: IntArray, turn: ComplexArray
) -> IntArray:
    """(k,) branches that only one of the two matched junctions has."""
    agree = _pairs(a, b, va, vb, turn).paired.sum(axis=1)
    return np.asarray(a.count[va] + b.count[vb] - 2 * agree)


def common_branches(
    a: Prepared, b: Prepared, va: IntArray, vb: IntArray, turn: ComplexArray
) -> tuple[IntArray, IntArray, IntArray]:
    """Branches that matched junctions have in common: rows of the match, branches of a and of b."""
    pairs = _pairs(a, b, va, vb, turn)
    row, branch = pairs.paired.nonzero()
    return row, branch, pairs.nearest[row, branch]


def _pairs(a: Prepared, b: Prepared, va: IntArray, vb: IntArray, turn: ComplexArray) -> BranchPairs:
    turned = b.branch_unit.take(vb, axis=0) * turn[:, None]
    return mutual_nearest(a.branch_unit.take(va, axis=0), turned)
