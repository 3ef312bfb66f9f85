"""Dead ends of the track: drives out of a junction and back, or only to it or from it.

Scans show junctions but no dead ends. If the robot came back to the junction that it had left, as
from a room, the farthest point of its drive is a dead end of the track; so are the first and the
last point of the track. Whether the corridor leads on there is not known.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple, Protocol, TypeVar

import numpy as np

from .arrays import BoolArray, FloatArray, IntArray
from .columns import joined, take
from .driven_branches import LEAVING_M
from .mapbuilding import DRAWING, centre_line, is_ring
from .odometry import Odometry
from .passes import NO_BRANCH, nearest_branch
from .polyline import Ways, leaving_over, simplify, way_of
from .se2 import turned
from .topomap import Graph, TopoMap
from .track import (
    by_begin,
    in_milliseconds,
    seconds_at,
    times_between,
    track_directions,
    way_at,
)
from .turning_points import NO_TURNING_POINTS, TRACK_END, TURNING_POINT, TurningPoints
from .visits import Visits, draw_track

NO_TIMES = np.zeros((0, 2), np.int64)


class _Excursion(NamedTuple):
    """One drive from a vertex to its farthest point, and back unless the track begins or ends
    there.

    path: (p, 2) [m] from the vertex; length: of it [m]; visit: the visit that it begins with;
    far_way_m: distance driven [m] up to the farthest point; begins, ends: whether there is no visit
    at that end because the track begins or ends there; time_ns: when it arrived at the farthest
    point; traversal_ns: (t, 2) when it was at the vertex and at that point.
    """

    vertex: int
    branch: int
    kind: str
    path: FloatArray
    length: float
    visit: int
    far_way_m: float
    begins: bool
    ends: bool
    time_ns: int = 0
    traversal_ns: IntArray = NO_TIMES


def turning_points(
    topomap: TopoMap,
    odometry: Odometry,
    visits: Visits,
    least_m: float,
) -> TurningPoints:
    """The turning points more than `least_m` [m] from their vertex that no corridor of the map
    leads to.

    Which those are is decided by `group_by_dead_end`; corridors within `least_m` count as the same.
    """
    every = _excursions(topomap, odometry, visits)
    found = sorted((e for e in every if e.length > least_m), key=lambda e: (-e.length, e.time_ns))
    corridors = Ways(topomap.paths, least_m / 4)
    kept = group_by_dead_end(
        ((e.time_ns, e) for e in found),
        topomap,
        lambda vertex: corridors,
        sound_m=DRAWING.sound_m,
        near_m=least_m,
    )
    return _as_points(kept, topomap)


class Drive(Protocol):
    """A drive from a vertex to a dead end."""

    @property
    def vertex(self) -> int:
        """Vertex that it starts at."""

    @property
    def branch(self) -> int:
        """Row-local branch by which it left, or NO_BRANCH."""

    @property
    def path(self) -> FloatArray:
        """(p, 2) [m] from the vertex on."""

    @property
    def length(self) -> float:
        """Length of the path [m]."""


D = TypeVar("D", bound=Drive)


def group_by_dead_end(
    ranked: Iterable[tuple[int, D]],
    graph: Graph,
    corridors: Callable[[int], Ways],
    *,
    sound_m: float,
    near_m: float,
) -> list[list[D]]:
    """Drives grouped by the dead end that they lead to, the deepest first in each group.

    Of several drives by one branch the deepest defines the dead end; those that came as far, to
    within `sound_m` [m], lead there, too. Drives by a branch that a corridor of the graph leaves by
    are left out, and so are drives by an unknown branch that stay within `near_m` [m] of known
    corridors.

    ranked: drives, the longest first, each with a number of its own: every drive by an unknown
    branch leads to a dead end of its own, and those of a vertex are ordered by number; corridors:
    gives those around a vertex.
    """
    ends = ((graph.source, graph.source_branch), (graph.target, graph.target_branch))
    known = {pair for v, b in ends for pair in zip(v.tolist(), b.tolist(), strict=True)}
    kept, here = dict[tuple[int, int, int], list[D]](), dict[int, list[FloatArray]]()
    for rank, drive in ranked:
        vertex, branch = drive.vertex, drive.branch
        key = (vertex, branch, rank if branch == NO_BRANCH else 0)
        deepest = kept[key][0].length if key in kept else drive.length
        if (vertex, branch) in known or deepest - drive.length > sound_m:
            continue
        if branch == NO_BRANCH:
            own = Ways(here.get(vertex, ()), near_m / 4).away(drive.path)
            if np.minimum(own, corridors(vertex).away(drive.path)).max() <= near_m:
                continue
        if key not in kept:
            here.setdefault(vertex, []).append(drive.path)
        kept.setdefault(key, []).append(drive)
    return [kept[key] for key in sorted(kept)]


def _excursions(topomap: TopoMap, odometry: Odometry, visits: Visits) -> Iterator[_Excursion]:
    """All drives between two consecutive visits of the same vertex, and before the first and after
    the last visit of each unbroken piece of the track."""
    branches = _branches_driven(topomap, odometry, visits)
    visits, real, xy = _with_ends(odometry, visits, topomap.xy)
    away, home = (np.full(len(real), NO_BRANCH) for _ in range(2))
    away[real], home[real] = branches
    drives = list(_drives(odometry, visits, xy, (real, away, home)))
    visit = np.array([d.visit for d in drives], np.int64)
    far_m = np.array([d.far_way_m for d in drives])
    arrival, departure = (in_milliseconds(odometry, t) for t in seconds_at(odometry, far_m))
    times = np.stack([visits.time_ns[visit], arrival, departure, visits.time_ns[visit + 1]], axis=1)
    halves = (4 * np.arange(len(drives))[:, None] + np.array([0, 2])).ravel().astype(np.int64)
    between = times_between(odometry, times.ravel(), halves, DRAWING.standing_m).reshape(-1, 2, 2)
    for k, d in enumerate(drives):
        out, back = between[k, 0], between[k, 1, ::-1]
        whole = [] if d.begins else [out]
        times_ns = np.array(whole if d.ends else [*whole, back])
        yield d._replace(time_ns=int(arrival[k]), traversal_ns=times_ns)


def _drives(
    odometry: Odometry,
    visits: Visits,
    xy: FloatArray,
    known: tuple[BoolArray, IntArray, IntArray],
) -> Iterator[_Excursion]:
    """Drives out and back, or only one way at the ends of the track.

    visits: including the ends of the track; xy: (n, 2) of all vertices; known: (v,) each: whether a
    visit is a real one, the branch by which the robot left, and by which it arrived.
    """
    real, away, home = known
    way, u, v = way_at(odometry, visits.time_ns), visits.vertex[:-1], visits.vertex[1:]
    within = (np.diff(visits.piece) == 0) & (np.diff(way) > DRAWING.standing_m)
    first = np.flatnonzero(within & ((real[:-1] & real[1:] & (u == v)) | (real[:-1] != real[1:])))
    track = draw_track(odometry, visits, xy, first)
    for k, visit in enumerate(first.tolist()):
        rows = slice(track.offsets[k], track.offsets[k + 1])
        points, at = track.xy[rows], track.way[rows]
        out, back = int(away[visit]), int(home[visit + 1])
        begins, ends = not real[visit], not real[visit + 1]
        if not (begins or ends) and _is_corridor(points, out, back):
            continue
        far = farthest(points[::-1] if begins else points, DRAWING.passable_m)
        far = len(points) - 1 - far if begins else far
        vertex = int(v[visit] if begins else u[visit])
        halves = [] if begins else [(points[: far + 1], out if out != NO_BRANCH else back)]
        halves += [] if ends else [(points[far:][::-1], back if back != NO_BRANCH else out)]
        # Detours only lengthen a drive: the shorter one of out and back is nearer to the corridor.
        lines = ((centre_line(half, xy[vertex], half[-1]), branch) for half, branch in halves)
        length, path, branch = min(
            ((float(way_of(path)[-1]), path, branch) for path, branch in lines),
            key=lambda line: line[0],
        )
        beyond = at[far] - at[0] if begins else at[-1] - at[far]
        at_end = (begins or ends) and beyond <= DRAWING.passable_m
        yield _Excursion(
            vertex=vertex,
            branch=branch,
            kind=TRACK_END if at_end else TURNING_POINT,
            path=path,
            length=length,
            visit=visit,
            far_way_m=float(at[far]),
            begins=begins,
            ends=ends,
        )


def _is_corridor(points: FloatArray, out: int, back: int) -> bool:
    """Whether a drive back to its start left and returned by two branches around an obstacle: a
    corridor."""
    return out != back and NO_BRANCH not in (out, back) and is_ring(points)


def _branches_driven(
    topomap: TopoMap, odometry: Odometry, visits: Visits
) -> tuple[IntArray, IntArray]:
    """(v,) each: branches by which the robot left its visits, and by which it arrived."""
    track = track_directions(odometry, visits.time_ns, visits.centre)
    there, turn = topomap.branches.take(visits.vertex), visits.pose[:, 2]
    leaving = nearest_branch(there, track.leaving + turn)
    return leaving, nearest_branch(there, track.arriving + turn)


def _with_ends(
    odometry: Odometry, visits: Visits, xy: FloatArray
) -> tuple[Visits, BoolArray, FloatArray]:
    """Visits extended by the two ends of each unbroken track as vertices of their own, positioned
    by the nearest visit; (v,) whether each is a real visit; and (n, 2) positions of all vertices
    [m]."""
    pieces = np.unique(visits.piece)
    rows = np.concatenate([[0], odometry.breaks, [len(odometry)]])
    row = np.concatenate([rows[pieces], rows[pieces + 1] - 1])
    nearest = np.concatenate(
        [
            np.searchsorted(visits.piece, pieces, side="left"),
            np.searchsorted(visits.piece, pieces, side="right") - 1,
        ]
    )
    turn, at = visits.pose[nearest, 2], odometry.pose[row, :2]
    where = xy[visits.vertex[nearest]] + turned(at - visits.centre[nearest], turn)
    ends = Visits(
        time_ns=odometry.time_ns[row],
        vertex=np.arange(len(xy), len(xy) + len(row)),
        seen=np.zeros(len(row), bool),
        pose=np.column_stack([where, turn]),
        centre=at,
        piece=np.concatenate([pieces, pieces]),
    )
    both = joined([visits, ends])
    # A visit at the very begin comes after it, one at the very end before.
    rank = np.concatenate([np.ones(len(visits.time_ns)), np.repeat([0, 2], len(pieces))])
    order = np.lexsort((rank, both.time_ns, both.piece))
    return take(both, order), order < len(visits.time_ns), np.concatenate([xy, where])


def farthest(points: FloatArray, near_m: float) -> int:
    """Index of the point of a track (p, 2) with the longest shortest path from its first point,
    where points within `near_m` [m] of each other are connected. O(area covered / near²).

    Straight-line distance would not do: a robot goes round corners.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import dijkstra
    from scipy.spatial import cKDTree

    cells = np.round(points / (near_m / 5)).astype(np.int64)
    one = np.sort(np.unique(cells, axis=0, return_index=True)[1])
    some = points[one]
    pairs = cKDTree(some).query_pairs(near_m, output_type="ndarray")
    step = np.maximum(np.hypot(*(some[pairs[:, 0]] - some[pairs[:, 1]]).T), 1e-9)
    graph = coo_array((step, (pairs[:, 0], pairs[:, 1])), shape=(len(some),) * 2)
    away: FloatArray = dijkstra(graph.tocsr(), directed=False, indices=[0])[0]
    return int(one[int(np.argmax(np.where(np.isfinite(away), away, -1.0)))])


def _as_points(kept: list[list[_Excursion]], topomap: TopoMap) -> TurningPoints:
    """Groups of drives to the same dead ends, the deepest first, as turning points."""
    if not kept:
        return NO_TURNING_POINTS
    deepest = [group[0] for group in kept]
    vertex = np.array([e.vertex for e in deepest])
    length = np.array([e.length for e in deepest])
    paths = tuple(simplify(e.path, DRAWING.path_tolerance_m) for e in deepest)
    noise = topomap.measured
    way = noise.along_m_per_sqrt_m**2 * length + (noise.scale * length) ** 2
    sigma = np.sqrt(way + noise.centre_m**2)
    turn = _turn_sigma(topomap, vertex)
    own = np.zeros(len(topomap)) if topomap.position_sigma is None else topomap.position_sigma
    times = [np.concatenate([e.traversal_ns for e in group]) for group in kept]
    return TurningPoints(
        kind=tuple(e.kind for e in deepest),
        vertex=vertex,
        branch=np.array([e.branch for e in deepest]),
        heading=np.array([leaving_over(path[::-1], LEAVING_M) for path in paths]),
        length=length,
        length_sigma=sigma,
        position_sigma=np.sqrt(own[vertex] ** 2 + (sigma**2 + (turn * length) ** 2) / 2),
        branch_sigma=turn,
        traversals=np.array([len(t) for t in times]),
        paths=paths,
        traversal_ns=tuple(by_begin(t) for t in times),
        time_ns=tuple(np.sort([e.time_ns for e in group])[:, None] for group in kept),
    )


def _turn_sigma(topomap: TopoMap, vertex: IntArray) -> FloatArray:
    """(k,) 1 sigma [rad] of directions seen from vertices: that of the least certain branch
    there."""
    if topomap.branch_sigma is None:
        return np.full(len(vertex), topomap.measured.branch_rad)
    return np.array([topomap.branch_sigma[v].max(initial=0.0) for v in vertex.tolist()])
