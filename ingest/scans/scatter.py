"""How far off poses are: by how much the walls that they were fitted to pull them apart.

The weights of a fit say what a point is worth beside others, not how wrong the result is: what is
seen of a stretch of wall errs together in every pair of scans that sees it, by noise, roughness and
what stands in front of it. Stretches of wall err each by itself. An M-estimate whose data come in
groups, independent of each other whatever hangs together within, has the covariance

    H⁻¹ (Σ s sᵀ) H⁻¹,  s = Σ of a group's gradients, H = curvature of the robust loss

(Huber, The behavior of maximum likelihood estimates under nonstandard conditions, 1967; Liang and
Zeger, Longitudinal data analysis using generalized linear models, 1986). Groups are patches of wall
and stretches of odometry.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solveh_banded

from ...topology.columns import joined
from ...topology.se2 import apply, between, turned_axes
from .association import MOST_PAIRS, Gate, Matches, Swept, matches

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

PATCH_M = 2.0
"""Longer than what one line is fitted to (0.7 m) and than a door. Patches of 1 m and of 4 m give
headings a tenth less and more noise."""
STRETCH = 16
"""Steps of odometry that err together, 4 m: turns and bends go on for so long."""


@dataclass(frozen=True, slots=True, eq=False)
class Scores:
    """What groups ask for. first, second: (e,) scans of a pair; group: (e,) number; gradient:
    (e, 3) by the motion to the first scan from the second."""

    first: IntArray
    second: IntArray
    group: IntArray
    gradient: FloatArray


_NONE = np.zeros(0, np.int64)
NO_SCORES = Scores(_NONE, _NONE, _NONE, np.zeros((0, 3)))


@dataclass(frozen=True, slots=True, eq=False)
class Scatter:
    """curvature: banded (lower form, 3 n columns); what walls and odometry ask for."""

    curvature: FloatArray
    walls: Scores
    odometry: Scores

    def headings(self, pose: FloatArray, first: IntArray, last: IntArray) -> FloatArray:
        """(q,) variance [rad²] of the turn from poses `first` (q,) to `last`, by how far the groups
        pull it apart."""
        q = np.arange(len(first))
        onto = np.zeros((3 * len(pose), len(q)))
        onto[3 * last + 2, q], onto[3 * first + 2, q] = 1.0, -1.0
        moved = self._solved(onto)
        walls, odometry = (_pulled(pose, s, moved) for s in (self.walls, self.odometry))
        return walls / _freedom(self.walls) + odometry

    def ways(self, pose: FloatArray, first: IntArray, last: IntArray) -> FloatArray:
        """(q,) variance [m²] of the way ahead from poses `first` (q,) to `last`, by the curvature
        alone: where odometry leads along bare walls, nothing pulls."""
        by_last, by_first = motion_by_ends(pose, last, first)
        k, q = np.arange(3), np.arange(len(first))[:, None]
        onto = np.zeros((3 * len(pose), len(first)))
        onto[3 * last[:, None] + k, q] = by_last[:, 0]
        onto[3 * first[:, None] + k, q] += by_first[:, 0]
        moved = self._solved(onto).reshape(onto.shape)
        return np.asarray(np.sum(onto * moved, axis=0))

    def _solved(self, onto: FloatArray) -> FloatArray:
        solved = np.asarray(solveh_banded(self.curvature, onto, lower=True))
        return solved.reshape(len(onto) // 3, 3, -1)


def _pulled(pose: FloatArray, scores: Scores, moved: FloatArray) -> FloatArray:
    """(s,) squares of how far every group moves what `moved` (n, 3, s) stands for, summed up."""
    if len(scores.group) == 0:
        return np.zeros(moved.shape[2])
    asked = _asked(pose, scores, moved)
    order = np.argsort(scores.group, kind="stable")
    begins = np.flatnonzero(np.diff(scores.group[order], prepend=-1))
    return np.asarray(np.sum(np.add.reduceat(asked[order], begins, axis=0) ** 2, axis=0))


def _freedom(walls: Scores) -> float:
    """Share of the scans' errors that their poses leave to be seen: a scan that sees k patches
    has three of as many (MacKinnon and White, 1985); of scans that see hardly any, a quarter."""
    looks = len(np.unique(walls.first * (4 * SPREAD**2) + walls.group))
    scans = len(np.unique(walls.first))
    return max(1 - 3 * scans / max(looks, 1), 0.25)


def _asked(pose: FloatArray, scores: Scores, moved: FloatArray) -> FloatArray:
    """(e, s) how far every entry moves what `moved` (n, 3, s) stands for."""
    by_first, by_second = motion_by_ends(pose, scores.first, scores.second)
    at_first = np.einsum("ekl,ek->el", by_first, scores.gradient)
    at_second = np.einsum("ekl,ek->el", by_second, scores.gradient)
    out = np.zeros((len(scores.first), moved.shape[2]))
    for k in range(3):
        out += at_first[:, k, None] * moved[scores.first, k]
        out += at_second[:, k, None] * moved[scores.second, k]
    return out


def motion_by_ends(
    pose: FloatArray, first: IntArray, second: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Derivatives (p, 3, 3) of the motion to `first` from `second` by both poses."""
    motion = between(pose[second], pose[first])
    by_first = turned_axes(-pose[second, 2])
    by_second = -by_first
    by_second[:, 0, 2], by_second[:, 1, 2] = motion[:, 1], -motion[:, 0]
    return by_first, by_second


def odometry_scores(gradient: FloatArray) -> Scores:
    """Of steps (n - 1, 3), from every pose to the next."""
    before = np.arange(len(gradient))
    return Scores(before + 1, before, before // STRETCH, gradient)


def wall_scores(
    scans: Swept,
    pose: FloatArray,
    pairs: tuple[IntArray, IntArray],
    gate: Gate,
    worth: float,
) -> tuple[Scores, float]:
    """What patches of wall ask for in pairs of scans that lie at poses (n, 3), a point's square of
    1 m² counting `worth`; and the curvature of the loss, as a share of the weights. O(p m log m).
    """
    first, second = pairs
    parts, curvature, weight = [NO_SCORES], 0.0, 0.0
    for begin in range(0, len(first), MOST_PAIRS):
        i, j = first[begin : begin + MOST_PAIRS], second[begin : begin + MOST_PAIRS]
        on = matches(scans, i, j, between(pose[j], pose[i]), gate)
        pair, patch, gradient = _by_patch(on, pose[j])
        parts.append(Scores(i[pair], j[pair], patch, worth * gradient))
        # Geman-McClure: weight 1 / (1 + z)², z the square of the residual in sigmas.
        z = (on.residual[on.good] / gate.sigma_m) ** 2
        curvature += float(np.sum((1 - 3 * z) / (1 + z) ** 3))
        weight += float(on.weight.sum())
    return joined(parts), max(curvature / max(weight, 1e-9), LEAST_CURVATURE)


LEAST_CURVATURE = 0.1
"""Where hardly a point fits, the loss as a whole may curve the other way."""


def _by_patch(on: Matches, pose: FloatArray) -> tuple[IntArray, IntArray, FloatArray]:
    """Row of a pair, number of a patch, and the sum of gradients of points there (e, 3)."""
    row, beam = np.nonzero(on.good)
    at = apply(pose[row], np.stack([on.x[row, beam], on.y[row, beam]], axis=1).astype(np.float64))
    nx, ny = on.nx[row, beam], on.ny[row, beam]
    # Both sides of a wall, and two walls of a corner, are patches of their own.
    bearing = np.arctan2(ny, nx) + pose[row, 2]
    faces = np.floor(bearing / (0.5 * np.pi) + 0.5).astype(np.int64) % 4
    x, y = np.floor(at / PATCH_M).astype(np.int64).T
    patch = ((x % SPREAD) * SPREAD + y % SPREAD) * 4 + faces
    # Beams come in order: those of one patch, one after the other.
    entry = row * (4 * SPREAD**2) + patch
    begins = np.flatnonzero(np.diff(entry, prepend=-1))
    asks = (on.weight * on.residual)[row, beam].astype(np.float64)
    levers = np.stack([nx, ny, on.lever[row, beam]], axis=1)
    gradient = np.add.reduceat(asks[:, None] * levers, begins, axis=0)
    return row[begins], patch[begins], gradient


SPREAD = 1 << 14
"""Patches to either side that are told apart: 32 km."""
