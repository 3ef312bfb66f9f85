"""A run as loop closure sees it: passes in a row, and the legs driven between them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..odometry import Odometry
from ..passes import Passes
from ..topomap import RunNoise
from ..track import chain_of, way_at

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class Walk:
    """The passes of a run and what the odometry says about the way between them.

    chain: (p,) unbroken piece of odometry of each pass. way: (p,) way driven so far [m].
    leg: (p - 1,) way from each pass to the next [m], NaN across a break. sums: (p, 13) prefix sums
    of the odometry's random walk up to each pass (`relative_covariance`), about `origin`.
    """

    passes: Passes
    noise: RunNoise
    bias_sigma: tuple[float, float]
    chain: IntArray
    way: FloatArray
    leg: FloatArray
    origin: FloatArray
    sums: FloatArray

    def __len__(self) -> int:
        return len(self.passes)


def make_walk(
    odometry: Odometry,
    passes: Passes,
    noise: RunNoise,
    bias_sigma: tuple[float, float] = (0.0, 0.0),
) -> Walk:
    """The walk of a run. bias_sigma: 1 sigma of a constant turning error per metre and per radian.

    O(n + p log n).
    """
    way = way_at(odometry, passes.time_ns)
    chain = chain_of(odometry, passes.time_ns)
    leg = np.where(np.diff(chain) == 0, np.diff(way), np.nan)
    origin = odometry.pose[:, :2].mean(axis=0)
    sums = _prefix_sums(odometry, passes, noise, origin)
    return Walk(passes, noise, bias_sigma, chain, way, leg, origin, sums)


def _prefix_sums(
    odometry: Odometry, passes: Passes, noise: RunNoise, origin: FloatArray
) -> FloatArray:
    """(p, 13) sums over all odometry steps before each pass.

    Columns: Σq, Σq x, Σq y, Σq x², Σq xy, Σq y² with q the heading variance of a step; Στ² ds;
    Σds, Σds x, Σds y; Σdθ, Σdθ x, Σdθ y.
    """
    step, turn = odometry.step_m, np.abs(odometry.turn_rad)
    x, y = (odometry.pose[:, :2] - origin).T
    q = noise.heading_rad_per_sqrt_m**2 * step + noise.heading_rad_per_sqrt_rad**2 * turn
    along = noise.along_m_per_sqrt_m**2 * step
    signed = odometry.turn_rad
    rows = np.stack(
        [
            q,
            q * x,
            q * y,
            q * x * x,
            q * x * y,
            q * y * y,
            along,
            step,
            step * x,
            step * y,
            signed,
            signed * x,
            signed * y,
        ],
        axis=1,
    )
    total = np.cumsum(rows, axis=0)
    origin_ns = odometry.time_ns[0]
    times = (odometry.time_ns - origin_ns).astype(np.float64)
    query = (passes.time_ns - origin_ns).astype(np.float64)
    return np.stack([np.interp(query, times, column) for column in total.T], axis=1)


def relative_covariance(walk: Walk, first: IntArray, second: IntArray) -> FloatArray:
    """(k, 3, 3) covariance of pass `second`'s x, y, theta as dead reckoned from pass `first`.

    Axes are those of the odometry frame; theta is the error of the frame's direction. Closed form
    from prefix sums, O(1) per pair: with S0 = Σq, S1 = Σq p, S2 = Σq p pᵀ over the steps between
    and c the second pass, C_θθ = S0, C_xyθ = J (S0 c - S1), and
    C_xy = Στ² ds I + J (S0 c cᵀ - S1 cᵀ - c S1ᵀ + S2) Jᵀ.
    """
    low, high = np.minimum(first, second), np.maximum(first, second)
    d = walk.sums[high] - walk.sums[low]
    c = walk.passes.centre[second] - walk.origin
    s0, s1x, s1y, s2xx, s2xy, s2yy, along = d[:, :7].T
    x, y = c.T
    mxx = s0 * x * x - 2 * s1x * x + s2xx
    mxy = s0 * x * y - s1x * y - s1y * x + s2xy
    myy = s0 * y * y - 2 * s1y * y + s2yy
    out = np.zeros((len(d), 3, 3))
    # J m Jᵀ with J = [[0, -1], [1, 0]].
    out[:, 0, 0] = along + myy
    out[:, 1, 1] = along + mxx
    out[:, 0, 1] = out[:, 1, 0] = -mxy
    out[:, 0, 2] = out[:, 2, 0] = -(s0 * y - s1y)
    out[:, 1, 2] = out[:, 2, 1] = s0 * x - s1x
    out[:, 2, 2] = s0
    # Constant errors of a run: scale, turning per metre, turning per radian.
    shift = c - (walk.passes.centre[first] - walk.origin)
    modes = [np.column_stack([shift * walk.noise.scale, np.zeros(len(d))])]
    for sigma, at in zip(walk.bias_sigma, (7, 10), strict=True):
        if sigma > 0:
            l0, l1x, l1y = d[:, at], d[:, at + 1], d[:, at + 2]
            modes.append(sigma * np.column_stack([-(l0 * y - l1y), l0 * x - l1x, l0]))
    for mode in modes:
        out += mode[:, :, None] * mode[:, None, :]
    return out
