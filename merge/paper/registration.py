"""Least-squares rigid transforms from vertex correspondences (§3.1).

The paper's choice is the two-dimensional version of point-based rigid registration by singular
value decomposition of a two-by-two covariance matrix (Fitzpatrick, Hill and Maurer).
"""

from __future__ import annotations

from typing import Any, Literal

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

    rotation_rad, free: (count,); the others keep the rotation given.
    """

    def fitted(w: FloatArray) -> FloatArray:
        moved = translate_groups(xy_a, xy_b, group, rotation_rad, w)
        if not np.any(free):
            return moved
        return np.where(free[:, None], register_groups(xy_a, xy_b, group, len(free), w), moved)

    T = fitted(np.ones(len(group)))
    for _ in range(ROUNDS if weights == "reweighted" and len(group) else 0):
        distance = np.hypot(*(xy_a - apply(T[group], xy_b)).T)
        T = fitted(1 / np.maximum(distance, NEAR_M))
    return T


def register(xy_a: Any, xy_b: Any, weights: Any = None) -> FloatArray:
    """T_a_b (3,) with the least (weighted) squared distance between `xy_a` and the moved `xy_b`.

    xy_a, xy_b: (n, 2); weights: (n,), not negative, not all zero. Where the best orthogonal matrix
    is a reflection, the best rotation is taken instead. Points that all coincide leave the
    rotation at 0. Raises ValueError on shapes that differ or no pairs.
    """
    a, b = np.asarray(xy_a, np.float64), np.asarray(xy_b, np.float64)
    if a.shape != b.shape or a.ndim != 2 or a.shape[1] != 2 or len(a) == 0:
        raise ValueError(f"register needs two equal (n, 2) arrays, got {a.shape} and {b.shape}")
    w = np.ones(len(a)) if weights is None else np.asarray(weights, np.float64)
    if w.shape != (len(a),) or np.any(w < 0) or not w.sum() > 0:
        raise ValueError("register needs one weight per pair, none negative, not all zero")
    return np.asarray(register_groups(a, b, np.zeros(len(a), np.int64), 1, w)[0])


def register_groups(
    xy_a: FloatArray,
    xy_b: FloatArray,
    group: IntArray,
    count: int,
    weights: FloatArray | None = None,
) -> FloatArray:
    """(count, 3) T_a_b of every group of pairs at once: one batched two-by-two SVD.

    group: (n,) group of each pair, every group present. R = V diag(1, det(V Uᵀ)) Uᵀ with
    U S Vᵀ = Σ w q pᵀ of the centred points: the determinant turns the reflection case back.
    """
    w = np.ones(len(group)) if weights is None else weights
    total = np.asarray(np.bincount(group, w, count), np.float64)
    mean_a, mean_b = _means(xy_a, group, count, w, total), _means(xy_b, group, count, w, total)
    p, q = xy_a - mean_a[group], xy_b - mean_b[group]
    covariance = np.empty((count, 2, 2))
    for i in range(2):
        for j in range(2):
            covariance[:, i, j] = np.bincount(group, w * q[:, i] * p[:, j], count)
    u, s, vt = np.linalg.svd(covariance)
    v, ut = vt.transpose(0, 2, 1), u.transpose(0, 2, 1)
    sign = np.where(np.linalg.det(v @ ut) < 0, -1.0, 1.0)
    v = v.copy()
    v[:, :, 1] *= sign[:, None]
    R = v @ ut
    R[s[:, 0] <= 0] = np.eye(2)
    shift = mean_a - np.einsum("kij,kj->ki", R, mean_b)
    return np.column_stack([shift, wrap(np.arctan2(R[:, 1, 0], R[:, 0, 0]))])


def translate_groups(
    xy_a: FloatArray,
    xy_b: FloatArray,
    group: IntArray,
    rotation_rad: FloatArray,
    weights: FloatArray | None = None,
) -> FloatArray:
    """(count, 3) T_a_b of every group, its rotation (count,) given (§3.3)."""
    count = len(rotation_rad)
    w = np.ones(len(group)) if weights is None else weights
    total = np.asarray(np.bincount(group, w, count), np.float64)
    mean_a, mean_b = (_means(xy, group, count, w, total) for xy in (xy_a, xy_b))
    c, s = np.cos(rotation_rad), np.sin(rotation_rad)
    x = mean_a[:, 0] - c * mean_b[:, 0] + s * mean_b[:, 1]
    y = mean_a[:, 1] - s * mean_b[:, 0] - c * mean_b[:, 1]
    return np.column_stack([x, y, wrap(rotation_rad)])


def _means(
    xy: FloatArray, group: IntArray, count: int, w: FloatArray, total: FloatArray
) -> FloatArray:
    return np.column_stack([np.bincount(group, w * xy[:, k], count) / total for k in range(2)])
