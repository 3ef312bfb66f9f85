"""The lattice vectors by which a map repeats itself (perceptual aliasing).

Rows of crops, shelves or pillars put junctions on a lattice. One lattice vector away, another
junction is far more likely than by the mean density of junctions, and similar. The lattice is
estimated from pairs of places a few corridors apart, which are certainly different.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array, eye_array
from scipy.sparse.csgraph import connected_components

from ..arrays import FloatArray
from ..matching.likelihood import LIKELIHOOD
from .places import HOPS, NOWHERE, Places


@dataclass(frozen=True, slots=True)
class LatticeSettings:
    """How lattice vectors are found."""

    width_m: float = 0.3
    """1 sigma of the step from a place to the next one by a lattice vector [m]."""
    least_places: int = 20
    """Least number of places of a piece with a lattice, unless no piece is larger."""
    regular: float = 0.4
    """A shift is a lattice vector if it leads from at least this share of all places to another
    place."""


LATTICE = LatticeSettings()


@dataclass(frozen=True, slots=True, eq=False)
class Lattice:
    """The lattice vectors of a map, in its axes.

    steps: (r, 2) [m]; share: (r,) share of the places that have another place at that step.
    """

    steps: FloatArray
    share: FloatArray

    @property
    def repeats(self) -> bool:
        """Whether the map repeats itself."""
        return len(self.steps) > 0

    def density(self, shift: FloatArray, cov: FloatArray) -> FloatArray:
        """(k,) other junctions per m² at `shift` (k, 2) [m], known with covariance `cov` (k, 2, 2)
        [m²]."""
        return np.asarray(_gaussians(shift, self.steps, cov) @ self.share)


NO_LATTICE = Lattice(np.zeros((0, 2)), np.zeros(0))
"""The lattice of a map that does not repeat itself."""


def lattice_of(places: Places, xy: FloatArray, *, core_m: float, typical_m: float) -> Lattice:
    """The lattice of a map with places at `xy` (n, 2) [m]: steps that lead from many places to
    another place, a few corridors away.

    core_m: places nearer than this may be the same junction [m]; typical_m: typical distance
    between junctions [m]. Lattice vectors are searched separately in each piece of a broken
    odometry, because pieces may be rotated against each other.
    """
    n = len(places)
    source, slot = np.nonzero(places.next_place != NOWHERE)
    target = places.next_place[source, slot]
    step = csr_array((np.ones(len(source)), (source, target)), shape=(n, n)) + eye_array(n)
    step = ((step + step.T) > 0).astype(np.float64)
    reachable = step
    for _ in range(HOPS - 1):
        reachable = reachable @ step
    a, b = reachable.nonzero()
    shift = xy[b] - xy[a]
    distance_m = np.hypot(*shift.T)
    usable = (distance_m > core_m) & (distance_m < HOPS * typical_m)
    shift, a = shift[usable], a[usable]
    _, piece = connected_components(step, directed=False)
    size = np.bincount(piece)
    large_pieces = np.flatnonzero(size >= min(LATTICE.least_places, size.max(initial=0)))
    by_piece = [_steps(shift[piece[a] == k], int(size[k])) for k in large_pieces.tolist()]
    steps = np.concatenate([np.zeros((0, 2)), *(steps for steps, _ in by_piece)])
    share = np.concatenate([np.zeros(0), *(share for _, share in by_piece)])
    return Lattice(steps, share)


def _steps(shift: FloatArray, places: int) -> tuple[FloatArray, FloatArray]:
    """(r, 2) lattice vectors among the shifts (k, 2) [m] of so many places, and (r,) the share of
    the places that have each."""
    cell = 2 * LATTICE.width_m
    _, cell_of = np.unique(np.rint(shift / cell), axis=0, return_inverse=True)
    cell_of = cell_of.ravel()
    count = np.bincount(cell_of)
    # The shifts of one lattice vector fall into four cells at most, with some in those around.
    full_cells = np.flatnonzero(count > LATTICE.regular * places / 16)
    mean = np.stack(
        [np.bincount(cell_of, shift[:, k])[full_cells] / count[full_cells] for k in (0, 1)], axis=1
    )
    count = count[full_cells]
    # The means of adjacent cells are less than two cells apart.
    adjacent = np.abs(mean[:, None, :] - mean).max(axis=2) < 2 * cell
    total = adjacent @ count
    share = np.minimum(total / places, 1.0)
    # Adjacent cells hold the same lattice vector; the first of the fullest represents it.
    rank = np.empty(len(full_cells), np.int64)
    rank[np.argsort(-total, kind="stable")] = np.arange(len(full_cells))
    is_largest = (~adjacent | (rank[:, None] <= rank)).all(axis=1)
    chosen = np.flatnonzero((share > LATTICE.regular) & is_largest)
    return (adjacent @ (mean * count[:, None]))[chosen] / total[chosen, None], share[chosen]


def _gaussians(shift: FloatArray, centre: FloatArray, cov: FloatArray) -> FloatArray:
    """(k, m) density [1/m²] of each centre (m, 2) at each `shift` (k, 2): a Gaussian mixed with a
    wider one for outliers."""
    x, y = (shift[:, None, :] - centre).transpose(2, 0, 1)
    d2, det = squared_mahalanobis(x, y, cov[:, None])
    outlier_share, outlier_variance = LIKELIHOOD.outlier_share, LIKELIHOOD.outlier_width**2
    core = (1.0 - outlier_share) * np.exp(-0.5 * d2)
    tail = outlier_share / outlier_variance * np.exp(-0.5 / outlier_variance * d2)
    return np.asarray((core + tail) / (2 * np.pi * np.sqrt(det)))


def squared_mahalanobis(
    x: FloatArray, y: FloatArray, cov: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Squared Mahalanobis distances of (x, y) with covariances (..., 2, 2), broadcast; and their
    determinants, bounded below against rounding."""
    xx, xy, yy = cov[..., 0, 0], cov[..., 0, 1], cov[..., 1, 1]
    det = np.maximum(xx * yy - xy**2, np.finfo(np.float64).eps * xx * yy)
    return (yy * x * x - 2 * xy * x * y + xx * y * y) / det, det
