"""How large the square of an error in several dimensions gets, whose axes are known unequally well.

A radius of one sigma holds 68.3 % of the errors along a line, but 63.2 % (the root mean square of
both coordinates) or 39.3 % (one coordinate's sigma) of those in a plane.
"""

from __future__ import annotations

import numpy as np

from .arrays import FloatArray

ONE_SIGMA = 0.6827
"""Share of the errors of one dimension that lie within one sigma."""


def quadratic_quantile(matrix: FloatArray, share: float) -> FloatArray:
    """(k,) what xᵀ Q x exceeds in 1 - share of all cases, of normal x of covariance C.

    matrix: (k, n, n) C Q. The χ² of the same first three cumulants (Hall, Buckley and Eagleson,
    1988): exact where all axes err alike or one alone, of two or three axes within 0.01 of the
    share.
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
