"""Evidence [bits] from the branches of two junctions of two maps."""

from __future__ import annotations

import numpy as np

from ...topology.arrays import ComplexArray, FloatArray, IntArray
from ...topology.matching.branches import BranchPairs, agreement_odds, mutual_nearest
from ...topology.matching.likelihood import BIT, LIKELIHOOD, doubted
from .prepare import Prepared


def branch_bits(
    a: Prepared, b: Prepared, va: IntArray, vb: IntArray, turn: ComplexArray
) -> FloatArray:
    """(k,) log2 likelihood ratio of the branches of vertices va and vb: one junction against any
    two.

    turn: (k,) rotation b → a as unit numbers. The null model is how common such junctions are in
    both maps (`Prepared.descriptor`). Each branch without a partner contributes the log of that
    run's fault rate; an agreeing one contributes more where directions vary more in these maps
    (`turn_rarity`).
    """
    of_a, of_b = a.descriptor.take(va, axis=0), b.descriptor.take(vb, axis=0)
    pairs = _pairs(a, b, va, vb, turn)
    agree = np.add.reduce(pairs.paired, axis=1)
    branches, variance, faults, _, confidence = (of_a + of_b).T
    lonely = branches - 2 * agree
    rarity = b.turn_rarity.take(vb, axis=0)[np.arange(len(turn))[:, None], pairs.nearest]
    free = np.minimum(a.turn_rarity.take(va, axis=0), rarity)
    angle = agreement_odds(pairs, variance, free, LIKELIHOOD.most / 2)
    # One pair of branches is used up by fitting the rotation.
    angle *= np.maximum(agree - 1, 0) / np.maximum(agree, 1)
    chance = np.minimum(of_a[:, 3], of_b[:, 3]) * BIT
    nats = np.minimum(chance + angle + lonely * np.log(faults), LIKELIHOOD.most)
    return np.asarray(doubted(nats, confidence) / BIT)


def unpaired_branches(
    a: Prepared, b: Prepared, va: IntArray, vb: IntArray, turn: ComplexArray
) -> IntArray:
    """(k,) number of branches of vertices va, vb without a partner. turn: as in `branch_bits`."""
    agree = _pairs(a, b, va, vb, turn).paired.sum(axis=1)
    return np.asarray(a.count[va] + b.count[vb] - 2 * agree)


def common_branches(
    a: Prepared, b: Prepared, va: IntArray, vb: IntArray, turn: ComplexArray
) -> tuple[IntArray, IntArray, IntArray]:
    """Branches that matched junctions have in common: row of the match, branch of a, branch of
    b."""
    pairs = _pairs(a, b, va, vb, turn)
    row, branch = pairs.paired.nonzero()
    return row, branch, pairs.nearest[row, branch]


def _pairs(a: Prepared, b: Prepared, va: IntArray, vb: IntArray, turn: ComplexArray) -> BranchPairs:
    """Mutually nearest branches of vertices va and vb, (k,) each, under the rotations b → a."""
    turned = b.branch_unit.take(vb, axis=0) * turn[:, None]
    return mutual_nearest(a.branch_unit.take(va, axis=0), turned)
