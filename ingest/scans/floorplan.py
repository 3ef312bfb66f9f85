"""Junctions and corridors of a saved grid, from the skeleton of its free space."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from ...topology.arrays import BoolArray, Float32Array, FloatArray, IntArray
from ...topology.polyline import leaving_over, way_of
from ...topology.se2 import wrap
from .crossing import crossings, with_crossings
from .grid import GridSettings, extents, labelled
from .junctions import JUNCTIONS
from .open_space import Lattice, OpenSpace, distance, wall_yaw
from .rooms import Rooms, door_nodes, doors, with_rooms
from .skeleton import Edge, Node, SkeletonGraph, SkeletonSettings, thin, traced
from .skeleton_lines import Lines, lines_of
from .ways import Drivable, drivable_way


@dataclass(frozen=True, slots=True)
class FloorplanSettings:
    """How a grid's free space is converted to a graph."""

    skeleton: SkeletonSettings = field(
        default_factory=lambda: SkeletonSettings(spur_m=0.6, border_m=0.2, axes_m=1.25)
    )
    """clearance_m is the robot's radius; corridors are up to 2.5 m wide, wider ones are halls; a
    way into the unknown needs to show some corridor: walls have gaps."""
    island_m: float = GridSettings().island_m
    """Smaller isolated obstacles are driven round, but make no junctions."""
    agree_m: float = JUNCTIONS.together_m
    """A variant agrees on a junction if it has one within this distance with as many branches."""
    unknown_m: float = 0.5
    """In one variant as much of the free space beside the unknown is unknown, too: junctions
    that change by it depend on what was not explored."""

    @classmethod
    def of_robot(cls, radius_m: float) -> FloorplanSettings:
        """The usual settings for a robot of this radius."""
        usual = cls()
        return replace(usual, skeleton=replace(usual.skeleton, clearance_m=radius_m))

    @property
    def among_pillars(self) -> FloorplanSettings:
        """The same, where all obstacles make junctions, as near to each other as these are."""
        near = replace(self.skeleton, join_m=0.5 * self.skeleton.join_m)
        return replace(self, skeleton=near, island_m=0.0)

    @property
    def through_narrow_doors(self) -> FloorplanSettings:
        """The same for a robot of half the radius: a map was recorded by something that passed."""
        return FloorplanSettings.of_robot(0.5 * self.skeleton.clearance_m)

    @property
    def variants(self) -> tuple[tuple[float, SkeletonSettings], ...]:
        """Six variations, each in one parameter: how far [m] the unknown reaches into the free
        space, and of the skeleton."""
        s = self.skeleton
        return (
            *((0.0, other) for other in s.variants),
            (0.0, replace(s, join_m=1.3 * s.join_m)),
            (self.unknown_m, s),
        )


FEW_JUNCTIONS = 4
"""Plans with fewer are homes and single halls, in which rooms and doors are the places. Elsewhere
doors are open in one recording and shut in the next, so that rooms come back less often than
junctions: with them 67 instead of 91 pairs of 14 recordings of a floor are merged."""

HOME_M2 = 100.0
"""Free area below which a plan is one of a home, whatever its junctions: their number differs
between recordings. Of twice 40 random homes 37 instead of 31 merge, 0 of 6,240 other pairs do. The
recorded floors have 135 m² and more."""

Kind = Literal["junction", "room", "door", "dead_end", "frontier"]


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """A place of a floor plan: xy: (2,) from the grid's corner [m]; branches: (b,) headings [rad],
    ascending; kind: "frontier" where a way leads on into the unknown; confidence: share of the
    variants that agree on the branches; area_m2: of a room, width_m: of a door, None of others."""

    xy: FloatArray
    branches: FloatArray
    kind: Kind
    confidence: float
    area_m2: float | None = None
    width_m: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Corridor:
    """A corridor between two places: their indices, the branch of each that it leaves by, and a way
    that a robot can drive: a polyline (k, 2) [m], k >= 2, and its length [m]."""

    source: int
    target: int
    source_branch: int
    target_branch: int
    path: FloatArray
    length_m: float


class Floorplan(NamedTuple):
    """Places and the corridors between them; blocked: number of corridors left out because a robot
    cannot drive them."""

    places: tuple[Place, ...]
    corridors: tuple[Corridor, ...]
    blocked: int = 0


class Ground(NamedTuple):
    """What plans of a grid by all settings have in common: its open space, (h, w) the distance of
    frontiers [m], and the direction of walls [rad]."""

    space: OpenSpace
    unknown_m: Float32Array
    yaw: float

    @classmethod
    def of(
        cls, free: BoolArray, frontier: BoolArray, resolution_m: float, radius_m: float
    ) -> Ground:
        """Of free cells (h, w), row 0 at the smallest y, column 0 at the smallest x, and those of
        them next to unknown ones; frontiers are as wide as a robot of this radius."""
        free, frontier = (np.pad(np.asarray(cells, bool), 1) for cells in (free, frontier))
        return cls(
            OpenSpace.of(free, resolution_m),
            _unknown_m(frontier, resolution_m, 2 * radius_m),
            wall_yaw(free, frontier, resolution_m),
        )


def plan(ground: Ground, settings: FloorplanSettings) -> Floorplan:
    """Places and corridors of a grid.

    A corridor that ends without a junction gets a dead end; one that leads into the unknown ends at
    a frontier, if it leads farther than the disc around its junction. Loops without a junction are
    left out. O(h w log(h w)).
    """
    if not ground.space.free.any():
        return Floorplan((), ())
    base, lattice = _axes(ground, settings)
    graph = with_crossings(base.graph(settings.skeleton), settings.skeleton)
    if not graph.nodes and not doors(graph):
        return Floorplan((), ())
    area_m2 = np.count_nonzero(ground.space.free) * ground.space.cell_m**2
    if len(graph.nodes) < FEW_JUNCTIONS or area_m2 < HOME_M2:
        rooms = with_rooms(graph, base.opening(), base.drivable, settings.skeleton)
    else:
        rooms = Rooms(graph, [*range(len(graph.nodes))], [], [], [], 0)
    own = [*(graph.nodes[k] for k in rooms.kept), *rooms.graph.nodes[rooms.first_door :]]
    others = []
    for unknown_m, skeleton in settings.variants if own else ():
        other = (base.less(unknown_m) if unknown_m else base).graph(skeleton)
        places = crossings(other, range(len(other.nodes)), skeleton).places
        others.append(list(places.values()))
        if rooms.doors:
            others[-1] += door_nodes(other, doors(other))
    known = _known_places(rooms, _agreement(own, others, settings), base.drivable)
    found = _floorplan(rooms.graph, known, base)
    found = found._replace(blocked=found.blocked + rooms.lost)
    return _from_corner(found, lattice, ground.space.cell_m)


CELL_M = 0.05
"""Cells that finer grids are joined to, and those of the lattice that skeletons are traced in,
whatever those of the grid: most maps are saved in these. A robot's radius has five; finer ones show
more of the walls' roughness, which is no part of the plan."""

FINER = 3
"""The lattice's cells are at most so many times smaller than the grid's: there is no more in it."""

MOST_CELLS = 1 << 22
"""Most cells of a grid, and of the lattice, whose distance from walls is measured: 100 by 100 m."""

MOST_PEELED = 1 << 27
"""Thinning visits all cells for every layer of the widest open space. This many visits take half a
second; wider spaces are traced in larger cells."""


def _unknown_m(frontier: BoolArray, cell_m: float, least_m: float) -> Float32Array:
    """(h, w) distance from frontiers of width `least_m` or more [m]; larger than the
    grid if there are none."""
    label, _ = labelled(frontier)
    wide = (label > 0) & (extents(label) * cell_m >= least_m)[label]
    if not wide.any():
        return np.full(wide.shape, sum(wide.shape) * cell_m, np.float32)
    return distance(~wide, cell_m)


@dataclass(frozen=True, slots=True, eq=False)
class _Axes:
    """The skeletons of an open space, in the cells of a lattice.

    clearance_m, unknown_m: (h, w) distances of walls, and of frontiers; drivable: where the robot
    can drive; lines: of the skeletons traced so far, by least clearance [m].
    """

    clearance_m: Float32Array
    unknown_m: Float32Array
    drivable: Drivable
    lines: dict[float, Lines] = field(default_factory=dict)

    def opening(self, cells: tuple[IntArray, IntArray] | slice = np.s_[:]) -> BoolArray:
        """Whether all or some cells are at most as far from a frontier as from any wall: corridors
        lead on into the unknown there. A way ends up to a cell before what it ends at."""
        clearance_m = self.clearance_m[cells]
        return np.asarray((clearance_m > 0) & (self.unknown_m[cells] <= clearance_m + self.cell_m))

    @property
    def cell_m(self) -> float:
        """Side of a cell of the lattice."""
        return self.drivable.cell_m

    def less(self, unknown_m: float) -> _Axes:
        """The same, if cells as near to a frontier as this were unknown, too."""
        clearance_m = np.minimum(self.clearance_m, self.unknown_m - np.float32(unknown_m))
        return _Axes(clearance_m, self.unknown_m, self.drivable)

    def graph(self, settings: SkeletonSettings) -> SkeletonGraph:
        """The graph of where there is the clearance of the settings."""
        least_m = settings.clearance_m
        if least_m not in self.lines:
            skeleton = thin(self.clearance_m > least_m)
            opening = self.opening()
            lines = lines_of(skeleton, self.clearance_m, self.cell_m, opening)
            self.lines[least_m] = _without_corners(lines, opening, self.cell_m)
        return traced(self.lines[least_m], settings)


def _axes(ground: Ground, settings: FloorplanSettings) -> tuple[_Axes, Lattice]:
    """The axes for a robot, and the lattice that they are traced in."""
    space, radius_m = ground.space, settings.skeleton.clearance_m
    clearance_m = space.clearance_m(radius_m, settings.island_m)
    area, wide_m = clearance_m.size * space.cell_m**2, float(clearance_m.max())
    peeled_m = (area * wide_m / MOST_PEELED) ** (1 / 3)
    cell_m = max(CELL_M, space.cell_m / FINER, peeled_m, (area / MOST_CELLS) ** 0.5)
    lattice = Lattice.along(ground.yaw, clearance_m.shape, space.cell_m, cell_m)
    # Without islands or specks they are one array.
    fields = clearance_m, space.room_m, space.all_m
    distinct = {id(values): values for values in fields}
    own = {key: lattice.of(values, space.cell_m) for key, values in distinct.items()}
    clearance_m, room_m, all_m = (own[id(values)] for values in fields)
    drivable = Drivable.of(room_m, all_m, radius_m, cell_m)
    return _Axes(clearance_m, lattice.of(ground.unknown_m, space.cell_m), drivable), lattice


def _without_corners(lines: Lines, opening: BoolArray, cell_m: float) -> Lines:
    """The lines, with spurs left out of `border`: in front of an opening a line forks towards both
    of its corners, but only the line itself leads on. opening: (h, w) cells."""
    columns, rows = np.rint(lines.fork_xy / cell_m).astype(np.int64).T
    in_front = opening[rows, columns]
    forks = lines.ends.max(axis=1)
    single = (lines.ends > 0).sum(axis=1) == 1
    corners = set(np.flatnonzero(single & in_front[forks]).tolist())
    return replace(lines, border=lines.border - corners)


def _known_places(rooms: Rooms, agreement: Sequence[float], drivable: Drivable) -> list[Place]:
    """A place for every node. agreement: of the junctions, and of the doors after them. A room is
    as sure as the least sure one of its doors."""
    junctions = len(rooms.kept)
    at_doors = agreement[junctions:]
    kinds: list[tuple[Kind, float, float | None, float | None]] = [
        *(("junction", share, None, None) for share in agreement[:junctions]),
        *(
            ("room", min((at_doors[k] for k in behind), default=1.0), area, None)
            for behind, area in zip(rooms.behind, rooms.area_m2, strict=True)
        ),
        *(
            ("door", share, None, 2 * door.half_m)
            for door, share in zip(rooms.doors, at_doors, strict=True)
        ),
    ]
    return [
        Place(drivable.moved(node.xy), node.headings, *kind)
        for node, kind in zip(rooms.graph.nodes, kinds, strict=True)
    ]


HEADING_M = 1.0
"""Distance from a dead end at which the heading of its one branch is measured."""


def _floorplan(graph: SkeletonGraph, known: Sequence[Place], axes: _Axes) -> Floorplan:
    """Places, and the ways between them that can be driven, from the corner of the lattice.

    known: a place for every node.
    """
    places = list(known)
    corridors, blocked = [], 0
    for number, edge in enumerate(graph.edges):
        source, target = edge.nodes
        line = _polyline(edge, graph.nodes, axes.cell_m)
        if line is None:
            continue
        source_branch, target_branch = graph.nodes[source].ends.index(number), 0
        line[0] = places[source].xy
        if target >= 0:
            # A ring comes back by another branch.
            ends = graph.nodes[target].ends
            target_branch = len(ends) - 1 - ends[::-1].index(number)
            line[-1] = places[target].xy
        else:
            kind, line = _ended(line, axes)
            if kind == "frontier" and way_of(line)[-1] <= graph.nodes[source].clearance_m:
                continue
        # Within the distance of the walls from each of its points.
        reach_m = axes.clearance_m[axes.drivable.at(line)].astype(np.float64)
        way = drivable_way(line, axes.drivable, reach_m)
        if way is None:
            blocked += 1
            continue
        if target < 0:
            target = len(places)
            heading = wrap(np.array([leaving_over(way.path[::-1], HEADING_M)]))
            places.append(Place(way.path[-1], heading, kind, 0.5))
        corridors.append(Corridor(source, target, source_branch, target_branch, *way))
    return Floorplan(tuple(places), tuple(corridors), blocked)


def _from_corner(plan: Floorplan, lattice: Lattice, cell_m: float) -> Floorplan:
    """A floor plan from the corner of its lattice, from that of the grid."""
    # The middle of the padded grid's first cell lies half a cell before the corner.
    shift = np.array([-0.5, -0.5]) * cell_m
    places = []
    for place in plan.places:
        headings = np.asarray(wrap(place.branches + lattice.yaw))
        places.append(replace(place, xy=lattice.out(place.xy) + shift, branches=headings))
    corridors = [replace(c, path=lattice.out(c.path) + shift) for c in plan.corridors]
    return plan._replace(places=tuple(places), corridors=tuple(corridors))


def _polyline(edge: Edge, nodes: Sequence[Node], cell_m: float) -> FloatArray | None:
    """(k, 2) points [m] of an edge, from the centre of its first node to that of the other, or to
    the free end; None if it has no node, or one node and no cells."""
    source, target = edge.nodes
    if source < 0 or (len(edge.cells) == 0 and target < 0):
        return None
    points = edge.cells[:, ::-1] * cell_m
    half = len(points) // 2 if source == target else len(points)
    begin, end = nodes[source].xy, nodes[target].xy
    first = int(np.argmin(np.hypot(*(points[:half] - begin).T))) if half else 0
    if target < 0:
        return np.concatenate([begin[None], points[first:]])
    later = max(first, half if source == target else 0)
    last = later + int(np.argmin(np.hypot(*(points[later:] - end).T))) if half else 0
    return np.concatenate([begin[None], points[first : last + 1], end[None]])


def _ended(line: FloatArray, axes: _Axes) -> tuple[Literal["dead_end", "frontier"], FloatArray]:
    """What a line ends at, and the line up to there."""
    cells = axes.drivable.at(line)
    opening = axes.opening(cells)
    if opening[-1]:
        before = np.flatnonzero(~opening)
        return "frontier", line[: max(2, int(before[-1]) + 2 if len(before) else 2)]
    line = _to_widest(line, axes.clearance_m, axes.cell_m)
    line[-1] = axes.drivable.moved(line[-1])
    return "dead_end", line


def _to_widest(path: FloatArray, clearance_m: Float32Array, cell_m: float) -> FloatArray:
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


def _agreement(
    places: Sequence[Node], shown: Sequence[Sequence[Node]], settings: FloorplanSettings
) -> list[float]:
    """Share of the variants, including the first one, that have each place of the first: within the
    tolerance, with as many branches. shown: places of the others."""
    own = _search_points(places, settings)
    agreeing = np.ones(len(own))
    for others in shown:
        away, _ = cKDTree(_search_points(others, settings)).query(own)
        agreeing += away <= settings.agree_m
    shares: list[float] = (agreeing / (1 + len(shown))).tolist()
    return shares


def _search_points(places: Sequence[Node], settings: FloorplanSettings) -> FloatArray:
    """(n, 3) points for a k-d tree: x, y [m], and a coordinate that keeps places with different
    numbers of branches farther apart than `agree_m`."""
    xy = np.array([place.xy for place in places]).reshape(-1, 2)
    branches = np.array([len(place.ends) for place in places])
    return np.column_stack([xy, 2 * settings.agree_m * branches])
