"""Maps as lines and arrows: what a picture shows of a graph, without the viewer's types."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..topology.passes import NO_BRANCH
from ..topology.ragged import Ragged
from ..topology.se2 import wrap

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

SAME_BRANCH_RAD = 0.7
"""A corridor that does not say which branch it takes takes the nearest one within this angle."""

LEAVING_M = 1.5
"""A corridor's direction at its end is taken over this way."""

MOST_NUMBERED = 150
"""Above this many junctions their numbers hide more than they tell: pointing at them shows them."""

MARGIN, SHEET_MARGIN = 0.05, 0.02
"""Room around a map, and around a sheet of maps, which have room of their own: shares of it."""


class Graph(Protocol):
    """What a TopoMap and a FusedMap have in common; the fields are TopoMap's."""

    # ruff: noqa: D102
    @property
    def xy(self) -> FloatArray: ...
    @property
    def branches(self) -> Ragged: ...
    @property
    def source(self) -> IntArray: ...
    @property
    def target(self) -> IntArray: ...
    @property
    def source_branch(self) -> IntArray: ...
    @property
    def target_branch(self) -> IntArray: ...
    @property
    def length(self) -> FloatArray: ...
    @property
    def paths(self) -> tuple[FloatArray, ...]: ...


def pen_m(graphs: Sequence[Graph]) -> float:
    """The width of a corridor's line [m]: a share of the usual corridor, the same on one sheet."""
    lengths = np.concatenate([*(g.length for g in graphs), np.zeros(0)])
    return float(np.clip(0.035 * np.median(lengths), 0.02, 2.0)) if len(lengths) else 0.2


def driven_branches(graph: Graph) -> NDArray[np.bool_]:
    """(total branches,) whether a corridor of the map leaves by the branch.

    Ends that name no branch count for the nearest one in direction. O(branches + edges).
    """
    driven = np.zeros(len(graph.branches.values), bool)
    offsets = graph.branches.offsets
    for vertex, branch, step in (
        (graph.source, graph.source_branch, 1),
        (graph.target, graph.target_branch, -1),
    ):
        known = branch != NO_BRANCH
        driven[offsets[vertex[known]] + branch[known]] = True
        for edge in np.flatnonzero(~known).tolist():
            leaving = _leaving(graph.paths[edge][::step])
            gap = np.abs(wrap(graph.branches[int(vertex[edge])] - leaving))
            if len(gap) and gap.min() < SAME_BRANCH_RAD:
                driven[offsets[vertex[edge]] + int(gap.argmin())] = True
    return driven


def _leaving(path: FloatArray) -> float:
    """Direction in which a polyline leaves its first point [rad]."""
    away = path - path[0]
    far = np.hypot(away[:, 0], away[:, 1]) >= LEAVING_M
    x, y = away[int(far.argmax())] if far.any() else away[-1]
    return float(np.arctan2(y, x))


def branch_arrows(graph: Graph, length_m: float) -> tuple[FloatArray, FloatArray]:
    """Origins and vectors, (total branches, 2) each, of arrows along every branch."""
    heading = graph.branches.values
    vectors = length_m * np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    return graph.xy[graph.branches.owner], vectors


def ribbon(path: FloatArray, offset_m: float) -> FloatArray:
    """A polyline beside another one, `offset_m` to its left; corners are mitred.

    Points that repeat are dropped; a path of no extent comes back as it is.
    """
    if offset_m == 0.0:
        return path
    keep = np.concatenate([[True], np.any(np.diff(path, axis=0) != 0, axis=1)])
    points = path[keep]
    if len(points) < 2:
        return path
    along = np.diff(points, axis=0)
    normal = np.stack([-along[:, 1], along[:, 0]], axis=-1) / np.hypot(*along.T)[:, None]
    # A corner moves along the bisector; sharp ones are held so that they throw no spikes.
    first, last = normal[:1], normal[-1:]
    mean = np.concatenate([first, normal[:-1] + normal[1:], last])
    mean /= np.maximum(np.hypot(*mean.T), 1e-9)[:, None]
    cosine = np.concatenate([[1.0], (mean[1:-1] * normal[1:]).sum(axis=1), [1.0]])
    beside: FloatArray = points + offset_m * mean / np.maximum(cosine, 0.5)[:, None]
    return beside


def thinned(xy: FloatArray, spacing_m: float) -> IntArray:
    """Rows of a track to draw: those that enter a new multiple of `spacing_m` of way, the first
    and the last; all for a spacing of 0."""
    if len(xy) < 3 or spacing_m == 0:
        return np.arange(len(xy))
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(xy, axis=0).T))])
    step = np.floor(way / spacing_m)
    keep = np.concatenate([[True], step[1:] != step[:-1]])
    keep[-1] = True
    return np.flatnonzero(keep)


def bounds(points: Sequence[FloatArray], margin: float = MARGIN) -> tuple[FloatArray, FloatArray]:
    """Low and high corner (2,) around all points, with a margin given as a share of the extent."""
    joined = np.concatenate([*points, np.zeros((0, 2))])
    if len(joined) == 0:
        joined = np.zeros((1, 2))
    low, high = joined.min(axis=0), joined.max(axis=0)
    spare = margin * max(float((high - low).max()), 4.0)
    return low - spare, high + spare
