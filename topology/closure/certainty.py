"""How sure the places of a closed estimate are: samples of all their errors together."""

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
    """How well errors are told."""

    samples: int = 256
    """They tell a sigma to 1 / √(2 · 256) = 4 %, which takes a point or less from its coverage."""
    least_shared: float = 0.5
    """Of the variance of a centre that scans show, so much at least all passes have alike: .5 to .8
    in simulated cities, offices, tiles and organic streets, less in rows and mazes."""


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

    Sampled from the posterior of the pose graph, with the errors that the graph does not hold: a
    place with a single pass is off by the error of its detection, all lengths share the error of
    the odometry's scale, and all passes of a place what they see alike (shared_m: of each pass,
    1 sigma per axis [m]; None for nothing).
    """
    count = CERTAINTY.samples
    sampled = SampledMarginals.of(estimate.graph, estimate.solution.with_full_weights(), count)
    node = estimate.node[kept]
    error = sampled.error[node]
    error[:, 2] = _means(sampled.error[: len(reckoning), 2], place)[kept]
    rng = np.random.default_rng(20052)

    def drawn(*shape: int) -> FloatArray:
        return of_unit_variance(rng.standard_normal((*shape, count)))

    alone = node < len(reckoning)
    error[alone, :2] += reckoning.noise.centre_m * drawn(int(alone.sum()), 2)
    position = sampled.pose[node, :2]
    scale = reckoning.noise.scale * drawn()
    if len(kept):
        error[:, :2] += (position - position.mean(axis=0))[:, :, None] * scale
    if shared_m is not None:
        alike = _means(shared_m, place)[kept]
        error[:, :2] += alike[:, None, None] * drawn(len(kept), 2)
    own = np.zeros(len(kept))
    if grid is not None:
        # The grid tells a pass its turn by the mean of its branches, to how well these were read
        # and how well corridors keep to the grid.
        branches = np.maximum(reckoning.passes.branches.counts, 1)
        read = reckoning.noise.branch_rad**2 / np.mean(branches)
        own[:] = read / (read + grid.spread_rad**2)
    return VertexErrors(error, own)


def seen_alike(open_m: FloatArray, noise: RunNoise) -> FloatArray:
    """(p,) 1 sigma per axis [m] of what all passes of a place see alike: of all that the walls
    leave open at each pass, open_m (p,), without what passes differ by."""
    least = np.sqrt(CERTAINTY.least_shared) * open_m
    return np.asarray(np.sqrt(np.maximum(open_m**2 - noise.centre_m**2, least**2)))


def _means(values: FloatArray, place: IntArray) -> FloatArray:
    """(n, …) mean over the passes by each place of their values (p, …).

    Of errors of turns: branches are drawn as every pass is turned. The place's own node in the pose
    graph is turned as they were read, too, which `branch_sigma` counts for itself.
    """
    row = np.flatnonzero(place >= 0)
    size = (int(place.max(initial=-1)) + 1, len(place))
    passes = np.bincount(place[row], minlength=size[0])[place[row]]
    mean = csr_array((1 / passes, (place[row], row)), shape=size)
    return np.asarray(mean @ values)
