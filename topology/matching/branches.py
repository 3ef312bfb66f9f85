"""Correspondence of the branches of two junctions, and its likelihood.

Headings are unit complex numbers e^{iθ}, 0 for missing branches, in rows as long as the largest
degree. The cosine of the angle between two branches is then one product, angles need no wrapping,
and a missing branch is near no other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import BoolArray, ComplexArray, FloatArray, IntArray
from .likelihood import LIKELIHOOD, log_density

COS_GATE = float(np.cos(LIKELIHOOD.branch_gate_rad))


@dataclass(frozen=True, slots=True, eq=False)
class BranchPairs:
    """Mutually nearest branches of k pairs of junctions.

    paired: (k, d_a) whether each branch of a has a partner in b; nearest: (k, d_a) the branch of b
    nearest to it, its partner if it is paired; chord2: (k, d_a) squared chord between the two on
    the unit circle, about the squared angle [rad²].
    """

    paired: BoolArray
    nearest: IntArray
    chord2: FloatArray


def unit_headings(heading: FloatArray) -> ComplexArray:
    """Headings [rad] as unit complex numbers, 0 for NaN."""
    exists = np.isfinite(heading)
    return np.asarray(np.where(exists, np.exp(1j * np.where(exists, heading, 0.0)), 0.0))


def mutual_nearest(
    unit_a: ComplexArray, unit_b: ComplexArray, cos_gate: float = COS_GATE
) -> BranchPairs:
    """Mutually nearest branches of (k, d_a) and (k, d_b), in one frame, closer than the angle whose
    cosine is `cos_gate`."""
    k, d_a, d_b = len(unit_a), unit_a.shape[1], unit_b.shape[1]
    if not (unit_a.size and unit_b.size):
        none = np.zeros(unit_a.shape)
        return BranchPairs(none.astype(np.bool_), none.astype(np.int64), none)
    pairs_a = unit_a.view(np.float64).reshape(k, d_a, 2)
    pairs_b = unit_b.view(np.float64).reshape(k, d_b, 2)
    cosine = np.matmul(pairs_a, pairs_b.transpose(0, 2, 1))
    nearest_b, nearest_a = cosine.argmax(axis=2), cosine.argmax(axis=1)
    row = np.arange(k)[:, None]
    best = cosine[row, np.arange(d_a), nearest_b]
    mutual = nearest_a[row, nearest_b] == np.arange(d_a)
    return BranchPairs((best > cos_gate) & mutual, nearest_b, 2 - 2 * best)


def agreement_odds(
    pairs: BranchPairs, variance: FloatArray, rarity: FloatArray | float, most: float = np.inf
) -> FloatArray:
    """(k,) log likelihood ratio [nats] of paired branches: Σ ln p(d | same) - ln p(heading | any).

    variance: (k,) or (1,) [rad²] of the difference of two readings; rarity: (k, d_a) -ln density
    [1/rad] of a branch in that direction by chance; most: upper bound per branch.
    """
    fit = log_density(pairs.chord2 / variance[:, None], variance[:, None])
    terms = np.where(pairs.paired, np.minimum(fit + rarity, most), 0.0)
    return np.asarray(np.add.reduce(terms, axis=1))


def missing_odds(pairs: BranchPairs, lack_a: FloatArray, lack_b: FloatArray) -> FloatArray:
    """(k,) log likelihood ratio [nats], negative, of branches without a partner.

    lack_a: (k, d_a), lack_b: (k, d_b) ln of the rate at which an observation misses that branch,
    weighted by its confidence; 0 where there is no branch.
    """
    partner = np.where(pairs.paired, pairs.nearest, -1)
    is_partner = (partner[:, :, None] == np.arange(lack_b.shape[1])).any(axis=1)
    of_a, of_b = np.where(pairs.paired, 0.0, lack_a), np.where(is_partner, 0.0, lack_b)
    return np.asarray(of_a.sum(axis=1) + of_b.sum(axis=1))
