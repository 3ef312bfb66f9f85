"""How sure the places of a laid out walk are, as samples of all their errors together."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..posegraph_samples import SampledMarginals
from ..vertex_errors import VertexErrors
from .layout import Layout, lay_out
from .rectilinear import GridHeadings
from .walk import Walk, louder

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

SAMPLES = 256
"""They tell a sigma to 1 / √(2 · 256) = 4 %, which takes a point or less from its coverage."""


PRIOR_FREEDOM = 8
"""A run tells its sigmas to a quarter before closure: as a χ² of so many degrees of freedom."""


def laid_out_fairly(
    walk: Walk, place: IntArray, layout: Layout, grid: GridHeadings | None = None
) -> tuple[Walk, Layout]:
    """The walk with its most likely noise, and its layout by that.

    walk: with the noise that the run showed before closure; layout: one of the places, to begin
    with. The squared errors of the layout, per degree of freedom, scale all variances.
    """
    layout = lay_out(walk, place, layout.pose, grid=grid)
    told = PRIOR_FREEDOM + layout.misfit * layout.freedom
    walk = louder(walk, float(np.sqrt(told / (PRIOR_FREEDOM + layout.freedom))))
    return walk, lay_out(walk, place, layout.pose, grid=grid)


def place_errors(walk: Walk, layout: Layout, kept: IntArray) -> VertexErrors:
    """Errors of the places `kept` of a layout, by the noise that the walk was laid out with.

    The pose graph holds all but two: a place of one pass is as far off as its detection, and all
    lengths share the odometry's error of scale.
    """
    sampled = SampledMarginals.of(layout.graph, layout.solution, SAMPLES)
    node = layout.node[kept]
    error = sampled.error[node]
    rng = np.random.default_rng(20052)
    alone = node < len(walk)
    error[alone, :2] += walk.noise.centre_m * rng.standard_normal((int(alone.sum()), 2, SAMPLES))
    position = sampled.pose[node, :2]
    scale = walk.noise.scale * rng.standard_normal(SAMPLES)
    error[:, :2] += (position - position.mean(axis=0))[:, :, None] * scale
    return VertexErrors(error)
