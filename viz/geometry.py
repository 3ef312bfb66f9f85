"""The geometry of pictures of a map: pens, ribbons, branch arrows, bounds. Independent of what
draws it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import Literal

import numpy as np

from ..merge.result import FusedMap
from ..topology.arrays import BoolArray, FloatArray, IntArray
from ..topology.polyline import way_of
from ..topology.topomap import Graph
from ..topology.turning_points import FRONTIER, TRACK_END, TURNING_POINT
from .palette import RING

Marker = Literal["circle", "triangle", "square", "diamond"]
"""Shapes of filled marks, by the names that Bokeh has for them."""

MOST_NUMBERED = 150
"""Up to this many junctions their numbers are always shown; above, only for the one pointed at."""

WIDEST_RIBBON = 4
"""Largest width of a ribbon, in pens; of more runs the strands are thinner."""

PENS = 10
"""A corridor of usual length is drawn at least so many pens long."""

TURNED = {
    TURNING_POINT: "the robot turned round",
    TRACK_END: "a log begins or ends",
    FRONTIER: "unknown beyond",
}
"""What is there where the track leads to no junction."""

TURNED_MARKERS: Mapping[str, Marker] = MappingProxyType(
    {TURNING_POINT: "triangle", TRACK_END: "square", FRONTIER: "diamond"}
)
"""Its mark, a red one."""

ROOM_MARKERS: Mapping[str, Marker] = MappingProxyType({"room": "square", "door": "diamond"})
"""Marks of the places of saved maps of homes. Junctions, dead ends and bends are circles."""

FINEST_M = 0.05
"""Lines are drawn with as few points as stay within it of the whole line, tracks with no more than
one on such a way [m]."""

MIN_SIDE_M = 4.0
"""Smallest side of a picture, or of a cell on a sheet: of a map of one junction."""

MARGIN = 0.05
"""Margin around a picture, as a share of its extent."""


def usual_m(lengths: FloatArray) -> float:
    """The median length of corridors [m], which tells how large a map is drawn; 1 without any."""
    return float(np.median(lengths)) if len(lengths) else 1.0


def pen_m(graph: Graph) -> float:
    """Width of a corridor's line in the viewer [m], thin, as one zooms in there."""
    return usual_m(graph.length) / (3 * PENS)


def extent(graph: Graph) -> FloatArray:
    """(k, 2) the map's vertices and corridor points: what a picture has to hold [m]."""
    return np.concatenate([graph.xy, *graph.paths])


def between(graph: Graph, ends: tuple[int, int]) -> list[FloatArray]:
    """The corridors, (k, 2) each [m], between two junctions."""
    rows = np.stack([graph.source, graph.target], axis=1)
    own = np.all(np.sort(rows, axis=1) == sorted(ends), axis=1)
    return [graph.paths[k] for k in np.flatnonzero(own).tolist()]


def branch_arrows(graph: Graph, chosen: BoolArray, pen: float) -> tuple[FloatArray, FloatArray]:
    """Origins and vectors, (k, 2) each [m], of arrows along the k chosen ones of all branches: a
    ring's width long. pen: width of a corridor's line [m]."""
    heading = graph.branches.values[chosen]
    vectors = RING * pen * np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    return graph.xy[graph.branches.owner[chosen]], vectors


def beside(path: FloatArray, offset_m: float) -> FloatArray:
    """A polyline (k, 2) parallel to one, offset to the left, with mitred corners and without
    repeated points; that itself if it has no extent."""
    points = path[np.r_[True, np.any(path[1:] != path[:-1], axis=1)]]
    if len(points) < 2 or offset_m == 0:
        return path
    step = np.diff(points, axis=0)
    normal = np.stack([-step[:, 1], step[:, 0]], axis=-1) / np.hypot(*step.T)[:, None]
    before, after = np.concatenate([normal[:1], normal]), np.concatenate([normal, normal[-1:]])
    # A corner moves along its bisector, by at most twice the offset: no spikes at sharp turns.
    mean = before + after
    mean /= np.maximum(np.hypot(*mean.T), 1e-9)[:, None]
    cosine = (mean * after).sum(axis=1)
    return np.asarray(points + offset_m * mean / np.maximum(cosine, 0.5)[:, None])


def strands(
    fused: FusedMap, edges: IntArray, pen: float
) -> dict[tuple[str, float], dict[int, FloatArray]]:
    """The given fused corridors as parallel lines (k, 2), one for each run that drove them, by run
    and width in pens: 1, or less where there are more than WIDEST_RIBBON runs. pen: width of a
    corridor's line [m]."""
    found: dict[tuple[str, float], dict[int, FloatArray]] = {}
    for edge in edges.tolist():
        runs = sorted({run for run, _ in fused.edge_members[edge]})
        pens = min(1.0, WIDEST_RIBBON / max(len(runs), 1))
        for k, run in enumerate(runs):
            aside = pens * pen * (k - (len(runs) - 1) / 2)
            found.setdefault((run, pens), {})[edge] = beside(fused.paths[edge], aside)
    return dict(sorted(found.items()))


def thinned(xy: FloatArray, spacing_m: float) -> IntArray:
    """Indices of the track's points to draw, about `spacing_m` of path apart, with the first and
    the last one; all for a spacing of 0."""
    if len(xy) < 3 or spacing_m == 0:
        return np.arange(len(xy))
    step = np.floor(way_of(xy) / spacing_m)
    keep = np.concatenate([[True], step[1:] != step[:-1]])
    keep[-1] = True
    return np.flatnonzero(keep)


def bounds(points: Sequence[FloatArray], margin: float = MARGIN) -> tuple[FloatArray, FloatArray]:
    """Low and high corner (2,) around all points, with a margin as a share of the extent, which
    counts at least MIN_SIDE_M."""
    joined = np.concatenate([*points, np.zeros((0, 2))])
    if len(joined) == 0:
        joined = np.zeros((1, 2))
    low, high = joined.min(axis=0), joined.max(axis=0)
    spare = margin * max(float((high - low).max()), MIN_SIDE_M)
    return low - spare, high + spare


def contradiction_spots(
    against: Iterable[tuple[str, tuple[Sequence[int], Sequence[int]]]],
    of_a: FloatArray,
    of_b: FloatArray,
) -> list[tuple[FloatArray, str]]:
    """Where contradictions are drawn, (2,) each, and their texts. against: texts, and the junctions
    of a and of b that each concerns; of_a, of_b: their positions, (n, 2) each, in one frame.

    At a junction that the other run did not see, or amid two corridors that cross.
    """
    spots = []
    for text, (a, b) in against:
        ends = [of[list(rows)] for of, rows in ((of_a, a), (of_b, b)) if len(rows)]
        shown = [points for points in ends if len(points) == 1] or ends
        spots.append((np.concatenate(shown).mean(axis=0), text))
    return spots
