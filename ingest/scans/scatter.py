"""How far off poses are: by how much the walls that they were fitted to pull them apart.

The weights of a fit say what a point is worth beside others, not how wrong the result is: what is
seen of a stretch of wall errs together in every pair of scans that sees it, by noise, roughness and
what stands in front of it. Stretches of wall err each by itself. An M-estimate whose data come in
groups, independent of each other whatever hangs together within, has the covariance

    H⁻¹ (Σ s sᵀ) H⁻¹,  s = Σ of a group's gradients, H = curvature of the robust loss

(Huber, The behavior of maximum likelihood estimates under nonstandard conditions, 1967; Liang and
Zeger, Longitudinal data analysis using generalized linear models, 1986). Groups are patches of wall
and stretches of odometry.

Patches of one bent wall err together. How much shows when pairs of scans are held against each
other the other way round, points of the one before against surfaces of the one after: those err
otherwise, as lines through bent walls lie to one side of them. Where patches are independent, the
square of all differences' sum is the sum of their squares; else it is more, the design effect of
clusters (Kish, Survey sampling, 1965), here without any truth.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import solveh_banded

from ...topology.arrays import FloatArray, IntArray
from ...topology.columns import joined
from ...topology.se2 import apply, between, turned_axes
from .association import MOST_PAIRS, Gate, Matches, Swept, matches

PATCH_M = 2.0
"""Longer than what one line is fitted to (0.7 m) and than a door. Patches of 1 m and of 4 m give
headings a tenth less and more noise."""
BACK = 4
"""Of so many points one is held against surfaces the other way round as well: matching takes a
twentieth longer, not a fifth. All points of every fourth scan cost as much, but what is seen in one
scan errs together in all of its pairs: of four simulated drives `TurnErrors.apart` over apart_alone
is off by 0.20 (r.m.s., all of all scans told 1.2 to 2.1), of every fourth point by 0.14."""
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
class TurnErrors:
    """Of turns (q,), sum of squares [rad²] of what patches of walls and stretches of odometry ask
    for; absorbed: share of the patches' errors that poses follow, so that it is not seen; apart:
    square [rad²] of what both ways to hold scans against each other differ by, apart_alone: the sum
    of every patch's own square."""

    walls: FloatArray
    absorbed: FloatArray
    odometry: FloatArray
    apart: FloatArray
    apart_alone: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Scatter:
    """curvature: banded (lower form, 3 n columns); what walls and odometry ask for; back: walls,
    where every `BACK`-th point of the scan before is held against the surfaces of the one after."""

    curvature: FloatArray
    walls: Scores
    back: Scores
    odometry: Scores

    def headings(self, pose: FloatArray, first: IntArray, last: IntArray) -> TurnErrors:
        """Of the turns from poses `first` (q,) to `last`, by how far the groups pull them apart."""
        q = np.arange(len(first))
        onto = np.zeros((3 * len(pose), len(q)))
        onto[3 * last + 2, q], onto[3 * first + 2, q] = 1.0, -1.0
        moved = self._solved(onto)
        apart = joined([self.back, replace(self.walls, gradient=-self.walls.gradient)])
        walls, odometry, apart_by = (
            _pulls(pose, scores, moved) for scores in (self.walls, self.odometry, apart)
        )
        return TurnErrors(
            np.sum(walls**2, axis=0),
            np.full(len(first), _absorbed(self.walls)),
            np.sum(odometry**2, axis=0),
            np.sum(apart_by, axis=0) ** 2,
            np.sum(apart_by**2, axis=0),
        )

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


def _pulls(pose: FloatArray, scores: Scores, moved: FloatArray) -> FloatArray:
    """(g, s) how far every group moves what `moved` (n, 3, s) stands for."""
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
    # What a group asks of a pose, of all its pairs at once: they are many times as many.
    rows = np.concatenate([scores.first, scores.second])
    where = np.tile(scores.group, 2) * len(pose) + rows
    order = np.argsort(where, kind="stable")
    begins = np.flatnonzero(np.diff(where[order], prepend=-1))
    asks = np.add.reduceat(asks[order], begins, axis=0)
    group, row = np.divmod(where[order][begins], len(pose))
    by_pose = np.einsum("ek,eks->es", asks, moved[row])
    return np.asarray(np.add.reduceat(by_pose, np.flatnonzero(np.diff(group, prepend=-1)), axis=0))


def _absorbed(walls: Scores) -> float:
    """Share of the scans' errors that their poses follow: a scan that sees k patches has three of
    as many (MacKinnon and White, 1985)."""
    looks = len(np.unique(walls.first * (4 * SPREAD**2) + walls.group))
    return min(3 * len(np.unique(walls.first)) / max(looks, 1), 1.0)


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
"""Patches to either side that are told apart: 32 km."""
