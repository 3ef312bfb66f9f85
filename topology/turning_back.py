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
from .track import by_begin, in_milliseconds, seconds_at, times_between, track_directions, way_at
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
    topomap: TopoMap, odometry: Odometry, visits: Visits, least_m: float
) -> TurningPoints:
    """The turning points more than `least_m` [m] from their vertex that no corridor of the map
    leads to, by `group_by_dead_end`; corridors within `least_m` are the same."""
    excursions = _excursions(topomap, odometry, visits)
    long = sorted(
        (e for e in excursions if e.length > least_m), key=lambda e: (-e.length, e.time_ns)
    )
    corridors = Ways(topomap.paths, least_m / 4)
    groups = group_by_dead_end(
        ((e.time_ns, e) for e in long),
        topomap,
        lambda vertex: corridors,
        sound_m=DRAWING.sound_m,
        near_m=least_m,
    )
    return _as_points(groups, topomap)


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

    Of several drives by one branch the deepest defines the dead end; those within `sound_m` [m] of
    its length lead there, too. Drives by a branch that a corridor of the graph leaves by are left
    out, and so are drives by an unknown branch that stay within `near_m` [m] of known corridors.

    ranked: drives, the longest first, each with a number of its own: every drive by an unknown
    branch leads to a dead end of its own, and those of a vertex are ordered by number; corridors:
    gives those around a vertex.
    """
    ends = ((graph.source, graph.source_branch), (graph.target, graph.target_branch))
    known_branches = {pair for v, b in ends for pair in zip(v.tolist(), b.tolist(), strict=True)}
    groups, paths_of = dict[tuple[int, int, int], list[D]](), dict[int, list[FloatArray]]()
    for rank, drive in ranked:
        vertex, branch = drive.vertex, drive.branch
        key = (vertex, branch, rank if branch == NO_BRANCH else 0)
        deepest = groups[key][0].length if key in groups else drive.length
        if (vertex, branch) in known_branches or deepest - drive.length > sound_m:
            continue
        if branch == NO_BRANCH:
            distance_m = Ways(paths_of.get(vertex, ()), near_m / 4).away(drive.path)
            if np.minimum(distance_m, corridors(vertex).away(drive.path)).max() <= near_m:
                continue
        if key not in groups:
            paths_of.setdefault(vertex, []).append(drive.path)
        groups.setdefault(key, []).append(drive)
    return [groups[key] for key in sorted(groups)]


def _excursions(topomap: TopoMap, odometry: Odometry, visits: Visits) -> Iterator[_Excursion]:
    """All drives between two consecutive visits of the same vertex, and before the first and after
    the last visit of each unbroken piece of the track."""
    branches = _branches_driven(topomap, odometry, visits)
    visits, is_visit, xy = _with_ends(odometry, visits, topomap.xy)
    leaving, arriving = (np.full(len(is_visit), NO_BRANCH) for _ in range(2))
    leaving[is_visit], arriving[is_visit] = branches
    drives = list(_drives(odometry, visits, xy, (is_visit, leaving, arriving)))
    visit = np.array([drive.visit for drive in drives], np.int64)
    far_m = np.array([drive.far_way_m for drive in drives])
    arrival, departure = (in_milliseconds(odometry, t) for t in seconds_at(odometry, far_m))
    times = np.stack([visits.time_ns[visit], arrival, departure, visits.time_ns[visit + 1]], axis=1)
    halves = (4 * np.arange(len(drives))[:, None] + np.array([0, 2])).ravel().astype(np.int64)
    between = times_between(odometry, times.ravel(), halves, DRAWING.standing_m).reshape(-1, 2, 2)
    for k, drive in enumerate(drives):
        way_out, way_back = between[k, 0], between[k, 1, ::-1]
        traversals = [] if drive.begins else [way_out]
        times_ns = np.array(traversals if drive.ends else [*traversals, way_back])
        yield drive._replace(time_ns=int(arrival[k]), traversal_ns=times_ns)


def _drives(
    odometry: Odometry,
    visits: Visits,
    xy: FloatArray,
    visit_columns: tuple[BoolArray, IntArray, IntArray],
) -> Iterator[_Excursion]:
    """Drives out and back, or only one way at the ends of the track.

    visits: including the ends of the track; xy: (n, 2) of all vertices; visit_columns: (v,) each:
    whether a visit is a real one, the branch by which the robot left, and by which it arrived.
    """
    is_visit, leaving, arriving = visit_columns
    visit_arc_m, u, v = way_at(odometry, visits.time_ns), visits.vertex[:-1], visits.vertex[1:]
    within = (np.diff(visits.piece) == 0) & (np.diff(visit_arc_m) > DRAWING.standing_m)
    first = np.flatnonzero(
        within & ((is_visit[:-1] & is_visit[1:] & (u == v)) | (is_visit[:-1] != is_visit[1:]))
    )
    track = draw_track(odometry, visits, xy, first)
    for k, visit in enumerate(first.tolist()):
        rows = slice(track.offsets[k], track.offsets[k + 1])
        points, arc_m = track.xy[rows], track.way[rows]
        left_by, came_by = int(leaving[visit]), int(arriving[visit + 1])
        begins, ends = not is_visit[visit], not is_visit[visit + 1]
        if not (begins or ends) and _is_corridor(points, left_by, came_by):
            continue
        far = farthest(points[::-1] if begins else points, DRAWING.passable_m)
        far = len(points) - 1 - far if begins else far
        vertex = int(v[visit] if begins else u[visit])
        halves = []
        if not begins:
            halves.append((points[: far + 1], left_by if left_by != NO_BRANCH else came_by))
        if not ends:
            halves.append((points[far:][::-1], came_by if came_by != NO_BRANCH else left_by))
        # Detours only lengthen a drive: the shorter one of out and back is nearer to the corridor.
        lines = ((centre_line(half, xy[vertex], half[-1]), branch) for half, branch in halves)
        length, path, branch = min(
            ((float(way_of(path)[-1]), path, branch) for path, branch in lines),
            key=lambda line: line[0],
        )
        beyond_m = arc_m[far] - arc_m[0] if begins else arc_m[-1] - arc_m[far]
        at_end = (begins or ends) and beyond_m <= DRAWING.passable_m
        yield _Excursion(
            vertex=vertex,
            branch=branch,
            kind=TRACK_END if at_end else TURNING_POINT,
            path=path,
            length=length,
            visit=visit,
            far_way_m=float(arc_m[far]),
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
    branches_there, turn = topomap.branches.take(visits.vertex), visits.pose[:, 2]
    leaving = nearest_branch(branches_there, track.leaving + turn)
    return leaving, nearest_branch(branches_there, track.arriving + turn)


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
    turn, end_xy = visits.pose[nearest, 2], odometry.pose[row, :2]
    end_in_map = xy[visits.vertex[nearest]] + turned(end_xy - visits.centre[nearest], turn)
    ends = Visits(
        time_ns=odometry.time_ns[row],
        vertex=np.arange(len(xy), len(xy) + len(row)),
        seen=np.zeros(len(row), bool),
        pose=np.column_stack([end_in_map, turn]),
        centre=end_xy,
        piece=np.concatenate([pieces, pieces]),
    )
    all_visits = joined([visits, ends])
    # A visit at the very begin comes after it, one at the very end before.
    rank = np.concatenate([np.ones(len(visits.time_ns)), np.repeat([0, 2], len(pieces))])
    order = np.lexsort((rank, all_visits.time_ns, all_visits.piece))
    return take(all_visits, order), order < len(visits.time_ns), np.concatenate([xy, end_in_map])


def farthest(points: FloatArray, near_m: float) -> int:
    """Index of the point of a track (p, 2) with the longest shortest path from its first point,
    where points within `near_m` [m] of each other are connected. O(area covered / near²).

    Straight-line distance would not do: a robot goes round corners.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import dijkstra
    from scipy.spatial import cKDTree

    cells = np.round(points / (near_m / 5)).astype(np.int64)
    distinct = np.sort(np.unique(cells, axis=0, return_index=True)[1])
    points_of_graph = points[distinct]
    pairs = cKDTree(points_of_graph).query_pairs(near_m, output_type="ndarray")
    step = np.maximum(
        np.hypot(*(points_of_graph[pairs[:, 0]] - points_of_graph[pairs[:, 1]]).T), 1e-9
    )
    graph = coo_array((step, (pairs[:, 0], pairs[:, 1])), shape=(len(points_of_graph),) * 2)
    path_m: FloatArray = dijkstra(graph.tocsr(), directed=False, indices=[0])[0]
    return int(distinct[int(np.argmax(np.where(np.isfinite(path_m), path_m, -1.0)))])


def _as_points(groups: list[list[_Excursion]], topomap: TopoMap) -> TurningPoints:
    """Groups of drives to the same dead ends, the deepest first, as turning points."""
    if not groups:
        return NO_TURNING_POINTS
    deepest = [group[0] for group in groups]
    vertex = np.array([e.vertex for e in deepest])
    length = np.array([e.length for e in deepest])
    paths = tuple(simplify(e.path, DRAWING.path_tolerance_m) for e in deepest)
    noise = topomap.measured
    way_variance = noise.along_m_per_sqrt_m**2 * length + (noise.scale * length) ** 2
    sigma = np.sqrt(way_variance + noise.centre_m**2)
    turn_sigma = _turn_sigma(topomap, vertex)
    vertex_sigma = (
        np.zeros(len(topomap)) if topomap.position_sigma is None else topomap.position_sigma
    )
    times = [np.concatenate([e.traversal_ns for e in group]) for group in groups]
    return TurningPoints(
        kind=tuple(e.kind for e in deepest),
        vertex=vertex,
        branch=np.array([e.branch for e in deepest]),
        heading=np.array([leaving_over(path[::-1], LEAVING_M) for path in paths]),
        length=length,
        length_sigma=sigma,
        position_sigma=np.sqrt(
            vertex_sigma[vertex] ** 2 + (sigma**2 + (turn_sigma * length) ** 2) / 2
        ),
        branch_sigma=turn_sigma,
        traversals=np.array([len(t) for t in times]),
        paths=paths,
        traversal_ns=tuple(by_begin(t) for t in times),
        time_ns=tuple(np.sort([e.time_ns for e in group])[:, None] for group in groups),
    )


def _turn_sigma(topomap: TopoMap, vertex: IntArray) -> FloatArray:
    """(k,) 1 sigma [rad] of directions seen from vertices: that of the least certain branch
    there."""
    if topomap.branch_sigma is None:
        return np.full(len(vertex), topomap.measured.branch_rad)
    return np.array([topomap.branch_sigma[v].max(initial=0.0) for v in vertex.tolist()])
