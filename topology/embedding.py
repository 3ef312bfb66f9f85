"""Vertices in the plane from corridors measured one by one (§3.1).

Two models: in a rectilinear world errors along the two axes are decoupled, so the most likely
embedding is two one-dimensional spring problems (§3.3); on general angles it is a pose graph in
SE(2). The frame may be placed anywhere: the first vertex of every connected part is the origin.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csc_array
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu

from .matching.structure import grid_direction
from .passes import NO_BRANCH
from .posegraph.solve import PoseGraph, solve
from .se2 import rotation, turned_axes
from .topomap import TopoMap

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class EmbeddingSettings:
    """Sigmas that a map's own noise does not state."""

    across_m: float = 0.03
    """A straight corridor of a rectilinear world keeps its line to this, 1 sigma; also how well
    two visits agree on the centre of a junction."""
    min_turn_rad: float = 1e-3
    """No corridor keeps its heading better than this, 1 sigma."""
    min_step_m: float = 0.005
    """Nor its length: what a document rounds and an odometry does not say."""


DEFAULT_EMBEDDING = EmbeddingSettings()


@dataclass(frozen=True, slots=True, eq=False)
class Measurements:
    """Corridors as relative poses between the vertices they join, loops left out.

    source, target: (k,) vertices; measurement: (k, 3) T_source_target in the map's directions,
    the turn being 0; information: (k, 3, 3).
    """

    source: IntArray
    target: IntArray
    measurement: FloatArray
    information: FloatArray


def embed_springs(
    count: int,
    ends: tuple[IntArray, IntArray],
    displacement: FloatArray,
    sigma: FloatArray,
) -> FloatArray:
    """(count,) positions on a line that fit displacements between pairs best, by least squares.

    ends: source and target (k,) of every spring; displacement: (k,) target minus source [m];
    sigma: (k,) 1 sigma [m]. The first vertex of every connected part is at 0. One sparse
    factorisation of the weighted graph Laplacian.
    """
    source, target = ends
    weight = sigma**-2.0
    rows = np.concatenate([source, target, source, target])
    columns = np.concatenate([source, target, target, source])
    values = np.concatenate([weight, weight, -weight, -weight])
    laplacian = csc_array(coo_array((values, (rows, columns)), shape=(count, count)))
    pull = weight * displacement
    right = np.bincount(target, pull, count) - np.bincount(source, pull, count)
    _, part = connected_components(laplacian, directed=False)
    _, first = np.unique(part, return_index=True)
    free = np.ones(count, bool)
    free[first] = False
    out = np.zeros(count)
    if free.any():
        index = np.flatnonzero(free)
        out[index] = splu(csc_array(laplacian[index][:, index])).solve(right[index])
    return out


def embed_rectilinear(
    topomap: TopoMap, settings: EmbeddingSettings = DEFAULT_EMBEDDING
) -> FloatArray:
    """(n, 2) positions [m] in the map's directions by two decoupled spring problems (§3.3).

    A straight corridor measures its length along its axis and nothing moves across it; one that
    bends measures the displacement of its path. Raises ValueError if the map is not rectilinear.
    """
    grid = grid_direction(topomap.branches.values)
    if grid is None:
        raise ValueError(f"map {topomap.run!r} is not rectilinear")
    step, straight = _grid_steps(topomap, grid)
    way = np.abs(step).sum(axis=1)
    share = np.sqrt(np.abs(step) / np.maximum(way, 1e-9)[:, None])
    sigma = np.hypot(topomap.length_sigma[:, None] * share, settings.across_m)
    sigma[straight] = np.where(
        np.abs(step[straight]) > 0, topomap.length_sigma[straight, None], settings.across_m
    )
    ends = (topomap.source, topomap.target)
    axes = [embed_springs(len(topomap), ends, step[:, k], sigma[:, k]) for k in range(2)]
    return np.asarray(np.column_stack(axes) @ rotation(grid).T)


def _grid_steps(topomap: TopoMap, grid_rad: float) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Displacement (m, 2) of every corridor along the two axes of the grid; which are straight."""
    chord = np.array([p[-1] - p[0] for p in topomap.paths]).reshape(-1, 2) @ rotation(grid_rad)
    drawn = np.array([np.hypot(*np.diff(p, axis=0).T).sum() for p in topomap.paths])
    step = chord * (topomap.length / np.maximum(drawn, 1e-9))[:, None]
    headings = np.full((len(step), 2), np.nan)
    for column, (end, branch) in enumerate(
        ((topomap.source, topomap.source_branch), (topomap.target, topomap.target_branch))
    ):
        known = branch != NO_BRANCH
        rows = topomap.branches.offsets[end[known]] + branch[known]
        headings[known, column] = topomap.branches.values[rows] - grid_rad
    quarter = np.rint(headings / (np.pi / 2))
    with np.errstate(invalid="ignore"):
        straight = (quarter[:, 0] - quarter[:, 1]) % 4 == 2
    straight &= topomap.source != topomap.target
    angle = quarter[straight, 0] * (np.pi / 2)
    axis = np.rint(np.column_stack([np.cos(angle), np.sin(angle)]))
    step[straight] = topomap.length[straight, None] * axis
    return step, straight


def corridor_measurements(
    topomap: TopoMap,
    step: FloatArray | None = None,
    settings: EmbeddingSettings = DEFAULT_EMBEDDING,
) -> Measurements:
    """Relative poses along the corridors of a map, with the errors of their lengths.

    step: (m, 2) displacement of every edge from source to target in the map's directions; by
    default of its path, drawn to its length. A heading that walks at random along a corridor turns
    its far end by sigma and its chord by sigma / sqrt(3).
    """
    noise, length = topomap.noise, topomap.length
    times = np.sqrt(np.maximum(topomap.traversals, 1))
    turn = np.maximum(noise.heading_rad_per_sqrt_m * np.sqrt(length) / times, settings.min_turn_rad)
    variance = np.zeros((len(length), 3, 3))
    variance[:, 0, 0] = topomap.length_sigma**2 + settings.across_m**2
    variance[:, 1, 1] = (turn * length) ** 2 / 3 + settings.across_m**2
    variance[:, 2, 2] = turn**2
    return _measurements(topomap, _path_steps(topomap) if step is None else step, variance)


def odometry_measurements(
    topomap: TopoMap, settings: EmbeddingSettings = DEFAULT_EMBEDDING
) -> Measurements:
    """Relative poses along the corridors of a map, with the errors of the odometry between them.

    For a pose graph over vertices whose centres are as this map saw them: where the detections
    err, all corridors of a junction err together, and that is said where the junction is tied to
    the world. What passes by one junction differ remains in every corridor. Into a corridor a
    robot turns by nothing or by a right angle, a quarter of π in the mean; each end has half.
    """
    noise, length = topomap.measured, topomap.length
    times = np.maximum(topomap.traversals, 1)
    visits = np.maximum(np.bincount(topomap.observation_vertex, minlength=len(topomap)), 1)
    differ = (1 - 1 / visits[topomap.source]) + (1 - 1 / visits[topomap.target])
    centre = noise.centre_m**2 * differ / times + settings.min_step_m**2
    walk = noise.heading_rad_per_sqrt_m**2 * length / times
    swing = noise.heading_rad_per_sqrt_rad**2 * np.pi / 8 / times
    cov = np.zeros((len(length), 3, 3))
    cov[:, 0, 0] = noise.along_m_per_sqrt_m**2 * length / times + centre
    # A heading that walks at random turns the chord by half as much as the far end; what it errs
    # in the junction at the near end, it turns all of the corridor by.
    cov[:, 1, 1] = (walk / 3 + swing) * length**2 + centre
    cov[:, 1, 2] = cov[:, 2, 1] = (walk / 2 + swing) * length
    cov[:, 2, 2] = walk + 2 * swing + settings.min_turn_rad**2
    step = topomap.xy[topomap.target] - topomap.xy[topomap.source]
    return _measurements(topomap, step, cov)


def _measurements(topomap: TopoMap, step: FloatArray, covariance: FloatArray) -> Measurements:
    """step: (m, 2); covariance: (m, 3, 3) along the step, across it [m] and of the turn [rad]."""
    keep = np.flatnonzero(topomap.source != topomap.target)  # a loop tells nothing of its junction
    along_step = step[keep]
    axes = turned_axes(np.arctan2(along_step[:, 1], along_step[:, 0]))
    information = axes @ np.linalg.inv(covariance[keep]) @ axes.transpose(0, 2, 1)
    measured = np.column_stack([along_step, np.zeros(len(keep))])
    return Measurements(
        topomap.source[keep],
        topomap.target[keep],
        measured,
        0.5 * (information + information.transpose(0, 2, 1)),
    )


def _path_steps(topomap: TopoMap) -> FloatArray:
    """(m, 2) chord of every path, scaled so that the path has the length of the edge."""
    chord = np.array([p[-1] - p[0] for p in topomap.paths]).reshape(-1, 2)
    drawn = np.array([np.hypot(*np.diff(p, axis=0).T).sum() for p in topomap.paths])
    return np.asarray(chord * (topomap.length / np.maximum(drawn, 1e-9))[:, None])


def embed_general(topomap: TopoMap, settings: EmbeddingSettings = DEFAULT_EMBEDDING) -> FloatArray:
    """(n, 2) positions [m] by least squares in SE(2): lengths, paths and headings together (§3.1).

    Raises nothing on a hard map: the solver's answer is the best it found.
    """
    graph = _graph(topomap, corridor_measurements(topomap, settings=settings))
    return solve(graph).pose[:, :2].copy()


def map_pose_graph(topomap: TopoMap) -> PoseGraph:
    """The vertices of a map as poses, its corridors as what the odometry measured between them.

    Headings are turns against the map's frame: all 0 where the map lies as it was drawn.
    """
    return _graph(topomap, odometry_measurements(topomap))


def _graph(topomap: TopoMap, parts: Measurements) -> PoseGraph:
    return PoseGraph(
        pose=np.column_stack([topomap.xy, np.zeros(len(topomap))]),
        source=parts.source,
        target=parts.target,
        measurement=parts.measurement,
        information=parts.information,
    )
