"""One pose graph over all runs of a component: where every vertex lies when all maps count.

Every vertex of every run is a pose: its position, and how far the run's map is turned there
against the component. Corridors are relative measurements within a run, with sigmas from the
run's noise and one scale for all of them; vertices that are one place are tied by relative
measurements across runs.
"""

from __future__ import annotations

import heapq
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...topology.arrays import FloatArray, IntArray
from ...topology.columns import joined
from ...topology.connected import connected
from ...topology.map_pose_graph import Measurements, map_pose_graph, odometry_measurements
from ...topology.matching.branches import mutual_nearest, unit_headings
from ...topology.matching.structure import grid_direction, padded_branches
from ...topology.posegraph.graph import PoseGraph, Priors, SharedErrors
from ...topology.posegraph.samples import SampledMarginals
from ...topology.posegraph.solve import Solution, SolverSettings, solve
from ...topology.se2 import apply, compose, fit_rigid, inverse, wrap
from ...topology.topomap import TopoMap
from ...topology.vertex_errors import VertexErrors
from ..result import PairVerdict
from .vertex_partition import Pool


@dataclass(frozen=True, slots=True)
class JointSettings:
    """Sigmas that maps do not state, and how much a false match may pull."""

    min_position_m: float = 0.01
    """No two maps agree better than this on where a junction's centre is, 1 sigma."""
    min_heading_rad: float = 0.01
    """Nor on the direction of its branches."""
    branch_gate_rad: float = 0.6
    """Branches further apart than this do not measure the turn between two maps."""
    bridge_m: float = 1.0
    """Parts of one map that no corridor joins keep their places to this, 1 sigma …"""
    bridge_rad: float = 0.1
    """… and their directions to this."""
    scaled_runs: int = 24
    """Up to so many runs the scale of each run's odometry is estimated, too: unknowns that many
    measurements share cost memory and time by the square of their number."""
    min_scale: float = 1e-6
    """No odometry's scale is known better than this: 0.1 mm in 100 m. It keeps information finite;
    a run whose odometry does not err states 2e-5 to 1e-4."""
    kernel_sigmas: float = 3.0
    """Identities count by a Cauchy kernel of this width: a false one gives way."""
    grid_rad: float = 0.035
    """Where every map lies on one grid, corridors keep to it within this, 1 sigma: what strays
    farther is none. As far as …"""
    grid_junctions: float = 20.0
    """… so many junctions say; the maps' own junctions tell the rest …"""
    min_grid_rad: float = 0.01
    """… down to this."""
    grid_gate_rad: float = 0.26
    """Maps whose grids differ by more than this, as first laid out, do not share one."""


JOINT = JointSettings()

_SAMPLES = 64
"""Samples of the errors of a map's vertices: their mean square has an error of a few per cent."""

_LEAST_BEND = 0.03
"""Lower bound of the share of a map's stated variances that bending explains: they are estimated
from 256 samples, and known no better."""

SOLVER = SolverSettings(relative_tolerance=1e-5, max_iterations=25)
"""Cauchy kernels converge slowly in their last digits, which are far below a millimetre."""


@dataclass(frozen=True, slots=True, eq=False)
class Joint:
    """Poses (n, 3) of all rows of a pool in the component's frame (position, and turn of the run's
    map there), and the graph that gave them with its solution in a frame of its own; None where no
    place ties two runs."""

    pose: FloatArray
    graph: PoseGraph | None
    solution: Solution | None


def run_poses(runs: Sequence[str], verdicts: Sequence[PairVerdict]) -> dict[str, FloatArray]:
    """A first T_component_run of every run along the strongest accepted verdicts.

    The frame is that of the first run by name; runs that no verdict reaches are left out.
    """
    of: dict[str, list[tuple[float, str, str, FloatArray]]] = {}
    for v in verdicts:
        if v.accepted and v.best is not None:
            link = (-v.evidence_bits, v.a, v.b, v.best.transform)
            of.setdefault(v.a, []).append(link)
            of.setdefault(v.b, []).append(link)
    start = min(runs)
    poses, ahead = {start: np.zeros(3)}, list(of.get(start, ()))
    heapq.heapify(ahead)
    while ahead:  # Prim: the strongest verdict that reaches a new run
        _, a, b, T_a_b = heapq.heappop(ahead)
        if a in poses and b in poses:
            continue
        new = b if a in poses else a
        poses[new] = compose(poses[a], T_a_b) if new == b else compose(poses[b], inverse(T_a_b))
        for link in of[new]:
            if link[1] not in poses or link[2] not in poses:
                heapq.heappush(ahead, link)
    return poses


def settle(
    pool: Pool, label: IntArray, start: Mapping[str, FloatArray], within: Measurements | None = None
) -> Joint:
    """The most likely poses of all rows of a pool.

    label: (n,) the place of each row; start: T_component_run of every run; within:
    `measured_within` of the pool, where it is known. The frame is chosen so that the first run,
    laid rigidly over its optimised vertices, does not move.
    """
    guess = np.concatenate([_laid_out(m, start[m.run]) for m in pool.maps])
    ties = _identity_factors(pool, label, guess)
    if len(ties.source) == 0:
        return Joint(guess, None, None)
    within = within or measured_within(pool)
    factors = joined([within, ties])
    kernel = np.full(len(factors.source), np.inf)
    kernel[len(within.source) :] = JOINT.kernel_sigmas
    graph = PoseGraph(
        pose=guess,
        source=factors.source,
        target=factors.target,
        measurement=factors.measurement,
        information=factors.information,
        kernel=kernel,
        priors=_grid_priors(pool, guess),
        shared=_scales(pool, factors, len(within.source)),
    )
    solution = solve(graph, SOLVER)
    first = pool.maps[0]
    home = fit_rigid(solution.pose[: len(first), :2], first.xy) if len(first) else np.zeros(3)
    return Joint(compose(inverse(home), solution.pose), graph, solution)


def measured_within(pool: Pool) -> Measurements:
    """What every run measured between its own rows."""
    return joined([_map_factors(m, pool.first[m.run]) for m in pool.maps])


def fitted_poses(pool: Pool, pose: FloatArray) -> dict[str, FloatArray]:
    """T_component_run of every run: its map laid rigidly over its optimised vertices."""
    out = {}
    for m in pool.maps:
        rows = slice(pool.first[m.run], pool.first[m.run] + len(m))
        out[m.run] = _fit(pose[rows], m.xy)
    out[pool.maps[0].run] = np.zeros(3)
    return out


def _fit(pose: FloatArray, xy: FloatArray) -> FloatArray:
    """Rigid transform from map positions to poses; the poses' own turns decide for one vertex."""
    if len(xy) == 0:
        return np.zeros(3)
    if len(xy) > 1 and np.ptp(xy, axis=0).max() > 0:
        return fit_rigid(pose[:, :2], xy)
    T = np.array([0.0, 0.0, pose[0, 2]])
    T[:2] = pose[0, :2] - apply(T, xy[0])
    return T


def _laid_out(topomap: TopoMap, T_component_run: FloatArray) -> FloatArray:
    local = np.column_stack([topomap.xy, np.zeros(len(topomap))])
    return compose(T_component_run, local)


def _map_factors(topomap: TopoMap, first: int) -> Measurements:
    """The corridors of one map as relative measurements, from row `first` of the pool on."""
    given = odometry_measurements(topomap)
    information = given.information / bending(topomap)
    roads = Measurements(given.source + first, given.target + first, given.measurement, information)
    return joined([roads, _bridges(topomap, first)])


def bending(topomap: TopoMap) -> float:
    """Factor on the variances of a map's corridors that makes its vertices as uncertain as its
    document states (`position_sigma`).

    The variances of corridors hold random walks and the scatter of passes. Constant errors of the
    odometry (a bias or a scale of turns) bend a map as well, and are in the `position_sigma` of its
    vertices. So is how each vertex's centre was seen, less what laying the map rigidly over the
    truth takes of that: 3 of the 2 n errors of n vertices, as much as all of the bending on good
    odometry.
    """
    if topomap.position_sigma is None or len(topomap) < 3:
        return 1.0
    graph, noise = map_pose_graph(topomap), topomap.measured
    graph = replace(graph, priors=_grid_priors(Pool.of([topomap]), graph.pose))
    whole = np.zeros(len(topomap), np.int64)
    walked = SampledMarginals.of(graph, solve(graph, SOLVER), _SAMPLES).error
    bent = VertexErrors(walked).as_a_whole(topomap.xy, whole).position_sigma()
    arm = topomap.xy - topomap.xy.mean(axis=0)
    reach = (arm**2).sum(axis=1)
    kept = 1 - 1 / len(topomap) - reach / (2 * max(float(reach.sum()), 1e-12))
    seen = kept * topomap.centre_variance
    stretched = noise.scale**2 * reach / 2
    stated = topomap.position_sigma**2
    left = float((stated - seen - stretched).sum())
    return max(left, _LEAST_BEND * float(stated.sum())) / max(float((bent**2).sum()), 1e-12)


def _bridges(topomap: TopoMap, first: int) -> Measurements:
    """Loose measurements between the parts of a map that no corridor joins."""
    part = connected(topomap.source, topomap.target, len(topomap))
    anchor = np.unique(part, return_index=True)[1]
    u, v = anchor[:-1], anchor[1:]
    measured = np.column_stack([topomap.xy[v] - topomap.xy[u], np.zeros(len(u))])
    weight = np.array([JOINT.bridge_m, JOINT.bridge_m, JOINT.bridge_rad]) ** -2.0
    information = np.tile(np.diag(weight), (len(u), 1, 1))
    return Measurements(u + first, v + first, measured.reshape(-1, 3), information)


def usual_scale(maps: Sequence[TopoMap]) -> float:
    """1 sigma of the scales of a component's odometries, which all its runs tell together, in the
    mean square: robots of one fleet are alike, and few runs can see their own."""
    return float(np.sqrt(np.mean([m.measured.scale**2 for m in maps])))


def _scales(pool: Pool, factors: Measurements, within: int) -> SharedErrors:
    """The scale of each run's odometry: one unknown that all its measurements share.

    within: how many of the factors, the first ones, are measurements within a run.
    """
    count = len(pool.maps)
    if count > JOINT.scaled_runs:
        return SharedErrors.none()
    sensitivity = np.zeros((len(factors.source), 3, count))
    run = pool.run[factors.source[:within]]
    sensitivity[np.arange(within), :2, run] = factors.measurement[:within, :2]
    sigma = np.full(count, max(usual_scale(pool.maps), JOINT.min_scale))
    return SharedErrors(sensitivity, sigma)


def _identity_factors(pool: Pool, label: IntArray, guess: FloatArray) -> Measurements:
    """Every further row of a place tied to its first: same position, turn as the branches say."""
    order = np.argsort(label, kind="stable")
    first = order[np.searchsorted(label[order], label[order])]
    source, target = first[first != order], order[first != order]
    heading, visits = branch_headings(pool), pass_counts(pool)
    noise = [m.measured for m in pool.maps]
    centre = centre_sigma(pool)
    spread = np.array([x.branch_rad for x in noise])[pool.run] / np.sqrt(visits)
    turn, count = measured_turn(
        heading[source], heading[target], wrap(guess[target, 2] - guess[source, 2]),
        JOINT.branch_gate_rad,
    )  # fmt: skip
    position = np.hypot(centre[source], centre[target])
    both = np.hypot(spread[source], spread[target]) / np.sqrt(np.maximum(count, 1))
    sigma = np.maximum(both, JOINT.min_heading_rad)
    information = np.zeros((len(source), 3, 3))
    information[:, 0, 0] = information[:, 1, 1] = position**-2.0
    information[:, 2, 2] = np.where(count > 0, sigma**-2.0, 0.0)
    measured = np.column_stack([np.zeros((len(source), 2)), turn])
    return Measurements(source, target, measured.reshape(-1, 3), information)


def _grid_priors(pool: Pool, guess: FloatArray) -> Priors:
    """Headings of all rows where every map is rectilinear and their grids agree.

    In a rectilinear building the directions of corridors are known up to quarter turns (§2.3), so
    a heading does not drift from map to map.
    """
    grids = [grid_direction(m.branches.values) for m in pool.maps]
    if any(g is None for g in grids):
        return Priors.empty()
    grid = np.array(grids, np.float64)[pool.run]
    target = float(grid[0] + guess[0, 2])  # the grid of the first map gives the frame
    if np.abs(wrap(4 * (grid + guess[:, 2] - target))).max() > 4 * JOINT.grid_gate_rad:
        return Priors.empty()
    heading, visits = branch_headings(pool), pass_counts(pool)
    off = wrap(4 * (heading + guess[:, 2:] - target)) / 4
    used = np.abs(off) <= JOINT.grid_gate_rad  # NaN, beyond the degree, is not
    count = used.sum(axis=1)
    rows = np.flatnonzero(count)
    mean = np.where(used, off, 0.0).sum(axis=1)[rows] / count[rows]
    spread = np.array([m.measured.branch_rad for m in pool.maps])[pool.run[rows]]
    spread = spread / np.sqrt(count[rows] * visits[rows])
    own = grid_sigma(mean, spread, pool.run[rows])
    if own > JOINT.grid_rad:
        return Priors.empty()  # square at every crossing, and bent as a whole
    sigma = np.hypot(spread, own)
    kernel = np.full(len(rows), JOINT.kernel_sigmas)
    return Priors.headings(rows, np.asarray(wrap(guess[rows, 2] - mean)), sigma, kernel)


def grid_sigma(off_rad: FloatArray, spread_rad: FloatArray, run: IntArray) -> float:
    """How truly a building keeps to its grid, 1 sigma [rad], by what its maps show of it.

    off_rad, spread_rad: (k,) means of the branches of each row off the grid, and their noise; run:
    (k,) their runs, each of which may be turned as a whole. The sample variance beyond noise is
    shrunk towards the settings as by so many more junctions.
    """
    count = np.maximum(np.bincount(run), 1)
    own = off_rad - (np.bincount(run, off_rad) / count)[run]
    beyond = float((own**2 - spread_rad**2).sum())
    known = JOINT.grid_junctions
    variance = (beyond + known * JOINT.grid_rad**2) / (len(run) + known)
    return float(np.sqrt(max(variance, JOINT.min_grid_rad**2)))


def measured_turn(
    heading_a: FloatArray, heading_b: FloatArray, expected_rad: FloatArray, gate_rad: float
) -> tuple[FloatArray, IntArray]:
    """Turn of frame b in frame a from branches of one place seen in both, and how many told it.

    heading_a, heading_b: (k, D) padded with NaN, each in its own map; expected_rad: (k,) the turn
    to within the gate. Mutually nearest branches within the gate measure it: mean of a minus b.
    """
    if not (heading_a.size and heading_b.size):
        return expected_rad.copy(), np.zeros(len(expected_rad), np.int64)
    unit_a = unit_headings(heading_a)
    unit_b = unit_headings(heading_b + expected_rad[:, None])
    pairs = mutual_nearest(unit_a, unit_b, float(np.cos(gate_rad)))
    gap = np.angle(unit_a * np.take_along_axis(unit_b, pairs.nearest, axis=1).conj())
    count = pairs.paired.sum(axis=1)
    mean = np.where(pairs.paired, gap, 0.0).sum(axis=1) / np.maximum(count, 1)
    return np.asarray(wrap(expected_rad + mean)), count


def branch_headings(pool: Pool) -> FloatArray:
    """(n, D) branch headings of all rows in their own maps, NaN where there are no more."""
    rows = [padded_branches(m) for m in pool.maps]
    width = max((r.shape[1] for r in rows), default=0)
    return np.concatenate(
        [np.pad(r, ((0, 0), (0, width - r.shape[1])), constant_values=np.nan) for r in rows]
    )


def centre_sigma(pool: Pool) -> FloatArray:
    """(n,) 1 sigma [m] per axis of the centre of each row as its map saw it."""
    one = np.array([m.measured.centre_m for m in pool.maps])[pool.run]
    least = JOINT.min_position_m / np.sqrt(2)
    return np.asarray(np.maximum(one / np.sqrt(pass_counts(pool)), least))


def shared_sigma(pool: Pool) -> FloatArray:
    """(n,) 1 sigma [m] per axis of what all passes by each row are off by alike: as the
    median one of its run, but no more than its map states of all errors there."""
    alike = np.array([m.measured.shared_centre_m for m in pool.maps])[pool.run]
    stated = [
        np.full(len(m), np.inf) if m.position_sigma is None else m.position_sigma for m in pool.maps
    ]
    return np.asarray(np.minimum(alike, np.concatenate(stated)))


def pass_counts(pool: Pool) -> IntArray:
    """(n,) passes by every row, at least 1."""
    return np.asarray(np.maximum(np.concatenate([m.passes for m in pool.maps]), 1), np.int64)
