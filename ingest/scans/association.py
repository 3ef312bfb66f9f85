"""Points of one scan on the surfaces of another: the terms that point-to-line matching sums up.

Correspondences by projection: a point is moved into the other laser's frame, its bearing says which
beams to look at. No tree is built, and thousands of pairs of scans go through one call.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...topology.se2 import between, wrap
from .surfaces import BoolArray, Float32Array, FloatArray, IntArray, Surfaces


@dataclass(frozen=True, slots=True, eq=False)
class Swept:
    """`k` scans on one raster of beams, with their surfaces.

    xy: (k, m, 2) points in the laser's frame [m], NaN where no return; start, increment: (k,)
    bearing of the first beam and from beam to beam [rad]; surfaces: of the same shape.
    """

    xy: Float32Array
    start: FloatArray
    increment: FloatArray
    surfaces: Surfaces

    def __len__(self) -> int:
        return len(self.xy)


@dataclass(frozen=True, slots=True)
class Gate:
    """Which correspondences count, and how much.

    residual_m: largest distance from the line; sigma_m: at which a residual weighs a quarter
    (Geman-McClure); beams: neighbours looked at on either side of the bearing.
    """

    residual_m: float
    sigma_m: float
    beams: int = 2


NEAR_M = 0.3
"""How far from the nearest point of a surface, besides the spacing of its beams, a point on it may
lie."""
ALIKE = 0.8
"""Cosine of the angle (37 degrees) to which normals of one surface agree."""
FIT_M = 0.08
"""A point nearer to a surface fits it: three times the noise of common lasers."""


@dataclass(frozen=True, slots=True, eq=False)
class PairTerms:
    """Per pair: `moments` (p, 5, 5) Σ w a aᵀ, a the derivative of a residual by the shift of the
    first scan (2), its turn, the turn of the second scan, and the residual itself; the axes of the
    shift are those of the second's parent frame. fit: (p,) share of the points that lie on a
    surface; weight: (p,) Σ w."""

    moments: FloatArray
    fit: FloatArray
    weight: FloatArray


def pair_terms(
    scans: Swept,
    first: IntArray,
    second: IntArray,
    poses: tuple[FloatArray, FloatArray],
    gate: Gate,
    *,
    stride: int = 1,
) -> PairTerms:
    """Hold points of scans `first` (p,) against surfaces of scans `second` (p,).

    poses: (p, 3) each, of the lasers of both in one parent frame; stride: every how manyth beam of
    the first is used. O(p m).
    """
    T_first, T_second = poses
    T = between(T_second, T_first).astype(np.float32)
    turn = np.cos(T[:, 2:3]), np.sin(T[:, 2:3])
    valid = scans.surfaces.valid[first, ::stride]
    own = scans.xy[first, ::stride]
    px, py = _turned(own[..., 0], own[..., 1], *turn)
    px, py = px + T[:, 0:1], py + T[:, 1:2]
    at, gap, inside = _nearest_beam(scans, second, (px, py), valid, gate.beams)
    point = scans.surfaces.point.reshape(-1, 2).take(at, axis=0)
    normal = scans.surfaces.normal.reshape(-1, 2).take(at, axis=0)
    nx, ny = normal[..., 0], normal[..., 1]
    residual = nx * (px - point[..., 0]) + ny * (py - point[..., 1])
    facing = scans.surfaces.normal[first, ::stride]
    mx, my = _turned(facing[..., 0], facing[..., 1], *turn)
    step = scans.increment[second].astype(np.float32)[:, None]
    reach = NEAR_M**2 + (3 * step) ** 2 * (px * px + py * py)
    near = inside & (gap < reach) & (nx * mx + ny * my > ALIKE)
    off = np.abs(residual)
    good = near & (off < gate.residual_m)
    weight = np.where(good, 1 / (1 + (residual / np.float32(gate.sigma_m)) ** 2) ** 2, 0)
    c2, s2 = np.cos(T_second[:, 2:3]).astype(np.float32), np.sin(T_second[:, 2:3])
    wx, wy = _turned(nx, ny, c2, s2.astype(np.float32))
    # d residual / d turn of first: n · J (p - t); of second: - n · J p; J (x, y) = (-y, x).
    by_first = ny * (px - T[:, 0:1]) - nx * (py - T[:, 1:2])
    by_second = nx * py - ny * px
    rows = np.stack([wx, wy, by_first, by_second, residual], axis=1)
    rows = np.where(good[:, None], rows, np.float32(0))
    moments = np.matmul(rows * weight[:, None].astype(np.float32), rows.transpose(0, 2, 1))
    fitting = np.count_nonzero(near & (off < FIT_M), axis=1)
    usable = np.maximum(np.count_nonzero(inside, axis=1), 1)
    total = weight.sum(axis=1, dtype=np.float64)
    return PairTerms(moments.astype(np.float64), fitting / usable, total)


def _turned(
    x: Float32Array, y: Float32Array, c: Float32Array, s: Float32Array
) -> tuple[Float32Array, Float32Array]:
    return c * x - s * y, s * x + c * y


def _nearest_beam(
    scans: Swept,
    second: IntArray,
    at_xy: tuple[Float32Array, Float32Array],
    valid: BoolArray,
    width: int,
) -> tuple[IntArray, Float32Array, BoolArray]:
    """Flat index of the beam of `second` whose surface is nearest to each point, squared distance
    [m²], and whether the point lies in the field of view."""
    m, (px, py) = scans.xy.shape[1], at_xy
    start = scans.start[second].astype(np.float32)[:, None]
    increment = scans.increment[second].astype(np.float32)[:, None]
    # The middle of the raster is where bearings do not wrap.
    middle = start + increment * np.float32(0.5 * (m - 1))
    bearing = wrap(np.arctan2(py, px) - middle) + increment * np.float32(0.5 * (m - 1))
    beam = np.rint(np.where(valid, bearing / increment, -1)).astype(np.int32)
    inside = valid & (beam >= 0) & (beam < m)
    base = (second * m).astype(np.int32)[:, None]
    target = scans.surfaces.point.reshape(-1, 2)
    tx = np.where(scans.surfaces.valid.reshape(-1), target[:, 0], np.float32(1e4))
    ty = np.ascontiguousarray(target[:, 1])
    best = np.full(px.shape, np.inf, np.float32)
    at = np.zeros(px.shape, np.int64)
    for k in range(-width, width + 1):
        index = np.clip(beam + np.int32(k), 0, m - 1) + base
        gap, aside = px - tx.take(index), py - ty.take(index)
        gap *= gap
        aside *= aside
        gap += aside
        nearer = gap < best
        np.copyto(best, gap, where=nearer)
        np.copyto(at, index, where=nearer)
    return at, best, inside
