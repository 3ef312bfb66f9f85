"""Points of one scan on the surfaces of another: the terms that point-to-line matching sums up.

Correspondences by projection: a point is moved into the other laser's frame, its bearing says which
beams to look at. No tree is built, and thousands of pairs of scans go through one call.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...topology.se2 import wrap
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
    """Per pair: `moments` (p, 4, 4) Σ w a aᵀ, a the derivative of a residual by the motion from the
    second scan to the first (shift along the second's axes, turn), and the residual itself. fit:
    (p,) share of the points that lie on a surface; weight: (p,) Σ w."""

    moments: FloatArray
    fit: FloatArray
    weight: FloatArray


MOST_PAIRS = 256
"""So many pairs at once: of some hundred beams, what they need stays in a processor's cache."""


def pair_terms(
    scans: Swept, first: IntArray, second: IntArray, motion: FloatArray, gate: Gate
) -> PairTerms:
    """Hold points of scans `first` (p,) against surfaces of scans `second` (p,).

    motion: (p, 3) to the first laser from the second. O(p m).
    """
    out = PairTerms(np.zeros((len(first), 4, 4)), np.zeros(len(first)), np.zeros(len(first)))
    for begin in range(0, len(first), MOST_PAIRS):
        k = slice(begin, begin + MOST_PAIRS)
        part = _terms(scans, first[k], second[k], motion[k], gate)
        out.moments[k], out.fit[k], out.weight[k] = part
    return out


@dataclass(frozen=True, slots=True, eq=False)
class Matches:
    """Points of `p` scans and what is nearest to each: (p, m). x, y: in the frame of the scan that
    holds the surface; nx, ny: its normal; lever: derivative of the residual by the motion's turn;
    good: within the gate; weight: 0 beyond; near: of one surface; inside: in the field of view."""

    x: Float32Array
    y: Float32Array
    nx: Float32Array
    ny: Float32Array
    lever: Float32Array
    residual: Float32Array
    weight: Float32Array
    good: BoolArray
    near: BoolArray
    inside: BoolArray


def matches(
    scans: Swept, first: IntArray, second: IntArray, motion: FloatArray, gate: Gate
) -> Matches:
    """Hold points of scans `first` (p,) against surfaces of scans `second` (p,); as `pair_terms`,
    point by point."""
    T = motion.astype(np.float32)
    turn = np.cos(T[:, 2:3]), np.sin(T[:, 2:3])
    valid = scans.surfaces.valid[first]
    own = scans.xy[first]
    rx, ry = _turned(own[..., 0], own[..., 1], *turn)
    px, py = rx + T[:, 0:1], ry + T[:, 1:2]
    at, gap, inside = _nearest_beam(scans, second, (px, py), valid, gate.beams)
    on = scans.surfaces
    nx, ny = on.nx.take(at), on.ny.take(at)
    residual = nx * (px - on.x.take(at)) + ny * (py - on.y.take(at))
    mx, my = _turned(on.nx[first], on.ny[first], *turn)
    step = scans.increment[second].astype(np.float32)[:, None]
    reach = NEAR_M**2 + (3 * step) ** 2 * (px * px + py * py)
    near = inside & (gap < reach) & (nx * mx + ny * my > ALIKE)
    good = near & (np.abs(residual) < gate.residual_m)
    likely = 1 / (1 + (residual / np.float32(gate.sigma_m)) ** 2) ** 2
    weight: Float32Array = np.where(good, likely, np.float32(0)).astype(np.float32, copy=False)
    # d residual / d turn = n · J R p, J (x, y) = (-y, x).
    return Matches(px, py, nx, ny, ny * rx - nx * ry, residual, weight, good, near, inside)


def _terms(
    scans: Swept, first: IntArray, second: IntArray, motion: FloatArray, gate: Gate
) -> tuple[FloatArray, FloatArray, FloatArray]:
    on = matches(scans, first, second, motion, gate)
    rows = np.stack([on.nx, on.ny, on.lever, on.residual], axis=1)
    rows = np.where(on.good[:, None], rows, np.float32(0))
    moments = np.matmul(rows * on.weight[:, None], rows.transpose(0, 2, 1))
    fitting = np.count_nonzero(on.near & (np.abs(on.residual) < FIT_M), axis=1)
    usable = np.maximum(np.count_nonzero(on.inside, axis=1), 1)
    return moments, fitting / usable, on.weight.sum(axis=1)


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
) -> tuple[NDArray[np.int32], Float32Array, BoolArray]:
    """Flat index of the beam of `second` whose surface is nearest to each point, squared distance
    [m²], and whether the point lies in the field of view."""
    m, (px, py) = scans.xy.shape[1], at_xy
    start = wrap(scans.start[second]).astype(np.float32)[:, None]
    increment = scans.increment[second].astype(np.float32)[:, None]
    beam = (np.arctan2(py, px) - start) / increment
    # Rasters begin anywhere in a turn: what lies before the first beam may lie behind the last.
    beam = np.where(beam < -0.5, beam + np.float32(2 * np.pi) / increment, beam)
    beam = np.rint(np.where(valid, beam, -1)).astype(np.int32)
    inside = valid & (beam >= 0) & (beam < m)
    base = (second * m).astype(np.int32)[:, None]
    tx, ty = scans.surfaces.x.ravel(), scans.surfaces.y.ravel()
    best: Float32Array = np.full(px.shape, np.inf, np.float32)
    at: NDArray[np.int32] = np.zeros(px.shape, np.int32)
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
