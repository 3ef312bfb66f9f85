"""Lines that the neighbouring beams of a scan make: what points of other scans are held against."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

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
    flatter: float = 0.25
    """Of the variance across the line through both sides, what one side must come below to be a
    wall of its own: of ten beams on one wall, one in twenty does so by chance (F test)."""
    flat_m: float = 0.002
    """1 sigma across a line that is no news: ranges come in steps of 1 to 10 mm."""


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
    """Fit a line through the neighbours of every point of (n, m, 2) scans, NaN where no return:
    on both sides, or on one, where that alone is flatter than chance.

    increment_rad: (n,) angle between neighbouring beams. Total least squares over the beams within
    `reach_m` that hang together; moments of all windows by prefix sums. O(n m).
    """
    distance = np.hypot(xy[..., 0], xy[..., 1]).astype(np.float64)
    with np.errstate(invalid="ignore"):
        seen = distance <= settings.farthest_m
    near = np.where(seen, distance, 1.0)
    low, high = _windows(xy, near, seen, increment_rad, settings)
    points = np.where(seen[..., None], xy, 0).astype(np.float64)
    x, y = points[..., 0], points[..., 1]
    beam = np.arange(xy.shape[1])
    sums = [_prefix_sums(values) for values in (x, y, x * x, y * y, x * y)]
    line = _line(sums, low, high)
    here = settings.flatter * _roughness(line, settings)
    # A line across a corner lies inside it, by how much depends on how far away it is seen from.
    for first, last in ((low, np.minimum(beam + 1, high)), (np.maximum(beam, low), high)):
        side = _line(sums, first, np.maximum(first, last))
        rough = np.where(side.size >= 2 * settings.least_beams, _roughness(side, settings), np.inf)
        better = rough < here
        here = np.where(better, rough, here)
        line = _Line(*(np.where(better, new, old) for new, old in zip(side, line, strict=True)))
    size, mx, my, along, across, length = line
    nx, ny = -np.sin(along), np.cos(along)
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


class _Line(NamedTuple):
    """Lines through beams (n, m): how many, their middle, direction [rad], variance across and
    along [m²]."""

    size: FloatArray
    x: FloatArray
    y: FloatArray
    along: FloatArray
    across: FloatArray
    length: FloatArray


def _prefix_sums(values: FloatArray) -> FloatArray:
    out = np.zeros((len(values), values.shape[1] + 1))
    np.cumsum(values, axis=1, out=out[:, 1:])
    return out


def _line(sums: Sequence[FloatArray], low: IntArray, high: IntArray) -> _Line:
    """Through beams `low` to before `high` (n, m), by sums of x, y, x², y², x y before each."""
    rows = np.arange(len(low))[:, None]
    size = np.maximum(high - low, 1).astype(np.float64)
    x, y, xx, yy, xy = ((total[rows, high] - total[rows, low]) / size for total in sums)
    xx, yy, xy = xx - x * x, yy - y * y, xy - x * y
    root = np.sqrt(0.25 * (xx - yy) ** 2 + xy**2)
    across, length = np.maximum(0.5 * (xx + yy) - root, 0.0), 0.5 * (xx + yy) + root
    return _Line(size, x, y, 0.5 * np.arctan2(2 * xy, xx - yy), across, length)


def _roughness(line: _Line, settings: SurfaceSettings) -> FloatArray:
    """Variance across each line [m²], its two parameters allowed for."""
    freedom = np.maximum(line.size - 2, 0.5)
    return np.asarray((line.across + settings.flat_m**2) * line.size / freedom)


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
    beam = np.arange(xy.shape[1])
    begins, ends = np.ones((n, m), bool), np.ones((n, m), bool)
    begins[:, 1:], ends[:, :-1] = broken, broken
    first = np.maximum.accumulate(np.where(begins, beam, 0), axis=1)
    last = np.minimum.accumulate(np.where(ends, beam, m - 1)[:, ::-1], axis=1)[:, ::-1]
    wide = np.rint(settings.reach_m / (np.maximum(distance, 0.05) * step))
    wide = np.clip(wide, settings.least_beams, settings.most_beams).astype(np.int64)
    low, high = np.maximum(beam - wide, first), np.minimum(beam + wide, last) + 1
    return np.where(seen, low, 0), np.where(seen, high, 0)
