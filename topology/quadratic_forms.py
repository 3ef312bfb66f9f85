"""Quantiles of quadratic forms of normal errors with unequal variances.

A radius of one sigma holds 68.3 % of the errors along a line, but of errors in a plane 63.2 %
(sigma the root mean square of the distance) or 39.3 % (sigma of one coordinate).
"""

from __future__ import annotations

import numpy as np

from .arrays import FloatArray

ONE_SIGMA = 0.6827
"""Probability that a normal error lies within one sigma."""

_NONE = 1e-12
"""Variance beside the square of a mean that is none: rounding leaves less."""


def quadratic_quantile(
    matrix: FloatArray, share: float, lean: FloatArray | None = None
) -> FloatArray:
    """(k,) quantile of xᵀ Q x for the probability `share`, x normal with mean μ and covariance C.

    matrix: (k, n, n) C Q; lean: (k, n, n) μ μᵀ Q, None for μ = 0. Approximated by a shifted and
    scaled χ² with the same first three cumulants (Hall, Buckley and Eagleson, 1988; with a mean
    Imhof, 1961): exact where all axes have the same variance or only one has any, otherwise within
    0.01 of the probability for n = 2 and 3; with a mean within 0.02.
    """
    from scipy.special import chdtri

    n = matrix.shape[-1]
    off = np.zeros_like(matrix) if lean is None else lean
    mean = np.trace(matrix + off, axis1=1, axis2=2)
    whole = np.where(mean > 0, mean, 1.0)[:, None, None]
    unit, off = matrix / whole, off / whole
    square = unit @ unit
    # No less than where all axes err alike.
    central = np.trace(unit, axis1=1, axis2=2)
    second = np.maximum(np.trace(square, axis1=1, axis2=2), central**2 / n)
    third = np.maximum(np.trace(square @ unit, axis1=1, axis2=2), central**3 / n**2)
    second = second + 2 * np.trace(off @ unit, axis1=1, axis2=2)
    third = third + 3 * np.trace(off @ square, axis1=1, axis2=2)
    # Of what is known exactly all quantiles are the same.
    second, third = np.maximum(second, _NONE), np.maximum(third, _NONE**2)
    freedom = second**3 / third**2
    beyond = third / second * (chdtri(freedom, 1.0 - share) - freedom)
    return np.asarray(np.maximum(mean * (1 + beyond), 0.0))
