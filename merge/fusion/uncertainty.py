"""How surely the runs of one component are placed against each other.

A run that only others place, along a chain of maps that bend, may lie metres off though every link
of the chain is right. The joint pose graph knows by how much: the covariance of its solution,
carried over to the rigid fit of each run's map.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from ...topology.posegraph.samples import SampledMarginals, white
from ...topology.posegraph.solve import Marginals, PoseGraph, Solution
from ...topology.vertex_errors import VertexErrors
from ..result import Spread
from .joint_graph import pass_counts
from .vertex_partition import Pool

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

VAGUE_M = 1.5
VAGUE_RAD = 0.087
"""Placements less sure than this (1 sigma) are no ground for a claim."""

CHUNK = 32
"""Runs whose columns are solved for at once: memory stays with them, and not with the square of the
graph or of the runs."""

SAMPLES = 64
"""They tell a sigma to 1 / √(2 · 64) = 9 %, which takes some points from its coverage."""
MOST_ROWS = 10_000
"""Samples of so many vertices take some 200 MB."""


def place_sigmas(
    pool: Pool, label: IntArray, graph: PoseGraph, solution: Solution
) -> FloatArray | None:
    """(places,) 1 sigma [m] of each coordinate, with the component laid rigidly over the truth.

    label: (n,) the place of each row of the pool. A place is where its rows lie in the mean,
    weighted by passes; each row is off by the joint solution, and by how its centre was seen.
    None for components of more than MOST_ROWS rows.
    """
    count, rows = int(label.max()) + 1, len(pool)
    if rows > MOST_ROWS:
        return None
    passes = pass_counts(pool).astype(np.float64)
    share = passes / np.bincount(label, passes)[label]
    gather = csr_array((share, (label, np.arange(rows))), shape=(count, rows))
    sampled = SampledMarginals.of(graph, solution.with_full_weights(), SAMPLES).error[:, :2]
    centre = np.array([m.measured.centre_m for m in pool.maps])[pool.run] / np.sqrt(passes)
    (noise,) = white(20053, [sampled.shape])
    off = np.asarray(gather @ (sampled + centre[:, None, None] * noise).reshape(rows, -1))
    error = np.zeros((count, 3, SAMPLES))
    error[:, :2] = off.reshape(count, 2, SAMPLES)
    xy = np.asarray(gather @ solution.pose[:, :2])
    return VertexErrors(error).as_a_whole(xy, np.zeros(count, np.int64)).position_sigma()


def spread(pool: Pool, graph: PoseGraph, solution: Solution, key: IntArray) -> Spread:
    """Errors of rigid fits to the solution of a joint pose graph over a pool; key: as in `Spread`.

    A rigid fit is linear in small shifts of its points, so its covariance is G H⁻¹ Gᵀ with H the
    normal matrix and three rows of G for each run. Cost: three pairs of triangular solves per run;
    what is held is the blocks that are asked for, and some columns at a time.
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
    first, second = np.divmod(key, count)
    own, above, below = np.zeros((count, 3, 3)), *np.zeros((2, len(key), 3, 3))
    for start in range(0, count, CHUNK):
        some = slice(3 * start, 3 * (start + CHUNK))
        columns = fit @ marginals.through(fit[some].toarray().T)
        block = columns.reshape(count, 3, -1, 3).transpose(0, 2, 1, 3)  # (run, run of these)
        here = np.arange(block.shape[1])
        own[start + here] = block[start + here, here]
        for blocks, row, column in ((above, first, second), (below, second, first)):
            rows = np.flatnonzero((column >= start) & (column < start + CHUNK))
            blocks[rows] = block[row[rows], column[rows] - start]
    names = tuple(m.run for m in pool.maps)
    return Spread(names, middle, _symmetric(own, own), key, _symmetric(above, below))


def _symmetric(one: FloatArray, other: FloatArray) -> FloatArray:
    """Blocks of a matrix that is symmetric but for rounding; other: those across its diagonal."""
    return np.asarray((one + other.transpose(0, 2, 1)) / 2, np.float64)
