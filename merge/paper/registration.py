"""Least-squares rigid transforms from vertex correspondences (§3.1).

The paper's choice is the two-dimensional version of point-based rigid registration by singular
value decomposition of a two-by-two covariance matrix (Fitzpatrick, Hill and Maurer); here it is the
closed form of `se2.rigid_from_sums`, for all groups of pairs at once.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from ...topology import se2
from ...topology.arrays import BoolArray, FloatArray, IntArray
from ...topology.se2 import apply, wrap

Weights = Literal["equal", "reweighted"]
"""equal: unweighted, as the paper chooses; reweighted: "iteratively reweighted least-squares", as
is usual in image registration (§3.1), here minimising the sum of distances instead of squares."""

ROUNDS = 20
"""Rounds of reweighting; by then transforms change by less than a millimetre."""
NEAR_M = 0.01
"""Distance below which vertices have equal weights: the sum of distances is not smooth at 0."""


def fit_groups(
    xy_a: FloatArray,
    xy_b: FloatArray,
    group: IntArray,
    rotation_rad: FloatArray,
    *,
    free: BoolArray,
    weights: Weights = "equal",
) -> FloatArray:
    """(count, 3) T_a_b of every group of pairs; only `free` groups estimate their rotation.

    group: (n,) group of each pair, every group present; rotation_rad, free: (count,): the others
    keep the rotation given (§3.3).
    """
    turn = np.where(free, 0.0, np.exp(1j * rotation_rad))
    T = se2.fit_groups(xy_a, xy_b, group, np.ones(len(group)), turn)
    T[~free, 2] = wrap(rotation_rad[~free])
    for _ in range(ROUNDS if weights == "reweighted" and len(group) else 0):
        distance = np.hypot(*(xy_a - apply(T[group], xy_b)).T)
        T = se2.fit_groups(xy_a, xy_b, group, 1 / np.maximum(distance, NEAR_M), turn)
    return T
