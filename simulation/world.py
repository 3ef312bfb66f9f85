"""Worlds: junctions in the plane, connected by corridors."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence, Set
from dataclasses import dataclass, field

import numpy as np

from ..topology.arrays import FloatArray, IntArray
from ..topology.connected import connected
from ..topology.frozen import freeze, frozen_rows
from ..topology.polyline import way_of
from ..topology.ragged import Ragged
from ..topology.se2 import wrap

BRANCH_REACH_M = 0.7
"""A branch's heading points to its corridor at this distance."""

CLEAR_M = 2.2
"""Where a robot turns round, and the detector invents junctions, in a corridor: at least this far
from its end."""

COORDINATE_DECIMALS = 3
COORDINATE_M: float = 10**-COORDINATE_DECIMALS
"""Coordinates are rounded to millimetres, so that worlds are the same on every processor."""

ROOM_M = 3.0
"""Depth of rooms, and distance between aisles of rows."""

STRAIGHT_RAD = 0.05
"""Largest deviation from straight at which a vertex of two straight corridors is no junction."""

Link = tuple[int, int, FloatArray]
"""Two vertices and the polyline (k, 2) between them, from which worlds are built."""


@dataclass(frozen=True, slots=True, eq=False)
class World:
    """A connected multigraph of `n` junctions and `m` corridors without self-loops.

    xy: (n, 2) [m]; source, target: (m,); paths: m polylines (k, 2) from source to target. Derived:
    length (m,) [m]; branches: n rows of headings [rad], ascending in [-pi, pi); branch_edge,
    branch_other: for every value of `branches` its corridor and the vertex at the other end. Raises
    ValueError on inconsistent parts.
    """

    name: str
    kind: str
    xy: FloatArray
    source: IntArray
    target: IntArray
    paths: tuple[FloatArray, ...]
    length: FloatArray = field(init=False)
    branches: Ragged = field(init=False)
    branch_edge: IntArray = field(init=False)
    branch_other: IntArray = field(init=False)

    def __post_init__(self) -> None:
        n, m = len(self.xy), len(self.source)
        freeze(self, np.float64, xy=(n, 2))
        freeze(self, np.int64, source=(m,), target=(m,))
        xy, source, target = self.xy, self.source, self.target
        paths = frozen_rows(self.paths, np.float64, 2, "path")
        if len(paths) != m or np.any(source == target):
            raise ValueError("one path per edge is needed, and no edge may join a vertex to itself")
        for u, v, path in zip(source.tolist(), target.tolist(), paths, strict=True):
            if not (np.array_equal(path[0], xy[u]) and np.array_equal(path[-1], xy[v])):
                raise ValueError(f"the path of corridor {u} to {v} does not begin and end there")
        length = np.array([polyline_length(p) for p in paths])
        heading = [polyline_heading(p) for p in paths] + [polyline_heading(p[::-1]) for p in paths]
        vertex = np.concatenate([source, target])
        order = np.lexsort((np.array(heading), vertex))
        offsets = np.searchsorted(vertex[order], np.arange(n + 1))
        derived = {
            "paths": paths,
            "length": length,
            "branches": Ragged(offsets, np.array(heading)[order]),
            "branch_edge": order % m,
            "branch_other": np.concatenate([target, source])[order],
        }
        for name, value in derived.items():
            object.__setattr__(self, name, value)
        freeze(self, np.float64, length=(m,))
        freeze(self, np.int64, branch_edge=(2 * m,), branch_other=(2 * m,))

    def __len__(self) -> int:
        """Number of vertices."""
        return len(self.xy)

    def ends(self, vertex: int) -> list[tuple[int, int, float]]:
        """(corridor, vertex at its other end, heading [rad]) of each branch of a vertex."""
        rows = slice(*self.branches.offsets[vertex : vertex + 2].tolist())
        edges, others = self.branch_edge[rows].tolist(), self.branch_other[rows].tolist()
        return list(zip(edges, others, self.branches[vertex].tolist(), strict=True))

    def path_from(self, edge: int, vertex: int) -> FloatArray:
        """(k, 2) a corridor's polyline, starting at the given end."""
        path = self.paths[edge]
        return path if int(self.source[edge]) == vertex else path[::-1]


def polyline_at(path: FloatArray, way_m: FloatArray) -> FloatArray:
    """(k, 2) points at distances along a polyline, clamped to its ends."""
    at = way_of(path)
    return np.column_stack([np.interp(way_m, at, path[:, 0]), np.interp(way_m, at, path[:, 1])])


def polyline_length(path: FloatArray) -> float:
    """Length of a polyline [m]."""
    return float(np.sum(np.hypot(*np.diff(path, axis=0).T)))


def polyline_heading(path: FloatArray) -> float:
    """Direction in which a polyline leaves its first point [rad], over BRANCH_REACH_M."""
    reach = min(BRANCH_REACH_M, 0.5 * polyline_length(path))
    dx, dy = polyline_at(path, np.array([reach]))[0] - path[0]
    return float(np.round(wrap(np.arctan2(dy, dx)), 9))


def straight(xy: FloatArray, u: int, v: int) -> Link:
    """A straight corridor between two vertices."""
    return u, v, np.array([xy[u], xy[v]])


def without_bends(links: Sequence[Link], corners: Set[int] = frozenset()) -> list[Link]:
    """The links with every vertex of degree 2 but for some corners replaced by a bend.

    A vertex is kept where merging its corridors would make a self-loop. O(links).
    """
    joined: dict[int, Link] = dict(enumerate(links))
    at: dict[int, set[int]] = defaultdict(set)
    for i, (u, v, _) in joined.items():
        at[u].add(i)
        at[v].add(i)
    for vertex in sorted(at.keys() - corners):
        if len(at[vertex]) != 2:
            continue
        first, second = sorted(at[vertex])
        u, path_in = _towards(joined[first], vertex)
        w, path_out = _towards(joined[second], vertex)
        if u == w:
            continue
        joined[first] = (u, w, np.concatenate([path_in, path_out[-2::-1]]))
        del joined[second]
        at[w] = (at[w] - {second}) | {first}
        at[vertex] = set()
    return [joined[i] for i in sorted(joined)]


def _towards(link: Link, vertex: int) -> tuple[int, FloatArray]:
    """The other end of a link, and its path from there to `vertex`."""
    u, v, path = link
    return (u, path) if v == vertex else (v, path[::-1])


def straight_world(name: str, kind: str, xy: FloatArray, pairs: Iterable[Sequence[int]]) -> World:
    """A world of straight corridors between pairs of points; two in line are joined into one."""
    links = [straight(xy, u, v) for u, v in pairs]
    leaving: dict[int, list[float]] = defaultdict(list)
    for u, v, path in links:
        leaving[u].append(polyline_heading(path))
        leaving[v].append(polyline_heading(path[::-1]))
    corners = {
        vertex
        for vertex, h in leaving.items()
        if len(h) == 2 and abs(wrap(h[0] - h[1] + np.pi)) >= STRAIGHT_RAD
    }
    return world_of_links(name, kind, xy, without_bends(links, corners))


def world_of_links(name: str, kind: str, xy: FloatArray, links: Sequence[Link]) -> World:
    """The largest connected part of the links, with vertices renumbered in order."""
    xy = np.round(xy, COORDINATE_DECIMALS) + 0.0
    ends = np.array([(u, v) for u, v, _ in links], np.int64).reshape(-1, 2)
    part = connected(ends[:, 0], ends[:, 1], len(xy))
    keep = part == np.bincount(part[ends[:, 0]]).argmax()
    number = np.cumsum(keep) - 1
    chosen = [(u, v, path) for u, v, path in links if keep[u]]
    paths = []
    for u, v, path in chosen:
        inner = np.round(path[1:-1], COORDINATE_DECIMALS) + 0.0
        paths.append(np.concatenate([xy[u : u + 1], inner, xy[v : v + 1]]))
    return World(
        name=name,
        kind=kind,
        xy=xy[keep],
        source=np.array([number[u] for u, _, _ in chosen], np.int64),
        target=np.array([number[v] for _, v, _ in chosen], np.int64),
        paths=tuple(paths),
    )
