"""Covariances of the runs' placements in one component.

A run that is placed along a chain of maps may be metres off though every link is correct, since
each map bends. The covariance of the joint pose graph's solution gives the covariance of the rigid
fit of each run's map.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_array

from ...topology.arrays import FloatArray, IntArray
from ...topology.corridor_lengths import LEAST_M, straightness
from ...topology.posegraph.graph import PoseGraph, SharedErrors
from ...topology.posegraph.marginals import Marginals
from ...topology.posegraph.samples import SampledMarginals, of_unit_variance, white
from ...topology.posegraph.solve import Solution
from ...topology.vertex_errors import VertexErrors
from ..result import Spread
from .edges import Corridor
from .joint_graph import centre_sigma, shared_sigma, usual_scale
from .vertex_partition import Pool

VAGUE_M = 1.5
VAGUE_RAD = 0.087
"""Placements with a larger standard deviation than these are reported as vague."""

CHUNK = 32
"""Runs whose columns are solved at once, which limits memory."""

SAMPLES = 64
"""Number of samples: a standard deviation estimated from them has an error of 1 / √(2 · 64) = 9
%."""
MOST_ROWS = 10_000
"""Limit on vertices for sampling, about 200 MB."""


@dataclass(frozen=True, slots=True, eq=False)
class Landmarks:
    """The joint graph with a node of its own for every place of several rows.

    A row of the pool is a junction's centre as seen by one map, with an error `seen` (n,) per axis
    [m]; a measurement between two rows has the errors of both, which are correlated with other
    measurements of the same rows. Here each row measures the node of its place instead.

    node: (n,) node of each row: that of its place, or its own; seen: 0 for rows of places of
    several rows; shared: (n,) error common to all passes of a row [m]. Maps that share a place have
    the same common error there: it moves the place but does not separate the maps.
    """

    graph: PoseGraph
    solution: Solution
    node: IntArray
    seen: FloatArray
    shared: FloatArray

    @classmethod
    def of(cls, pool: Pool, label: IntArray, graph: PoseGraph, solution: Solution) -> Landmarks:
        """label: (n,) the place of each row of the pool; graph, solution: its joint pose graph."""
        solution, n = solution.with_full_weights(), len(pool)
        across = pool.run[graph.source] != pool.run[graph.target]
        ties, own = np.flatnonzero(across), np.flatnonzero(~across)
        rows = np.flatnonzero(np.bincount(label)[label] > 1)
        first, place = np.unique(label[rows], return_index=True, return_inverse=True)[1:]
        node = np.arange(n)
        node[rows] = n + place
        sigma = centre_sigma(pool)
        # Each end of a measurement between rows gets half of the variance of its rotation.
        weight, turn = np.ones(n), np.zeros(n)
        weight[graph.target[ties]] = solution.edge_weight[ties]
        np.maximum.at(turn, graph.source[ties], 2 * graph.information[ties, 2, 2])
        turn[graph.target[ties]] = 2 * graph.information[ties, 2, 2]
        seen = np.zeros((len(rows), 3, 3))
        seen[:, 0, 0] = seen[:, 1, 1] = sigma[rows] ** -2.0
        seen[:, 2, 2] = turn[rows]
        shared = graph.shared
        nothing = np.zeros((len(rows), 3, len(shared)))
        pose = np.concatenate([solution.pose, solution.pose[rows[first]]])
        extended = PoseGraph(
            pose=pose,
            source=np.concatenate([graph.source[own], rows]),
            target=np.concatenate([graph.target[own], node[rows]]),
            measurement=np.concatenate([graph.measurement[own], np.zeros((len(rows), 3))]),
            information=np.concatenate([graph.information[own], seen]),
            priors=graph.priors,
            shared=SharedErrors(np.concatenate([shared.sensitivity[own], nothing]), shared.sigma),
        )
        edge_weight = np.concatenate([solution.edge_weight[own], weight[rows]])
        at = replace(solution, pose=pose, edge_weight=edge_weight)
        alone = np.where(node < n, sigma, 0.0)
        return cls(extended, at, node, alone, shared_sigma(pool))

    @property
    def alone(self) -> FloatArray:
        """(n,) error per axis of the centre of each row that no other map saw, else 0 [m]."""
        return np.where(self.seen > 0, np.hypot(self.seen, self.shared), 0.0)


def fused_sigmas(
    pool: Pool,
    label: IntArray,
    graph: PoseGraph,
    solution: Solution,
    corridors: Sequence[Corridor],
) -> tuple[FloatArray, FloatArray] | None:
    """Standard deviations of the places' coordinates (p,) [m], after a rigid fit of the component
    to the truth, and of the corridors' lengths (c,) [m].

    label: (n,) the place of each row of the pool. None for components of more than MOST_ROWS rows.
    """
    if len(pool) > MOST_ROWS:
        return None
    marks = Landmarks.of(pool, label, graph, solution)
    first = np.unique(label, return_index=True)[1]
    xy, whole = marks.solution.pose[marks.node[first], :2], np.zeros(len(first), np.int64)
    errors = _place_errors(marks, first, SampledMarginals.of(marks.graph, marks.solution, SAMPLES))
    sigma = errors.as_a_whole(xy, whole).position_sigma()
    return sigma, _length_sigmas(marks, first, xy, pool, corridors)


def _place_errors(marks: Landmarks, first: IntArray, sampled: SampledMarginals) -> VertexErrors:
    """Sampled errors of places, each with the row (p,) that is the first of it."""
    error = sampled.error[marks.node[first]]
    (noise,) = white(20053, [(len(first), 2, SAMPLES)])
    off = np.hypot(marks.seen, marks.shared)[first]
    error[:, :2] += off[:, None, None] * of_unit_variance(noise)
    error[:, 2] = 0.0
    return VertexErrors(error)


def _length_sigmas(
    marks: Landmarks, first: IntArray, xy: FloatArray, pool: Pool, corridors: Sequence[Corridor]
) -> FloatArray:
    """(c,) standard deviations of the lengths of corridors between places at xy (p, 2) [m].

    The paths of all runs end at the same places: a length has the error of their distance times the
    chord's share of the length, whichever runs drove there. The rest of the length has the scale
    errors of the runs that drove it, and their other errors (`Corridor.way`), which a path's bends
    make larger than they are: together they are at most what the runs' maps state (`sigma`).

    The scales of more runs than they are estimated for are drawn independently.
    """
    ends = np.array([(c.u, c.v) for c in corridors], np.int64).reshape(-1, 2).T
    columns = [(c.length, c.way, c.sigma) for c in corridors]
    length, way, own = np.array(columns, np.float64).reshape(-1, 3).T
    sampled = SampledMarginals.of(marks.graph, marks.solution, SAMPLES)
    _, straight = straightness(xy, ends[0], ends[1], length)
    rest = (1 - straight**2) * length
    scale = sampled.shared
    if not len(scale):
        (drawn,) = white(20054, [(len(pool.maps), SAMPLES)])
        scale, rest = usual_scale(pool.maps) * of_unit_variance(drawn), length
    number = {m.run: k for k, m in enumerate(pool.maps)}
    drivers = [sorted({number[run] for run, _ in c.members}) for c in corridors]
    mean = np.array([scale[runs].mean(axis=0) for runs in drivers]).reshape(-1, SAMPLES)
    places = _place_errors(marks, first, sampled)
    off = straight[:, None] * places.distance_errors(xy, *ends) + rest[:, None] * mean
    variance = np.minimum(np.mean(off**2, axis=1) + way**2 + LEAST_M**2, own**2)
    return np.asarray(np.sqrt(variance))


def spread(
    pool: Pool, label: IntArray, graph: PoseGraph, solution: Solution, key: IntArray
) -> Spread:
    """Covariances of the rigid fits of the truth to the maps of a pool, from its joint pose graph.

    label: (n,) the place of each row; key: as in `Spread`. A rigid fit is linear in small shifts of
    its points, so that its covariance is G H⁻¹ Gᵀ, with H the normal matrix and three rows of G for
    each run, plus the errors of places that one map alone saw. Cost: three pairs of triangular
    solves per run; memory: the blocks asked for, and CHUNK runs' columns.
    """
    marks = Landmarks.of(pool, label, graph, solution)
    marginals = Marginals.of(marks.graph, marks.solution)
    pattern = marginals.factor.pattern
    count = len(pool.maps)
    size = np.maximum(np.bincount(pool.run, minlength=count), 1)
    xy = solution.pose[:, :2]
    middle = np.stack([np.bincount(pool.run, xy[:, k], count) / size for k in (0, 1)], axis=-1)
    arm = xy - middle[pool.run]
    reach = np.bincount(pool.run, (arm**2).sum(axis=1), count)[pool.run]
    lone = reach < 1e-6  # the rotation of a single place is that of its pose
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
    variable = pattern.variable[: len(pool)].copy()
    variable[:, :2] = pattern.variable[marks.node, :2]
    column = np.broadcast_to(variable[:, None, :], weight.shape)
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
    seen = weight[:, :, :2] * marks.alone[:, None, None]
    np.add.at(own, pool.run, seen @ seen.transpose(0, 2, 1))
    names = tuple(m.run for m in pool.maps)
    return Spread(names, middle, _symmetric(own, own), key, _symmetric(above, below))


def _symmetric(one: FloatArray, other: FloatArray) -> FloatArray:
    """Blocks of a matrix, made exactly symmetric; other: those across its diagonal."""
    return np.asarray((one + other.transpose(0, 2, 1)) / 2, np.float64)
