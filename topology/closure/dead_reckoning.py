"""Dead reckoning: the passes of a run in order, and the odometry with its errors between them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from ..arrays import FloatArray, IntArray
from ..odometry import Odometry
from ..passes import Passes
from ..posegraph.graph import NO_MEASUREMENTS, Measurements
from ..run import NOT_SEEN_AGAIN, SeenAgain
from ..topomap import RunNoise
from ..track import interpolated, piece_of, stretch_of, track_directions, way_at


@dataclass(frozen=True, slots=True, eq=False)
class DeadReckoning:
    """The passes of a run and the odometry between them.

    piece: (p,) unbroken piece of odometry of each pass. leg: (p - 1,) distance driven from each
    pass to the next [m], NaN across a break or a jump. arriving, leaving: (p,) headings [rad] from
    the place to where the robot came from and went to, NaN where unknown. aside: (p,) distance at
    which the robot passed the place [m]. sums: (p, 7) prefix sums over the odometry up to each
    pass (see `_variance_sums`), about `origin` (p, 2), the centroid of the pass's piece; jumps: (p,
    7) the same for the variances of jumps; loops: between passes, as views measured them.
    """

    passes: Passes
    noise: RunNoise
    piece: IntArray
    leg: FloatArray
    arriving: FloatArray
    leaving: FloatArray
    aside: FloatArray
    origin: FloatArray
    sums: FloatArray
    jumps: FloatArray
    loops: Measurements = field(default=NO_MEASUREMENTS)

    def __len__(self) -> int:
        return len(self.passes)


def dead_reckoning(
    odometry: Odometry, passes: Passes, noise: RunNoise, revisits: SeenAgain = NOT_SEEN_AGAIN
) -> DeadReckoning:
    """Dead reckoning of a run. O(n + p log n) for n odometry rows and p passes.

    revisits: places that the robot passed again; the odometry was corrected by them.
    """
    way = way_at(odometry, passes.time_ns)
    piece = piece_of(odometry, passes.time_ns)
    leg = np.where(np.diff(stretch_of(odometry, passes.time_ns)) == 0, np.diff(way), np.nan)
    track = track_directions(odometry, passes.time_ns, passes.centre)
    centroids, centred = about_centroids(odometry)
    return DeadReckoning(
        passes=passes,
        noise=noise,
        piece=piece,
        leg=leg,
        arriving=track.arriving,
        leaving=track.leaving,
        aside=np.hypot(*(odometry.at(passes.time_ns)[:, :2] - passes.centre).T),
        origin=centroids[piece],
        sums=walk_sums(odometry, passes, noise, centred),
        jumps=_jump_sums(odometry, passes, centred),
        loops=_loops_of_passes(odometry, passes, noise, revisits),
    )


FAR_M = 15.0
"""Largest distance of a pass from a revisit that ties it: beyond is another corridor."""


def _loops_of_passes(
    odometry: Odometry, passes: Passes, noise: RunNoise, revisits: SeenAgain
) -> Measurements:
    """Revisits as loops between the passes nearest to both times; for each pair the most certain.

    Left out are revisits with a time farther than `FAR_M` from all passes, or with one pass nearest
    to both. A loop has the shift of `odometry`, which the revisits have corrected; the ways to the
    passes add to its covariance.
    """
    if not len(revisits) or not len(passes):
        return NO_MEASUREMENTS
    pass_arc_m, stretch = way_at(odometry, passes.time_ns), stretch_of(odometry, passes.time_ns)
    rows, covs = [], [np.linalg.inv(revisits.information)]
    for times in (revisits.first_ns, revisits.second_ns):
        arc_m = way_at(odometry, times)
        gap = np.abs(pass_arc_m - arc_m[:, None])
        gap[stretch != stretch_of(odometry, times)[:, None]] = np.inf
        nearest = gap.argmin(axis=1)
        distance_m = gap[np.arange(len(arc_m)), nearest]
        rows.append(np.where(distance_m <= FAR_M, nearest, -1))
        covs.append(noise.straight_covariance(np.minimum(distance_m, FAR_M)))
        covs[-1][:, (0, 1), (0, 1)] += noise.centre_m**2
    first, second = np.minimum(*rows), np.maximum(*rows)
    cov = sum(covs[1:], covs[0])
    variance = cov[:, 0, 0] + cov[:, 1, 1]
    usable = np.flatnonzero((first >= 0) & (first != second))
    best = usable[np.argsort(variance[usable], kind="stable")]
    chosen = best[np.unique([first[best], second[best]], axis=1, return_index=True)[1]]
    first, second = first[chosen], second[chosen]
    measurement = np.zeros((len(chosen), 3))
    measurement[:, :2] = passes.centre[second] - passes.centre[first]
    information = np.linalg.inv(cov[chosen])
    return Measurements(
        first, second, measurement, 0.5 * (information + information.transpose(0, 2, 1))
    )


def scale_noise(reckoning: DeadReckoning, factor: float) -> DeadReckoning:
    """Dead reckoning with its random errors (1 sigma) but those of jumps multiplied by `factor`."""
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
    sums *= factor**2
    return replace(reckoning, noise=noise, sums=sums)


def about_centroids(odometry: Odometry) -> tuple[FloatArray, FloatArray]:
    """(q, 2) centroid of every unbroken piece [m], and (n, 2) positions relative to that of their
    piece [m].

    A reset may put a piece far from the origin, where sums of coordinates lose precision.
    """
    position = odometry.pose[:, :2]
    centroids = np.stack([m.mean(axis=0) for m in np.split(position, odometry.breaks)])
    piece = np.searchsorted(odometry.breaks, np.arange(len(position)), side="right")
    return centroids, position - centroids[piece]


def walk_sums(
    odometry: Odometry, passes: Passes, noise: RunNoise, centred: FloatArray
) -> FloatArray:
    """(p, 7) `_variance_sums` of the odometry's random walks."""
    step, turn = odometry.step_m, np.abs(odometry.turn_rad)
    heading_variance = noise.heading_rad_per_sqrt_m**2 * step
    heading_variance = heading_variance + noise.heading_rad_per_sqrt_rad**2 * turn
    along_variance = noise.along_m_per_sqrt_m**2 * step
    return _variance_sums(odometry, passes, heading_variance, along_variance, centred)


def _jump_sums(odometry: Odometry, passes: Passes, centred: FloatArray) -> FloatArray:
    """(p, 7) `_variance_sums` of the odometry's jumps."""
    heading_variance, along_variance = np.zeros(len(odometry)), np.zeros(len(odometry))
    along_variance[odometry.jumps], heading_variance[odometry.jumps] = odometry.jump_sigma.T**2
    return _variance_sums(odometry, passes, heading_variance, along_variance, centred)


def _variance_sums(
    odometry: Odometry, passes: Passes, q: FloatArray, along: FloatArray, centred: FloatArray
) -> FloatArray:
    """(p, 7) sums over all odometry steps before each pass: Σq, Σq x, Σq y, Σq x², Σq xy, Σq y²
    with q (n,) the heading variance of a step, and Σ of its variance along the way (n,).
    centred: (n, 2) its position by `about_centroids`."""
    x, y = centred.T
    columns = np.stack([q, q * x, q * y, q * x * x, q * x * y, q * y * y, along], axis=1)
    sums = np.cumsum(columns, axis=0)
    return np.stack([interpolated(odometry, column, passes.time_ns) for column in sums.T], axis=1)


def relative_covariance(reckoning: DeadReckoning, first: IntArray, second: IntArray) -> FloatArray:
    """(k, 3, 3) covariance of pass `second`'s x, y, theta as dead reckoned from pass `first`.

    Axes are those of the odometry frame; theta is the error of that frame's heading. Closed
    form from prefix sums, O(1) per pair. Per step between: position p, variances q of heading and
    τ² ds of position. With S0 = Σq, S1 = Σq p, S2 = Σq p pᵀ, second pass c and J the rotation by
    90°: C_θθ = S0, C_xyθ = J (S0 c - S1), C_xy = Στ² ds I + J (S0 c cᵀ - S1 cᵀ - c S1ᵀ + S2) Jᵀ.
    """
    sums = _increase(reckoning.sums + reckoning.jumps, first, second)
    c = (reckoning.passes.centre - reckoning.origin)[second]
    s0, s1x, s1y, s2xx, s2xy, s2yy, along = sums.T
    x, y = c.T
    mxx = s0 * x * x - 2 * s1x * x + s2xx
    mxy = s0 * x * y - s1x * y - s1y * x + s2xy
    myy = s0 * y * y - 2 * s1y * y + s2yy
    covariance = np.zeros((len(sums), 3, 3))
    # J m Jᵀ with J = [[0, -1], [1, 0]].
    covariance[:, 0, 0] = along + myy
    covariance[:, 1, 1] = along + mxx
    covariance[:, 0, 1] = covariance[:, 1, 0] = -mxy
    covariance[:, 0, 2] = covariance[:, 2, 0] = -(s0 * y - s1y)
    covariance[:, 1, 2] = covariance[:, 2, 1] = s0 * x - s1x
    covariance[:, 2, 2] = s0
    return covariance


def _increase(sums: FloatArray, first: IntArray, second: IntArray) -> FloatArray:
    """(k, c) increase of prefix sums (p, c) between two passes (k,), given in either order."""
    low, high = np.minimum(first, second), np.maximum(first, second)
    return np.asarray(sums[high] - sums[low])
