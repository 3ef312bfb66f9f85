"""Evidence [bits] from the branches of two junctions of two maps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...topology.arrays import ComplexArray, FloatArray, IntArray
from ...topology.columns import take
from ...topology.matching.branches import BranchPairs, agreeing, mutual_nearest
from ...topology.matching.likelihood import BIT, LIKELIHOOD, doubted
from .prepare import Prepared


def branch_bits(
    a: Prepared, b: Prepared, va: IntArray, vb: IntArray, turn: ComplexArray
) -> FloatArray:
    """(k,) log2 likelihood ratio of the branches of vertices va and vb: one junction against any
    two.

    turn: (k,) rotation b → a as unit numbers. One of two close forks may appear as a whole crossing
    in the other map: it counts as that, at the price of a fault, if that fits better.
    """
    of_a, of_b = _Observed.of(a, va), _Observed.of(b, vb)
    nats = _nats(of_a, of_b, turn)
    for m, v, crossing_of_a in ((a, va, True), (b, vb, False)):
        rows = (m.halves.half.take(v) != v).nonzero()[0]
        if len(rows):
            whole = _Observed.of_crossings(m, v[rows])
            pair = (whole, take(of_b, rows)) if crossing_of_a else (take(of_a, rows), whole)
            better = _nats(*pair, turn[rows]) + np.log(m.fault_rate[v[rows]])
            nats[rows] = np.maximum(nats[rows], better)
    return doubted(nats, of_a.descriptor[:, 4] + of_b.descriptor[:, 4]) / BIT


@dataclass(frozen=True, slots=True, eq=False)
class _Observed:
    """Branches of k junctions: (k, d) unit numbers and rarity, (k, 5) descriptor; see
    `Prepared`."""

    unit: ComplexArray
    rarity: FloatArray
    descriptor: FloatArray

    @classmethod
    def of(cls, m: Prepared, v: IntArray) -> _Observed:
        descriptor = m.descriptor.take(v, axis=0)
        return cls(m.branch_unit.take(v, axis=0), m.turn_rarity.take(v, axis=0), descriptor)

    @classmethod
    def of_crossings(cls, m: Prepared, v: IntArray) -> _Observed:
        descriptor = m.descriptor.take(v, axis=0)
        descriptor[:, 0] = 4
        whole = m.halves
        return cls(whole.unit.take(v, axis=0), whole.rarity.take(v, axis=0), descriptor)


def _nats(a: _Observed, b: _Observed, turn: ComplexArray) -> FloatArray:
    """(k,) log likelihood ratio [nats], without the detectors' confidence.

    The null model is how common such junctions are in both maps (`Prepared.descriptor`). Each
    branch without a partner contributes the log of that run's fault rate; an agreeing one
    contributes more where directions vary more in these maps (`turn_rarity`).
    """
    pairs = mutual_nearest(a.unit, b.unit * turn[:, None])
    agree = np.add.reduce(pairs.paired, axis=1)
    branches, variance, faults = (a.descriptor + b.descriptor).T[:3]
    lonely = branches - 2 * agree
    row = np.arange(len(turn))[:, None]
    free = np.minimum(a.rarity, b.rarity[row, pairs.nearest])
    angle = agreeing(pairs, variance, free, LIKELIHOOD.most / 2)
    # One pair of branches is used up by fitting the rotation.
    angle *= np.maximum(agree - 1, 0) / np.maximum(agree, 1)
    chance = np.minimum(a.descriptor[:, 3], b.descriptor[:, 3]) * BIT
    return np.asarray(np.minimum(chance + angle + lonely * np.log(faults), LIKELIHOOD.most))


def lonely_branches(
    a: Prepared, b: Prepared, va: IntArray, vb: IntArray, turn: ComplexArray
) -> IntArray:
    """(k,) number of branches that only one of two matched junctions has."""
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
    turned = b.branch_unit.take(vb, axis=0) * turn[:, None]
    return mutual_nearest(a.branch_unit.take(va, axis=0), turned)
