"""SE(2): the rigid motions of the plane, and the only place that converts conventions.

A pose or transform is an array (..., 3) of x [m], y [m], theta [rad]; `T_a_b` takes coordinates
of frame b to frame a, so `T_a_c = compose(T_a_b, T_b_c)`. Angles are in [-pi, pi).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from .arrays import ComplexArray, FloatArray, IntArray


def wrap(angle_rad: Any) -> Any:
    """Bring angles into [-pi, pi); scalars stay scalars, arrays keep their shape."""
    return (angle_rad + np.pi) % (2 * np.pi) - np.pi


def rotation(theta_rad: float) -> FloatArray:
    """(2, 2) matrix that turns column vectors by `theta_rad`."""
    c, s = np.cos(theta_rad), np.sin(theta_rad)
    return np.array([[c, -s], [s, c]])


def turned(xy: FloatArray, theta_rad: Any) -> FloatArray:
    """Vectors (..., 2) rotated by one angle, or by angles (...,) [rad]."""
    c, s = np.cos(theta_rad), np.sin(theta_rad)
    x, y = xy[..., 0], xy[..., 1]
    return np.stack([c * x - s * y, s * x + c * y], axis=-1)


def turned_axes(theta_rad: FloatArray) -> FloatArray:
    """(k, 3, 3) diag(R(θ), 1) of angles (k,) [rad]."""
    axes = np.zeros((len(theta_rad), 3, 3))
    axes[:, 0, 0] = axes[:, 1, 1] = np.cos(theta_rad)
    axes[:, 1, 0] = np.sin(theta_rad)
    axes[:, 0, 1] = -axes[:, 1, 0]
    axes[:, 2, 2] = 1.0
    return axes


def compose(T_a_b: Any, T_b_c: Any) -> FloatArray:
    """T_a_c, broadcast over the leading axes of both (..., 3)."""
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
    """T_a_b of two poses in one frame: pose b in the frame of a."""
    return compose(inverse(T_w_a), T_w_b)


def apply(T_a_b: Any, xy_b: Any) -> FloatArray:
    """Points (..., 2) of frame b in frame a; one transform for all, or one per point."""
    ab, p = np.asarray(T_a_b, np.float64), np.asarray(xy_b, np.float64)
    c, s = np.cos(ab[..., 2]), np.sin(ab[..., 2])
    x = ab[..., 0] + c * p[..., 0] - s * p[..., 1]
    y = ab[..., 1] + s * p[..., 0] + c * p[..., 1]
    return np.stack([x, y], axis=-1)


def xy_as_complex(points: FloatArray) -> ComplexArray:
    """(n,) x + iy of points or poses, (n, 2) or (n, 3)."""
    return np.asarray(points[:, 0] + 1j * points[:, 1])


def rigid_from_sums(
    weight: Any, sum_a: Any, sum_b: Any, sum_ab: Any, lever: Any = 0.0
) -> tuple[Any, Any, Any]:
    """Weighted least-squares rigid motion of points b = x + iy onto points a, from their sums.

    The only rigid fit of the project (§3.1; orthogonal Procrustes in closed form, without scaling
    or reflection): the rotation is the direction of Σ w (a - ā) conj(b - b̄), and b̄ is moved onto
    ā. weight: Σ w, positive; sum_a: Σ w a; sum_b: Σ w b; sum_ab: Σ w a conj(b): numbers, or arrays
    for many fits at once; lever: added to the sum [m²], for other information on the rotation.
    Returns the rotation as a unit number (0 where undetermined) and the weighted means ā and b̄.
    """
    mean_a, mean_b = sum_a / weight, sum_b / weight
    turn = sum_ab - sum_a * mean_b.conjugate() + lever
    return turn / (abs(turn) + _TINY), mean_a, mean_b


_TINY = 1e-300
"""Avoids 0 / 0 without changing any other quotient."""


def fit_rigid(xy_a: Any, xy_b: Any) -> FloatArray:
    """Least-squares T_a_b with `xy_a ≈ apply(T_a_b, xy_b)`: `rigid_from_sums` with equal weights.

    xy_a, xy_b: (n, 2). One pair, or pairs that all coincide, leave the rotation undetermined; theta
    is 0 then. Raises ValueError without pairs and on shapes that differ.
    """
    a, b = np.asarray(xy_a, np.float64), np.asarray(xy_b, np.float64)
    if a.shape != b.shape or a.ndim != 2 or a.shape[1] != 2 or len(a) == 0:
        raise ValueError(f"fit_rigid needs two equal (n, 2) arrays, got {a.shape} and {b.shape}")
    group = np.zeros(len(a), np.int64)
    return np.asarray(fit_groups(a, b, group, np.ones(len(a)))[0])


def fit_groups(
    xy_a: FloatArray,
    xy_b: FloatArray,
    group: IntArray,
    weight: FloatArray,
    turn: ComplexArray | None = None,
) -> FloatArray:
    """(count, 3) weighted least-squares T_a_b of every group of pairs, all at once.

    xy_a, xy_b: (n, 2); group: (n,) group of each pair, every group present; weight: (n,); turn:
    (count,) given rotations as unit numbers, 0 for those to be estimated.
    """
    a, b = xy_as_complex(xy_a), xy_as_complex(xy_b)
    total = np.bincount(group, weight)
    mean_a, mean_b = _grouped(group, weight * a) / total, _grouped(group, weight * b) / total
    # About the means: far from the origin the sums themselves would lose digits.
    a, b = a - mean_a[group], b - mean_b[group]
    sums = (_grouped(group, weight * part) for part in (a, b, a * b.conj()))
    unit = rigid_from_sums(total, *sums)[0]
    if turn is not None:
        unit = np.where(turn != 0, turn, unit)
    unit = np.where(unit != 0, unit, 1.0)
    shift = mean_a - unit * mean_b
    return np.column_stack([shift.real, shift.imag, wrap(np.angle(unit))])


def _grouped(group: IntArray, value: ComplexArray) -> ComplexArray:
    out = np.bincount(group, value.real) + 1j * np.bincount(group, value.imag)
    return np.asarray(out)


def yaw_from_quaternion(x: Any, y: Any, z: Any, w: Any) -> Any:
    """Rotation about the vertical axis [rad] of quaternions (x, y, z, w), normalised or not.

    For a pure yaw this is 2·atan2(z, w); roll and pitch are projected away (ZYX Euler). NaN where a
    component is not finite or its square overflows.
    """
    with np.errstate(invalid="ignore", over="ignore"):
        return np.arctan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z)
