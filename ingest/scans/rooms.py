"""Doors and rooms of open space: its regions between the narrowest points of its skeleton.

A door is a critical point of the skeleton: clearance is least there, and rises on both sides
(Thrun, Learning metric-topological maps for indoor mobile robot navigation, Artificial Intelligence
99, 1998). The free disc around it touches the walls on both sides, and so cuts the free space. What
doors part is a region, as in the Voronoi segmentation of Bormann, Jordan, Li, Hampp and Hägele,
Room segmentation: survey, implementation, and analysis, ICRA 2016. A compact region is a room.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from ...topology.arrays import BoolArray, FloatArray, IntArray
from .crossing import crossing
from .grid import Labels
from .open_space import distances, nearest_cells
from .skeleton import Edge, Node, SkeletonGraph, SkeletonSettings
from .ways import Drivable, cheapest

WIDEST_M = 1.2
"""Widest door: single doors are up to 1.1 m wide. What is wider is often a gap between furniture,
or beside a pillar."""

RISE = 1.35
"""Clearance on both sides of a door, in those of the door: a door of 0.9 m in a corridor of 1.25 m
is one."""

DEEP_M = 2.0
"""Way within which clearance rises as much on both sides: a wall, and a leaf that stands open at
right angles. What is longer is a passage."""

COMPACT = 6.0
"""Largest area of a room, in those of its widest free disc: 2.5 of a room twice as long as wide, 6
of one of five times, or with furniture along its walls. Corridors have more."""


class Door(NamedTuple):
    """A door: edge of the skeleton, index of its cell along it, and half its width [m]."""

    edge: int
    at: int
    half_m: float


def doors(graph: SkeletonGraph) -> list[Door]:
    """The doors on the edges of a graph, in their order. O(cells of the skeleton)."""
    return [
        Door(number, at, half_m)
        for number, edge in enumerate(graph.edges)
        for at, half_m in _narrowest(graph, edge)
    ]


def _narrowest(graph: SkeletonGraph, edge: Edge) -> Iterator[tuple[int, float]]:
    """Index and clearance of the doors along an edge."""
    ends_m = [graph.nodes[node].clearance_m if node >= 0 else 0.0 for node in edge.nodes]
    cell_m = graph.cell_m
    cells = edge.cells
    if not len(cells):
        return
    r = np.concatenate([ends_m[:1], graph.clearance_m[tuple(cells.T)], ends_m[1:]])
    way = np.concatenate([[0.0, cell_m], np.hypot(*np.diff(cells, axis=0).T) * cell_m, [cell_m]])
    way = np.cumsum(way)
    for k in range(1, len(r) - 1):
        # The first cell of a level stretch stands for it.
        if r[k] > 0.5 * WIDEST_M or r[k] >= r[k - 1] or r[k] > r[k + 1]:
            continue
        wide = r >= RISE * r[k]
        before, after = np.flatnonzero(wide[:k]), np.flatnonzero(wide[k:])
        if not len(before) or not len(after):
            continue
        first, last = int(before[-1]), k + int(after[0])
        if way[last] - way[first] > DEEP_M or r[first:k].min() <= r[k] or r[k:last].min() < r[k]:
            continue
        level = first + 1 + np.flatnonzero(r[first + 1 : last] <= r[k] + 0.5 * cell_m)
        yield int(level[len(level) // 2]) - 1, float(r[k])


@dataclass(frozen=True, slots=True, eq=False)
class Regions:
    """Free space between doors. label: (h, w) region of each cell, 0 within the discs of doors, and
    for none; area_m2, (n + 1,): of each; centre: (n + 1, 2) middle of its widest part, x and y [m];
    clearance_m: (n + 1,) there; is_room: (n + 1,); boxes: n pairs of slices
    around them."""

    label: Labels
    area_m2: FloatArray
    centre: FloatArray
    clearance_m: FloatArray
    is_room: BoolArray
    boxes: list[tuple[slice, slice]]

    def of_node(self, graph: SkeletonGraph, number: int) -> int:
        """The region of a node: that of the first of its edges, up to a door."""
        node = graph.nodes[number]
        edge = graph.edges[node.ends[0]]
        return self.along(edge.cells if edge.nodes[0] == number else edge.cells[::-1])

    def along(self, cells: IntArray) -> int:
        """The region of a line (k, 2) that passes no door, 0 if it lies within their discs."""
        found = self.label[tuple(cells.T)]
        return int(found[np.argmax(found > 0)]) if len(found) else 0


def regions(graph: SkeletonGraph, found: Sequence[Door], robot_m: float) -> Regions:
    """The regions that doors part, of where a robot of radius `robot_m` can be: walls have gaps.

    Free cells as near to a region as that count in its area. O(h w).
    """
    clearance_m, cell_m = graph.clearance_m, graph.cell_m
    open_ = clearance_m > robot_m
    for door in found:
        _cut(open_, _cell(graph, door), door.half_m / cell_m + 1.0)
    # By four neighbours: no way leads past a corner of a disc.
    parts, count = ndimage.label(open_)
    nearest = nearest_cells(parts == 0)
    near = (clearance_m > 0) & (distances(nearest, cell_m) <= robot_m + cell_m)
    label: Labels = np.where(near, parts[tuple(nearest)], np.int32(0))
    del nearest  # it takes 8 bytes a cell
    inside = label > 0
    own, r = label[inside], clearance_m[inside]
    area = np.bincount(own, minlength=count + 1) * cell_m**2
    most = np.zeros(count + 1)
    np.maximum.at(most, own, r)
    inside[inside] = r > most[own] - cell_m
    (rows, columns), own = np.nonzero(inside), label[inside]
    size = np.maximum(np.bincount(own, minlength=count + 1), 1)
    centre = np.column_stack(
        [np.bincount(own, at, count + 1) / size * cell_m for at in (columns, rows)]
    )
    boxes = [(rows, columns) for rows, columns in ndimage.find_objects(label)]
    out = Regions(
        label, area.astype(np.float64), centre, most, area <= COMPACT * np.pi * most**2, boxes
    )
    out.is_room[:] &= _behind_doors(graph, found, out)
    return out


def _behind_doors(graph: SkeletonGraph, found: Sequence[Door], between: Regions) -> BoolArray:
    """(n + 1,) regions that a door parts from another one. What leads from a region back into it is
    a passage beside an obstacle."""
    out = np.zeros(len(between.is_room), bool)
    for door in found:
        cells = graph.edges[door.edge].cells
        sides = between.along(cells[door.at :: -1]), between.along(cells[door.at :])
        out[list(sides)] |= sides[0] != sides[1]
    out[0] = False
    return out


def _cut(free: BoolArray, cell: IntArray, radius: float) -> None:
    """Take a disc of cells out of a mask."""
    top, left = (max(int(k - radius), 0) for k in cell.tolist())
    box = np.s_[top : int(cell[0] + radius) + 2, left : int(cell[1] + radius) + 2]
    part = free[box]
    rows, columns = np.ogrid[: part.shape[0], : part.shape[1]]
    part &= np.hypot(rows + top - cell[0], columns + left - cell[1]) > radius


class Rooms(NamedTuple):
    """A skeleton with its doors and rooms as nodes: first nodes of the former graph, by number
    (`kept`), then rooms, then doors.

    area_m2: of each room; doors: the doors; behind: doors of each room; lost: number of doors of
    rooms that a robot cannot drive to.
    """

    graph: SkeletonGraph
    kept: list[int]
    area_m2: list[float]
    doors: list[Door]
    behind: list[list[int]]
    lost: int

    @property
    def first_door(self) -> int:
        """Number of the first door among the nodes."""
        return len(self.kept) + len(self.area_m2)


def with_rooms(
    graph: SkeletonGraph, opening: BoolArray, drivable: Drivable, settings: SkeletonSettings
) -> Rooms:
    """The graph cut at its doors; in rooms, ways from the middle to the doors, and to where the
    unknown begins, replace it.

    opening: (h, w) cells where the unknown begins.
    """
    cell_m, found = graph.cell_m, doors(graph)
    between = regions(graph, found, settings.clearance_m)
    rooms = np.flatnonzero(between.is_room).tolist()
    inside = [between.of_node(graph, k) for k in range(len(graph.nodes))]
    kept = [k for k, region in enumerate(inside) if not between.is_room[region]]
    room = {region: len(kept) + k for k, region in enumerate(rooms)}
    number = {k: room[region] for k, region in enumerate(inside) if region in room}
    number |= {k: new for new, k in enumerate(kept)} | {_NOTHING: _NOTHING}
    first = len(kept) + len(rooms)
    number |= {len(graph.nodes) + k: first + k for k in range(len(found))}
    edges: list[Edge] = []
    lost = 0
    for cells, ends in _parts(graph, found):
        one, two = (number[end] for end in ends)
        region = between.along(cells)
        if region not in room:
            edges.append(Edge((one, two), cells, _length_m(cells, cell_m)))
            continue
        for stop, cell in ((one, cells[0]), (two, cells[-1])):
            if stop >= first or (stop == _NOTHING and opening[tuple(cell)]):
                way = _way_in(between, region, cell, drivable)
                lost += way is None
                if way is not None:
                    edges.append(Edge((room[region], stop), way, _length_m(way, cell_m)))
    nodes = [graph.nodes[k] for k in kept]
    nodes += [Node(between.centre[r], float(between.clearance_m[r]), ()) for r in rooms]
    nodes += door_nodes(graph, found)
    ends_of: list[list[int]] = [[] for _ in nodes]
    for k, edge in enumerate(edges):
        for node in edge.nodes:
            if node != _NOTHING:
                ends_of[node].append(k)
    cut = replace(graph, edges=tuple(edges))
    crossed = tuple(
        crossing(cut, Node(node.xy, node.clearance_m, tuple(ways)), settings)
        for node, ways in zip(nodes, ends_of, strict=True)
    )
    behind = [
        [end - first for k in ends_of[room[r]] for end in edges[k].nodes if end >= first]
        for r in rooms
    ]
    area = between.area_m2[rooms].tolist()
    return Rooms(replace(cut, nodes=crossed), kept, area, found, behind, lost)


def door_nodes(graph: SkeletonGraph, found: Sequence[Door]) -> list[Node]:
    """Doors of a graph as nodes of two branches."""
    return [
        Node(
            np.asarray(_cell(graph, door)[::-1] * graph.cell_m, np.float64),
            door.half_m,
            (door.edge, door.edge),
        )
        for door in found
    ]


_NOTHING = -1
"""In place of a node, where an edge ends without one."""


def _parts(
    graph: SkeletonGraph, found: Sequence[Door]
) -> Iterator[tuple[IntArray, tuple[int, int]]]:
    """Cells of every edge between doors, and what it leads from and to: nodes, then doors by their
    numbers after those of the nodes."""
    own: list[list[int]] = [[] for _ in graph.edges]
    for k, door in enumerate(found):
        own[door.edge].append(k)
    for edge, those in zip(graph.edges, own, strict=True):
        stops = [edge.nodes[0], *(len(graph.nodes) + k for k in those), edge.nodes[1]]
        cuts = [0, *(found[k].at for k in those), len(edge.cells) - 1]
        for (begin, end), ends in zip(pairwise(cuts), pairwise(stops), strict=True):
            forward = ends[0] != _NOTHING
            cells = edge.cells[begin : end + 1]
            yield (cells, ends) if forward else (cells[::-1], ends[::-1])


def _way_in(between: Regions, region: int, cell: IntArray, drivable: Drivable) -> IntArray | None:
    """Cells (k, 2) of the cheapest way from the middle of a region to a cell at its border, None
    if there is none."""
    box = between.boxes[region - 1]
    reach = int(WIDEST_M / drivable.cell_m)
    low = np.maximum(np.minimum([s.start for s in box], cell - reach), 0)
    high = np.maximum([s.stop for s in box], cell + reach + 1)
    whole = np.s_[low[0] : high[0], low[1] : high[1]]
    # The disc of the door belongs to no region.
    label = between.label[whole]
    within = (label == region) | (label == 0) & drivable.cells[whole]
    begin = drivable.moved(between.centre[region])
    end = cell[::-1] * drivable.cell_m
    return cheapest(np.array([begin, end]), drivable, within, (int(low[0]), int(low[1])))


def _cell(graph: SkeletonGraph, door: Door) -> IntArray:
    cell: IntArray = graph.edges[door.edge].cells[door.at]
    return cell


def _length_m(cells: IntArray, cell_m: float) -> float:
    return float(np.hypot(*np.diff(cells, axis=0).T).sum() * cell_m)
