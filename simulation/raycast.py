"""What a beam meets first: walls, doors, people."""

from __future__ import annotations

import numpy as np

from ..topology.arrays import BoolArray, FloatArray, IntArray
from .walls import Segments

NOTHING = -1
"""Stands for the segment that a beam meets, where it meets none."""


def cast_at_segments(
    origin: FloatArray,
    direction: FloatArray,
    segments: Segments,
    present: BoolArray | None = None,
) -> tuple[FloatArray, IntArray, FloatArray]:
    """How far each beam gets, which segment it meets, and where on it. O(r s), vectorised.

    origin, direction: (r, 2), directions of length 1; present: (r, s) which segments are there for
    which beam. Returns way (r,) [m], inf where nothing is met; segment (r,), NOTHING there; at (r,)
    way along the segment from its begin [m].
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
    """(r,) way of each beam to the nearest circle, inf where it meets none.

    origin, direction: (r, 2); centre: (r, p, 2), where the circles are for each beam.
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
