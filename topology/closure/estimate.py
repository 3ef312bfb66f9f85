"""The estimate of a run: poses of passes and places by a pose graph, given the places."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..arrays import FloatArray, IntArray
from ..circular import cluster_angles
from ..columns import joined
from ..matching.likelihood import LIKELIHOOD
from ..passes import ONE_WAY_RAD
from ..posegraph.graph import NO_MEASUREMENTS, Measurements, PoseGraph, Priors, Solution
from ..posegraph.marginals import Marginals
from ..posegraph.samples import SampledMarginals
from ..posegraph.solve import SolverSettings, solve
from ..se2 import turned, wrap
from .dead_reckoning import DeadReckoning, relative_covariance
from .manhattan import GridCorridors, GridHeadings

GAP_M = 20.0
"""Space between the pieces of a map [m], wider than most corridors are long."""

_SWING = 0.5
"""Share of the heading error of a leg that rotates its end about its start: the error accumulates
uniformly along it."""


@dataclass(frozen=True, slots=True)
class EstimateSettings:
    """The solver, and the weight of grid headings in the estimate."""

    grid_kernel: float = 2.0
    """Width [sigmas] of the Cauchy kernel of grid headings and grid corridors: 2.385 would be 95 %
    efficient with Gaussian errors (Holland, Welsch 1977) and found fewer places in rows, before
    corridors held these straight (`benchmarks/ablation.txt`, part 2)."""
    settled_chi2: float = 0.1
    """Absolute tolerance of the solver in χ²: smaller steps move poses by less than a third
    sigma."""
    samples: int = 64
    """Samples for covariances of many nodes, and for the redundancy of edges
    (`variance_components.py`): standard error of a variance √(2 / 64) = 18 %."""


ESTIMATE = EstimateSettings()


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """The solved pose graph of a run.

    pose: (p, 3) of every pass in the map frame: its centre, and the rotation from odometry to map.
    xy: (n, 2) position of every place; node: (n,) its vertex in the pose graph: one of its own if
    it has several passes, else its pass. sighting: (k,) pass of each observation factor;
    sighting_chi2: (k,) its squared Mahalanobis error; loop_chi2: the same of each of the loops.
    reduced_chi2: squared errors, up to the gate each, per degree of freedom, 1 if the noise model
    is right; freedom: degrees of freedom, without those of loops.
    """

    pose: FloatArray
    xy: FloatArray
    node: IntArray
    sighting: IntArray
    sighting_chi2: FloatArray
    loop_chi2: FloatArray
    reduced_chi2: float
    freedom: int
    graph: PoseGraph
    solution: Solution

    def relative_covariance(self, a: IntArray, b: IntArray) -> FloatArray:
        """(k, 3, 3) of nodes b relative to nodes a, in the axes of a: exact for few nodes, sampled
        for many.

        Sampled covariances are enlarged by the relative standard error of a sampled sigma.
        """
        samples = ESTIMATE.samples
        # A node takes three solutions, a sample one.
        if 3 * len(np.unique(np.concatenate([a, b]))) <= samples:
            return Marginals.of(self.graph, self.solution).relative(a, b)
        sampled = SampledMarginals.of(self.graph, self.solution, samples).relative(a, b)
        return float(1.0 + np.sqrt(0.5 / samples)) * sampled


def optimise(
    reckoning: DeadReckoning,
    place: IntArray,
    start: FloatArray | None = None,
    *,
    turn: FloatArray | None = None,
    grid: GridHeadings | None = None,
    corridors: GridCorridors | None = None,
) -> Estimate:
    """Most likely poses of passes and places, from odometry and identifications.

    place: (p,) place of each pass, numbered from 0; negative: none. start: (p, 3) initial poses;
    turn: (p,) rotations [rad] that align the branches of one place; by default those of `start`.

    Nodes of the pose graph are the passes (at their centre, rotated like the odometry frame) and
    the places with several passes. Edges are the legs between consecutive passes, the observations
    of places by passes, and the loops of `reckoning`. A corridor of the grid is a node as well:
    a line that its passes lie on.
    """
    count = len(reckoning)
    if start is None:
        start = _initial_poses(reckoning, grid)
    node, centres = _nodes(place, start)
    nodes = count + len(centres)
    legs, loops = _odometry_edges(reckoning), reckoning.loops
    sightings = _observations(reckoning, place, node, start[:, 2] if turn is None else turn)
    corridor_factors, corridor_poses = _corridor_lines(start, corridors, nodes)
    factors = joined([legs, sightings, loops, corridor_factors])
    end_sightings = len(legs) + len(sightings)
    end_loops, edges = end_sightings + len(loops), len(factors)
    kernel = np.full(edges, np.inf)
    kernel[end_loops:] = ESTIMATE.grid_kernel
    graph = PoseGraph(
        pose=np.vstack([start, centres, corridor_poses]),
        source=factors.source,
        target=factors.target,
        measurement=factors.measurement,
        information=factors.information,
        kernel=kernel,
        priors=_priors(grid, corridors, nodes),
        swing=np.where(np.arange(edges) < len(legs), _SWING, 0.0),
    )
    graph, solution, chi2 = _solve_with_gate(graph, slice(len(legs), end_loops))
    freedom = 3 * (len(sightings) - len(centres)) + len(corridor_factors) - len(corridor_poses)
    within_gate = np.minimum(chi2, LIKELIHOOD.gate_chi2(3))
    return Estimate(
        pose=solution.pose[:count],
        xy=solution.pose[node, :2],
        node=node,
        sighting=sightings.source,
        sighting_chi2=solution.edge_chi2[len(legs) : end_sightings],
        loop_chi2=solution.edge_chi2[end_sightings:end_loops],
        reduced_chi2=float(within_gate.sum()) / freedom if freedom else 1.0,
        freedom=freedom,
        graph=graph,
        solution=solution,
    )


def set_apart(reckoning: DeadReckoning, place: IntArray, estimate: Estimate) -> Estimate:
    """The estimate with its pieces side by side along x, `GAP_M` apart: where the odometry broke,
    the relative poses of its pieces are unknown.

    place: (p,) of each pass, numbered from 0. A piece has the passes of one unbroken piece of
    odometry. Only `pose` and `xy` of the result are moved.
    """
    pieces = np.unique(reckoning.piece)
    if len(pieces) < 2:
        return estimate
    pose, xy = estimate.pose.copy(), estimate.xy.copy()
    piece_of = np.zeros(len(xy), np.int64)
    piece_of[place[place >= 0]] = reckoning.piece[place >= 0]
    right_m = None
    for piece in pieces.tolist():
        in_piece = reckoning.piece == piece
        low_m, high_m = pose[in_piece, 0].min(), pose[in_piece, 0].max()
        shift = 0.0 if right_m is None else right_m + GAP_M - low_m
        pose[in_piece, 0] += shift
        xy[piece_of == piece, 0] += shift
        right_m = high_m + shift
    return replace(estimate, pose=pose, xy=xy)


def _initial_poses(reckoning: DeadReckoning, grid: GridHeadings | None) -> FloatArray:
    """(p, 3) initial poses by odometry, with its legs rotated by the grid of the building.

    Without the grid, headings may be arbitrarily wrong after hundreds of corridors, beyond the
    solver's basin of convergence.
    """
    centre = reckoning.passes.centre
    if grid is None:
        return np.column_stack([centre, np.zeros(len(centre))])
    turn, piece = np.zeros(len(centre)), reckoning.piece[grid.row]
    for k in np.unique(piece).tolist():
        passes_of_piece, grid_of_piece = np.flatnonzero(reckoning.piece == k), piece == k
        turn[passes_of_piece] = np.interp(
            passes_of_piece, grid.row[grid_of_piece], np.unwrap(grid.turn[grid_of_piece])
        )
    mean_turn = 0.5 * (turn[1:] + turn[:-1])
    steps = turned(np.diff(centre, axis=0), mean_turn)
    xy = centre[0] + np.vstack([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    return np.column_stack([xy, wrap(turn)])


def _nodes(place: IntArray, start: FloatArray) -> tuple[IntArray, FloatArray]:
    """(n,) node of every place: its only pass, or, for a place with several passes, a node of its
    own after those of all passes; and (s, 3) initial poses of the latter, at the mean positions of
    their passes."""
    places = int(place.max(initial=-1)) + 1
    placed = np.flatnonzero(place >= 0)
    visits = np.bincount(place[placed], minlength=places)
    revisited = np.flatnonzero(visits > 1)
    node = np.zeros(places, np.int64)
    node[place[placed]] = placed
    node[revisited] = len(place) + np.arange(len(revisited))
    centres = np.zeros((len(revisited), 3))
    for k in (0, 1):
        sums = np.bincount(place[placed], start[placed, k], minlength=places)
        centres[:, k] = sums[revisited] / visits[revisited]
    return node, centres


def _solve_with_gate(graph: PoseGraph, observed: slice) -> tuple[PoseGraph, Solution, FloatArray]:
    """Solve without robust kernels on the observed edges (observations and loops), then, if some do
    not fit, with kernels. Also returns χ² of the edges without kernels.

    A new identification may move places by far, which a robust kernel would reject at first.
    """
    settings = SolverSettings(relative_tolerance=0.0, absolute_tolerance=ESTIMATE.settled_chi2)
    solution = solve(graph, settings)
    gate = LIKELIHOOD.gate_sigmas
    if np.all(solution.edge_chi2[observed] < gate**2):
        return graph, solution, solution.edge_chi2
    kernel = graph.kernel.copy()
    kernel[observed] = gate
    robust = replace(graph, pose=solution.pose, kernel=kernel)
    return robust, solve(robust, settings), solution.edge_chi2


def _priors(grid: GridHeadings | None, corridors: GridCorridors | None, first_line: int) -> Priors:
    """Priors of headings of passes, and of directions of lines (nodes from `first_line`)."""
    if grid is None:
        return Priors.empty()
    row, turn, sigma = grid.row, grid.turn, grid.sigma
    kernel = np.full(len(row), ESTIMATE.grid_kernel)
    if corridors is not None:
        count = len(corridors.direction)
        row = np.concatenate([row, first_line + np.arange(count)])
        turn = np.concatenate([turn, corridors.direction])
        sigma = np.concatenate([sigma, np.full(count, grid.spread_rad)])
        kernel = np.concatenate([kernel, np.full(count, np.inf)])
    return Priors.headings(row, turn, sigma, kernel)


def _odometry_edges(reckoning: DeadReckoning) -> Measurements:
    """Edges of odometry from each pass to the next one, unless it broke in between."""
    row = np.flatnonzero(np.diff(reckoning.piece) == 0)
    cov = leg_covariance(reckoning, row) + np.diag([1e-6, 1e-6, 1e-8])
    shift = np.diff(reckoning.passes.centre, axis=0)[row]
    measurement = np.column_stack([shift, np.zeros(len(row))])
    return Measurements(row, row + 1, measurement, _information(cov))


def leg_covariance(reckoning: DeadReckoning, row: IntArray) -> FloatArray:
    """(k, 3, 3) covariance of the errors of the legs from passes `row` (k,) to the next ones, as
    the pose graph measures them: the translation after rotation by half of the heading error
    (`PoseGraph.swing`)."""
    x, y = (reckoning.passes.centre[row + 1] - reckoning.passes.centre[row]).T
    swing = np.tile(np.eye(3), (len(row), 1, 1))
    swing[:, 0, 2], swing[:, 1, 2] = _SWING * y, -_SWING * x
    cov = relative_covariance(reckoning, row, row + 1)
    return np.asarray(swing @ cov @ swing.transpose(0, 2, 1))


def _information(cov: FloatArray) -> FloatArray:
    """Inverses of covariances (k, 3, 3), symmetric and positive definite.

    If the odometry jumps by hundreds of kilometres, the condition number is so large that an
    inverse has no correct digit. Small variances are then raised so that four digits are correct.
    """
    variance, axes = np.linalg.eigh(cov)
    least = 1e-12 * variance[:, -1:]
    inverse = axes / np.maximum(variance, least)[:, None, :] @ axes.transpose(0, 2, 1)
    return np.asarray(0.5 * (inverse + inverse.transpose(0, 2, 1)))


def _observations(
    reckoning: DeadReckoning, place: IntArray, node: IntArray, turn: FloatArray
) -> Measurements:
    """Observations of places with several passes, which have nodes of their own: the centres
    coincide, the branches fix the rotation."""
    row = np.flatnonzero(place >= 0)
    row = row[node[place[row]] >= len(place)]
    branches = reckoning.passes.branches
    group = np.where(place < 0, place.max(initial=0) + 1 + np.arange(len(reckoning)), place)
    clusters = cluster_angles(
        branches.values + turn[branches.owner], group[branches.owner], ONE_WAY_RAD
    )
    # Rotation of each pass that aligns its branches with the mean branches of its place.
    rotation = wrap(clusters.mean[clusters.of] - branches.values - turn[branches.owner])
    counts = np.maximum(branches.counts, 1)
    turn = turn + np.bincount(branches.owner, rotation, minlength=len(reckoning)) / counts
    measurement = np.column_stack([np.zeros((len(row), 2)), wrap(-turn[row])])
    information = np.zeros((len(row), 3, 3))
    information[:, 0, 0] = information[:, 1, 1] = reckoning.noise.centre_m**-2
    information[:, 2, 2] = counts[row] * reckoning.noise.branch_rad**-2
    return Measurements(row, node[place[row]], measurement, information)


def _corridor_lines(
    start: FloatArray, corridors: GridCorridors | None, nodes: int
) -> tuple[Measurements, FloatArray]:
    """Measurements from the lines of grid corridors (nodes from `nodes` on) to the passes on them,
    and the initial poses of the lines (c, 3), at their first passes."""
    if corridors is None:
        return NO_MEASUREMENTS, np.zeros((0, 3))
    passes, is_first = corridors.row, np.diff(corridors.corridor, prepend=-1) > 0
    information = np.zeros((len(passes), 3, 3))
    information[:, 1, 1] = corridors.sigma_m**-2
    information[is_first, 0, 0] = corridors.sigma_m**-2
    pose = np.column_stack([start[passes[is_first], :2], corridors.direction])
    measurement = np.zeros((len(passes), 3))
    measurement[:, 1] = corridors.aside
    return Measurements(nodes + corridors.corridor, passes, measurement, information), pose
