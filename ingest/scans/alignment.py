"""Poses of many scans at once, so that the surfaces they share fall on each other.

Every scan is held against several before it (point to line), every step against the odometry; all
poses of a window are solved for together, so that what comes later corrects what was before. The
normal matrix is banded: nothing ties scans that are farther apart than the widest pair.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solveh_banded

from ...topology.se2 import between, compose, wrap
from .association import Gate, Swept, pair_terms
from .scatter import Scatter, motion_by_ends, odometry_scores, wall_scores

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class AlignmentSettings:
    """How scans are held against each other."""

    sigma_m: float = 0.03
    """1 sigma of a point's distance from the surface that it is on."""
    pair_worth: float = 0.1
    """Independent looks that a point of one pair is worth: neighbours err together."""
    joint_worth: float = 0.0034
    """The same of a point in all pairs of a window, which err together as well. It is weighed
    against the odometry: half of it and twice are worse in two real and two simulated buildings
    (`benchmarks/laser.py`)."""
    least_residual_m: float = 0.006
    """What is nearer is by chance: walls are not flatter."""
    offsets: tuple[int, ...] = (1, 2, 4, 8, 14, 24, 36, 52)
    """How many keyframes back a scan is held against: up to 13 m of way. Two more change nothing,
    two fewer cost a fifth of the drift."""
    pair_rounds: tuple[tuple[int, Gate], ...] = ((5, Gate(0.5, 0.2, 1)), (4, Gate(0.2, 0.05, 1)))
    joint_rounds: tuple[tuple[int, Gate], ...] = ((3, Gate(0.3, 0.08)), (8, Gate(0.2, 0.05)))
    """Rounds at most, and what counts in them: the wide gate reaches from where a bad odometry
    leads (without it, drift by scans alone is a quarter more)."""
    settled_m: float = 0.01
    """Points that a round moves by less have the same counterparts in the next …"""
    settled_at_m: float = 5.0
    """… at this distance, as far as points in rooms and corridors are."""
    lost_fit: float = 0.6
    """A step whose points fit less than this is searched for."""
    search_rad: float = 0.52
    search_step_rad: float = 0.052
    """Headings tried: 30 degrees either way, so near that matching reaches the best from one."""
    better_fit: float = 0.1
    """What a search must gain to be believed."""

    def moved(self, change: FloatArray) -> BoolArray:
        """(p,) whether a change (p, 3) of motions moves points by more than `settled_m`."""
        shift = np.hypot(change[:, 0], change[:, 1])
        return np.asarray(shift + self.settled_at_m * np.abs(change[:, 2]) > self.settled_m)


@dataclass(frozen=True, slots=True, eq=False)
class Steps:
    """What the odometry says of the motion from some poses to others: (p, 3) motion and (p, 3, 3)
    information (inverse covariance), in the frame of the pose before."""

    motion: FloatArray
    information: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class PairMotion:
    """Motion (p, 3) from scan to scan; fit: (p,) share of points on a surface; searched: (p,)
    where the odometry led nowhere and another heading was found; loose_m: (p,) 1 sigma of the
    motion in the direction that the scans tell least of, as along a bare corridor."""

    motion: FloatArray
    fit: FloatArray
    searched: BoolArray
    loose_m: FloatArray


MOST_POINTS = 1 << 18
"""So many points are searched for at once, 100 bytes each."""


def match_steps(
    scans: Swept, pairs: tuple[IntArray, IntArray], steps: Steps, settings: AlignmentSettings
) -> PairMotion:
    """The motion to scans `first` (p,) from scans `second` alone, by both odometry and scans."""
    first, second = pairs
    n = len(first)
    # The odometry holds what the scans leave open, no more, until all have their say.
    weak = settings.pair_worth * steps.information
    start = steps.motion
    motion, fit, loose_m = _matched(scans, (first, second), (start, start, weak), settings)
    searched = np.zeros(n, bool)
    lost = np.flatnonzero(fit < settings.lost_fit)
    tried = np.arange(-settings.search_rad, settings.search_rad + 1e-9, settings.search_step_rad)
    together = max(1, MOST_POINTS // (len(tried) * scans.beams))
    for some in (lost[k : k + together] for k in range(0, len(lost), together)):
        rows = np.repeat(some, len(tried))
        start = steps.motion[rows]
        start[:, 2] = wrap(start[:, 2] + np.tile(tried, len(some)))
        prior = steps.motion[rows], start, 0.01 * weak[rows]
        found, found_fit, found_loose_m = _matched(
            scans, (first[rows], second[rows]), prior, settings
        )
        by_row = found_fit.reshape(len(some), -1)
        best = by_row.argmax(axis=1)
        better = by_row[np.arange(len(some)), best] > fit[some] + settings.better_fit
        at = some[better]
        motion[at] = found.reshape(len(some), -1, 3)[better, best[better]]
        fit[at] = by_row[better, best[better]]
        loose_m[at] = found_loose_m.reshape(len(some), -1)[better, best[better]]
        searched[at] = True
    return PairMotion(motion, fit, searched, loose_m)


def _matched(
    scans: Swept,
    pairs: tuple[IntArray, IntArray],
    odometry: tuple[FloatArray, FloatArray, FloatArray],
    settings: AlignmentSettings,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Gauss-Newton on each pair: motion, fit, loose_m. odometry: motion, start, information."""
    expected, motion, information = odometry
    motion = motion.copy()
    scale = settings.pair_worth / settings.sigma_m**2
    first, second = pairs
    for rounds, gate in settings.pair_rounds:
        moving = np.arange(len(motion))
        for _ in range(rounds):
            some = first[moving], second[moving]
            moments = scale * pair_terms(scans, *some, motion[moving], gate).moments
            off = _difference(motion[moving], expected[moving])
            odometry_gradient = np.einsum("pkl,pl->pk", information[moving], off)
            gradient = moments[:, :3, 3] + odometry_gradient
            total = moments[:, :3, :3] + information[moving]
            step = np.clip(np.linalg.solve(total, gradient[..., None])[..., 0], -0.5, 0.5)
            motion[moving] -= step
            motion[:, 2] = wrap(motion[:, 2])
            moving = moving[settings.moved(step)]
    last = pair_terms(scans, *pairs, motion, settings.pair_rounds[-1][-1])
    weakest = np.linalg.eigvalsh(scale * last.moments[:, :2, :2])[:, 0]
    return motion, last.fit, 1 / np.sqrt(np.maximum(weakest, 1e-4))


@dataclass(frozen=True, slots=True, eq=False)
class Aligned:
    """Poses (n, 3), and how far off they may be."""

    pose: FloatArray
    scatter: Scatter


def align(
    scans: Swept,
    pose: FloatArray,
    steps: Steps,
    *,
    fixed: int,
    earlier: Sequence[IntArray],
    settings: AlignmentSettings,
) -> Aligned:
    """All poses together, starting from `pose` (n, 3), the first `fixed` of which stay.

    earlier: per offset of the settings the scan (n,) that each is held against, -1 for none; steps:
    from each pose to the next. Gauss-Newton with a
    Cauchy weight on odometry; O(n · offsets · beams) a round.
    """
    looks = _Looks.of(earlier, fixed)
    for rounds, gate in settings.joint_rounds:
        looks.known[:] = False
        for _ in range(rounds):
            if not looks.renewed(scans, pose, gate, settings):
                break
            band = _equations(pose, steps, looks, settings)
            band.hold(fixed)
            pose = pose + band.solve()
            pose[:, 2] = wrap(pose[:, 2])
    return Aligned(pose, _scatter(scans, pose, steps, looks, fixed=fixed, settings=settings))


def _scatter(
    scans: Swept,
    pose: FloatArray,
    steps: Steps,
    looks: _Looks,
    *,
    fixed: int,
    settings: AlignmentSettings,
) -> Scatter:
    """What walls and odometry ask for at poses (n, 3) that all of them together agree on."""
    pairs, gate = (looks.first, looks.second), settings.joint_rounds[-1][1]
    worth = scans.each * _worth(looks, pose, settings)
    walls, curvature = wall_scores(scans, pose, pairs, gate, worth)
    off, information = _odometry(pose, steps)
    odometry = odometry_scores(np.einsum("pkl,pl->pk", information, off))
    band = _equations(pose, steps, looks, settings, curvature)
    band.hold(fixed)
    return Scatter(band.lower(), walls, odometry)


def _odometry(pose: FloatArray, steps: Steps) -> tuple[FloatArray, FloatArray]:
    """By how much (n - 1, 3) poses stray from every step, and its information with its weight."""
    off = _difference(between(pose[:-1], pose[1:]), steps.motion)
    distance = np.einsum("pk,pkl,pl->p", off, steps.information, off)
    return off, steps.information / (1 + distance / 9)[:, None, None]


def _worth(looks: _Looks, pose: FloatArray, settings: AlignmentSettings) -> float:
    """What a point's square of 1 m² counts, by how far all points are off."""
    squares = looks.quadratic(pose)[2]
    residual_m = float(np.sqrt(max(squares.sum(), 0.0) / max(looks.weight.sum(), 1e-9)))
    return settings.joint_worth / max(residual_m, settings.least_residual_m) ** 2


@dataclass(slots=True, eq=False)
class _Looks:
    """Pairs of scans, those of the first offset first, and what they were when last looked at:
    motion (p, 3), moments (p, 4, 4), weight (p,); known: (p,) whether they were."""

    first: IntArray
    second: IntArray
    offset: IntArray
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
        offset = np.repeat(np.arange(len(rows)), [len(i) for i in rows])
        nothing = np.zeros((p, 3)), np.zeros((p, 4, 4)), np.zeros(p), np.zeros(p, bool)
        return cls(first, second, offset, *nothing)

    def renewed(
        self, scans: Swept, pose: FloatArray, gate: Gate, settings: AlignmentSettings
    ) -> bool:
        """Look again at those that moved so far that other points may count; whether any did."""
        motion = between(pose[self.second], pose[self.first])
        k = np.flatnonzero(~self.known | settings.moved(self._change(motion)))
        terms = pair_terms(scans, self.first[k], self.second[k], motion[k], gate)
        self.motion[k], self.moments[k], self.weight[k] = motion[k], terms.moments, terms.weight
        self.known[k] = True
        return len(k) > 0

    def _change(self, motion: FloatArray) -> FloatArray:
        return _difference(motion, self.motion)

    def quadratic(self, pose: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Σ w a aᵀ (p, 3, 3), Σ w a r (p, 3) and Σ w r² (p,) at these poses, by the residuals'
        derivatives where they were last looked at."""
        change = self._change(between(pose[self.second], pose[self.first]))
        inner, outer = self.moments[:, :3, :3], self.moments[:, :3, 3]
        by_change = np.einsum("pkl,pl->pk", inner, change)
        squares = self.moments[:, 3, 3] + np.sum((2 * outer + by_change) * change, axis=1)
        return inner, outer + by_change, squares


def _difference(motion: FloatArray, other: FloatArray) -> FloatArray:
    """(p, 3) of motions, turns by the shorter way."""
    out = motion - other
    out[:, 2] = wrap(out[:, 2])
    return out


def _equations(
    pose: FloatArray,
    steps: Steps,
    looks: _Looks,
    settings: AlignmentSettings,
    share: float = 1.0,
) -> _Band:
    """Of odometry and scans together; share: of their worth by which scans count."""
    first, second = looks.first, looks.second
    band = _Band.empty(len(pose), int((first - second).max(initial=1)))
    off, information = _odometry(pose, steps)
    after = np.arange(1, len(pose))
    band.add(pose, after, after - 1, (information, np.einsum("pkl,pl->pk", information, off)))
    information, gradient, _ = looks.quadratic(pose)
    scale = share * _worth(looks, pose, settings)
    ends = np.searchsorted(looks.offset, np.arange(looks.offset.max(initial=0) + 2))
    for k in map(slice, ends[:-1], ends[1:]):
        band.add(pose, first[k], second[k], (scale * information[k], scale * gradient[k]))
    return band


@dataclass(frozen=True, slots=True, eq=False)
class _Band:
    """Normal equations of n poses: blocks (n, d + 1, 3, 3) of row a and column a - d; gradient."""

    blocks: FloatArray
    gradient: FloatArray

    @classmethod
    def empty(cls, n: int, widest: int) -> _Band:
        return cls(np.zeros((n, widest + 1, 3, 3)), np.zeros((n, 3)))

    def add(
        self,
        pose: FloatArray,
        first: IntArray,
        second: IntArray,
        terms: tuple[FloatArray, FloatArray],
    ) -> None:
        """Information (p, 3, 3) and gradient (p, 3) of the motion to distinct rows `first` from
        distinct rows `second` before them."""
        information, gradient = terms
        by_first, by_second = motion_by_ends(pose, first, second)
        to_first = by_first.transpose(0, 2, 1) @ information
        to_second = by_second.transpose(0, 2, 1) @ information
        self.blocks[first, 0] += to_first @ by_first
        self.blocks[second, 0] += to_second @ by_second
        self.blocks[first, first - second] += to_first @ by_second
        self.gradient[first] += np.einsum("pkl,pk->pl", by_first, gradient)
        self.gradient[second] += np.einsum("pkl,pk->pl", by_second, gradient)

    def hold(self, fixed: int) -> None:
        """Keep the first poses where they are, and those that nothing ties down."""
        self.blocks[: max(fixed, 1), 0] += 1e10 * np.eye(3)
        self.blocks[:, 0] += 1e-6 * np.eye(3)

    def lower(self) -> FloatArray:
        """(3 d + 3, 3 n) the lower band as scipy takes it."""
        n, width = self.blocks.shape[:2]
        band = np.zeros((3 * width + 2, n, 3))
        for d in range(width):
            for p in range(3):
                for q in range(3):
                    if 3 * d + p >= q:
                        band[3 * d + p - q, : n - d, q] = self.blocks[d:, d, p, q]
        return band.reshape(3 * width + 2, 3 * n)

    def solve(self) -> FloatArray:
        step = solveh_banded(self.lower(), -self.gradient.ravel(), lower=True)
        return np.asarray(step).reshape(-1, 3)


def chained(start: FloatArray, motion: Sequence[FloatArray] | FloatArray) -> FloatArray:
    """(n, 3) poses from `start` (3,) on, one after each motion, without the start."""
    out = np.empty((len(motion), 3))
    pose = np.asarray(start)
    for k, step in enumerate(motion):
        pose = out[k] = compose(pose, step)
    return out
