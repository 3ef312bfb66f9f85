"""Least-squares rigid transforms from vertex correspondences (§3.1).

The paper's choice is the two-dimensional version of point-based rigid registration by singular
value decomposition of a two-by-two covariance matrix (Fitzpatrick, Hill and Maurer); here it is in
closed form, for all groups of pairs at once.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ...topology.se2 import apply, wrap

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

Weights = Literal["equal", "reweighted"]
"""equal: unweighted, as the paper chooses; reweighted: "iteratively reweighted least-squares", as
is usual in image registration (§3.1), here for the least sum of distances, not of their squares."""

ROUNDS = 20
"""Rounds of reweighting; by then transforms move by less than a millimetre."""
NEAR_M = 0.01
"""Vertices nearer than this all weigh alike: the sum of distances has a kink at 0."""


def fit_groups(
    xy_a: FloatArray,
    xy_b: FloatArray,
    group: IntArray,
    rotation_rad: FloatArray,
    *,
    free: NDArray[np.bool_],
    weights: Weights = "equal",
) -> FloatArray:
    """(count, 3) T_a_b of every group of pairs; only those of `free` groups find their rotation.

    group: (n,) group of each pair, every group present; rotation_rad, free: (count,): the others
    keep the rotation given (§3.3).
    """

    def fitted(w: FloatArray) -> FloatArray:
        mean_a, mean_b = _means(xy_a, group, w), _means(xy_b, group, w)
        p, q = xy_a - mean_a[group], xy_b - mean_b[group]
        turn = np.where(free, _rotations(p, q, group, w), rotation_rad)
        turned = apply(np.column_stack([np.zeros((len(turn), 2)), turn]), mean_b)
        return np.column_stack([mean_a - turned, wrap(turn)])

    T = fitted(np.ones(len(group)))
    for _ in range(ROUNDS if weights == "reweighted" and len(group) else 0):
        distance = np.hypot(*(xy_a - apply(T[group], xy_b)).T)
        T = fitted(1 / np.maximum(distance, NEAR_M))
    return T


def _rotations(p: FloatArray, q: FloatArray, group: IntArray, w: FloatArray) -> FloatArray:
    """Best rotation of every group of centred points; 0 where all of its points coincide.

    In the plane the rotation of the orthogonal Procrustes problem has a closed form, equal to that
    of the singular value decomposition with a determinant of 1.
    """
    cross = np.bincount(group, w * (q[:, 0] * p[:, 1] - q[:, 1] * p[:, 0]))
    return np.asarray(np.arctan2(cross, np.bincount(group, w * (p * q).sum(axis=1))))


def _means(xy: FloatArray, group: IntArray, w: FloatArray) -> FloatArray:
    total = np.bincount(group, w)
    return np.column_stack([np.bincount(group, w * xy[:, k]) / total for k in range(2)])
