"""The joint pose graph of all runs of a component, which gives the positions of all vertices.

Every vertex of every run is a pose: its position, and the rotation of the run's map there in the
component's frame. Corridors are relative measurements within a run, with covariances from the run's
noise and one common scale error. Measurements between runs connect the vertices of one place.
"""

from __future__ import annotations

import heapq
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...topology.arrays import FloatArray, IntArray
from ...topology.columns import joined
from ...topology.connected import connected
from ...topology.map_pose_graph import map_pose_graph, odometry_measurements
from ...topology.matching.branches import mutual_nearest, unit_headings
from ...topology.matching.likelihood import LIKELIHOOD
from ...topology.matching.structure import STRUCTURE, grid_direction, padded_branches
from ...topology.posegraph.graph import (
    NO_MEASUREMENTS,
    Measurements,
    PoseGraph,
    Priors,
    SharedErrors,
    Solution,
)
from ...topology.posegraph.samples import SampledMarginals
from ...topology.posegraph.solve import SolverSettings, solve
from ...topology.se2 import apply, compose, fit_rigid, inverse, wrap
from ...topology.topomap import TopoMap
from ...topology.vertex_errors import VertexErrors
from ..result import PairVerdict
from .vertex_partition import Pool


@dataclass(frozen=True, slots=True)
class JointSettings:
    """Standard deviations that maps do not state. Measurements between runs have Cauchy kernels as
    wide as `LIKELIHOOD.gate_sigmas`, which limit the influence of false ones."""

    min_position_m: float = 0.01
    """Lower bound of the uncertainty of a junction's centre between two maps."""
    min_heading_rad: float = 0.01
    """Lower bound of the uncertainty of a rotation between two maps, by branches of one junction,
    and of that of corridors about the grid."""
    bridge_m: float = 1.0
    """Standard deviation of the relative position of parts of one map that no corridor connects."""
    bridge_rad: float = 0.1
    """Standard deviation of the relative heading of such parts."""
    scaled_runs: int = 24
    """Largest number of runs whose scales are estimated: memory and time grow with its square."""
    min_scale: float = 1e-6
    """Lower bound of the scale's standard deviation, 0.1 mm in 100 m, which keeps information
    finite; runs without odometry errors state 2e-5 to 1e-4."""
    grid_rad: float = 0.035
    """Prior standard deviation of corridors about the grid of a rectilinear building."""
    grid_junctions: float = 20.0
    """Weight of this prior, as a number of junctions."""


JOINT = JointSettings()

_SAMPLES = 64
"""Number of samples of the vertices' errors; their mean square has an error of a few per cent."""

_LEAST_BEND = 0.03
"""Lower bound of the share of a map's stated variances that is due to bending (sampled)."""

_STIFF = 1.1
"""Factor on the variances of a map without a grid. Variances stated by maps, propagated through the
joint graph, are this share of its own variance across and of turns: 1.09 and 1.14 at high drift
(`benchmarks/transforms.py --worlds organic city`)."""

SOLVER = SolverSettings(relative_tolerance=1e-5, max_iterations=25)
"""Cauchy kernels converge slowly; the remaining error is far below a millimetre."""


@dataclass(frozen=True, slots=True, eq=False)
class Joint:
    """pose: (n, 3) of all rows of a pool in the component's frame (position, and rotation of the
    run's map there); graph, solution: in another frame; None if no place connects two runs."""

    pose: FloatArray
    graph: PoseGraph | None
    solution: Solution | None


def run_poses(runs: Sequence[str], verdicts: Sequence[PairVerdict]) -> dict[str, FloatArray]:
    """Initial T_component_run of every run, along a maximum spanning tree by evidence.

    The frame is that of the first run; runs that are not connected to it are left out.
    """
    links_of: dict[str, list[tuple[float, str, str, FloatArray]]] = {}
    for v in verdicts:
        if v.accepted and v.best is not None:
            link = (-v.evidence_bits, v.a, v.b, v.best.transform)
            links_of.setdefault(v.a, []).append(link)
            links_of.setdefault(v.b, []).append(link)
    start = runs[0]
    poses, frontier = {start: np.zeros(3)}, list(links_of.get(start, ()))
    heapq.heapify(frontier)
    while frontier:  # Prim's algorithm: the strongest verdict that reaches a new run
        _, a, b, T_a_b = heapq.heappop(frontier)
        if a in poses and b in poses:
            continue
        new = b if a in poses else a
        poses[new] = compose(poses[a], T_a_b) if new == b else compose(poses[b], inverse(T_a_b))
        for link in links_of[new]:
            if link[1] not in poses or link[2] not in poses:
                heapq.heappush(frontier, link)
    return poses


def optimise_poses(
    pool: Pool,
    label: IntArray,
    start: Mapping[str, FloatArray],
    within: Measurements | None = None,
    across: Measurements = NO_MEASUREMENTS,
) -> Joint:
    """The maximum-likelihood poses of all rows of a pool.

    label: (n,) place of each row; start: T_component_run of every run; within: `measured_within` of
    the pool, if computed before; across: `measured_across`. The frame is chosen so that the rigid
    fit of the first run's map to its optimised vertices is the identity.
    """
    local = [np.column_stack([m.xy, np.zeros(len(m))]) for m in pool.maps]
    initial = np.concatenate(
        [compose(start[m.run], pose) for m, pose in zip(pool.maps, local, strict=True)]
    )
    across_factors = joined([_place_factors(pool, label, initial), across])
    if len(across_factors.source) == 0:
        return Joint(initial, None, None)
    within = within or measured_within(pool)
    factors = joined([within, across_factors])
    kernel = np.full(len(factors.source), np.inf)
    kernel[len(within.source) :] = LIKELIHOOD.gate_sigmas
    graph = PoseGraph(
        pose=initial,
        source=factors.source,
        target=factors.target,
        measurement=factors.measurement,
        information=factors.information,
        kernel=kernel,
        priors=_grid_priors(pool, initial),
        shared=_scales(pool, factors, len(within.source)),
    )
    solution = solve(graph, SOLVER)
    first = pool.maps[0]
    fit = fit_rigid(solution.pose[: len(first), :2], first.xy) if len(first) else np.zeros(3)
    return Joint(compose(inverse(fit), solution.pose), graph, solution)


def measured_within(pool: Pool) -> Measurements:
    """The relative measurements of every run between its own rows."""
    return joined([_map_factors(m, pool.first[m.run]) for m in pool.maps])


def measured_across(pool: Pool, verdicts: Sequence[PairVerdict]) -> Measurements:
    """The relative measurements between rows of different runs in accepted verdicts."""
    measurements = [
        replace(
            v.best.ties,
            source=v.best.ties.source + pool.first[v.a],
            target=v.best.ties.target + pool.first[v.b],
        )
        for v in verdicts
        if v.best is not None
    ]
    return joined([NO_MEASUREMENTS, *measurements])


def fitted_poses(pool: Pool, pose: FloatArray) -> dict[str, FloatArray]:
    """T_component_run of every run: the rigid fit of its map to its optimised vertices."""
    poses = {}
    for m in pool.maps:
        rows = slice(pool.first[m.run], pool.first[m.run] + len(m))
        poses[m.run] = _rigid_fit(pose[rows], m.xy)
    poses[pool.maps[0].run] = np.zeros(3)
    return poses


def _rigid_fit(pose: FloatArray, xy: FloatArray) -> FloatArray:
    """The rigid fit of map positions to poses; for a single position by the poses' own heading."""
    if len(xy) == 0:
        return np.zeros(3)
    if len(xy) > 1 and np.ptp(xy, axis=0).max() > 0:
        return fit_rigid(pose[:, :2], xy)
    T = np.array([0.0, 0.0, pose[0, 2]])
    T[:2] = pose[0, :2] - apply(T, xy[0])
    return T


def _map_factors(topomap: TopoMap, first: int) -> Measurements:
    """The corridors of one map as relative measurements; `first`: its first row in the pool."""
    odometry = odometry_measurements(topomap)
    information = odometry.information / bending(topomap)
    corridors = Measurements(
        odometry.source + first, odometry.target + first, odometry.measurement, information
    )
    return joined([corridors, _bridges(topomap, first)])


def bending(topomap: TopoMap) -> float:
    """Factor on the variances of a map's corridors that makes its vertices as uncertain as its
    document states (`position_sigma`).

    The corridors' variances are of random walks and of the scatter of passes. The `position_sigma`
    of vertices also contains constant errors of the odometry, which bend the map (a bias, a scale
    of turns), and the error of each centre. The latter is subtracted, without the part that a rigid
    fit to the truth absorbs: 3 of 2 n errors, with good odometry as much as all bending.
    """
    if topomap.position_sigma is None or len(topomap) < 3:
        return 1.0
    graph, noise = map_pose_graph(topomap), topomap.measured
    graph = replace(graph, priors=_grid_priors(Pool.of([topomap]), graph.pose))
    whole = np.zeros(len(topomap), np.int64)
    sampled = SampledMarginals.of(graph, solve(graph, SOLVER), _SAMPLES).error
    sigma = VertexErrors(sampled).as_a_whole(topomap.xy, whole).position_sigma()
    offset = topomap.xy - topomap.xy.mean(axis=0)
    reach2 = (offset**2).sum(axis=1)
    remaining = 1 - 1 / len(topomap) - reach2 / (2 * max(float(reach2.sum()), 1e-12))
    centre_variance = remaining * topomap.centre_variance
    scale_variance = noise.scale**2 * reach2 / 2
    stated = topomap.position_sigma**2
    bent_variance = float((stated - centre_variance - scale_variance).sum())
    share = max(bent_variance, _LEAST_BEND * float(stated.sum()))
    share /= max(float((sigma**2).sum()), 1e-12)
    return share if len(graph.priors) else _STIFF * share


def _bridges(topomap: TopoMap, first: int) -> Measurements:
    """Loose measurements between parts of a map that no corridor connects."""
    part = connected(topomap.source, topomap.target, len(topomap))
    anchor = np.unique(part, return_index=True)[1]
    u, v = anchor[:-1], anchor[1:]
    offset = np.column_stack([topomap.xy[v] - topomap.xy[u], np.zeros(len(u))])
    weight = np.array([JOINT.bridge_m, JOINT.bridge_m, JOINT.bridge_rad]) ** -2.0
    information = np.tile(np.diag(weight), (len(u), 1, 1))
    return Measurements(u + first, v + first, offset.reshape(-1, 3), information)


def usual_scale(maps: Sequence[TopoMap]) -> float:
    """Root mean square of the runs' scale errors (relative, standard deviation). All runs get it:
    robots of one fleet are alike, and few runs can measure their own scale."""
    return float(np.sqrt(np.mean([m.measured.scale**2 for m in maps])))


def _scales(pool: Pool, factors: Measurements, within: int) -> SharedErrors:
    """The scale error of each run's odometry, as one unknown shared by all its measurements.

    within: the first so many factors are measurements within a run.
    """
    count = len(pool.maps)
    if count > JOINT.scaled_runs:
        return SharedErrors.none()
    sensitivity = np.zeros((len(factors.source), 3, count))
    run = pool.run[factors.source[:within]]
    sensitivity[np.arange(within), :2, run] = factors.measurement[:within, :2]
    sigma = np.full(count, max(usual_scale(pool.maps), JOINT.min_scale))
    return SharedErrors(sensitivity, sigma)


def _place_factors(pool: Pool, label: IntArray, guess: FloatArray) -> Measurements:
    """Measurements from the first row of each place to its other rows: same position, and a
    rotation by the branches."""
    order = np.argsort(label, kind="stable")
    first = order[np.searchsorted(label[order], label[order])]
    source, target = first[first != order], order[first != order]
    heading, visits = branch_headings(pool), pass_counts(pool)
    noise = [m.measured for m in pool.maps]
    centre = centre_sigma(pool)
    branch_sigma = np.array([x.branch_rad for x in noise])[pool.run] / np.sqrt(visits)
    expected = wrap(guess[target, 2] - guess[source, 2])
    turn, count = measured_turn(heading[source], heading[target], expected)
    position = np.hypot(centre[source], centre[target])
    turn_sigma = np.hypot(branch_sigma[source], branch_sigma[target]) / np.sqrt(
        np.maximum(count, 1)
    )
    sigma = np.maximum(turn_sigma, JOINT.min_heading_rad)
    information = np.zeros((len(source), 3, 3))
    information[:, 0, 0] = information[:, 1, 1] = position**-2.0
    information[:, 2, 2] = np.where(count > 0, sigma**-2.0, 0.0)
    measured = np.column_stack([np.zeros((len(source), 2)), turn])
    return Measurements(source, target, measured.reshape(-1, 3), information)


def _grid_priors(pool: Pool, guess: FloatArray) -> Priors:
    """Heading priors of all rows, if every map is rectilinear and their grids agree.

    In a rectilinear building the directions of corridors are known up to quarter turns (§2.3),
    which stops the drift of headings from map to map.
    """
    grids = [grid_direction(m.branches.values) for m in pool.maps]
    if any(g is None for g in grids):
        return Priors.empty()
    grid = np.array(grids, np.float64)[pool.run]
    target = float(grid[0] + guess[0, 2])  # the grid of the first map gives the frame
    if np.abs(wrap(4 * (grid + guess[:, 2] - target))).max() > 4 * STRUCTURE.rectilinear_rad:
        return Priors.empty()
    heading, visits = branch_headings(pool), pass_counts(pool)
    deviation = wrap(4 * (heading + guess[:, 2:] - target)) / 4
    near_grid = np.abs(deviation) <= STRUCTURE.rectilinear_rad  # NaN, beyond the degree, is not
    count = near_grid.sum(axis=1)
    rows = np.flatnonzero(count)
    mean = np.where(near_grid, deviation, 0.0).sum(axis=1)[rows] / count[rows]
    branch_sigma = np.array([m.measured.branch_rad for m in pool.maps])[pool.run[rows]]
    branch_sigma = branch_sigma / np.sqrt(count[rows] * visits[rows])
    corridor_sigma = grid_sigma(mean, branch_sigma, pool.run[rows])
    if corridor_sigma > JOINT.grid_rad:
        return Priors.empty()  # rectangular crossings, but bent corridors
    sigma = np.hypot(branch_sigma, corridor_sigma)
    kernel = np.full(len(rows), LIKELIHOOD.gate_sigmas)
    return Priors.headings(rows, np.asarray(wrap(guess[rows, 2] - mean)), sigma, kernel)


def grid_sigma(off_rad: FloatArray, spread_rad: FloatArray, run: IntArray) -> float:
    """Standard deviation of a building's corridors about its grid [rad], estimated from its maps.

    off_rad, spread_rad: (k,) mean deviation of each row's branches from the grid, and its noise;
    run: (k,) their runs, each of which has a rotation of its own. The sample variance beyond noise
    is shrunk towards the prior, which has the weight of `grid_junctions`.
    """
    count = np.maximum(np.bincount(run), 1)
    centred = off_rad - (np.bincount(run, off_rad) / count)[run]
    excess = float((centred**2 - spread_rad**2).sum())
    prior_weight = JOINT.grid_junctions
    variance = (excess + prior_weight * JOINT.grid_rad**2) / (len(run) + prior_weight)
    return float(np.sqrt(max(variance, JOINT.min_heading_rad**2)))


def measured_turn(
    heading_a: FloatArray, heading_b: FloatArray, expected_rad: FloatArray
) -> tuple[FloatArray, IntArray]:
    """(k,) rotations of frames b in frames a by the branches of one place in both, and numbers of
    branches used: the mean difference a - b over mutually nearest branches within the gate.

    heading_a, heading_b: (k, D) padded with NaN, each in its own map; expected_rad: (k,).
    """
    if not (heading_a.size and heading_b.size):
        return expected_rad.copy(), np.zeros(len(expected_rad), np.int64)
    unit_a = unit_headings(heading_a)
    unit_b = unit_headings(heading_b + expected_rad[:, None])
    pairs = mutual_nearest(unit_a, unit_b)
    difference = np.angle(unit_a * np.take_along_axis(unit_b, pairs.nearest, axis=1).conj())
    count = pairs.paired.sum(axis=1)
    mean = np.where(pairs.paired, difference, 0.0).sum(axis=1) / np.maximum(count, 1)
    return np.asarray(wrap(expected_rad + mean)), count


def branch_headings(pool: Pool) -> FloatArray:
    """(n, D) branch headings of all rows in their own maps, padded with NaN."""
    rows = [padded_branches(m) for m in pool.maps]
    width = max((r.shape[1] for r in rows), default=0)
    return np.concatenate(
        [np.pad(r, ((0, 0), (0, width - r.shape[1])), constant_values=np.nan) for r in rows]
    )


def centre_sigma(pool: Pool) -> FloatArray:
    """(n,) standard deviation per axis of each row's centre as seen by its own map [m]."""
    of_pass = np.array([m.measured.centre_m for m in pool.maps])[pool.run]
    least_m = JOINT.min_position_m / np.sqrt(2)
    return np.asarray(np.maximum(of_pass / np.sqrt(pass_counts(pool)), least_m))


def shared_sigma(pool: Pool) -> FloatArray:
    """(n,) standard deviation per axis of the error common to all passes of each row [m]: the run's
    median, but at most the `position_sigma` of the row."""
    shared = np.array([m.measured.shared_centre_m for m in pool.maps])[pool.run]
    stated = [
        np.full(len(m), np.inf) if m.position_sigma is None else m.position_sigma for m in pool.maps
    ]
    return np.asarray(np.minimum(shared, np.concatenate(stated)))


def pass_counts(pool: Pool) -> IntArray:
    """(n,) passes of every row, at least 1."""
    return np.asarray(np.maximum(np.concatenate([m.passes for m in pool.maps]), 1), np.int64)
