"""Maps with the lengths that passes by their junctions show.

Runs are matched as their odometries measured them, since robots of one kind err alike; what joins
them is drawn as it is.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...topology.corridor_lengths import LEAST_M
from ...topology.topomap import TopoMap


def at_shown_scale(topomap: TopoMap) -> TopoMap:
    """A map whose lengths are corrected by its `length_scale`, about the middle of its vertices, so
    that a rigid fit to it is one to the map as it was; its sigmas hold what is left of the scale's
    error."""
    scale = topomap.length_scale
    if scale is None or len(topomap) == 0:
        return topomap
    factor, middle = 1 - scale.too_long, topomap.xy.mean(axis=0)
    arm = topomap.xy - middle
    stated = topomap.measured.scale
    known = stated**2 - scale.sigma**2
    position = topomap.position_sigma
    if position is not None:
        least = topomap.centre_variance
        position = factor * np.sqrt(
            np.maximum(
                position**2 - known * (arm**2).sum(axis=1) / 2, np.minimum(position**2, least)
            )
        )
    left = topomap.length_sigma**2 - known * topomap.length**2
    return replace(
        topomap,
        xy=middle + factor * arm,
        length=factor * topomap.length,
        length_sigma=factor * np.sqrt(np.maximum(left, LEAST_M**2)),
        paths=tuple(middle + factor * (path - middle) for path in topomap.paths),
        position_sigma=position,
        fitted_noise=replace(topomap.measured, scale=scale.sigma),
    )
