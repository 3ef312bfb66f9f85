"""Uncertainty of the places of a closed run: samples of their joint error."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from ..arrays import FloatArray, IntArray
from ..posegraph.samples import SampledMarginals, of_unit_variance
from ..topomap import RunNoise
from ..vertex_errors import VertexErrors
from .dead_reckoning import DeadReckoning
from .estimate import Estimate
from .manhattan import GridHeadings


@dataclass(frozen=True, slots=True)
class CertaintySettings:
    """The number of samples, and the error of a centre that all passes share."""

    samples: int = 256
    """Standard error of a sigma: 1 / √(2 · 256) = 4 %, which costs its coverage a point or less."""
    least_shared: float = 0.5
    """Least share of the variance of a centre detected in scans that all passes have in common: .5
    to .8 in simulated cities, offices, tiles and organic streets, less in rows and mazes."""


CERTAINTY = CertaintySettings()


def place_errors(
    reckoning: DeadReckoning,
    estimate: Estimate,
    place: IntArray,
    kept: IntArray,
    grid: GridHeadings | None = None,
    *,
    shared_m: FloatArray | None = None,
) -> VertexErrors:
    """Errors of the places `kept` of an estimate, by the noise that it was optimised with.

    Sampled from the posterior of the pose graph, plus the errors that the graph does not contain:
    the detection error of places with a single pass, the scale error of the odometry, common to all
    lengths, and the error that all passes by a place have in common (shared_m: (p,) 1 sigma per
    axis [m]; None for none).
    """
    count = CERTAINTY.samples
    sampled = SampledMarginals.of(estimate.graph, estimate.solution.with_full_weights(), count)
    node = estimate.node[kept]
    error = sampled.error[node]
    error[:, 2] = _means(sampled.error[: len(reckoning), 2], place)[kept]
    rng = np.random.default_rng(20052)

    def drawn(*shape: int) -> FloatArray:
        """(*shape, count) independent normal errors of unit variance."""
        return of_unit_variance(rng.standard_normal((*shape, count)))

    single = node < len(reckoning)
    error[single, :2] += reckoning.noise.centre_m * drawn(int(single.sum()), 2)
    position = sampled.pose[node, :2]
    scale = reckoning.noise.scale * drawn()
    if len(kept):
        error[:, :2] += (position - position.mean(axis=0))[:, :, None] * scale
    if shared_m is not None:
        shared_error = _means(shared_m, place)[kept]
        error[:, :2] += shared_error[:, None, None] * drawn(len(kept), 2)
    own_share = np.zeros(len(kept))
    if grid is not None:
        # The grid determines the rotation at a pass from the mean of its branches, up to their
        # reading errors and the deviation of corridors from the grid.
        branches = np.maximum(reckoning.passes.branches.counts, 1)
        reading_variance = reckoning.noise.branch_rad**2 / np.mean(branches)
        own_share[:] = reading_variance / (reading_variance + grid.spread_rad**2)
    return VertexErrors(error, own_share)


def shared_centre_sigma(open_m: FloatArray, noise: RunNoise) -> FloatArray:
    """(p,) 1 sigma per axis [m] of the error that all passes by a place have in common.

    open_m: (p,) 1 sigma per axis [m] of the centre by the walls at each pass, which includes the
    scatter between passes.
    """
    least_m = np.sqrt(CERTAINTY.least_shared) * open_m
    return np.asarray(np.sqrt(np.maximum(open_m**2 - noise.centre_m**2, least_m**2)))


def _means(values: FloatArray, place: IntArray) -> FloatArray:
    """(n, …) mean over the passes by each place of values (p, …).

    Used for errors of the rotation: maps rotate branches by the mean rotation of their passes. The
    rotation of the place's node in the pose graph also contains the reading errors of the branches,
    which `branch_sigma` adds by itself.
    """
    row = np.flatnonzero(place >= 0)
    size = (int(place.max(initial=-1)) + 1, len(place))
    passes = np.bincount(place[row], minlength=size[0])[place[row]]
    mean = csr_array((1 / passes, (place[row], row)), shape=size)
    return np.asarray(mean @ values)
