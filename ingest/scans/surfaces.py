"""Lines that the neighbouring beams of a scan make: what points of other scans are held against."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Float32Array = NDArray[np.float32]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class SurfaceSettings:
    """Which neighbouring beams lie on one surface."""

    reach_m: float = 0.35
    """Half the length of wall that makes a line: long beside the noise of a range (1 to 3 cm),
    short beside a door's frame."""
    least_beams: int = 2
    """On either side, however far apart they are."""
    most_beams: int = 10
    thickness_m: float = 0.06
    """1 sigma across the line beyond which it is none: the noise of the coarsest lasers."""
    farthest_m: float = 20.0
    """Farther returns make none: their footprint is wider than a wall is straight."""
    grazing: float = 5.0
    """Beams that graze a wall at more than 78 degrees (1 / cos = 5) leave gaps unbridged."""


@dataclass(frozen=True, slots=True, eq=False)
class Surfaces:
    """Of scans (n, m): x, y of a point on the fitted line, nx, ny of its normal towards the laser;
    where there is none, `valid` is False and the point is out of reach."""

    x: Float32Array
    y: Float32Array
    nx: Float32Array
    ny: Float32Array
    valid: BoolArray


OUT_OF_REACH_M = 1e4
"""No laser reaches so far: what is there is nobody's nearest."""


def surfaces(
    xy: Float32Array, increment_rad: FloatArray, settings: SurfaceSettings = SurfaceSettings()
) -> Surfaces:
    """Fit a line through the neighbours of every point of (n, m, 2) scans, NaN where no return.

    increment_rad: (n,) angle between neighbouring beams. Total least squares over the beams within
    `reach_m` that hang together; moments of all windows by prefix sums. O(n m).
    """
    n, m = xy.shape[:2]
    distance = np.hypot(xy[..., 0], xy[..., 1]).astype(np.float64)
    with np.errstate(invalid="ignore"):
        seen = distance <= settings.farthest_m
    near = np.where(seen, distance, 1.0)
    low, high = _windows(xy, near, seen, increment_rad, settings)
    points = np.where(seen[..., None], xy, 0).astype(np.float64)
    x, y = points[..., 0], points[..., 1]
    size = np.maximum(high - low, 1).astype(np.float64)
    rows = np.arange(n)[:, None]

    def mean(values: FloatArray) -> FloatArray:
        total = np.zeros((n, m + 1))
        np.cumsum(values, axis=1, out=total[:, 1:])
        return np.asarray((total[rows, high] - total[rows, low]) / size)

    mx, my = mean(x), mean(y)
    xx, yy, xy_ = mean(x * x) - mx * mx, mean(y * y) - my * my, mean(x * y) - mx * my
    along = 0.5 * np.arctan2(2 * xy_, xx - yy)
    nx, ny = -np.sin(along), np.cos(along)
    root = np.sqrt(0.25 * (xx - yy) ** 2 + xy_**2)
    across, length = np.maximum(0.5 * (xx + yy) - root, 0.0), 0.5 * (xx + yy) + root
    valid = (
        seen
        & (size > 2 * settings.least_beams - 1)
        & (across < settings.thickness_m**2)
        & (length > 9 * across)
    )
    off = nx * (x - mx) + ny * (y - my)
    towards = np.where(nx * x + ny * y > 0, -1.0, 1.0)
    return Surfaces(
        np.where(valid, x - nx * off, OUT_OF_REACH_M).astype(np.float32),
        (y - ny * off).astype(np.float32),
        (nx * towards).astype(np.float32),
        (ny * towards).astype(np.float32),
        valid,
    )


def _windows(
    xy: Float32Array,
    distance: FloatArray,
    seen: BoolArray,
    increment_rad: FloatArray,
    settings: SurfaceSettings,
) -> tuple[IntArray, IntArray]:
    """First beam, and that after the last, of every point's window: unbroken, within reach."""
    n, m = distance.shape
    step = increment_rad[:, None]
    gap = np.hypot(*np.moveaxis(np.diff(xy.astype(np.float64), axis=1), -1, 0))
    limit = 0.1 + settings.grazing * step * np.minimum(distance[:, 1:], distance[:, :-1])
    broken = ~(gap < limit)
    beam = np.arange(m)
    begins, ends = np.ones((n, m), bool), np.ones((n, m), bool)
    begins[:, 1:], ends[:, :-1] = broken, broken
    first = np.maximum.accumulate(np.where(begins, beam, 0), axis=1)
    last = np.minimum.accumulate(np.where(ends, beam, m - 1)[:, ::-1], axis=1)[:, ::-1]
    wide = np.rint(settings.reach_m / (np.maximum(distance, 0.05) * step))
    wide = np.clip(wide, settings.least_beams, settings.most_beams).astype(np.int64)
    low, high = np.maximum(beam - wide, first), np.minimum(beam + wide, last) + 1
    return np.where(seen, low, 0), np.where(seen, high, 0)
