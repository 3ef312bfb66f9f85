"""Line fits to neighbouring beams of a scan, for point-to-line scan matching."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ...topology.arrays import BoolArray, Float32Array, FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class SurfaceSettings:
    """Which neighbouring beams belong to one surface."""

    reach_m: float = 0.35
    """Half the length of wall to fit: long against range noise (1 to 3 cm), short against a door
    frame."""
    least_beams: int = 2
    """Fewest beams on either side, whatever their distance."""
    most_beams: int = 10
    thickness_m: float = 0.06
    """Largest standard deviation across the line, about the noise of the coarsest lasers."""
    farthest_m: float = 20.0
    """Farther echoes have no line: the beam's footprint is larger than walls are straight."""
    grazing: float = 5.0
    """Neighbours are connected up to an incidence angle of 78° (1 / cos = 5)."""
    flatter: float = 0.25
    """A one-sided fit replaces the two-sided one if its variance is below this share of it: for ten
    beams on one wall this happens by chance for one in twenty (F test)."""
    flat_m: float = 0.002
    """Standard deviation below which fits are equal: ranges are quantised in steps of 1 to 10
    mm."""


SURFACES = SurfaceSettings()


@dataclass(frozen=True, slots=True, eq=False)
class Surfaces:
    """Line fits of scans, (n, m) each: a point x, y on the line [m] and its unit normal nx, ny,
    towards the laser.

    Where there is none `valid` is False, the normal zero and the point OUT_OF_REACH_M away.
    """

    x: Float32Array
    y: Float32Array
    nx: Float32Array
    ny: Float32Array
    valid: BoolArray


MOST_POINTS = 1 << 18
"""Points worked on at once, some 100 bytes each."""
OUT_OF_REACH_M = 1e4
"""Coordinate of missing points, far enough never to be a nearest neighbour."""
LEAST_M2 = 1e-9
"""Lower bound of the variance along a line."""


def surfaces(xy: Float32Array, increment_rad: FloatArray) -> Surfaces:
    """Fit a line to the neighbours of every point of scans (n, m, 2) [m], NaN without an echo: to
    those on both sides, or on one side where that fit is significantly flatter.

    increment_rad: (n,) angle between neighbouring beams. Total least squares over the connected
    beams within `reach_m`; the moments of all windows are differences of prefix sums. O(n m).
    """
    distance = np.hypot(xy[..., 0], xy[..., 1]).astype(np.float64)
    with np.errstate(invalid="ignore"):
        seen = distance <= SURFACES.farthest_m
    near = np.where(seen, distance, 1.0)
    low, high = _windows(xy, near, seen, increment_rad)
    points = np.where(seen[..., None], xy, 0).astype(np.float64)
    x, y = points[..., 0], points[..., 1]
    # Sums over all beams before each.
    sums = np.cumsum(np.stack([x, y, x * x, y * y, x * y]), axis=-1)
    sums = np.pad(sums, ((0, 0), (0, 0), (1, 0)))
    here = SURFACES.flatter * _roughness(_line(sums, low, high))
    # A line fitted across a corner lies inside it, by an amount that depends on the distance.
    beam = np.arange(xy.shape[1])
    sides = (low, np.minimum(beam + 1, high)), (np.maximum(beam, low), high)
    for first, last in sides:
        side = _line(sums, first, np.maximum(first, last))
        rough = np.where(side.size >= 2 * SURFACES.least_beams, _roughness(side), np.inf)
        better = rough < here
        here = np.minimum(rough, here)
        low, high = low + better * (first - low), high + better * (last - high)
    size, mx, my, across, length, cos2, sin2 = _line(sums, low, high)
    # Half-angle formulas with roots only: sines and arctangents differ between processors.
    twice = 2 * np.maximum(np.sqrt(cos2 * cos2 + sin2 * sin2), LEAST_M2)
    nx = -np.copysign(np.sqrt(np.maximum(0.5 - cos2 / twice, 0.0)), sin2)
    ny = np.sqrt(np.maximum(0.5 + cos2 / twice, 0.0))
    valid = (
        seen
        & (size > 2 * SURFACES.least_beams - 1)
        & (across < SURFACES.thickness_m**2)
        & (length > 9 * across)
    )
    off = nx * (x - mx) + ny * (y - my)
    towards = -np.copysign(1.0, nx * x + ny * y)
    towards *= valid
    return Surfaces(
        np.where(valid, x - nx * off, OUT_OF_REACH_M).astype(np.float32),
        (y - ny * off).astype(np.float32),
        (nx * towards).astype(np.float32),
        (ny * towards).astype(np.float32),
        valid,
    )


class _Line(NamedTuple):
    """Line fits through beams (n, m): number of beams, centroid, variance across and along [m²];
    cosine and sine of twice the direction, times the difference of both variances."""

    size: FloatArray
    x: FloatArray
    y: FloatArray
    across: FloatArray
    length: FloatArray
    cos2: FloatArray
    sin2: FloatArray


def _line(sums: FloatArray, low: IntArray, high: IntArray) -> _Line:
    """Fit lines through the beams [low, high), (n, m) each, from prefix sums of x, y, x², y², x
    y."""
    size = np.maximum(high - low, 1).astype(np.float64)
    begin = sums.shape[2] * np.arange(len(low))[:, None]
    low, high = begin + low, begin + high
    x, y, xx, yy, xy = ((total.take(high) - total.take(low)) / size for total in sums)
    xx, yy, xy = xx - x * x, yy - y * y, xy - x * y
    cos2, sin2 = xx - yy, 2 * xy
    # The smaller eigenvalue from the determinant, which avoids cancellation.
    length = 0.5 * (xx + yy + np.sqrt((cos2 * cos2 + sin2 * sin2).astype(np.float32)))
    across = np.maximum(xx * yy - xy * xy, 0.0) / np.maximum(length, LEAST_M2)
    return _Line(size, x, y, across, length, cos2, sin2)


def _roughness(line: _Line) -> FloatArray:
    """Unbiased variance across each line [m²], for two fitted parameters."""
    freedom = np.maximum(line.size - 2, 0.5)
    return np.asarray((line.across + SURFACES.flat_m**2) * line.size / freedom)


def _windows(
    xy: Float32Array, distance: FloatArray, seen: BoolArray, increment_rad: FloatArray
) -> tuple[IntArray, IntArray]:
    """First beam, and that after the last, of every point's window: connected and within reach."""
    n, m = distance.shape
    step = increment_rad[:, None]
    dx, dy = (xy[:, 1:, k] - xy[:, :-1, k] for k in (0, 1))
    limit = 0.1 + SURFACES.grazing * step * np.minimum(distance[:, 1:], distance[:, :-1])
    broken = ~(dx * dx + dy * dy < limit * limit)
    beam = np.arange(xy.shape[1])
    begins, ends = np.ones((n, m), bool), np.ones((n, m), bool)
    begins[:, 1:], ends[:, :-1] = broken, broken
    first = np.maximum.accumulate(np.where(begins, beam, 0), axis=1)
    last = np.minimum.accumulate(np.where(ends, beam, m - 1)[:, ::-1], axis=1)[:, ::-1]
    wide = np.rint(SURFACES.reach_m / (np.maximum(distance, 0.05) * step))
    wide = np.clip(wide, SURFACES.least_beams, SURFACES.most_beams).astype(np.int64)
    low, high = np.maximum(beam - wide, first), np.minimum(beam + wide, last) + 1
    return np.where(seen, low, 0), np.where(seen, high, 0)
