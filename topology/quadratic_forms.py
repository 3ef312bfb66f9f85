"""Quantiles of quadratic forms of normal errors with unequal variances.

A radius of one sigma holds 68.3 % of the errors along a line, but of errors in a plane 63.2 %
(sigma the root mean square of the distance) or 39.3 % (sigma of one coordinate).
"""

from __future__ import annotations

from math import erf, sqrt
from statistics import NormalDist

import numpy as np

from .arrays import FloatArray

ONE_SIGMA = erf(1 / sqrt(2))
"""Probability that a normal error lies within one sigma."""

MEDIAN_CHI2 = NormalDist().inv_cdf(0.75) ** 2
"""Median of χ² with one degree of freedom."""


def quadratic_quantile(matrix: FloatArray, share: float) -> FloatArray:
    """(k,) quantile of xᵀ Q x for the probability `share`, x normal with mean 0 and covariance C.

    matrix: (k, n, n) C Q. Approximated by a shifted and scaled χ² with the same first three
    cumulants (Hall, Buckley and Eagleson, 1988): exact where all axes have the same variance or
    only one has any, otherwise within 0.01 of the probability for n = 2 and 3.
    """
    from scipy.special import chdtri

    n = matrix.shape[-1]
    mean = np.trace(matrix, axis1=1, axis2=2)
    unit = matrix / np.where(mean > 0, mean, 1.0)[:, None, None]
    square = unit @ unit
    # No less than where all axes err alike.
    second = np.maximum(np.trace(square, axis1=1, axis2=2), 1 / n)
    third = np.maximum(np.trace(square @ unit, axis1=1, axis2=2), 1 / n**2)
    freedom = second**3 / third**2
    beyond = third / second * (chdtri(freedom, 1.0 - share) - freedom)
    return np.asarray(np.maximum(mean * (1 + beyond), 0.0))
