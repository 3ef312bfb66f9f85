"""How surely the runs of one component are placed against each other.

A run that only others place, along a chain of maps that bend, may lie metres off though every link
of the chain is right. The joint pose graph knows by how much: the covariance of its solution,
carried over to the rigid fit of each run's map.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array

from ...topology.posegraph.solve import Marginals, PoseGraph, Solution
from ..result import Spread
from .vertex_partition import Pool

VAGUE_M = 1.5
VAGUE_RAD = 0.087
"""Placements less sure than this (1 sigma) are no ground for a claim."""

CHUNK = 96
"""Columns solved for at once: memory stays with them and not with the square of the graph."""


def spread(pool: Pool, graph: PoseGraph, solution: Solution) -> Spread:
    """Errors of rigid fits to the solution of a joint pose graph over a pool.

    A rigid fit is linear in small shifts of its points, so its covariance is G H⁻¹ Gᵀ with H the
    normal matrix and three rows of G for each run. Cost: three pairs of triangular solves per run.
    """
    marginals = Marginals.of(graph, solution.with_full_weights())
    pattern = marginals.factor.pattern
    count = len(pool.maps)
    size = np.maximum(np.bincount(pool.run, minlength=count), 1)
    xy = solution.pose[:, :2]
    middle = np.stack([np.bincount(pool.run, xy[:, k], count) / size for k in (0, 1)], axis=-1)
    arm = xy - middle[pool.run]
    reach = np.bincount(pool.run, (arm**2).sum(axis=1), count)[pool.run]
    lone = reach < 1e-6  # a single place is turned by its own heading alone
    lever = arm / np.where(lone, 1.0, reach)[:, None]
    share, zero = 1 / size[pool.run], np.zeros(len(xy))
    # (row, component of the fit, component of the pose): the derivative.
    weight = np.array(
        [
            [share, zero, zero],
            [zero, share, zero],
            [np.where(lone, zero, -lever[:, 1]), np.where(lone, zero, lever[:, 0]), lone * share],
        ]
    ).transpose(2, 0, 1)
    column = np.broadcast_to(pattern.variable[:, None, :], weight.shape)
    row = np.broadcast_to((3 * pool.run)[:, None, None] + np.arange(3)[:, None], weight.shape)
    used = (column >= 0) & (weight != 0)
    fit = csr_array((weight[used], (row[used], column[used])), shape=(3 * count, pattern.size))
    covariance = np.zeros((3 * count, 3 * count))
    for start in range(0, 3 * count, CHUNK):
        some = slice(start, start + CHUNK)
        covariance[:, some] = fit @ marginals.through(fit[some].toarray().T)
    names = tuple(m.run for m in pool.maps)
    return Spread(names, middle, (covariance + covariance.T) / 2)
