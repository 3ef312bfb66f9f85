"""Junctions and corridors of a saved grid, from the skeleton of its free space."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, NamedTuple

import numpy as np
from scipy import ndimage
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from ...topology.arrays import BoolArray, FloatArray, IntArray
from ...topology.se2 import wrap
from .crossing import Known, crossings, with_crossings
from .grid import GridSettings
from .skeleton import Edge, Node, SkeletonGraph, SkeletonSettings, thin, traced
from .skeleton_lines import Lines, labelled, lines_of


@dataclass(frozen=True, slots=True)
class FloorplanSettings:
    """How a grid's free space is converted to a graph."""

    skeleton: SkeletonSettings = field(default_factory=SkeletonSettings)
    island_m: float = GridSettings().island_m
    """Smaller isolated obstacles are removed first."""
    agree_m: float = 0.7
    """A variant agrees on a junction if it has one within this distance with as many branches."""

    @property
    def variants(self) -> tuple[SkeletonSettings, ...]:
        """The skeleton's settings and six variations, each in one parameter."""
        s = self.skeleton
        return (
            s,
            replace(s, clearance_m=0.8 * s.clearance_m),
            replace(s, clearance_m=1.3 * s.clearance_m),
            s.with_spurs(0.8),
            s.with_spurs(1.25),
            replace(s, join_m=0.75 * s.join_m),
            replace(s, join_m=1.3 * s.join_m),
        )


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """A place of a floor plan: xy: (2,) from the grid's corner [m]; branches: (b,) headings [rad],
    ascending; confidence: share of the variants that agree on the branches."""

    xy: FloatArray
    branches: FloatArray
    kind: Literal["junction", "dead_end"]
    confidence: float


@dataclass(frozen=True, slots=True, eq=False)
class Corridor:
    """A corridor between two places: their indices, the branch of each that it leaves by, and a
    polyline (k, 2) [m], k >= 2."""

    source: int
    target: int
    source_branch: int
    target_branch: int
    path: FloatArray


def skeleton_graph(
    free: BoolArray,
    resolution_m: float,
    settings: FloorplanSettings = FloorplanSettings(),
    frontier: BoolArray | None = None,
) -> tuple[tuple[Place, ...], tuple[Corridor, ...]]:
    """Places and corridors of free space (h, w), row 0 at the smallest y, column 0 at the smallest
    x.

    Every obstacle counts as wall; remove small islands first (`without_islands`). frontier: (h, w)
    free cells next to unknown ones; none by default. A corridor that ends without a junction gets a
    dead end. A corridor that leads into the unknown is a branch of its junction only. Loops without
    a junction are left out. Raises ValueError on a grid that is not two-dimensional or a resolution
    that is not positive. O(h w) per variant.
    """
    free = np.asarray(free, bool)
    if free.ndim != 2 or not resolution_m > 0:
        raise ValueError("a grid of two dimensions and a positive resolution are needed")
    if not free.any():
        return (), ()
    padded = np.pad(free, 1)
    clearance = ndimage.distance_transform_edt(padded) * resolution_m
    opening = _openings(frontier, clearance, resolution_m, 2 * settings.skeleton.clearance_m)
    lines: dict[float, Lines] = {}
    for s in settings.variants:
        if s.clearance_m not in lines:
            skeleton = thin(clearance > s.clearance_m)
            found = lines_of(skeleton, clearance, resolution_m, opening)
            lines[s.clearance_m] = _without_corners(found, opening, resolution_m)
    traced_from = [lines[s.clearance_m] for s in settings.variants]
    return _places(traced_from, clearance, opening, resolution_m, settings)


def _openings(
    frontier: BoolArray | None, clearance_m: FloatArray, cell_m: float, least_m: float
) -> BoolArray:
    """(h, w) cells at most as far from a frontier of width `least_m` as from any wall: corridors
    that end there continue beyond. frontier: without the border that clearance_m has."""
    out = np.zeros(clearance_m.shape, bool)
    if frontier is None:
        return out
    label, _ = labelled(np.pad(frontier, 1))
    for number, part in enumerate(ndimage.find_objects(label), start=1):
        if max(s.stop - s.start for s in part) * cell_m >= least_m:
            out[part] |= label[part] == number
    if not out.any():
        return out
    away = ndimage.distance_transform_edt(~out) * cell_m
    # Frontiers are free, walls are not; a way ends up to a cell before what it ends at.
    return np.asarray(clearance_m > 0) & (away <= clearance_m + cell_m)


def _without_corners(lines: Lines, opening: BoolArray, cell_m: float) -> Lines:
    """The lines, where those that fork in front of an opening into its two corners no longer count
    as leading to the border: the line that forks leads on, not they."""
    columns, rows = np.rint(lines.fork_xy / cell_m).astype(np.int64).T
    in_front = opening[rows, columns]
    ends = Counter(line for line, _ in lines.touching)
    corners = {line for line, fork in lines.touching if ends[line] == 1 and in_front[fork]}
    return replace(lines, border=lines.border - corners)


def _places(
    lines: list[Lines],
    clearance_m: FloatArray,
    opening: BoolArray,
    cell_m: float,
    settings: FloorplanSettings,
) -> tuple[tuple[Place, ...], tuple[Corridor, ...]]:
    """Places, with the agreement of the variants on them, and corridors. lines: of the skeleton
    under each of the variants; opening: see `_openings`."""
    known: Known = {}
    graph, own = with_crossings(
        traced(lines[0], settings.skeleton), clearance_m, cell_m, settings.skeleton, known=known
    )
    shown = []
    for found, variant in zip(lines[1:], settings.variants[1:], strict=True):
        other = traced(found, variant)
        every = crossings(other, range(len(other.nodes)), clearance_m, cell_m, variant, known=known)
        shown.append(list(every.places.values()))
    agreement = _agreement(own, shown, settings)
    # The middle of the padded grid's first cell lies half a cell before the corner.
    shift = np.array([-0.5, -0.5]) * cell_m
    places = [
        Place(place.xy + shift, place.headings, "junction", share)
        for place, share in zip(own, agreement, strict=True)
    ]
    corridors = []
    used = [[False] * len(node.ends) for node in graph.nodes]
    for number, (edge, way) in enumerate(zip(graph.edges, _polylines(graph, cell_m), strict=True)):
        if way is None:
            continue
        path, (source, target) = way, edge.nodes
        source_branch, target_branch = _take(graph, used, source, number), 0
        if target >= 0:
            target_branch = _take(graph, used, target, number)
        else:
            column, row = np.rint(way[-1] / cell_m).astype(np.int64)
            if opening[row, column]:
                continue
            target, path = len(places), _ended(way, clearance_m, cell_m)
            back = path[-min(len(path), 1 + round(1.0 / cell_m))] - path[-1]
            heading = wrap(np.array([np.arctan2(back[1], back[0])]))
            places.append(Place(path[-1] + shift, heading, "dead_end", 0.5))
        corridors.append(Corridor(source, target, source_branch, target_branch, path + shift))
    return tuple(places), tuple(corridors)


def _ended(path: FloatArray, clearance_m: FloatArray, cell_m: float) -> FloatArray:
    """A path into a dead end, cut at the centre of its widest part.

    Where exactly a skeleton ends in a room, and with what hook, is arbitrary. The widest part is
    the largest free disc around a cell of the path that contains the path's end.
    """
    columns, rows = np.rint(path.T / cell_m).astype(np.int64)
    clear = clearance_m[rows, columns]
    holds = np.hypot(*(path - path[-1]).T) <= clear
    peak = int(np.argmax(np.where(holds, clear, 0.0)))
    row, column, reached = rows[peak], columns[peak], clear[peak]
    around = np.arange(-int(reached / cell_m), int(reached / cell_m) + 1)
    wide = clearance_m[row + around[:, None], column + around] >= reached - cell_m
    wide &= np.hypot(around[:, None], around) * cell_m < reached
    corner = np.array([column, row]) + around[0]
    end = (np.argwhere(wide).mean(axis=0)[::-1] + corner) * cell_m
    nearest = int(np.argmin(np.hypot(*(path - end).T)))
    return np.concatenate([path[: max(nearest, 1)], end[None]])


def _take(graph: SkeletonGraph, used: list[list[bool]], node: int, edge: int) -> int:
    """The branch of a place that an edge leaves by; a ring leaves by two."""
    for branch, way in enumerate(graph.nodes[node].ends):
        if way == edge and not used[node][branch]:
            used[node][branch] = True
            return branch
    raise AssertionError("every way at a place is one of its branches")


def _agreement(
    places: Sequence[Node], shown: Sequence[Sequence[Node]], settings: FloorplanSettings
) -> list[float]:
    """Share of the variants, including the first one, that have each place of the first: within the
    tolerance, with as many branches. shown: places of the others."""
    own = _placed(places, settings)
    agreeing = np.ones(len(own))
    for others in shown:
        away, _ = cKDTree(_placed(others, settings)).query(own)
        agreeing += away <= settings.agree_m
    shares: list[float] = (agreeing / (1 + len(shown))).tolist()
    return shares


def _placed(places: Sequence[Node], settings: FloorplanSettings) -> FloatArray:
    """(n, 3) x, y [m], and a coordinate that separates places with different numbers of
    branches."""
    xy = np.array([place.xy for place in places]).reshape(-1, 2)
    branches = np.array([len(place.ends) for place in places])
    return np.column_stack([xy, 2 * settings.agree_m * branches])


def _polylines(graph: SkeletonGraph, cell_m: float) -> list[FloatArray | None]:
    """For each edge its cells in order, between the centres of its places; None if it has
    neither."""
    begun = [k for k, edge in enumerate(graph.edges) if edge.nodes[0] >= 0 and len(edge.cells)]
    ways = []
    for edge in (graph.edges[k] for k in begun):
        away = edge.away(graph.nodes[edge.nodes[0]].xy, cell_m)
        first = int(np.argmin(np.hypot(*away.T)))
        ways.append(_Way(edge.cells, first, edge.nodes[0] == edge.nodes[1]))
    chains = dict(zip(begun, _chains(ways), strict=True))
    return [_polyline(edge, graph, chains.get(k), cell_m) for k, edge in enumerate(graph.edges)]


def _polyline(
    edge: Edge, graph: SkeletonGraph, chain: IntArray | None, cell_m: float
) -> FloatArray | None:
    centres = [graph.nodes[node].xy[None] for node in edge.nodes if node >= 0]
    if edge.nodes[0] < 0 or (chain is None and len(centres) < 2):
        return None
    between = edge.cells[:0] if chain is None else edge.cells[chain]
    return np.concatenate([centres[0], between[:, ::-1] * cell_m, *centres[1:]])


class _Way(NamedTuple):
    """Cells (k, 2) of an edge, unordered, the index of the first one, and whether it is a ring."""

    cells: IntArray
    first: int
    ring: bool


def _chains(ways: list[_Way]) -> list[IntArray]:
    """For each edge the rows of its cells along the shortest path from the first to the farthest
    one.

    Neighbouring cells are connected; gaps left by removed nodes are bridged at a higher cost. All
    edges are components of one graph.
    """
    if not ways:
        return []
    cells = np.concatenate([way.cells for way in ways])
    size = np.array([len(way.cells) for way in ways])
    owner, begin = np.repeat(np.arange(len(ways)), size), np.cumsum(size) - size
    first = begin + [way.first for way in ways]
    # Ways lie in planes so far apart that no two are near each other.
    pairs = cKDTree(np.column_stack([cells, 8 * owner])).query_pairs(4.0, output_type="ndarray")
    gap = np.hypot(*(cells[pairs[:, 0]] - cells[pairs[:, 1]]).T)
    # The two ends of a ring come near each other at the place that they hang on.
    home = np.hypot(*(cells - cells[first[owner]]).T) < 8
    home &= np.array([way.ring for way in ways])[owner]
    across = (gap > 1.5) & home[pairs].all(axis=1)
    pairs, gap = pairs[~across], gap[~across]
    graph = coo_array((gap**3, (pairs[:, 0], pairs[:, 1])), shape=(len(cells),) * 2).tocsr()
    distance, before, _ = dijkstra(graph, False, first, return_predecessors=True, min_only=True)
    distance = np.where(np.isfinite(distance), distance, -1.0)
    steps, out = before.tolist(), []
    for k, start in enumerate(begin.tolist()):
        chain = [start + int(np.argmax(distance[start : start + size[k]]))]
        while chain[-1] != first[k]:
            chain.append(steps[chain[-1]])
        out.append(np.array(chain[::-1], np.int64) - start)
    return out
