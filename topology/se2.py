"""SE(2): the rigid motions of the plane, and the only place that converts conventions.

A pose or transform is an array (..., 3) of x [m], y [m], theta [rad]; `T_a_b` takes coordinates
of frame b to frame a, so `T_a_c = compose(T_a_b, T_b_c)`. Angles are in [-pi, pi).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


def wrap(angle_rad: Any) -> Any:
    """Bring angles into [-pi, pi); scalars stay scalars, arrays keep their shape."""
    return (angle_rad + np.pi) % (2 * np.pi) - np.pi


def rotation(theta_rad: float) -> FloatArray:
    """(2, 2) matrix that turns column vectors by `theta_rad`."""
    c, s = np.cos(theta_rad), np.sin(theta_rad)
    return np.array([[c, -s], [s, c]])


def turned_axes(theta_rad: FloatArray) -> FloatArray:
    """(k, 3, 3) diag(R(θ), 1) of angles (k,): turns x and y, and leaves directions."""
    out = np.zeros((len(theta_rad), 3, 3))
    out[:, 0, 0] = out[:, 1, 1] = np.cos(theta_rad)
    out[:, 1, 0] = np.sin(theta_rad)
    out[:, 0, 1] = -out[:, 1, 0]
    out[:, 2, 2] = 1.0
    return out


def compose(T_a_b: Any, T_b_c: Any) -> FloatArray:
    """T_a_c, broadcast over leading axes of both (..., 3)."""
    ab, bc = np.asarray(T_a_b, np.float64), np.asarray(T_b_c, np.float64)
    c, s = np.cos(ab[..., 2]), np.sin(ab[..., 2])
    x = ab[..., 0] + c * bc[..., 0] - s * bc[..., 1]
    y = ab[..., 1] + s * bc[..., 0] + c * bc[..., 1]
    return np.stack([x, y, wrap(ab[..., 2] + bc[..., 2])], axis=-1)


def inverse(T_a_b: Any) -> FloatArray:
    """T_b_a of (..., 3)."""
    ab = np.asarray(T_a_b, np.float64)
    c, s = np.cos(ab[..., 2]), np.sin(ab[..., 2])
    x = -c * ab[..., 0] - s * ab[..., 1]
    y = s * ab[..., 0] - c * ab[..., 1]
    return np.stack([x, y, wrap(-ab[..., 2])], axis=-1)


def between(T_w_a: Any, T_w_b: Any) -> FloatArray:
    """T_a_b of two poses in one frame: where b is, seen from a."""
    return compose(inverse(T_w_a), T_w_b)


def apply(T_a_b: Any, xy_b: Any) -> FloatArray:
    """Points (..., 2) of frame b in frame a; one transform, or one per point."""
    ab, p = np.asarray(T_a_b, np.float64), np.asarray(xy_b, np.float64)
    c, s = np.cos(ab[..., 2]), np.sin(ab[..., 2])
    x = ab[..., 0] + c * p[..., 0] - s * p[..., 1]
    y = ab[..., 1] + s * p[..., 0] + c * p[..., 1]
    return np.stack([x, y], axis=-1)


def fit_rigid(xy_a: Any, xy_b: Any) -> FloatArray:
    """Least-squares T_a_b with `xy_a ≈ apply(T_a_b, xy_b)` (§3.1; no scaling, no reflection).

    In the plane the rotation of the orthogonal Procrustes problem has a closed form, equal to the
    SVD solution restricted to det R = +1. xy_a, xy_b: (n, 2). One pair, or pairs that all coincide,
    leave the rotation undetermined: theta is 0 then. Raises ValueError on no pairs, and on
    shapes that differ.
    """
    a, b = np.asarray(xy_a, np.float64), np.asarray(xy_b, np.float64)
    if a.shape != b.shape or a.ndim != 2 or a.shape[1] != 2 or len(a) == 0:
        raise ValueError(f"fit_rigid needs two equal (n, 2) arrays, got {a.shape} and {b.shape}")
    mean_a, mean_b = a.mean(axis=0), b.mean(axis=0)
    p, q = a - mean_a, b - mean_b
    theta = float(np.arctan2((q[:, 0] * p[:, 1] - q[:, 1] * p[:, 0]).sum(), (p * q).sum()))
    shift = mean_a - rotation(theta) @ mean_b
    return np.array([shift[0], shift[1], wrap(theta)])


def yaw_from_quaternion(x: Any, y: Any, z: Any, w: Any) -> Any:
    """Rotation about the vertical axis [rad] of unit or non-unit quaternions (x, y, z, w).

    For a pure yaw this is 2·atan2(z, w); a roll or pitch on top is projected away (ZYX Euler). What
    is not finite, or too large to be squared, may give nan.
    """
    with np.errstate(invalid="ignore", over="ignore"):
        return np.arctan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z)
