"""Dead reckoning: the passes of a run in order, and the odometry with its errors between them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from ..arrays import FloatArray, IntArray
from ..frozen import freeze
from ..odometry import Odometry
from ..passes import Passes
from ..run import NOT_SEEN_AGAIN, SeenAgain
from ..topomap import RunNoise
from ..track import interpolated, piece_of, stretch_of, track_directions, way_at

RANDOM = slice(7)
"""Columns of `DeadReckoning.sums` that hold variances."""


@dataclass(frozen=True, slots=True)
class SystematicErrors:
    """1 sigma of the odometry's constant errors.

    Scale is not among them, because a scaled map still closes all of its loops.
    """

    turn_rad_per_m: float = 0.0005
    """Heading bias per metre driven."""
    turn_rad_per_rad: float = 0.01
    """Relative error of turns."""


@dataclass(frozen=True, slots=True, eq=False)
class Factors:
    """Measured relative poses of nodes of a `PoseGraph`. Its first nodes are the passes of a run,
    at their centres and rotated like the odometry frame.

    first, second: (k,) nodes; measurement: (k, 3) T_first_second; information: (k, 3, 3) of it.
    """

    first: IntArray
    second: IntArray
    measurement: FloatArray
    information: FloatArray

    def __post_init__(self) -> None:
        k = len(self.first)
        freeze(self, np.int64, first=(k,), second=(k,))
        freeze(self, np.float64, measurement=(k, 3), information=(k, 3, 3))

    def __len__(self) -> int:
        return len(self.first)


NO_FACTORS = Factors(
    np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 3, 3))
)


@dataclass(frozen=True, slots=True, eq=False)
class DeadReckoning:
    """The passes of a run and the odometry between them.

    piece: (p,) unbroken piece of odometry of each pass. leg: (p - 1,) distance driven from each
    pass to the next [m], NaN across a break or a jump. arriving, leaving: (p,) headings [rad] from
    the place to where the robot came from and went to, NaN where unknown. aside: (p,) distance at
    which the robot passed the place [m]. sums: (p, 13) prefix sums over the odometry up to each
    pass (see `_prefix_sums`), about `origin` (p, 2), the centroid of the pass's piece; jumps: (p,
    7) what the odometry's jumps add to the variances among them; loops: between passes apart
    in time, measured by what a laser saw there.
    """

    passes: Passes
    noise: RunNoise
    systematic: SystematicErrors
    piece: IntArray
    leg: FloatArray
    arriving: FloatArray
    leaving: FloatArray
    aside: FloatArray
    origin: FloatArray
    sums: FloatArray
    jumps: FloatArray
    loops: Factors = field(default=NO_FACTORS)

    def __len__(self) -> int:
        return len(self.passes)


def dead_reckoning(
    odometry: Odometry,
    passes: Passes,
    noise: RunNoise,
    systematic: SystematicErrors = SystematicErrors(),
    again: SeenAgain = NOT_SEEN_AGAIN,
) -> DeadReckoning:
    """Dead reckoning of a run. O(n + p log n) for n odometry rows and p passes.

    again: where the robot came by a place again; the odometry was laid out accordingly.
    """
    way = way_at(odometry, passes.time_ns)
    piece = piece_of(odometry, passes.time_ns)
    leg = np.where(np.diff(stretch_of(odometry, passes.time_ns)) == 0, np.diff(way), np.nan)
    track = track_directions(odometry, passes.time_ns, passes.centre)
    middle, about = _about_pieces(odometry)
    return DeadReckoning(
        passes=passes,
        noise=noise,
        systematic=systematic,
        piece=piece,
        leg=leg,
        arriving=track.arriving,
        leaving=track.leaving,
        aside=np.hypot(*(odometry.at(passes.time_ns)[:, :2] - passes.centre).T),
        origin=middle[piece],
        sums=_prefix_sums(odometry, passes, noise, about),
        jumps=_jump_sums(odometry, passes, about),
        loops=_loops_of_passes(odometry, passes, noise, again),
    )


FAR_M = 15.0
"""Passes farther than this from where the robot was seen again are not tied by it: two
corridors."""


def _loops_of_passes(
    odometry: Odometry, passes: Passes, noise: RunNoise, again: SeenAgain
) -> Factors:
    """Each time that the robot came by a place again, as a loop between the two passes next to it,
    of which the one known best is kept for every pair."""
    if not len(again) or not len(passes):
        return NO_FACTORS
    way, piece = way_at(odometry, passes.time_ns), stretch_of(odometry, passes.time_ns)
    rows, covs = [], [np.linalg.inv(again.information)]
    for times in (again.first_ns, again.second_ns):
        at = way_at(odometry, times)
        gap = np.abs(way - at[:, None])
        gap[piece != stretch_of(odometry, times)[:, None]] = np.inf
        row = gap.argmin(axis=1)
        away = gap[np.arange(len(at)), row]
        rows.append(np.where(away <= FAR_M, row, -1))
        covs.append(_straight_covariance(noise, np.minimum(away, FAR_M)))
    first, second = np.minimum(*rows), np.maximum(*rows)
    cov = sum(covs[1:], covs[0])
    size = cov[:, 0, 0] + cov[:, 1, 1]
    fine = np.flatnonzero((first >= 0) & (first != second))
    best = fine[np.argsort(size[fine], kind="stable")]
    kept = best[np.unique([first[best], second[best]], axis=1, return_index=True)[1]]
    first, second = first[kept], second[kept]
    measured = np.zeros((len(kept), 3))
    measured[:, :2] = passes.centre[second] - passes.centre[first]
    information = np.linalg.inv(cov[kept])
    return Factors(first, second, measured, 0.5 * (information + information.transpose(0, 2, 1)))


def _straight_covariance(noise: RunNoise, way: FloatArray) -> FloatArray:
    """(k, 3, 3) of x, y, theta after driving straight on for `way` (k,) [m], the same in all
    directions."""
    turn = noise.heading_rad_per_sqrt_m**2 * way
    out = np.zeros((len(way), 3, 3))
    shift = noise.along_m_per_sqrt_m**2 * way + turn * way**2 / 3 + noise.centre_m**2
    out[:, 0, 0] = out[:, 1, 1] = shift
    out[:, 2, 2] = turn
    return out


def scale_noise(reckoning: DeadReckoning, factor: float) -> DeadReckoning:
    """Dead reckoning with its random errors (1 sigma) multiplied by `factor`; those of jumps
    stay."""
    n = reckoning.noise
    noise = replace(
        n,
        along_m_per_sqrt_m=factor * n.along_m_per_sqrt_m,
        heading_rad_per_sqrt_m=factor * n.heading_rad_per_sqrt_m,
        heading_rad_per_sqrt_rad=factor * n.heading_rad_per_sqrt_rad,
        centre_m=factor * n.centre_m,
        branch_rad=factor * n.branch_rad,
    )
    sums = reckoning.sums.copy()
    sums[:, RANDOM] *= factor**2
    return replace(reckoning, noise=noise, sums=sums)


def _about_pieces(odometry: Odometry) -> tuple[FloatArray, FloatArray]:
    """(q, 2) centroid of every unbroken piece, and (n, 2) positions relative to that of their
    piece.

    Sums about the centroid keep their precision wherever a reset has put the frame.
    """
    position = odometry.pose[:, :2]
    middle = np.stack([m.mean(axis=0) for m in np.split(position, odometry.breaks)])
    piece = np.searchsorted(odometry.breaks, np.arange(len(position)), side="right")
    return middle, position - middle[piece]


def _prefix_sums(
    odometry: Odometry, passes: Passes, noise: RunNoise, about: FloatArray
) -> FloatArray:
    """(p, 13) sums over all odometry steps before each pass.

    Columns: Σq, Σq x, Σq y, Σq x², Σq xy, Σq y² with q the heading variance of a step; Στ² ds;
    Σds, Σds x, Σds y; Σdθ, Σdθ x, Σdθ y.
    """
    step, turn = odometry.step_m, odometry.turn_rad
    x, y = about.T
    q = noise.heading_rad_per_sqrt_m**2 * step
    q = q + noise.heading_rad_per_sqrt_rad**2 * np.abs(turn)
    along = noise.along_m_per_sqrt_m**2 * step
    spread = _variances(q, along, x, y)
    constant = [step, step * x, step * y, turn, turn * x, turn * y]
    return _up_to_passes(odometry, passes, spread + constant)


def _jump_sums(odometry: Odometry, passes: Passes, about: FloatArray) -> FloatArray:
    """(p, 7) the variance columns of `_prefix_sums`, over the jumps only."""
    q, along = np.zeros(len(odometry)), np.zeros(len(odometry))
    along[odometry.jumps], q[odometry.jumps] = odometry.jump_sigma.T**2
    x, y = about.T
    return _up_to_passes(odometry, passes, _variances(q, along, x, y))


def _variances(q: FloatArray, along: FloatArray, x: FloatArray, y: FloatArray) -> list[FloatArray]:
    return [q, q * x, q * y, q * x * x, q * x * y, q * y * y, along]


def _up_to_passes(odometry: Odometry, passes: Passes, columns: list[FloatArray]) -> FloatArray:
    """Sums of the columns over the odometry steps before each pass."""
    total = np.cumsum(np.stack(columns, axis=1), axis=0)
    return np.stack([interpolated(odometry, column, passes.time_ns) for column in total.T], axis=1)


def relative_covariance(reckoning: DeadReckoning, first: IntArray, second: IntArray) -> FloatArray:
    """(k, 3, 3) covariance of pass `second`'s x, y, theta as dead reckoned from pass `first`.

    Random walk and jumps only; see `systematic_modes` for the constant errors. Axes are those of
    the odometry frame; theta is the error of that frame's heading. Closed form from prefix sums,
    O(1) per pair: with S0 = Σq, S1 = Σq p, S2 = Σq p pᵀ over the steps between and c the second
    pass, C_θθ = S0, C_xyθ = J (S0 c - S1), C_xy = Στ² ds I + J (S0 c cᵀ - S1 cᵀ - c S1ᵀ + S2) Jᵀ.
    """
    d = _between(reckoning.sums[:, RANDOM] + reckoning.jumps, first, second)
    c = (reckoning.passes.centre - reckoning.origin)[second]
    s0, s1x, s1y, s2xx, s2xy, s2yy, along = d.T
    x, y = c.T
    mxx = s0 * x * x - 2 * s1x * x + s2xx
    mxy = s0 * x * y - s1x * y - s1y * x + s2xy
    myy = s0 * y * y - 2 * s1y * y + s2yy
    out = np.zeros((len(d), 3, 3))
    # J m Jᵀ with J = [[0, -1], [1, 0]].
    out[:, 0, 0] = along + myy
    out[:, 1, 1] = along + mxx
    out[:, 0, 1] = out[:, 1, 0] = -mxy
    out[:, 0, 2] = out[:, 2, 0] = -(s0 * y - s1y)
    out[:, 1, 2] = out[:, 2, 1] = s0 * x - s1x
    out[:, 2, 2] = s0
    return out


def systematic_modes(reckoning: DeadReckoning, first: IntArray, second: IntArray) -> FloatArray:
    """(k, 3, 2) derivatives of pass `second`'s x, y, theta, relative to `first`, by the constant
    errors.

    Last axis: turn per metre, turn per radian (`SystematicErrors`). Exact sums over the odometry
    rows, for first <= second.
    """
    d = _between(reckoning.sums, first, second)
    c = (reckoning.passes.centre - reckoning.origin)[second]
    out = np.zeros((len(d), 3, 2))
    for mode, at in ((0, 7), (1, 10)):
        l0, l1x, l1y = d[:, at], d[:, at + 1], d[:, at + 2]
        out[:, 0, mode] = -(l0 * c[:, 1] - l1y)
        out[:, 1, mode] = l0 * c[:, 0] - l1x
        out[:, 2, mode] = l0
    return out


def dead_reckoning_covariance(
    reckoning: DeadReckoning, first: IntArray, second: IntArray
) -> FloatArray:
    """(k, 3, 3) `relative_covariance` including the systematic errors."""
    modes = systematic_modes(reckoning, first, second)
    s = reckoning.systematic
    modes = modes * np.array([s.turn_rad_per_m, s.turn_rad_per_rad])
    out: FloatArray = relative_covariance(reckoning, first, second) + modes @ modes.transpose(
        0, 2, 1
    )
    return out


def _between(sums: FloatArray, first: IntArray, second: IntArray) -> FloatArray:
    """(k, c) sums over the odometry between two passes each, in either order."""
    low, high = np.minimum(first, second), np.maximum(first, second)
    difference: FloatArray = sums[high] - sums[low]
    return difference
