"""Does a map of right angles bend on its way? Streets may meet at right angles and still turn."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .dead_reckoning import Walk
from .estimate import Layout
from .manhattan import OWN_SPREAD_RAD, from_quarter

IntArray = NDArray[np.int64]

_PAIRS = 400
_CLIP = 9.0
"""A pair counts no more than this: a place may hold a false branch."""


def bend(walk: Walk, place: IntArray, layout: Layout) -> float:
    """Mean squared turn of the grid between two places, in units of its variance; 0 if unknown.

    layout: of a closure that did not use the grid. In a rectilinear building the branches of all
    places point the same ways up to quarter turns and to the errors of the layout, about 1 here.
    """
    branches, n = walk.passes.branches, len(layout.xy)
    owner = branches.owner
    angle = 4 * (branches.values + layout.pose[owner, 2])
    at = place[owner]
    z = np.bincount(at, np.cos(angle), n) + 1j * np.bincount(at, np.sin(angle), n)
    count = np.bincount(at, minlength=n)
    clear = np.flatnonzero(np.abs(z) > 0.5 * np.maximum(count, 1))
    if len(clear) < 2:
        return 0.0
    a, b = np.random.default_rng(0).choice(clear, (2, _PAIRS))
    chain = np.zeros(n, np.int64)
    chain[place] = walk.chain
    known = (a != b) & (chain[a] == chain[b])
    a, b = a[known], b[known]
    if len(a) == 0:
        return 0.0
    turn = from_quarter(np.angle(z[a]) / 4 - np.angle(z[b]) / 4)
    variance = layout.relative_covariance(layout.node[a], layout.node[b])[:, 2, 2]
    variance += walk.noise.branch_rad**2 * (1 / count[a] + 1 / count[b]) + 2 * OWN_SPREAD_RAD**2
    return float(np.minimum(turn**2 / variance, _CLIP).mean())
