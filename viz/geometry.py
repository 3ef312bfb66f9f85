"""The geometry of pictures of a map: ribbons, branch arrows, thinned tracks, bounds. Independent of
the viewer."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

import numpy as np

from ..merge.change import Change
from ..merge.result import FusedMap
from ..topology.arrays import BoolArray, FloatArray, IntArray
from ..topology.polyline import way_of
from ..topology.topomap import Graph
from ..topology.turning_points import FRONTIER, TRACK_END, TURNING_POINT

Marker = Literal["circle", "triangle", "square", "diamond"]
"""Shapes of filled marks."""

MOST_NUMBERED = 150
"""Up to this many junctions their numbers are always shown; above, only for the one pointed at."""

WIDEST_RIBBON = 4
"""Largest width of a ribbon, in pens; with more runs its strands get thinner."""

SMALL, MEDIUM, LARGE = 1.0, 1.5, 2.2
"""Radii of dots in the viewer, in pens (`pen_m`): wide enough to cover a corridor's line, and told
apart by eye."""

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

MIN_SIDE_M = 4.0
"""Smallest side of a picture, or of a cell on a sheet: of a map of one junction."""

LINE_SHARE = 0.12
"""Largest width of a run's line in a merge over the median corridor: several lie side by side."""

MARGIN, SHEET_MARGIN = 0.05, 0.02
"""Margin around a map and around a sheet of maps, as shares of the extent."""


def pen_m(graphs: Sequence[Graph]) -> float:
    """Width of a corridor's line [m]: a share of the median corridor length over all maps of a
    sheet."""
    lengths = np.concatenate([*(g.length for g in graphs), np.zeros(0)])
    return float(np.clip(0.035 * np.median(lengths), 0.02, 2.0)) if len(lengths) else 0.2


def extent(graph: Graph) -> FloatArray:
    """(k, 2) the map's vertices and corridor points: what a picture has to hold [m]."""
    return np.concatenate([graph.xy, *graph.paths])


def branch_arrows(
    graph: Graph, chosen: BoolArray, length_m: float
) -> tuple[FloatArray, FloatArray]:
    """Origins and vectors, (k, 2) each [m], of arrows along the k chosen ones of all branches."""
    heading = graph.branches.values[chosen]
    vectors = length_m * np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    return graph.xy[graph.branches.owner[chosen]], vectors


def ribbons(paths: Sequence[FloatArray], offset_m: FloatArray) -> list[FloatArray]:
    """Polylines parallel to the given ones, (k, 2) each, offset to the left by `offset_m` (n,),
    with mitred corners.

    Repeated points are dropped. A path without extent, or with offset 0, is returned as it is. All
    paths are computed at once, concatenated.
    """
    owner = np.arange(len(paths)).repeat([len(path) for path in paths])
    points = np.concatenate([np.zeros((0, 2)), *paths])
    fresh = np.ones(len(points), np.bool_)
    fresh[1:] = (owner[1:] != owner[:-1]) | np.any(points[1:] != points[:-1], axis=1)
    points, owner = points[fresh], owner[fresh]
    within = owner[1:] == owner[:-1]
    x, y = (points[1:] - points[:-1])[within].T
    normal = np.stack([-y, x], axis=-1) / np.hypot(x, y)[:, None]
    before, after = np.zeros_like(points), np.zeros_like(points)
    before[1:][within], after[:-1][within] = normal, normal
    # A corner moves along its bisector, by at most twice the offset: no spikes at sharp turns.
    mean = before + after
    mean /= np.maximum(np.hypot(*mean.T), 1e-9)[:, None]
    cosine = np.ones(len(points))
    corner = np.flatnonzero(within[:-1] & within[1:]) + 1
    cosine[corner] = (mean[corner] * after[corner]).sum(axis=1)
    beside = points + offset_m[owner][:, None] * mean / np.maximum(cosine, 0.5)[:, None]
    size = np.bincount(owner, minlength=len(paths))
    stops = np.cumsum(size).tolist()
    moved = ((size > 1) & (offset_m != 0)).tolist()
    return [
        beside[stop - own : stop] if aside else path
        for path, aside, own, stop in zip(paths, moved, size.tolist(), stops, strict=True)
    ]


@dataclass(frozen=True, slots=True, eq=False)
class Strand:
    """One run's line of a fused corridor. share: its width, in pens."""

    edge: int
    run: str
    share: float
    path: FloatArray


def strands(fused: FusedMap, edges: IntArray, pen: float) -> list[Strand]:
    """The given fused corridors as parallel lines, one for each run that drove them, one `pen` wide
    or thinner where there are more than WIDEST_RIBBON runs."""
    rows = edges.tolist()
    runs = [sorted({run for run, _ in fused.edge_members[edge]}) for edge in rows]
    count = np.array([len(own) for own in runs], np.int64)
    share = np.minimum(1.0, WIDEST_RIBBON / np.maximum(count, 1))
    strand = np.arange(count.sum()) - (np.cumsum(count) - count).repeat(count)
    aside = (strand - (count.repeat(count) - 1) / 2) * pen * share.repeat(count)
    paths = [fused.paths[edge] for edge, own in zip(rows, runs, strict=True) for _ in own]
    whose = [
        (edge, run, part)
        for edge, own, part in zip(rows, runs, share.tolist(), strict=True)
        for run in own
    ]
    beside = ribbons(paths, aside)
    return [Strand(*known, path) for known, path in zip(whose, beside, strict=True)]


def changed_path(fused: FusedMap, edges: IntArray, change: Change) -> FloatArray:
    """(k, 2) the corridor, of its site's `edges`, that a change is about, or its junction alone."""
    if change.edge is None:
        return np.array([change.xy, change.xy])
    path: FloatArray = fused.paths[edges[change.edge]]
    return path


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
    *,
    apart: bool = False,
) -> list[tuple[FloatArray, str]]:
    """Where contradictions are drawn, (2,) each, and their texts. against: texts, and the junctions
    of a and of b that each concerns; of_a, of_b: their positions, (n, 2) each, in one frame.

    At a junction that the other run did not see, or amid two corridors that cross; of maps that are
    drawn apart on one of them.
    """
    spots = []
    for told, (a, b) in against:
        ends = [of[list(rows)] for of, rows in ((of_a, a), (of_b, b)) if len(rows)]
        shown = [points for points in ends if len(points) == 1] or ends
        spots.append((np.concatenate(shown[:1] if apart else shown).mean(axis=0), told))
    return spots
