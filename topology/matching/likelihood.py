"""How likely an association is: stated once, for closure, robust merging and the paper's method.

An association says that two things, one of each of two views, are one thing: two passes by a
junction, two junctions, two corridors. It is judged by the log likelihood ratio of what was
measured of the two,

    λ = Σ_i ln p(x_i | the same thing) - ln p(x_i | any two things),

in natural units (nats). Measurements enter by three kinds of term.

*What both have.* Two looks at one length, position or heading differ by d with a variance σ², but a
share ε of them is measured worse than the noise says, by a factor w (`log_density`):

    p(d | same) = (1 - ε) N(d; 0, σ²) + ε N(d; 0, w²σ²).

*Chance.* Any two things differ as two draws from what the view holds. So a length is worth its
rarity among the lengths of its own view, -ln p(x) (`rarity`), and what is common tells little.

*What only one has.* It costs ln(rate), rate being how often a look adds or misses such a thing.

A look that shows its object as it is with a confidence c, and else tells nothing, tells
ln(c e^λ + 1 - c) (`doubted`). Branches have their own sum of these terms (`branches.py`), and so
has the growth of matches.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, chdtri

from ..arrays import FloatArray, IntArray

Reals = NDArray[np.floating[Any]]
"""Of single precision where odds need no more."""

BIT = float(np.log(2.0))
"""Nats of a bit: evidence is added up in nats here, and told in bits."""


@dataclass(frozen=True, slots=True)
class LikelihoodSettings:
    """Numbers of the likelihood, common to closure and to merging."""

    outlier_share: float = 0.05
    """Share of lengths and headings that are measured worse than their noise says …"""
    outlier_width: float = 4.0
    """… by this factor. Also the share of lengths, and of sets of branches, that no others of the
    same view foretell."""
    fault_floor: float = 0.01
    """Of junctions and branches so many differ though both looks were good: doors, furniture. Tried
    in closure: 0.02, the same."""
    most_bits: float = 6.0
    """No single junction, corridor or contradiction tells more, for or against [bits]: it may be a
    fault that no rate foresaw, at a chance of 1/64. Tried: in merging, with 7 and 8 fewer offices
    are told; in closure, with 3 a run on tiles is closed wrongly under three times the noise."""
    gate_sigmas: float = 3.0
    """Two readings that differ by more standard deviations are not of one thing: 99.7 % that are
    differ by less. Tried in closure: 3.5 for all gates, 90 walks the same; for those of one
    dimension alone, three walks through rows find less."""
    branch_gate_rad: float = 0.45
    """Branches this close in heading may be the same [rad]: 26°, several sigmas of any detector."""
    gate_m: float = 0.55
    """What lies apart by less may be the same [m]: a junction and where it was predicted, a
    junction and the line of a corridor or of a grid, the middles of two corridors over their ends,
    and, with twice the drift, where two links of one alignment place the other map. Tried for
    lines .8 and 1.2, beside corridors .45, for middles .75: the same."""
    cells_per_m: int = 10
    """Histograms of lengths have cells of 10 cm, about what two looks at a length differ by …"""
    kernel_cells: int = 4
    """… smoothed by a triangle that ends so many cells off."""
    longest_m: float = 1000.0
    """Longer corridors count as this long [m]: it bounds the histograms alone."""

    @property
    def most(self) -> float:
        """`most_bits` in nats."""
        return self.most_bits * BIT

    def gate_chi2(self, freedom: int) -> float:
        """The same gate for errors of so many dimensions together: the largest squared error, in
        sigmas, as seldom exceeded by chance (the quantile of χ²)."""
        return float(chdtri(freedom, chdtrc(1, self.gate_sigmas**2)))


LIKELIHOOD = LikelihoodSettings()


def log_density(q: Reals, variance: Reals) -> FloatArray:
    """ln density of a difference between two looks at one thing; q: its square over the variance.

    The density is per unit of the root of `variance`: 1/m for lengths, 1/rad for headings.
    """
    share, width = LIKELIHOOD.outlier_share, LIKELIHOOD.outlier_width
    core = (1 - share) * np.exp(-0.5 * q) + share / width * np.exp(-0.5 * q / width**2)
    return np.asarray(np.log(core / np.sqrt(2 * np.pi * variance)))


def doubted(told: FloatArray, sure: FloatArray) -> FloatArray:
    """(k,) nats of looks that are right only with some confidence: ln(c e^told + 1 - c).

    told: (k,) nats if the looks are right; sure: (k,) ln c.
    """
    out = np.array(told)
    rows = (sure < 0).nonzero()[0]
    if len(rows):
        out[rows] = np.logaddexp(sure[rows] + told[rows], np.log(-np.expm1(sure[rows])))
    return out


def length_log_density(difference: FloatArray, variance: FloatArray) -> FloatArray:
    """ln density [1/m] of a length difference between two looks at one corridor."""
    return log_density(difference * difference / variance, variance)


@dataclass(frozen=True, slots=True, eq=False)
class Lengths:
    """How common lengths are: density: (cells,) [1/m] by cells of `cells_per_m`."""

    density: FloatArray

    @classmethod
    def of(cls, length: FloatArray) -> Lengths:
        """Of a sample (k,) [m]: a smoothed histogram, a share of it (`outlier_share`) spread evenly
        from 0 to the longest."""
        if len(length) == 0:
            return cls(np.ones(1))
        spread = LIKELIHOOD.outlier_share
        density = (1 - spread) * _smoothed(_cells(length)) / len(length)
        return cls(density + spread / max(float(length.max()), 1.0))

    def rarity(self, length: FloatArray) -> FloatArray:
        """-ln density [1/m] of each of some lengths [m]: what it tells to have just this one."""
        return np.asarray(-np.log(self.density)[np.minimum(_cells(length), len(self.density) - 1)])


def rarity(length: FloatArray) -> FloatArray:
    """-ln of the density [1/m] of lengths like each of these [m], among all of them."""
    return Lengths.of(length).rarity(length)


def density_of_equals(length: FloatArray) -> tuple[float, float]:
    """Σ density [1/m] at zero of the differences between corridors, and how many were summed.

    length: (k,) of corridors seen from both ends: every corridor stands twice, and its own two rows
    do not count. O(k), by the histogram of `rarity`.
    """
    k = len(length)
    if k == 0:
        return 0.0, 0.0
    cell = _cells(length)
    near = float(_smoothed(cell)[cell].sum())
    own = 2 * k * LIKELIHOOD.cells_per_m / LIKELIHOOD.kernel_cells
    return near - own, float(k * (k - 2))


def _cells(length: FloatArray) -> IntArray:
    return (np.minimum(length, LIKELIHOOD.longest_m) * LIKELIHOOD.cells_per_m).astype(np.int64)


def _smoothed(cell: IntArray) -> FloatArray:
    """Histogram [1/m] of lengths by their cells, smoothed; it ends where nothing is left."""
    reach = LIKELIHOOD.kernel_cells
    histogram = np.bincount(cell, minlength=int(cell.max()) + reach + 1)
    triangle = (reach - np.abs(np.arange(1 - reach, reach))) / reach**2
    return np.convolve(histogram, triangle, mode="same") * LIKELIHOOD.cells_per_m
