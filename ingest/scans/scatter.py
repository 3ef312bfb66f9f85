"""Uncertainty of aligned poses, from the scatter of the gradients by which single walls pull at
them.

The weights of a fit determine the relative weight of points, not the error of the result: errors of
one part of a wall are common to all pairs of scans that see it (noise, roughness, objects in
front). Different parts of walls err independently. An M-estimate whose data come in independent
groups has the covariance

    H⁻¹ (Σ s sᵀ) H⁻¹,  s = Σ of a group's gradients, H = curvature of the robust loss

(Huber, The behavior of maximum likelihood estimates under nonstandard conditions, 1967; Liang and
Zeger, Longitudinal data analysis using generalized linear models, 1986). Groups are patches of wall
and parts of the odometry.

Patches of one bent wall err alike, which `TOGETHER` accounts for.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solveh_banded

from ...topology.arrays import FloatArray, IntArray
from ...topology.columns import joined
from ...topology.se2 import apply, between, turned_axes
from .association import MOST_PAIRS, Gate, Matches, Swept, matches

PATCH_M = 2.0
"""Side of a patch: longer than a fitted line (0.7 m) and than a door. Patches of 1 m and of 4 m
give headings a tenth less and more noise."""
STRETCH = 16
"""Steps of odometry with common errors, 4 m: turns and bends last that long."""
TOGETHER = 1.3
"""Design effect of wall patches (Kish, Survey sampling, 1965): the variance of their sum, relative
to independent errors, as patches of one bent wall err alike. Pairs of scans that are matched both
ways, with different errors, show it: over six kinds of simulated world and two buildings 1.2 in the
mean, 0.4 (aces) to 1.7 (offices). Measured run by run it changes headings within sigmas by 2 %."""
LEAST_SEEN = 0.25
"""Lower bound of the share of the walls' errors that remains in the residuals."""


@dataclass(frozen=True, slots=True, eq=False)
class Scores:
    """Gradients by groups. first, second: (e,) scans of a pair; group: (e,) index; gradient: (e, 3)
    with respect to the motion to the first scan from the second."""

    first: IntArray
    second: IntArray
    group: IntArray
    gradient: FloatArray


_NONE = np.zeros(0, np.int64)
NO_SCORES = Scores(_NONE, _NONE, _NONE, np.zeros((0, 3)))


@dataclass(frozen=True, slots=True, eq=False)
class Aligned:
    """Poses (n, 3), and their uncertainty: curvature: banded (lower form, 3 n columns); gradients
    by walls and odometry."""

    pose: FloatArray
    curvature: FloatArray
    walls: Scores
    odometry: Scores

    def headings(self, first: IntArray, last: IntArray) -> FloatArray:
        """(q,) variance [rad²] of the rotations from poses `first` (q,) to `last`, from the scatter
        of the groups.

        With scores s of patches, M the sum of their variances and κ M the variance of their sum,
        the residual scores at the fitted poses, s - A H⁻¹ Σ s, have squares that sum up to M (1 - 2
        κ l + κ l), where l is the share absorbed by the poses (if errors are distributed like the
        curvature).
        """
        q = np.arange(len(first))
        onto = np.zeros((3 * len(self.pose), len(q)))
        onto[3 * last + 2, q], onto[3 * first + 2, q] = 1.0, -1.0
        moved = self._solved(onto)
        walls, odometry = (
            np.sum(_pulls(self.pose, by, moved) ** 2, axis=0) for by in (self.walls, self.odometry)
        )
        seen = max(1 - TOGETHER * _absorbed(self.walls), LEAST_SEEN)
        return np.asarray(TOGETHER * walls / seen + odometry)

    def ways(self, first: IntArray, last: IntArray) -> FloatArray:
        """(q,) variance [m²] of the distance ahead from poses `first` (q,) to `last`, by the
        curvature alone: along bare walls there are no gradients."""
        by_last, by_first = motion_by_ends(self.pose, last, first)
        k, q = np.arange(3), np.arange(len(first))[:, None]
        onto = np.zeros((3 * len(self.pose), len(first)))
        onto[3 * last[:, None] + k, q] = by_last[:, 0]
        onto[3 * first[:, None] + k, q] += by_first[:, 0]
        moved = self._solved(onto).reshape(onto.shape)
        return np.asarray(np.sum(onto * moved, axis=0))

    def _solved(self, onto: FloatArray) -> FloatArray:
        solved = np.asarray(solveh_banded(self.curvature, onto, lower=True))
        return solved.reshape(len(onto) // 3, 3, -1)


def _pulls(pose: FloatArray, scores: Scores, moved: FloatArray) -> FloatArray:
    """(g, s) by how much every group moves the quantities with the sensitivities `moved` (n, 3,
    s)."""
    if len(scores.group) == 0:
        return np.zeros((0, moved.shape[2]))
    # As `motion_by_ends`, without its matrices, of which there would be one an entry.
    c, s = np.cos(pose[:, 2])[scores.second], np.sin(pose[:, 2])[scores.second]
    gx, gy, turn = scores.gradient.T
    gx, gy = c * gx - s * gy, s * gx + c * gy
    dx, dy = (pose[scores.first, :2] - pose[scores.second, :2]).T
    at_first = np.column_stack([gx, gy, turn])
    at_second = np.column_stack([-gx, -gy, dy * gx - dx * gy - turn])
    asks = np.concatenate([at_first, at_second])
    # Sum by group and pose first: pairs are many times as many.
    rows = np.concatenate([scores.first, scores.second])
    where = np.tile(scores.group, 2) * len(pose) + rows
    order = np.argsort(where, kind="stable")
    begins = np.flatnonzero(np.diff(where[order], prepend=-1))
    asks = np.add.reduceat(asks[order], begins, axis=0)
    group, row = np.divmod(where[order][begins], len(pose))
    by_pose = np.einsum("ek,eks->es", asks, moved[row])
    return np.asarray(np.add.reduceat(by_pose, np.flatnonzero(np.diff(group, prepend=-1)), axis=0))


def _absorbed(walls: Scores) -> float:
    """Share of the patches' errors that the scans' poses absorb: 3 / k for a scan that sees k
    patches, because its pose has three degrees of freedom (MacKinnon and White, 1985)."""
    looks = len(np.unique(walls.first * (4 * SPREAD**2) + walls.group))
    return min(3 * len(np.unique(walls.first)) / max(looks, 1), 1.0)


def motion_by_ends(
    pose: FloatArray, first: IntArray, second: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Derivatives (p, 3, 3) of the motion to `first` from `second` with respect to both poses."""
    motion = between(pose[second], pose[first])
    by_first = turned_axes(-pose[second, 2])
    by_second = -by_first
    by_second[:, 0, 2], by_second[:, 1, 2] = motion[:, 1], -motion[:, 0]
    return by_first, by_second


def odometry_scores(gradient: FloatArray, stretch: int = STRETCH) -> Scores:
    """Gradients of steps (n - 1, 3), from every pose to the next; `stretch` of them err alike."""
    before = np.arange(len(gradient))
    return Scores(before + 1, before, before // stretch, gradient)


def wall_scores(
    scans: Swept, pose: FloatArray, pairs: tuple[IntArray, IntArray], gate: Gate, worth: float
) -> tuple[Scores, float]:
    """Gradients by patches of wall in pairs of scans at poses (n, 3), with the weight `worth` of a
    squared residual [1/m²]; and the curvature of the loss, as a share of the weights. O(p m log m).
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
"""Lower bound of the curvature: if hardly any point fits, it may be negative."""


def _by_patch(on: Matches, pose: FloatArray) -> tuple[IntArray, IntArray, FloatArray]:
    """Row of a pair, index of a patch, and the sum of the gradients of its points (e, 3)."""
    row, beam = np.nonzero(on.good)
    at = apply(pose[row], np.stack([on.x[row, beam], on.y[row, beam]], axis=1).astype(np.float64))
    nx, ny = on.nx[row, beam], on.ny[row, beam]
    # Both sides of a wall, and two walls at a corner, are different patches.
    bearing = np.arctan2(ny, nx, dtype=np.float64) + pose[row, 2]
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
"""Number of patches per axis that are distinguished: 32 km."""
