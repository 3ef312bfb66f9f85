"""The walls of a world: corridors of one width, rooms at dead ends, doorways."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..topology.arrays import FloatArray, IntArray
from ..topology.frozen import freeze
from ..topology.polyline import densely, simplify
from ..topology.se2 import wrap
from .world import COORDINATE_M, ROOM_M, World, polyline_at

ROUND = 12
"""Most corners of a junction's polygon, and those of a round one."""

BEND_M = 0.02
"""Tolerance to which curved corridors are approximated by straight pieces."""

THINNEST_WALL_M = 0.15
"""Least thickness of a wall between rooms and corridors."""

DOORWAY_M = 0.25
"""Distance of a door into its corridor from the junction's polygon."""


@dataclass(frozen=True, slots=True, eq=False)
class Segments:
    """Straight walls from a (s, 2) to b (s, 2) [m]."""

    a: FloatArray
    b: FloatArray

    def __post_init__(self) -> None:
        freeze(self, np.float64, a=(None, 2), b=(len(self.a), 2))

    def __len__(self) -> int:
        return len(self.a)

    @property
    def length(self) -> FloatArray:
        """(s,) [m]."""
        return np.asarray(np.hypot(*(self.b - self.a).T))


def walls_of(world: World, corridor_m: float) -> Segments:
    """The outline of a world's free space: the edges of its parts where they lie within no other
    part. O(n log n)."""
    half = 0.5 * corridor_m
    parts = free_space(world, corridor_m)
    sides = [side for path in world.paths for side in _offset(simplify(path, BEND_M), half)]
    rings = [np.concatenate([room, room[:1]]) for room in parts[: len(world)]]
    edges = np.concatenate([_steps(line) for line in (*sides, *rings)])
    inside = _HalfPlanes.of(parts)
    left_over = [_outside(start, end, inside) for start, end in edges]
    a, b = np.concatenate(left_over).transpose(1, 0, 2)
    return Segments(a, b)


def free_space(world: World, corridor_m: float) -> list[FloatArray]:
    """Convex polygons (k, 2), counter-clockwise, whose union is the free space; the first n belong
    to the vertices.

    The polygon of a vertex is a square where all corridors meet at right angles, a room as large as
    its surroundings allow at a dead end, else round. The others are straight pieces of corridors.
    """
    half = 0.5 * corridor_m
    parts = [_junction(world, vertex, half) for vertex in range(len(world))]
    for path in world.paths:
        left, right = _offset(simplify(path, BEND_M), half)
        parts += [
            np.array([right[k], right[k + 1], left[k + 1], left[k]]) for k in range(len(left) - 1)
        ]
    return parts


def doorways(world: World, corridor_m: float) -> tuple[Segments, IntArray]:
    """Possible doors: a segment across each end of every corridor, with its corridor.

    A door is placed where the corridor no longer overlaps its neighbours at the junction.
    """
    half = 0.5 * corridor_m
    a, b, edges = [], [], []
    for edge in range(len(world.source)):
        for vertex in (int(world.source[edge]), int(world.target[edge])):
            if world.branches.counts[vertex] < 2:
                continue
            path = world.path_from(edge, vertex)
            way = half / np.tan(0.5 * min(_to_neighbour(world, edge, vertex), np.pi / 2))
            way = min(float(way) + DOORWAY_M, 0.4 * float(world.length[edge]))
            at = polyline_at(path, np.array([way, way + 0.05]))
            across = _left_of(at[1] - at[0])
            a.append(at[0] - half * across)
            b.append(at[0] + half * across)
            edges.append(edge)
    doors = Segments(np.array(a).reshape(-1, 2), np.array(b).reshape(-1, 2))
    return doors, np.array(edges, np.int64)


def _to_neighbour(world: World, edge: int, vertex: int) -> float:
    """Angle [rad] between a corridor and the next one at its vertex."""
    ends = world.ends(vertex)
    own = next(heading for e, _, heading in ends if e == edge)
    return min(abs(float(wrap(heading - own))) for e, _, heading in ends if e != edge)


def _junction(world: World, vertex: int, half: float) -> FloatArray:
    """(k, 2) convex polygon, counter-clockwise: the free space at a vertex."""
    headings, xy = world.branches[vertex], world.xy[vertex]
    if len(headings) == 1:
        room = max(half, _room_for(world, vertex, half))
        return _square(xy, room, float(headings[0]))
    if _at_right_angles(headings):
        return _square(xy, half, float(headings[0]))
    return _round(xy, half)


def _offset(path: FloatArray, half: float) -> tuple[FloatArray, FloatArray]:
    """The left and right sides of a corridor, with mitred corners."""
    normals = np.array([_left_of(step) for step in np.diff(path, axis=0)])
    at_bends = normals[:-1] + normals[1:]
    mitre = 2 * at_bends / np.sum(at_bends**2, axis=1)[:, None]
    across = half * np.concatenate([normals[:1], mitre, normals[-1:]])
    return path + across, path - across


def _steps(line: FloatArray) -> FloatArray:
    """(k - 1, 2, 2) the segments of a polyline."""
    return np.stack([line[:-1], line[1:]], axis=1)


def _left_of(step: FloatArray) -> FloatArray:
    """(2,) unit normal to the left of a step."""
    return np.asarray(np.array([-step[1], step[0]]) / np.hypot(*step))


def _round(centre: FloatArray, radius: float) -> FloatArray:
    angle = 2 * np.pi * np.arange(ROUND) / ROUND
    return centre + radius * np.round(np.column_stack([np.cos(angle), np.sin(angle)]), 12)


def _square(centre: FloatArray, half: float, heading: float) -> FloatArray:
    ahead = np.round(np.array([np.cos(heading), np.sin(heading)]), 12)
    left = np.array([-ahead[1], ahead[0]])
    corners = [(-1, -1), (1, -1), (1, 1), (-1, 1)]
    return np.array([centre + half * (u * ahead + v * left) for u, v in corners])


def _at_right_angles(headings: FloatArray) -> bool:
    quarter = np.asarray(wrap(4 * (headings - headings[0])))
    return bool(np.all(np.abs(quarter) < 4 * COORDINATE_M))


def _room_for(world: World, vertex: int, half: float) -> float:
    """Half the side of a room at a dead end that meets no other room or corridor."""
    here = world.xy[vertex]
    others = [
        float(np.min(np.hypot(*(densely(path, 0.5) - here).T)))
        for edge, path in enumerate(world.paths)
        if vertex not in (world.source[edge], world.target[edge])
    ]
    rooms = np.flatnonzero(world.branches.counts == 1)
    away = np.hypot(*(world.xy[rooms[rooms != vertex]] - here).T)
    own = float(world.length[world.branch_edge[world.branches.offsets[vertex]]])
    to_corridor = min([*others, own]) - half - THINNEST_WALL_M
    to_room = 0.5 * (float(away.min(initial=np.inf)) - THINNEST_WALL_M)
    # By its corners, which are √2 times as far out as its walls.
    return min(0.5 * ROOM_M, float(min(to_corridor, to_room) / np.sqrt(2)))


@dataclass(frozen=True, slots=True, eq=False)
class _HalfPlanes:
    """Convex polygons as outward normals (p, ROUND, 2) and offsets (p, ROUND), with bounding boxes.

    A point is inside if n·x ≤ c for all sides; missing sides are 0·x ≤ 1. The outline itself is not
    inside.
    """

    normal: FloatArray
    offset: FloatArray
    low: FloatArray
    high: FloatArray

    @classmethod
    def of(cls, polygons: list[FloatArray]) -> _HalfPlanes:
        normal, offset = np.zeros((len(polygons), ROUND, 2)), np.ones((len(polygons), ROUND))
        for k, polygon in enumerate(polygons):
            side = np.roll(polygon, -1, axis=0) - polygon
            outwards = np.column_stack([side[:, 1], -side[:, 0]]) / np.hypot(*side.T)[:, None]
            normal[k, : len(polygon)] = outwards
            offset[k, : len(polygon)] = np.sum(outwards * polygon, axis=1) - 1e-6
        low, high = (np.array([f(p, axis=0) for p in polygons]) for f in (np.min, np.max))
        return cls(normal, offset, low, high)


def _outside(start: FloatArray, end: FloatArray, inside: _HalfPlanes) -> FloatArray:
    """(k, 2, 2) the parts of a segment that lie in no polygon."""
    least, most = np.minimum(start, end), np.maximum(start, end)
    near = ((inside.low <= most) & (inside.high >= least)).all(axis=1)
    normal = inside.normal[near]
    depth = inside.offset[near] - normal @ start
    rate = normal @ (end - start)
    parallel = np.abs(rate) < 1e-12
    t = depth / np.where(parallel, 1.0, rate)
    t0 = np.max(np.where(~parallel & (rate < 0), t, 0.0), axis=1, initial=0.0)
    t1 = np.min(np.where(~parallel & (rate > 0), t, 1.0), axis=1, initial=1.0)
    hidden = (t0 < t1) & ~(parallel & (depth < 0)).any(axis=1)
    ends = np.array(_left_open(t0[hidden].tolist(), t1[hidden].tolist())).reshape(-1, 2, 1)
    parts: FloatArray = start + ends * (end - start)
    long = np.hypot(*(parts[:, 1] - parts[:, 0]).T) > COORDINATE_M
    return np.asarray(parts[long])


def _left_open(begins: list[float], ends: list[float]) -> list[tuple[float, float]]:
    """The parts of [0, 1] that the intervals do not cover."""
    at, left = 0.0, []
    for t0, t1 in sorted(zip(begins, ends, strict=True)):
        if t0 > at:
            left.append((at, t0))
        at = max(at, t1)
    return [*left, (at, 1.0)] if at < 1.0 else left
