"""Ray casting against wall segments and circles."""

from __future__ import annotations

import numpy as np

from ..topology.arrays import BoolArray, FloatArray, IntArray
from .walls import Segments

NOTHING = -1
"""Segment of a beam that hits none."""


def cast_at_segments(
    origin: FloatArray,
    direction: FloatArray,
    segments: Segments,
    present: BoolArray | None = None,
) -> tuple[FloatArray, IntArray, FloatArray]:
    """The first hit of each beam on a set of segments. O(r s), vectorised.

    origin, direction: (r, 2), directions of unit length; present: (r, s) which segments exist for
    which beam. Returns range (r,) [m], inf without a hit; segment (r,), else NOTHING; at (r,)
    distance from the segment's start [m].
    """
    if len(segments) == 0:
        rays = len(origin)
        return np.full(rays, np.inf), np.full(rays, NOTHING, np.int64), np.zeros(rays)
    # o + t d = a + u e, solved for all beams against all segments by Cramer's rule.
    ex, ey = (segments.b - segments.a).T
    ax, ay = segments.a[:, 0] - origin[:, :1], segments.a[:, 1] - origin[:, 1:]
    dx, dy = direction[:, :1], direction[:, 1:]
    cross = dx * ey - dy * ex
    with np.errstate(divide="ignore", invalid="ignore"):
        way = (ax * ey - ay * ex) / cross
        share = (ax * dy - ay * dx) / cross
    met = (way > 0) & (share >= 0) & (share <= 1)
    if present is not None:
        met &= present
    way = np.where(met, way, np.inf)
    rows = np.arange(len(origin))
    first = way.argmin(axis=1)
    nearest = way[rows, first]
    hit = np.isfinite(nearest)
    at = np.where(hit, share[rows, first], 0.0) * segments.length[first]
    return nearest, np.where(hit, first, NOTHING).astype(np.int64), at


def cast_at_circles(
    origin: FloatArray, direction: FloatArray, centre: FloatArray, radius_m: float
) -> FloatArray:
    """(r,) range of each beam to the nearest circle, inf without a hit.

    origin, direction: (r, 2); centre: (r, p, 2), the circles' positions for each beam.
    """
    if centre.shape[1] == 0:
        return np.full(len(origin), np.inf)
    to = centre - origin[:, None]
    along = np.einsum("rpk,rk->rp", to, direction)
    apart2 = np.einsum("rpk,rpk->rp", to, to) - along**2
    half2 = radius_m**2 - apart2
    met = (half2 > 0) & (along > 0)
    way = np.where(met, along - np.sqrt(np.where(met, half2, 0.0)), np.inf)
    return np.asarray(np.where(way > 0, way, np.inf).min(axis=1))
