"""Log likelihood ratios of associations, shared by closure, robust merging and the paper's method.

An association states that two things, one of each of two views, are the same: two passes by a
junction, two junctions, two corridors. Its evidence is the log likelihood ratio of all measurements
of the two,

    λ = Σ_i ln p(x_i | the same thing) - ln p(x_i | any two things),

in nats. Measurements enter by three kinds of term.

*Measured in both views.* Two measurements of one length, position or heading differ by d with
variance σ²; a share ε of them is worse than the noise model says by a factor w (`log_density`):

    p(d | same) = (1 - ε) N(d; 0, σ²) + ε N(d; 0, w²σ²).

*Null model.* Any two things differ as two draws from their view. A length therefore contributes its
self-information among the lengths of its own view, -ln p(x) (`rarity`), so that common lengths
contribute little.

*Measured in one view only.* This contributes ln(rate), where rate is how often a view misses or
invents such a thing.

A view that shows its object correctly with confidence c, and otherwise carries no information,
contributes ln(c e^λ + 1 - c) (`doubted`). Branches have their own sum of these terms
(`branches.py`), and so has the growth of matches.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, chdtri

from ..arrays import FloatArray, IntArray

Reals = NDArray[np.floating[Any]]
"""Floating point of any precision."""

BIT = float(np.log(2.0))
"""Nats per bit: evidence is summed in nats and reported in bits."""


@dataclass(frozen=True, slots=True)
class LikelihoodSettings:
    """Parameters of the likelihood, common to closure and merging."""

    outlier_share: float = 0.05
    """Share ε of lengths and headings with larger errors than their noise model. Also the share of
    lengths, and of sets of branches, that the others of the same view do not predict."""
    outlier_width: float = 4.0
    """Factor w on the standard deviation of these outliers."""
    fault_floor: float = 0.01
    """Least share of junctions and branches that differ between correct views (doors, furniture).
    Tried in closure: 0.02, no change."""
    most_bits: float = 6.0
    """Bound on the evidence of a single junction, corridor or contradiction [bits]: a probability
    of 1/64 of a fault beyond the modelled rates. Tried: in merging, with 7 and 8 fewer offices are
    merged; in closure, with 3 a run on tiles is closed wrongly under three times the noise."""
    gate_sigmas: float = 3.0
    """Gate for two measurements of one thing, in standard deviations: 99.7 % pass. Tried in
    closure: 3.5 for all gates, 90 walks unchanged; for those of one dimension alone, three walks
    through rows find less."""
    branch_gate_rad: float = 0.45
    """Gate for two headings of one branch [rad]: 26°, several sigmas of any detector."""
    gate_m: float = 0.55
    """Gate for positions that are compared without a covariance [m]: a junction and its prediction,
    a junction and the line of a corridor or of a grid, the middles of two corridors with matched
    ends, and, with twice the drift, two placements of the other map by links of one alignment.
    Tried: .8 and 1.2 for lines, .45 for junctions beside corridors, .75 for middles, no change."""
    cells_per_m: int = 10
    """Histograms of lengths have cells of 10 cm, about the difference of two measurements of a
    length."""
    kernel_cells: int = 4
    """Histograms of lengths are smoothed by a triangular kernel of this half width [cells]."""
    longest_m: float = 1000.0
    """Longer corridors count as this long [m], to bound the histograms."""

    @property
    def most(self) -> float:
        """`most_bits` in nats."""
        return self.most_bits * BIT

    def gate_chi2(self, freedom: int) -> float:
        """The same gate for errors of `freedom` dimensions: the quantile of χ² with the tail
        probability of `gate_sigmas`."""
        return float(chdtri(freedom, chdtrc(1, self.gate_sigmas**2)))


LIKELIHOOD = LikelihoodSettings()


def log_density(q: Reals, variance: Reals) -> FloatArray:
    """ln density of the difference d of two measurements of one thing; q: d² / variance.

    The density is per unit of √variance: 1/m for lengths, 1/rad for headings.
    """
    share, width = LIKELIHOOD.outlier_share, LIKELIHOOD.outlier_width
    core = (1 - share) * np.exp(-0.5 * q) + share / width * np.exp(-0.5 * q / width**2)
    return np.asarray(np.log(core / np.sqrt(2 * np.pi * variance)))


def doubted(if_correct: FloatArray, log_confidence: FloatArray) -> FloatArray:
    """(k,) evidence [nats] λ of observations that are correct with confidence c: ln(c e^λ + 1 - c).

    if_correct: (k,) λ, the evidence if they are correct; log_confidence: (k,) ln c.
    """
    evidence = np.array(if_correct)
    rows = (log_confidence < 0).nonzero()[0]
    if len(rows):
        evidence[rows] = np.logaddexp(
            log_confidence[rows] + if_correct[rows], np.log(-np.expm1(log_confidence[rows]))
        )
    return evidence


def length_log_density(difference: FloatArray, variance: FloatArray) -> FloatArray:
    """ln density [1/m] of the difference [m] of two measurements of one corridor."""
    return log_density(difference * difference / variance, variance)


@dataclass(frozen=True, slots=True, eq=False)
class Lengths:
    """Distribution of the lengths of a view: density: (cells,) [1/m] in cells of 1 /
    `cells_per_m`."""

    density: FloatArray

    @classmethod
    def of(cls, length: FloatArray) -> Lengths:
        """From a sample (k,) [m]: a smoothed histogram, mixed with a uniform density from 0 to the
        longest length with the share `outlier_share`."""
        if len(length) == 0:
            return cls(np.ones(1))
        outlier_share = LIKELIHOOD.outlier_share
        density = (1 - outlier_share) * _smoothed(_cells(length)) / len(length)
        return cls(density + outlier_share / max(float(length.max()), 1.0))

    def rarity(self, length: FloatArray) -> FloatArray:
        """Self-information -ln density [1/m] of lengths [m]."""
        return np.asarray(-np.log(self.density)[np.minimum(_cells(length), len(self.density) - 1)])


def rarity(length: FloatArray) -> FloatArray:
    """Self-information -ln density [1/m] of each of these lengths [m] among all of them."""
    return Lengths.of(length).rarity(length)


def density_of_equals(length: FloatArray) -> tuple[float, float]:
    """Σ over ordered pairs of different corridors of the density [1/m] at zero of their length
    difference, and the number of pairs.

    length: (k,) [m] of corridors seen from both ends: every corridor appears twice, and pairs of
    its own two rows are left out. O(k), by the histogram of `rarity`.
    """
    k = len(length)
    if k == 0:
        return 0.0, 0.0
    cell = _cells(length)
    total = float(_smoothed(cell)[cell].sum())
    self_pairs = 2 * k * LIKELIHOOD.cells_per_m / LIKELIHOOD.kernel_cells
    return total - self_pairs, float(k * (k - 2))


def _cells(length: FloatArray) -> IntArray:
    return (np.minimum(length, LIKELIHOOD.longest_m) * LIKELIHOOD.cells_per_m).astype(np.int64)


def _smoothed(cell: IntArray) -> FloatArray:
    """Smoothed histogram [1/m] of lengths given by their cells."""
    reach = LIKELIHOOD.kernel_cells
    histogram = np.bincount(cell, minlength=int(cell.max()) + reach + 1)
    triangle = (reach - np.abs(np.arange(1 - reach, reach))) / reach**2
    return np.convolve(histogram, triangle, mode="same") * LIKELIHOOD.cells_per_m
