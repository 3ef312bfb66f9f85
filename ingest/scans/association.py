"""Projective data association: points of one scan matched to surfaces of another, and the terms of
point-to-line matching.

A point is transformed into the other laser's frame; its bearing selects the beam whose surface it
is compared with. No search tree is built, hundreds of pairs of scans go through one call, and inner
loops are free of branches.

Single precision suffices, with operations that IEEE 754 rounds alike everywhere (+, -, ·, /).
numpy's arctangents and BLAS's products differ between processors by 1e-7 and more, so that other
points pass a gate, and poses differ by 1e-5 m.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ...topology.arrays import BoolArray, Float32Array, FloatArray, IntArray
from ...topology.se2 import wrap
from .keyframes import Keyframes
from .surfaces import Surfaces, surfaces

POINT_RAD = 0.035
"""Least angle between beams of one scan that are matched: those between lie on the same lines
(drift is the same within noise, of every third beam a tenth more)."""


@dataclass(frozen=True, slots=True, eq=False)
class Swept:
    """`k` scans in rows of `beams` beams, of which one in `each` counts as a point.

    start, increment: (k,) bearing of the first beam and between beams [rad]; points: every
    `each`-th point, row `each` i + j: scan i from beam j on, all 0 where there is no surface;
    lines: surfaces of all beams, concatenated (k m,), of a beam without one its neighbour's;
    own_beams: (k,) beams of each scan, beyond which its row is padded.
    """

    start: FloatArray
    increment: FloatArray
    beams: int
    each: int
    points: Surfaces
    lines: Surfaces
    own_beams: IntArray

    @classmethod
    def of(cls, frames: Keyframes) -> Swept:
        """The points of keyframes, and the surfaces that these lie on."""
        xy, increment = frames.xy, frames.increment
        on = surfaces(xy, increment)
        each = max(int(POINT_RAD / increment.max(initial=1e-3)), 1)
        x, y = (np.where(on.valid, xy[..., k], np.float32(0)) for k in (0, 1))
        x, y, nx, ny = (_interleaved(values, each) for values in (x, y, on.nx, on.ny))
        points = Surfaces(x, y, nx, ny, _interleaved(on.valid, each))
        at = _with_neighbours(on.valid)
        x, y, nx, ny = (values.take(at) for values in (on.x, on.y, on.nx, on.ny))
        lines = Surfaces(x, y, nx, ny, on.valid.take(at))
        return cls(frames.start, increment, xy.shape[1], each, points, lines, frames.beams)


def _interleaved(values: Any, each: int) -> Any:
    """Rows (k, m) split into `each` rows of every `each`-th column, padded by 0: row `each` i + j
    of the result (each k, ceil(m / each)) has columns j, j + each, … of row i."""
    k, m = values.shape
    padded = np.pad(values, ((0, 0), (0, -m % each)))
    return np.ascontiguousarray(padded.reshape(k, -1, each).swapaxes(1, 2)).reshape(k * each, -1)


def _with_neighbours(valid: BoolArray) -> IntArray:
    """(k m,) flat index of every beam's own surface, or of that next to it."""
    around = np.pad(valid, ((0, 0), (1, 1)))
    aside = np.where(around[:, :-2], -1, around[:, 2:].astype(np.int64))
    return np.arange(valid.size) + np.where(valid, 0, aside).ravel()


@dataclass(frozen=True, slots=True)
class Gate:
    """Which correspondences count, and their weight.

    residual_m: largest distance from the line; sigma_m: residual with weight 1/4 (Geman-McClure);
    beams: neighbours on either side among which the nearest is searched.
    """

    residual_m: float
    sigma_m: float
    beams: int = 0


NEAR_M = 0.3
"""Largest distance of a point from the point of its surface, besides the spacing of beams [m]."""
ALIKE = 0.8
"""Cosine of the largest angle between the normals of one surface (37 degrees)."""
FIT_M = 0.08
"""Distance within which a point fits a surface: three times the noise of common lasers."""


@dataclass(frozen=True, slots=True, eq=False)
class PairTerms:
    """Sums of the terms of each pair.

    moments: (p, 4, 4) Σ w a aᵀ, a the derivative of a residual by the motion from the second scan
    to the first (shift along the second's axes, rotation), and the residual itself; fit: (p,) share
    of the points that lie on a surface; weight: (p,) Σ w. Sums are per beam: every point stands for
    `each`.
    """

    moments: FloatArray
    fit: FloatArray
    weight: FloatArray


MOST_PAIRS = 256
"""Pairs per batch: with some hundred beams, they fit a processor's cache."""


def pair_terms(
    scans: Swept, first: IntArray, second: IntArray, motion: FloatArray, gate: Gate
) -> PairTerms:
    """Match points of scans `first` (p,) with surfaces of scans `second` (p,).

    motion: (p, 3) to the first laser from the second. O(p m).
    """
    out = PairTerms(np.zeros((len(first), 4, 4)), np.zeros(len(first)), np.zeros(len(first)))
    for begin in range(0, len(first), MOST_PAIRS):
        k = slice(begin, begin + MOST_PAIRS)
        on = matches(scans, first[k], second[k], motion[k], gate)
        rows = np.stack([on.nx, on.ny, on.lever, on.residual])
        out.moments[k] = scans.each * np.einsum("kph,lph->pkl", rows * on.weight, rows)
        fitting = np.count_nonzero(on.near & (np.abs(on.residual) < FIT_M), axis=1)
        out.fit[k] = fitting / np.maximum(np.count_nonzero(on.inside, axis=1), 1)
        out.weight[k] = scans.each * on.weight.sum(axis=1)
    return out


@dataclass(frozen=True, slots=True, eq=False)
class Matches:
    """Points of `p` scans and their corresponding surfaces, (p, h) each.

    x, y: in the frame of the scan with the surface [m]; nx, ny: its normal; lever: derivative of
    the residual by the rotation; residual [m]; weight: 0 beyond the gate; good: within the gate;
    near: on one surface; inside: in the field of view.
    """

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
    """Match points of scans `first` (p,) with surfaces of scans `second` (p,); as `pair_terms`,
    point by point."""
    T = motion.astype(np.float32)[:, :, None]
    turn = [of(motion[:, 2:]).astype(np.float32) for of in (np.cos, np.sin)]
    # Pairs alternate between subsets of beams, so that all beams are used in a window.
    held, points, lines = scans.each * first + second % scans.each, scans.points, scans.lines
    rx, ry = _turned(points.x[held], points.y[held], *turn)
    px, py = rx + T[:, 0], ry + T[:, 1]
    beam, inside = _beam(scans, second, px, py)
    inside &= points.valid[held]
    at, dx, dy, gap = _nearest(scans, second, beam, (px, py), gate.beams)
    nx, ny = lines.nx.take(at), lines.ny.take(at)
    residual = nx * dx + ny * dy
    mx, my = _turned(points.nx[held], points.ny[held], *turn)
    spacing = np.square(3 * scans.increment[second]).astype(np.float32)[:, None]
    near = gap < NEAR_M**2 + spacing * (px * px + py * py)
    near &= inside & (nx * mx + ny * my > ALIKE)
    good = near & (np.abs(residual) < gate.residual_m)
    off = residual * np.float32(1 / gate.sigma_m)
    weight = good / np.square(1 + off * off)
    # d residual / d turn = n · J R p, J (x, y) = (-y, x).
    return Matches(px, py, nx, ny, ny * rx - nx * ry, residual, weight, good, near, inside)


def _turned(
    x: Float32Array, y: Float32Array, c: Float32Array, s: Float32Array
) -> tuple[Float32Array, Float32Array]:
    return c * x - s * y, s * x + c * y


def _beam(
    scans: Swept, second: IntArray, x: Float32Array, y: Float32Array
) -> tuple[IntArray, BoolArray]:
    """Beam of scans `second` (p,) in the direction of each point (p, h), or the nearest one, and
    whether the point is in the field of view."""
    start = wrap(scans.start[second]).astype(np.float32)[:, None]
    per_rad = (1 / scans.increment[second]).astype(np.float32)[:, None]
    beam = (bearings(x, y) - start) * per_rad
    # Bearings before the first beam are moved on by a whole turn.
    beam += (beam < -0.5) * (np.float32(2 * np.pi) * per_rad)
    beam = np.rint(beam)
    inside = (beam >= 0) & (beam < scans.own_beams[second][:, None])
    return np.clip(beam, 0, scans.beams - 1).astype(np.int64), inside


ARCTAN = np.array((0.9998660, -0.3302995, 0.1801410, -0.0851330, 0.0208351), np.float32)
"""arctan(t) = t Σ a_k t^2k, to 1e-5 rad for t in [0, 1], a thousandth of the angle between beams
(Abramowitz and Stegun, Handbook of Mathematical Functions, 1964, 4.4.47)."""


def bearings(x: Float32Array, y: Float32Array) -> Float32Array:
    """Bearing of every point [rad], as arctan2(y, x), but the same on every processor."""
    across, along = np.abs(y), np.abs(x)
    longer = np.maximum(np.maximum(across, along), np.finfo(np.float32).tiny)
    ratio = np.minimum(across, along) / longer
    square = ratio * ratio
    bearing = square * ARCTAN[-1]
    for a in ARCTAN[-2:0:-1]:
        bearing += a
        bearing *= square
    bearing += ARCTAN[0]
    bearing *= ratio
    bearing = np.where(across > along, np.float32(0.5 * np.pi) - bearing, bearing)
    return np.asarray(np.copysign(np.where(x < 0, np.float32(np.pi) - bearing, bearing), y))


def _nearest(
    scans: Swept,
    second: IntArray,
    beam: IntArray,
    xy: tuple[Float32Array, Float32Array],
    beams: int,
) -> tuple[IntArray, Float32Array, Float32Array, Float32Array]:
    """Flat index of the nearest of `beams` surfaces on either side, and the offset along x and y
    and squared distance of each point from it."""
    lines, (x, y) = scans.lines, xy
    base = scans.beams * second[:, None]
    at = beam + base
    dx, dy = x - lines.x.take(at), y - lines.y.take(at)
    gap = dx * dx + dy * dy
    for aside in (k for k in range(-beams, beams + 1) if k != 0):
        other = np.clip(beam + aside, 0, scans.beams - 1) + base
        to_x, to_y = x - lines.x.take(other), y - lines.y.take(other)
        away = to_x * to_x + to_y * to_y
        at += (away < gap) * (other - at)
        gap = np.minimum(gap, away)
    if beams:
        dx, dy = x - lines.x.take(at), y - lines.y.take(at)
    return at, dx, dy, gap
