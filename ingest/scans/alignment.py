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
from .association import Gate, PairTerms, Swept, pair_terms

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class AlignmentSettings:
    """How scans are held against each other."""

    sigma_m: float = 0.03
    """1 sigma of a point's distance from the surface that it is on."""
    pair_worth: float = 0.1
    """Independent looks that a point of one pair is worth: neighbours err together …"""
    joint_worth: float = 0.02
    """… and so do the several pairs that it is in."""
    offsets: tuple[int, ...] = (1, 2, 4, 8, 14, 20, 28, 36, 46, 56)
    """How many keyframes back a scan is held against: up to 14 m of way."""
    pair_gates: tuple[Gate, ...] = (
        *(Gate(0.5, 0.2, 3),) * 5,
        *(Gate(0.3, 0.1),) * 4,
        *(Gate(0.2, 0.05),) * 3,
    )
    joint_gates: tuple[tuple[int, Gate], ...] = (
        *((3, Gate(0.3, 0.08)),) * 2,
        *((4, Gate(0.3, 0.08)),) * 2,
        *((7, Gate(0.2, 0.05)),) * 3,
        *((10, Gate(0.2, 0.05)),) * 3,
    )
    """Rounds: how many of the offsets, and what counts."""
    lost_fit: float = 0.6
    """A step whose points fit less than this is searched for."""
    search_rad: float = 0.52
    search_step_rad: float = 0.052
    """Headings tried: 30 degrees either way, so near that matching reaches the best from one."""
    better_fit: float = 0.1
    """What a search must gain to be believed."""


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
    together = max(1, MOST_POINTS // (len(tried) * scans.xy.shape[1]))
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
    scale = settings.pair_worth / settings.sigma_m**2
    origin = np.zeros_like(motion)
    for gate in settings.pair_gates:
        moments = scale * pair_terms(scans, *pairs, (motion, origin), gate).moments
        off = motion - expected
        off[:, 2] = wrap(off[:, 2])
        gradient = moments[:, :3, 4] + np.einsum("pkl,pl->pk", information, off)
        step = np.linalg.solve(moments[:, :3, :3] + information, gradient[..., None])[..., 0]
        motion = motion - np.clip(step, -0.5, 0.5)
        motion[:, 2] = wrap(motion[:, 2])
    last = pair_terms(scans, *pairs, (motion, origin), settings.pair_gates[-1])
    weakest = np.linalg.eigvalsh(scale * last.moments[:, :2, :2])[:, 0]
    return motion, last.fit, 1 / np.sqrt(np.maximum(weakest, 1e-4))


@dataclass(frozen=True, slots=True, eq=False)
class Aligned:
    """Poses (n, 3), their banded information (lower form, `3 n` columns), and the root mean square
    of what all points are off by [m]."""

    pose: FloatArray
    information: FloatArray
    residual_m: float


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
    rows = [np.flatnonzero((j >= 0) & (np.arange(len(j)) >= fixed)) for j in earlier]
    band, squares, weight = _Band.empty(len(pose), 1), 0.0, 0.0
    for count, gate in settings.joint_gates:
        pairs = [(i, earlier[k][i]) for k, i in enumerate(rows[:count]) if len(i)]
        band = _Band.empty(len(pose), max((int((i - j).max()) for i, j in pairs), default=1))
        band.add_steps(pose, steps)
        squares, weight = 0.0, 0.0
        for i, j in pairs:
            terms = pair_terms(scans, i, j, (pose[i], pose[j]), gate)
            band.add_pairs(i, j, terms, settings.joint_worth / settings.sigma_m**2)
            squares += float(terms.moments[:, 4, 4].sum())
            weight += float(terms.weight.sum())
        band.hold(fixed)
        pose = pose + band.solve()
        pose[:, 2] = wrap(pose[:, 2])
    residual_m = float(np.sqrt(squares / weight)) if weight > 0 else settings.sigma_m
    return Aligned(pose, band.lower(), residual_m)


@dataclass(frozen=True, slots=True, eq=False)
class _Band:
    """Normal equations of n poses: blocks (n, d + 1, 3, 3) of row a and column a - d; gradient."""

    blocks: FloatArray
    gradient: FloatArray

    @classmethod
    def empty(cls, n: int, widest: int) -> _Band:
        return cls(np.zeros((n, widest + 1, 3, 3)), np.zeros((n, 3)))

    def add_pairs(self, first: IntArray, second: IntArray, terms: PairTerms, scale: float) -> None:
        """Terms of distinct rows `first` against distinct rows `second` before them."""
        moments = scale * terms.moments
        by_first, by_second = _SELECT_FIRST, _SELECT_SECOND
        self.blocks[first, 0] += by_first.T @ moments @ by_first
        self.blocks[second, 0] += by_second.T @ moments @ by_second
        self.blocks[first, first - second] += by_first.T @ moments @ by_second
        self.gradient[first] += moments[:, :, 4] @ by_first
        self.gradient[second] += moments[:, :, 4] @ by_second

    def add_steps(self, pose: FloatArray, steps: Steps) -> None:
        motion = between(pose[:-1], pose[1:])
        off = motion - steps.motion
        off[:, 2] = wrap(off[:, 2])
        distance = np.einsum("pk,pkl,pl->p", off, steps.information, off)
        information = steps.information / (1 + distance / 9)[:, None, None]
        c, s = np.cos(pose[:-1, 2]), np.sin(pose[:-1, 2])
        by_next = np.zeros((len(motion), 3, 3))
        by_next[:, 0, 0] = by_next[:, 1, 1] = c
        by_next[:, 0, 1], by_next[:, 1, 0] = s, -s
        by_next[:, 2, 2] = 1.0
        by_before = -by_next
        by_before[:, 0, 2], by_before[:, 1, 2] = motion[:, 1], -motion[:, 0]
        to_next = by_next.transpose(0, 2, 1) @ information
        to_before = by_before.transpose(0, 2, 1) @ information
        self.blocks[1:, 0] += to_next @ by_next
        self.blocks[:-1, 0] += to_before @ by_before
        self.blocks[1:, 1] += to_next @ by_before
        self.gradient[1:] += (to_next @ off[..., None])[..., 0]
        self.gradient[:-1] += (to_before @ off[..., None])[..., 0]

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


_SELECT_FIRST = np.zeros((5, 3))
_SELECT_FIRST[[0, 1, 2], [0, 1, 2]] = 1.0
_SELECT_SECOND = np.zeros((5, 3))
_SELECT_SECOND[[0, 1, 3], [0, 1, 2]] = -1.0, -1.0, 1.0


def chained(start: FloatArray, motion: Sequence[FloatArray] | FloatArray) -> FloatArray:
    """(n, 3) poses from `start` (3,) on, one after each motion, without the start."""
    out = np.empty((len(motion), 3))
    pose = np.asarray(start)
    for k, step in enumerate(motion):
        pose = out[k] = compose(pose, step)
    return out
