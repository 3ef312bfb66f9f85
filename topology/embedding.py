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

from .passes import NO_BRANCH
from .posegraph import PoseGraph, solve
from .se2 import rotation
from .structure import grid_direction
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
    """Relative poses along the corridors of a map, with the noise of its odometry.

    step: (m, 2) displacement of every edge from source to target in the map's directions; by
    default of its path, drawn to its length. A heading that walks at random along a corridor turns
    its far end by sigma and its chord by sigma / sqrt(3).
    """
    given = _path_steps(topomap) if step is None else step
    keep = np.flatnonzero(topomap.source != topomap.target)  # a loop tells nothing of its junction
    along_step = given[keep]
    noise, length = topomap.noise, topomap.length[keep]
    times = np.sqrt(np.maximum(topomap.traversals[keep], 1))
    turn = np.maximum(noise.heading_rad_per_sqrt_m * np.sqrt(length) / times, settings.min_turn_rad)
    across = np.hypot(turn * length / np.sqrt(3.0), settings.across_m) ** -2.0
    along = np.hypot(topomap.length_sigma[keep], settings.across_m) ** -2.0
    bearing = np.arctan2(along_step[:, 1], along_step[:, 0])
    c, s = np.cos(bearing), np.sin(bearing)
    information = np.zeros((len(keep), 3, 3))
    information[:, 0, 0] = c * c * along + s * s * across
    information[:, 1, 1] = s * s * along + c * c * across
    information[:, 0, 1] = information[:, 1, 0] = c * s * (along - across)
    information[:, 2, 2] = turn**-2.0
    measured = np.column_stack([along_step, np.zeros(len(keep))])
    return Measurements(topomap.source[keep], topomap.target[keep], measured, information)


def _path_steps(topomap: TopoMap) -> FloatArray:
    """(m, 2) chord of every path, scaled so that the path has the length of the edge."""
    chord = np.array([p[-1] - p[0] for p in topomap.paths]).reshape(-1, 2)
    drawn = np.array([np.hypot(*np.diff(p, axis=0).T).sum() for p in topomap.paths])
    return np.asarray(chord * (topomap.length / np.maximum(drawn, 1e-9))[:, None])


def embed_general(topomap: TopoMap, settings: EmbeddingSettings = DEFAULT_EMBEDDING) -> FloatArray:
    """(n, 2) positions [m] by least squares in SE(2): lengths, paths and headings together (§3.1).

    Raises nothing on a hard map: the solver's answer is the best it found.
    """
    parts = corridor_measurements(topomap, settings=settings)
    start = np.column_stack([topomap.xy, np.zeros(len(topomap))])
    graph = PoseGraph(
        pose=start,
        source=parts.source,
        target=parts.target,
        measurement=parts.measurement,
        information=parts.information,
    )
    return solve(graph).pose[:, :2].copy()
