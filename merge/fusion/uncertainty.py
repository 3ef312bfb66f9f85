"""Errors of one component's fused map, and of its runs' placements, from samples.

A run that is placed along a chain of maps may be metres off although every match is correct, since
each map bends. Samples of the joint pose graph's solution give the errors of places, of corridors
and of the rigid fit of each run's map.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_array

from ...topology.arrays import FloatArray, IntArray
from ...topology.corridor_lengths import LEAST_M, straightness
from ...topology.posegraph.graph import PoseGraph, SharedErrors, Solution
from ...topology.posegraph.samples import SampledMarginals, of_unit_variance, white
from ...topology.vertex_errors import VertexErrors
from ..result import Spread
from .edges import Corridor
from .joint_graph import centre_sigma, shared_sigma, usual_scale
from .vertex_partition import Pool

VAGUE_M = 1.5
VAGUE_RAD = 0.087
"""Placements with a larger standard deviation than these are reported as vague."""

SAMPLES, LEAST_SAMPLES = 256, 16
"""Number of samples: a standard deviation estimated from 256 has an error of 4 %."""
MOST_ROWS = 2_500
"""Number of vertices from which on there are fewer samples: with so many they take 200 MB."""


@dataclass(frozen=True, slots=True, eq=False)
class Landmarks:
    """The joint graph with an additional node for every place of several rows.

    A row of the pool is a junction's centre as seen by one map, with an error of its own. A
    measurement between two rows has the errors of both, which are correlated with other
    measurements of the same rows. So each row measures the node of its place instead.

    node: (n,) node of each row: that of its place, or its own; seen: (n,) error per axis of the
    row's centre [m], 0 for rows of places of several rows; shared: (n,) error common to all passes
    of a row [m]. Maps that share a place have the same common error there: it moves the place but
    does not separate the maps.
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
        between_runs, within_run = np.flatnonzero(across), np.flatnonzero(~across)
        rows = np.flatnonzero(np.bincount(label)[label] > 1)
        first, place = np.unique(label[rows], return_index=True, return_inverse=True)[1:]
        node = np.arange(n)
        node[rows] = n + place
        sigma = centre_sigma(pool)
        # Each end of a measurement between rows gets half of the variance of its rotation.
        weight, turn = np.ones(n), np.zeros(n)
        weight[graph.target[between_runs]] = solution.edge_weight[between_runs]
        np.maximum.at(turn, graph.source[between_runs], 2 * graph.information[between_runs, 2, 2])
        turn[graph.target[between_runs]] = 2 * graph.information[between_runs, 2, 2]
        row_information = np.zeros((len(rows), 3, 3))
        row_information[:, 0, 0] = row_information[:, 1, 1] = sigma[rows] ** -2.0
        row_information[:, 2, 2] = turn[rows]
        shared = graph.shared
        no_sensitivity = np.zeros((len(rows), 3, len(shared)))
        pose = np.concatenate([solution.pose, solution.pose[rows[first]]])
        extended = PoseGraph(
            pose=pose,
            source=np.concatenate([graph.source[within_run], rows]),
            target=np.concatenate([graph.target[within_run], node[rows]]),
            measurement=np.concatenate([graph.measurement[within_run], np.zeros((len(rows), 3))]),
            information=np.concatenate([graph.information[within_run], row_information]),
            priors=graph.priors,
            shared=SharedErrors(
                np.concatenate([shared.sensitivity[within_run], no_sensitivity]), shared.sigma
            ),
        )
        edge_weight = np.concatenate([solution.edge_weight[within_run], weight[rows]])
        solved = replace(solution, pose=pose, edge_weight=edge_weight)
        row_error = np.where(node < n, sigma, 0.0)
        return cls(extended, solved, node, row_error, shared_sigma(pool))

    @property
    def alone(self) -> FloatArray:
        """(n,) error per axis of the centre of each row that no other map saw, else 0 [m]."""
        return np.where(self.seen > 0, np.hypot(self.seen, self.shared), 0.0)


def fused_sigmas(
    pool: Pool, label: IntArray, graph: PoseGraph, solution: Solution, corridors: Sequence[Corridor]
) -> tuple[FloatArray, FloatArray, Spread]:
    """Standard deviations of the places' coordinates (p,) [m], after a rigid fit of the component
    to the truth, and of the corridors' lengths (c,) [m]; and the errors of the runs' placements.

    label: (n,) the place of each row of the pool; graph, solution: its joint pose graph. One
    factorisation and a pair of triangular solves per sample.
    """
    landmarks = Landmarks.of(pool, label, graph, solution)
    count = max(SAMPLES * MOST_ROWS // max(len(pool), MOST_ROWS), LEAST_SAMPLES)
    sampled = SampledMarginals.of(landmarks.graph, landmarks.solution, count)
    first = np.unique(label, return_index=True)[1]
    xy, whole = landmarks.solution.pose[landmarks.node[first], :2], np.zeros(len(first), np.int64)
    places = _place_errors(landmarks, first, sampled)
    sigma = places.as_a_whole(xy, whole).position_sigma()
    lengths = _length_sigmas(places, sampled, xy, pool, corridors)
    return sigma, lengths, _run_errors(pool, landmarks, sampled.error)


def _place_errors(landmarks: Landmarks, first: IntArray, sampled: SampledMarginals) -> VertexErrors:
    """Sampled errors of places, each with the row (p,) that is the first of it."""
    error = sampled.error[landmarks.node[first]]
    (noise,) = white(20053, [(len(first), 2, error.shape[2])])
    sigma = np.hypot(landmarks.seen, landmarks.shared)[first]
    error[:, :2] += sigma[:, None, None] * of_unit_variance(noise)
    error[:, 2] = 0.0
    return VertexErrors(error)


def _length_sigmas(
    places: VertexErrors,
    sampled: SampledMarginals,
    xy: FloatArray,
    pool: Pool,
    corridors: Sequence[Corridor],
) -> FloatArray:
    """(c,) standard deviations of the lengths of corridors between places at xy (p, 2) [m].

    The paths of all runs end at the same places: a length has the error of their distance times the
    chord's share of the length, for any runs. The rest of the length has the scale errors of the
    runs that drove it, and their other errors (`Corridor.way`), which bends of the path exaggerate:
    all together are at most the sigma of the runs' maps (`sigma`).

    The scales of more runs than they are estimated for are sampled independently.
    """
    ends = np.array([(c.u, c.v) for c in corridors], np.int64).reshape(-1, 2).T
    columns = [(c.length, c.way, c.sigma) for c in corridors]
    length, other, stated = np.array(columns, np.float64).reshape(-1, 3).T
    _, straight = straightness(xy, ends[0], ends[1], length)
    rest = (1 - straight**2) * length
    scale = sampled.shared
    if not len(scale):
        (noise,) = white(20054, [(len(pool.maps), sampled.error.shape[2])])
        scale, rest = usual_scale(pool.maps) * of_unit_variance(noise), length
    number = {m.run: k for k, m in enumerate(pool.maps)}
    drivers = [sorted({number[run] for run, _ in c.members}) for c in corridors]
    mean = np.array([scale[runs].mean(axis=0) for runs in drivers]).reshape(-1, scale.shape[1])
    error = straight[:, None] * places.distance_errors(xy, *ends) + rest[:, None] * mean
    variance = np.minimum(np.mean(error**2, axis=1) + other**2 + LEAST_M**2, stated**2)
    return np.asarray(np.sqrt(variance))


def _run_errors(pool: Pool, landmarks: Landmarks, error: FloatArray) -> Spread:
    """Sampled errors of the placements of a pool's maps. A placement is the rigid fit of a map to
    its true positions, linear in small shifts. error: (…, 3, s), of the joint graph's nodes."""
    n, count = len(pool), len(pool.maps)
    of_run = csr_array((np.ones(n), (pool.run, np.arange(n))), shape=(count, n))
    size = np.maximum(np.bincount(pool.run, minlength=count), 1)[:, None]
    xy = landmarks.solution.pose[:n, :2]
    centroid = (of_run @ xy) / size
    lever = xy - centroid[pool.run]
    inertia = (of_run @ (lever**2).sum(axis=1))[:, None]
    (noise,) = white(20055, [(n, 2, error.shape[2])])
    moved = error[landmarks.node, :2] + landmarks.alone[:, None, None] * of_unit_variance(noise)
    torque = lever[:, :1] * moved[:, 1] - lever[:, 1:] * moved[:, 0]
    is_single = inertia < 1e-6  # the rotation of a single place is that of its pose
    heading = (of_run @ error[:n, 2]) / size
    turn = np.where(is_single, heading, (of_run @ torque) / np.where(is_single, 1.0, inertia))
    shift = [(of_run @ moved[:, k]) / size for k in (0, 1)]
    return Spread(tuple(m.run for m in pool.maps), centroid, np.stack([*shift, turn], axis=1))
