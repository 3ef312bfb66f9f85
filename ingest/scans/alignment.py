"""Joint alignment of many scans: point-to-line scan matching with odometry, as one least-squares
problem.

Every scan is matched to several before it (point to line), every step to the odometry; all poses of
a window are solved for jointly. The normal matrix is banded, because scans farther apart than the
widest pair are not connected.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import solveh_banded

from ...topology.arrays import BoolArray, FloatArray, IntArray
from ...topology.se2 import between, wrap
from .association import Gate, Swept, pair_terms
from .scatter import STRETCH, Aligned, odometry_scores, wall_scores
from .surfaces import MOST_POINTS


@dataclass(frozen=True, slots=True)
class AlignmentSettings:
    """Settings of scan matching."""

    sigma_m: float = 0.03
    """1 sigma of a point's distance from the surface that it lies on."""
    pair_worth: float = 0.1
    """Weight of a point of one pair, in independent observations: neighbouring points have
    correlated errors."""
    joint_worth: float = 0.0034
    """Weight of a point in all pairs of a window, which have correlated errors as well. It sets the
    weight against the odometry: half of it and twice are worse in two real and two simulated
    buildings (`benchmarks/laser.py`)."""
    least_residual_m: float = 0.006
    """Lower bound of the estimated residual: walls are not flatter."""
    offsets: tuple[int, ...] = (1, 2, 4, 8, 14, 24, 36, 52)
    """Offsets, in keyframes, of the earlier scans that a scan is matched to: up to 13 m of way. Two
    more change nothing, two fewer cost a fifth of the drift."""
    pair_rounds: tuple[tuple[int, Gate], ...] = ((5, Gate(0.5, 0.2, 1)), (4, Gate(0.2, 0.05, 1)))
    joint_rounds: tuple[tuple[int, Gate], ...] = ((2, Gate(0.3, 0.08)), (8, Gate(0.2, 0.05)))
    """Largest number of rounds, and gate, of each stage (pair by pair, and jointly); the wide gates
    cover the errors of a bad odometry (without them, drift by scans alone is a quarter more)."""
    settled_share: float = 0.02
    """Converged when at most this share of pairs still moves: the rest is not seen in the drift of
    thirteen logs."""
    settled_m: float = 0.01
    """Correspondences are kept in the next round if points at `settled_at_m` moved by less than
    this."""
    settled_at_m: float = 5.0
    """Distance of typical points in rooms and corridors."""
    lost_fit: float = 0.6
    """A step is searched for if the share of its points that fit is below this."""
    search_rad: float = 0.52
    search_step_rad: float = 0.052
    """Headings tried in a search: 30 degrees either way, dense enough for matching to converge from
    one."""
    better_fit: float = 0.1
    """Least gain in fit for accepting the result of a search."""
    least_shared: float = 0.35
    """If the robot turned so far that less of a scan than this looks where the one before looked,
    the odometry stands: the few walls in common fit at headings that are wrong by 6° to 15°
    (`benchmarks/inside.py`, half a turn seen every metre)."""
    grain: float = 2.0**-17
    """Poses are rounded to this after every round [m, rad] (8 µm), far below the accuracy of
    matching: solvers differ between processors in the last digits, and gates would amplify that. As
    a power of two it is exact, also in single precision up to 128 m."""


ALIGNMENT = AlignmentSettings()


def _moved(change: FloatArray) -> BoolArray:
    """(p,) whether a change (p, 3) of motions moves points by more than `settled_m`."""
    shift = np.hypot(change[:, 0], change[:, 1])
    return np.asarray(shift + ALIGNMENT.settled_at_m * np.abs(change[:, 2]) > ALIGNMENT.settled_m)


def _rounded(pose: FloatArray) -> FloatArray:
    """Poses or motions (p, 3) rounded to the `grain`, angles wrapped."""
    out = np.rint(pose / ALIGNMENT.grain) * ALIGNMENT.grain
    out[:, 2] = wrap(out[:, 2])
    return out


@dataclass(frozen=True, slots=True, eq=False)
class Steps:
    """The odometry's motion (p, 3) between pairs of poses, and its information (p, 3, 3) (inverse
    covariance), in the frame of the earlier pose."""

    motion: FloatArray
    information: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class PairMotion:
    """Motion (p, 3) from scan to scan.

    fit: (p,) share of points on a surface; searched: (p,) whether it was found by searching
    headings; loose_m: (p,) 1 sigma of the motion in its least constrained direction, as along a
    bare corridor [m].
    """

    motion: FloatArray
    fit: FloatArray
    searched: BoolArray
    loose_m: FloatArray


def match_steps(
    scans: Swept,
    pairs: tuple[IntArray, IntArray],
    steps: Steps,
    search_rad: float = ALIGNMENT.search_rad,
) -> PairMotion:
    """The motion to scans `first` (p,) from scans `second`, by pairwise matching with the odometry
    as prior; search_rad: see `AlignmentSettings`."""
    first, second = pairs
    # Weak weight: the odometry only decides what the scans leave open.
    weak = ALIGNMENT.pair_worth * steps.information
    motion, fit, loose_m = _matched(scans, pairs, Steps(steps.motion, weak), steps.motion)
    searched = np.zeros(len(first), bool)
    shared = _shared(scans, first, second, steps.motion[:, 2])
    apart = shared < ALIGNMENT.least_shared
    motion[apart] = _rounded(steps.motion)[apart]
    lost = np.flatnonzero((fit < ALIGNMENT.lost_fit) & ~apart)
    tried = np.arange(-search_rad, search_rad + 1e-9, ALIGNMENT.search_step_rad)
    together = max(1, MOST_POINTS // (len(tried) * scans.beams))
    for some in (lost[k : k + together] for k in range(0, len(lost), together)):
        rows = np.repeat(some, len(tried))
        start = steps.motion[rows]
        start[:, 2] = wrap(start[:, 2] + np.tile(tried, len(some)))
        prior = Steps(steps.motion[rows], 0.01 * weak[rows])
        found = _matched(scans, (first[rows], second[rows]), prior, start)
        by_row = found[1].reshape(len(some), -1)
        best = by_row.argmax(axis=1)
        better = by_row[np.arange(len(some)), best] > fit[some] + ALIGNMENT.better_fit
        at, nth = some[better], np.flatnonzero(better) * len(tried) + best[better]
        motion[at], fit[at], loose_m[at] = (values[nth] for values in found)
        searched[at] = True
    return PairMotion(motion, fit, searched, loose_m)


def _shared(scans: Swept, first: IntArray, second: IntArray, turn: FloatArray) -> FloatArray:
    """(p,) share of the field of view of scans `first` that lies in that of scans `second`, at
    turns (p,) from these to those [rad]."""
    width = np.minimum(scans.increment * scans.own_beams, 2 * np.pi)
    begin = wrap(turn + scans.start[first] - scans.start[second]) % (2 * np.pi)
    end = begin + width[first]
    ahead = np.maximum(np.minimum(end, width[second]) - begin, 0.0)
    around = np.maximum(np.minimum(end - 2 * np.pi, width[second]), 0.0)
    return np.asarray((ahead + around) / np.maximum(width[first], 1e-9))


def _matched(
    scans: Swept, pairs: tuple[IntArray, IntArray], prior: Steps, motion: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Gauss-Newton on each pair, from `motion` (p, 3) on: motion, fit, loose_m of `PairMotion`."""
    motion, information = _rounded(motion), prior.information
    scale = ALIGNMENT.pair_worth / ALIGNMENT.sigma_m**2
    first, second = pairs
    for rounds, gate in ALIGNMENT.pair_rounds:
        moving = np.arange(len(motion))
        for _ in range(rounds):
            some = first[moving], second[moving]
            moments = scale * pair_terms(scans, *some, motion[moving], gate).moments
            off = _difference(motion[moving], prior.motion[moving])
            odometry_gradient = np.einsum("pkl,pl->pk", information[moving], off)
            gradient = moments[:, :3, 3] + odometry_gradient
            total = moments[:, :3, :3] + information[moving]
            step = np.clip(np.linalg.solve(total, gradient[..., None])[..., 0], -0.5, 0.5)
            motion[moving] = _rounded(motion[moving] - step)
            moving = moving[_moved(step)]
    last = pair_terms(scans, *pairs, motion, ALIGNMENT.pair_rounds[-1][-1])
    weakest = np.linalg.eigvalsh(scale * last.moments[:, :2, :2])[:, 0]
    return motion, last.fit, 1 / np.sqrt(np.maximum(weakest, 1e-4))


def align(
    scans: Swept,
    pose: FloatArray,
    steps: Steps,
    *,
    fixed: int,
    earlier: Sequence[IntArray],
    stretch: int = STRETCH,
) -> Aligned:
    """Align all poses jointly, starting from `pose` (n, 3), the first `fixed` of which stay.

    earlier: for each of the settings' offsets the scan (n,) that each is matched to, -1 for none;
    steps: from each pose to the next; stretch: how many of them err alike. Gauss-Newton with a
    Cauchy weight on odometry; O(n · offsets · beams) per round.
    """
    looks = _Looks.of(earlier, fixed)
    equations = _Equations.of(len(pose), fixed, looks)
    pose = _rounded(pose)
    for rounds, gate in ALIGNMENT.joint_rounds:
        looks.known[:] = False
        for _ in range(rounds):
            if looks.renewed(scans, pose, gate) <= ALIGNMENT.settled_share:
                break
            quadratic = looks.quadratic(pose)
            band, gradient = equations.at(pose, steps, quadratic, _worth(looks, quadratic))
            step = solveh_banded(band, -gradient, lower=True, overwrite_ab=True, overwrite_b=True)
            pose = _rounded(pose + np.asarray(step).reshape(-1, 3))
    quadratic = looks.quadratic(pose)
    worth = _worth(looks, quadratic)
    pairs, gate = (looks.first, looks.second), ALIGNMENT.joint_rounds[-1][1]
    # Gradients by walls and odometry at the solution.
    walls, curvature = wall_scores(scans, pose, pairs, gate, scans.each * worth)
    off, information = _odometry(pose, steps)
    odometry = odometry_scores(np.einsum("pkl,pl->pk", information, off), stretch)
    band, _ = equations.at(pose, steps, quadratic, curvature * worth)
    return Aligned(pose, band, walls, odometry)


def _odometry(pose: FloatArray, steps: Steps) -> tuple[FloatArray, FloatArray]:
    """Deviations (n - 1, 3) of poses from the odometry's steps, and the weighted information."""
    off = _difference(between(pose[:-1], pose[1:]), steps.motion)
    distance = np.einsum("pk,pkl,pl->p", off, steps.information, off)
    return off, steps.information / (1 + distance / 9)[:, None, None]


def _worth(looks: _Looks, quadratic: _Quadratic) -> float:
    """Weight of a point's squared residual [1/m²], from the mean squared residual."""
    squares, weight = max(quadratic.squares.sum(), 0.0), max(looks.weight.sum(), 1e-9)
    residual_m = float(np.sqrt(squares / weight))
    return ALIGNMENT.joint_worth / max(residual_m, ALIGNMENT.least_residual_m) ** 2


class _Quadratic(NamedTuple):
    """Of pairs: Σ w a aᵀ (p, 3, 3), Σ w a r (p, 3) and Σ w r² (p,)."""

    information: FloatArray
    gradient: FloatArray
    squares: FloatArray


@dataclass(slots=True, eq=False)
class _Looks:
    """Pairs of scans, those of the first offset first, with their last linearisation.

    motion: (p, 3), moments: (p, 4, 4), weight: (p,) at that time; known: (p,) whether there is one.
    """

    first: IntArray
    second: IntArray
    motion: FloatArray
    moments: FloatArray
    weight: FloatArray
    known: BoolArray

    @classmethod
    def of(cls, earlier: Sequence[IntArray], fixed: int) -> _Looks:
        rows = [np.flatnonzero((j >= 0) & (np.arange(len(j)) >= fixed)) for j in earlier]
        first = np.concatenate(rows)
        second = np.concatenate([j[i] for i, j in zip(rows, earlier, strict=True)])
        p = len(first)
        nothing = np.zeros((p, 3)), np.zeros((p, 4, 4)), np.zeros(p), np.zeros(p, bool)
        return cls(first, second, *nothing)

    def renewed(self, scans: Swept, pose: FloatArray, gate: Gate) -> float:
        """Linearise again the pairs that moved so far that correspondences may change; returns
        their share."""
        motion = between(pose[self.second], pose[self.first])
        k = np.flatnonzero(~self.known | _moved(self._change(motion)))
        terms = pair_terms(scans, self.first[k], self.second[k], motion[k], gate)
        self.motion[k], self.moments[k], self.weight[k] = motion[k], terms.moments, terms.weight
        self.known[k] = True
        return len(k) / max(len(self.known), 1)

    def _change(self, motion: FloatArray) -> FloatArray:
        return _difference(motion, self.motion)

    def quadratic(self, pose: FloatArray) -> _Quadratic:
        """The quadratic form at these poses, extrapolated from the last linearisation."""
        change = self._change(between(pose[self.second], pose[self.first]))
        inner, outer = self.moments[:, :3, :3], self.moments[:, :3, 3]
        by_change = np.einsum("pkl,pl->pk", inner, change)
        squares = self.moments[:, 3, 3] + np.sum((2 * outer + by_change) * change, axis=1)
        return _Quadratic(inner, outer + by_change, squares)


def _difference(motion: FloatArray, other: FloatArray) -> FloatArray:
    """(p, 3) differences of motions, angles wrapped."""
    out = motion - other
    out[:, 2] = wrap(out[:, 2])
    return out


@dataclass(frozen=True, slots=True, eq=False)
class _Equations:
    """Normal equations of n poses: the positions of the terms of every pair, followed by those of
    the odometry's steps.

    first, second: (p,) their poses; entry: (21, p) index into the lower band with `rows` rows
    (scipy's format); fixed: number of first poses that stay.
    """

    first: IntArray
    second: IntArray
    entry: IntArray
    rows: int
    fixed: int

    @classmethod
    def of(cls, n: int, fixed: int, looks: _Looks) -> _Equations:
        after = np.arange(1, n)
        first = np.concatenate([looks.first, after])
        second = np.concatenate([looks.second, after - 1])
        # Diagonal blocks: the lower half; off-diagonal blocks: all of it.
        p, q = np.tril_indices(3)
        own = [3 * n * (p - q)[:, None] + (3 * pose + q[:, None]) for pose in (first, second)]
        row, column = np.indices((3, 3)).reshape(2, 9, 1)
        both = 3 * n * (3 * (first - second) + row - column) + 3 * second + column
        rows = 3 * int((first - second).max(initial=0)) + 3
        return cls(first, second, np.concatenate([*own, both]), rows, max(fixed, 1))

    def at(
        self, pose: FloatArray, steps: Steps, looks: _Quadratic, worth: float
    ) -> tuple[FloatArray, FloatArray]:
        """The band (rows, 3 n) and the gradient (3 n,) at poses (n, 3).

        With the motion's axes rotated into the world, W its information and d the vector between
        the two, the later pose has W, the earlier Bᵀ W B, both -W B, where B adds J d of the
        rotation, J a quarter turn.
        """
        n = len(pose)
        off, information = _odometry(pose, steps)
        gradient = np.einsum("pkl,pl->pk", information, off)
        information = np.concatenate([worth * looks.information, information])
        gx, gy, g_turn = np.concatenate([worth * looks.gradient, gradient]).T
        theta = pose[self.second, 2]
        c, s = np.cos(theta), np.sin(theta)
        xx, xy, yy = information[:, 0, 0], information[:, 0, 1], information[:, 1, 1]
        w00 = c * c * xx - 2 * c * s * xy + s * s * yy
        w10 = c * s * (xx - yy) + (c * c - s * s) * xy
        w11 = s * s * xx + 2 * c * s * xy + c * c * yy
        xt, yt, w22 = information[:, 0, 2], information[:, 1, 2], information[:, 2, 2]
        w20, w21 = c * xt - s * yt, s * xt + c * yt
        dx, dy = (pose[self.first, :2] - pose[self.second, :2]).T
        v0, v1, v2 = w10 * dx - w00 * dy, w11 * dx - w10 * dy, w21 * dx - w20 * dy
        by_turn = w20 + v0, w21 + v1, w22 + v2
        later = w00, w10, w11, w20, w21, w22
        earlier = w00, w10, w11, *by_turn[:2], by_turn[2] + v2 + v1 * dx - v0 * dy
        both = -w00, -w10, -by_turn[0], -w10, -w11, -by_turn[1], -w20, -w21, -by_turn[2]
        terms = np.stack([*later, *earlier, *both])
        band = _sums(self.entry, terms, self.rows * 3 * n).reshape(self.rows, 3 * n)
        # Fixed poses, and a small load for unconstrained ones.
        band[0, : 3 * self.fixed] += 1e10
        band[0] += 1e-6
        gx, gy = c * gx - s * gy, s * gx + c * gy
        ends = 3 * np.stack([self.first] * 3 + [self.second] * 3)
        ends += np.array([0, 1, 2, 0, 1, 2])[:, None]
        terms = np.stack([gx, gy, g_turn, -gx, -gy, gx * dy - gy * dx - g_turn])
        return band, _sums(ends, terms, 3 * n)


def _sums(at: IntArray, terms: FloatArray, size: int) -> FloatArray:
    """(size,) sums of terms by position."""
    sums = np.bincount(at.ravel(), terms.ravel(), size)
    # bincount of nothing has integer type.
    return np.asarray(sums, np.float64)


def chained(start: FloatArray, motion: Sequence[FloatArray] | FloatArray) -> FloatArray:
    """(n, 3) poses after each motion, from `start` (3,) on, without the start."""
    steps = np.asarray(motion, np.float64).reshape(-1, 3)
    theta = start[2] + np.concatenate([[0.0], np.cumsum(steps[:, 2])])
    c, s = np.cos(theta[:-1]), np.sin(theta[:-1])
    x = start[0] + np.cumsum(c * steps[:, 0] - s * steps[:, 1])
    y = start[1] + np.cumsum(s * steps[:, 0] + c * steps[:, 1])
    return np.stack([x, y, wrap(theta[1:])], axis=1)
