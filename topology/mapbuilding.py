"""From passes assigned to places to the topological map: vertices, branches, corridors."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .arrays import BoolArray, FloatArray, IntArray
from .circular import AngleClusters, cluster_angles
from .corridor_lengths import LEAST_M, LIKE_SIGMAS, corridor_lengths, straightness, turning_variance
from .odometry import Odometry
from .passes import NO_BRANCH, ONE_WAY_RAD, Passes, nearest_branch
from .polyline import join_centres, loop_erased, loop_width, simplify, way_of, with_corners
from .ragged import Ragged
from .se2 import wrap
from .topomap import RunNoise, TopoMap
from .track import by_begin, times_between, track_directions, way_at
from .vertex_errors import VertexErrors
from .visits import STEP_M, PassesAtPlaces, Visits, draw_track

_Ends = tuple[int, int, int, int]
"""Ends of a corridor: source, target, and the branch at each."""


@dataclass(frozen=True, slots=True)
class MapBuildingSettings:
    """Geometry of the final map."""

    least_share: float = 0.5
    """Least share of the vertex's passes that saw a branch, if it was never driven."""
    path_tolerance_m: float = 0.08
    """Tolerance of simplified paths."""
    junction_m: float = 0.7
    """Radius around a junction's centre in which robots cut corners: the path is straight there.
    Also the largest distance at which the track passes a place."""
    passable_m: float = 0.5
    """Largest distance of points of tracks without a wall between them: about a robot's width. Over
    this distance to either side the turn of the track is measured at corners."""
    corner_rad: float = 0.5
    """Least turn of a corner of the corridor; a smaller one is a bend."""
    standing_m: float = STEP_M / 2
    """Least distance of a drive between two visits. Time within this path length of a centre
    (standing, turning on the spot) is not driving time."""
    sound_m: float = 1.0
    """Largest difference from its corridor's median length of a leg driven straight through, and
    of a leg with an unknown branch that belongs to the corridor."""
    repeated_m: float = 50.0
    """Prior for the variance of wandering, as a length driven again without any."""


DRAWING = MapBuildingSettings()


def build_topomap(
    run: str,
    odometry: Odometry,
    passes: Passes,
    places: PassesAtPlaces,
    *,
    noise: RunNoise,
    errors: VertexErrors,
    askew_rad: float = 0.0,
    fitted_noise: RunNoise | None = None,
) -> TopoMap:
    """The map of a run whose passes have been assigned to places.

    errors: of the vertices; askew_rad: standard deviation of the heading error common to all passes
    of a vertex; noise, fitted_noise: as in TopoMap.
    """
    xy, visits = places.xy, places.visits
    track = track_directions(odometry, visits.time_ns, visits.centre)
    arriving, leaving = track.arriving + visits.pose[:, 2], track.leaving + visits.pose[:, 2]
    slots, votes, keep = _slots(passes, places, (arriving, leaving))
    branches = Ragged.by_owner(slots.owner[keep], slots.mean[keep], len(xy))
    branches_there = branches.take(visits.vertex)
    exit_ = nearest_branch(branches_there, leaving)
    entry = nearest_branch(branches_there, arriving)
    legs = _legs(odometry, visits, exit_, entry, xy=xy)
    edges = _edges(legs, xy)
    paths = _paths(legs, edges)
    placed_passes = np.flatnonzero(places.place >= 0)
    observed = places.place[placed_passes]
    piece = np.zeros(len(xy), np.int64)
    piece[visits.vertex] = visits.piece
    shape = errors.as_a_whole(xy, piece)
    measured = fitted_noise or noise
    reading = np.hypot(measured.branch_rad / np.sqrt(votes[keep]), askew_rad)
    return TopoMap(
        run=run,
        frame=odometry.frame,
        xy=xy,
        branches=branches,
        kind=tuple(_kind(branches[i]) for i in range(len(xy))),
        source=edges.source,
        target=edges.target,
        source_branch=edges.source_branch,
        target_branch=edges.target_branch,
        length=edges.length,
        length_sigma=_length_sigma(edges, paths, xy, measured, errors),
        traversals=edges.traversals,
        paths=paths,
        observation_vertex=observed,
        observation_time_ns=passes.time_ns[placed_passes],
        noise=noise,
        fitted_noise=fitted_noise,
        position_sigma=shape.position_sigma(),
        branch_sigma=Ragged(branches.offsets, shape.branch_sigma(branches.owner, reading)),
        traversal_ns=edges.time_ns,
        confidence=mean_of((passes.confidence * places.fair)[placed_passes], observed, len(xy)),
    )


def mean_of(values: FloatArray, group: IntArray, count: int) -> FloatArray:
    """(count,) mean of the values in each group, 1 for an empty group."""
    count_of = np.bincount(group, minlength=count)
    sums = np.bincount(group, values, count)
    return np.where(count_of > 0, sums / np.maximum(count_of, 1), 1.0)


def _slots(
    passes: Passes, places: PassesAtPlaces, driven_rad: tuple[FloatArray, FloatArray]
) -> tuple[AngleClusters, IntArray, BoolArray]:
    """Branches of every vertex as clusters of readings, the number of passes that saw each, and
    which are kept: driven ones, and those seen by enough passes. driven_rad: two arrays (v,) of
    track directions at the visits."""
    pass_vertex, visited = np.where(places.fair, places.place, -1), places.visits.vertex
    owner = passes.branches.owner
    placed = pass_vertex[owner] >= 0
    angle = (passes.branches.values + places.turn[owner])[placed]
    vertex = pass_vertex[owner][placed]
    slots = cluster_angles(angle, vertex, ONE_WAY_RAD)
    votes = slots.votes(owner[placed])
    visits = np.bincount(pass_vertex[pass_vertex >= 0])
    share = votes / visits[slots.owner]
    rows = Ragged.by_owner(slots.owner, slots.mean, len(visits))
    driven = np.zeros(len(slots), bool)
    branches_there = rows.take(visited)
    for direction in driven_rad:
        local = nearest_branch(branches_there, direction)
        on_branch = local != NO_BRANCH
        driven[rows.offsets[visited[on_branch]] + local[on_branch]] = True
    return slots, votes, driven | slots.well_seen(share, DRAWING.least_share)


def _kind(branches: FloatArray) -> str:
    """The kind of a vertex by its branches: a dead end has one, a bend two that are not
    opposite."""
    if len(branches) == 1:
        return "dead_end"
    if len(branches) == 2:
        opposite = abs(abs(float(wrap(branches[0] - branches[1]))) - np.pi)
        return "junction" if opposite < ONE_WAY_RAD else "bend"
    return "junction"


@dataclass(frozen=True, slots=True, eq=False)
class _Legs:
    """Drives from one visit to the next: ends with their branches, and paths from centre to centre.

    length: (l,) of `path` [m]; path: l polylines from the first visit's vertex to the next one's;
    time_ns: (l, 2) when the robot left the first centre and reached the next.
    """

    source: IntArray
    target: IntArray
    source_branch: IntArray
    target_branch: IntArray
    length: FloatArray
    path: list[FloatArray]
    turned: BoolArray
    """Whether it was driven from target to source."""
    time_ns: IntArray


def _legs(
    odometry: Odometry, visits: Visits, exit_: IntArray, entry: IntArray, *, xy: FloatArray
) -> _Legs:
    """Legs within unbroken parts of the track, without those that turn back in a corridor."""
    first = np.arange(len(visits.time_ns) - 1)
    u, v = visits.vertex[:-1], visits.vertex[1:]
    exits, entries = exit_[:-1], entry[1:]
    loop = (u == v) & ((exits == entries) | (exits == NO_BRANCH) | (entries == NO_BRANCH))
    driven = np.diff(way_at(odometry, visits.time_ns)) > DRAWING.standing_m
    usable = (np.diff(visits.piece) == 0) & ~loop & driven
    path = _between_centres(odometry, visits, xy, first[usable])
    length = np.array([way_of(p)[-1] for p in path])
    is_corridor = (u != v)[usable] | np.array([is_ring(p) for p in path], bool)
    first, u, v, exits, entries = (x[usable][is_corridor] for x in (first, u, v, exits, entries))
    path = [p for p, kept in zip(path, is_corridor.tolist(), strict=True) if kept]
    length = length[is_corridor]
    # Corridors have one direction: from the smaller (vertex, branch).
    swap = (u > v) | ((u == v) & (exits > entries))
    source, target = np.where(swap, v, u), np.where(swap, u, v)
    source_branch, target_branch = np.where(swap, entries, exits), np.where(swap, exits, entries)
    time_ns = times_between(odometry, visits.time_ns, first, DRAWING.standing_m)
    return _Legs(source, target, source_branch, target_branch, length, path, swap, time_ns)


def _between_centres(
    odometry: Odometry, visits: Visits, xy: FloatArray, first: IntArray
) -> list[FloatArray]:
    """For each leg its path between the centres of both junctions, in the map's frame.

    A robot passes beside a centre and cuts corners: the track near a centre, and where it went out
    and back, is no part of the corridor's path. In between the track is interpolated between its
    placements at both junctions.
    """
    track = draw_track(odometry, visits, xy, first)
    paths = []
    for k, visit in enumerate(first.tolist()):
        points = track.xy[track.offsets[k] : track.offsets[k + 1]]
        begin, end = xy[visits.vertex[visit : visit + 2]]
        loop = visits.vertex[visit] == visits.vertex[visit + 1]
        paths.append(centre_line(points, begin, end, loop=bool(loop)))
    return paths


def centre_line(
    drawn: FloatArray, begin: FloatArray, end: FloatArray, *, loop: bool = False
) -> FloatArray:
    """(p, 2) the corridor's path between the centres of two junctions, or back to the same one
    (loop), from a track (k, 2) in the map's frame that was driven between them."""
    path = join_centres(drawn, begin, end, DRAWING.junction_m)
    # The angles where the track is connected to a centre are no corners.
    inner = path[1:-1]
    if not loop:
        inner = loop_erased(inner, DRAWING.passable_m)
    inner = with_corners(inner, DRAWING.passable_m, DRAWING.corner_rad)
    return np.concatenate([path[:1], inner, path[-1:]])


def is_ring(path: FloatArray) -> bool:
    """Whether a path back to its beginning goes round something. A robot that turns about in a
    junction or a corridor may seem to leave by one branch and enter by another."""
    is_long = float(way_of(path)[-1]) > 2 * DRAWING.junction_m
    return is_long and loop_width(path) > DRAWING.passable_m


@dataclass(frozen=True, slots=True, eq=False)
class _Edges:
    source: IntArray
    target: IntArray
    source_branch: IntArray
    target_branch: IntArray
    length: FloatArray
    traversals: IntArray
    time_ns: tuple[IntArray, ...]
    leg: IntArray
    """The leg whose track is the path (`corridor_lengths`)."""
    wander: float
    """Variance of the lengths of drives through one corridor, per metre [m]."""
    detour: float
    """Detours, which differ from drive to drive: their share of the length beyond the chord
    (`_chosen_detour`)."""
    farthest_m: float
    """Largest plausible detour [m] (`_chosen_detour`)."""


def _edges(legs: _Legs, xy: FloatArray) -> _Edges:
    """Legs between the same branches of the same vertices are one corridor.

    A leg with an unknown branch belongs to the corridor that fits its length.
    """
    groups = _corridors(legs)
    keys = sorted(groups)
    members = [np.array(groups[key]) for key in keys]
    sound = [_sound(legs, member) for member in members]
    chord = np.hypot(*(xy[legs.target] - xy[legs.source]).T)
    length, leg = corridor_lengths(legs.length, chord, sound)
    excess = sum(float(np.var(legs.length[drives]) * len(drives)) for drives in sound)
    shown_m = DRAWING.repeated_m + sum(
        float(corridor_m * (len(drives) - 1))
        for corridor_m, drives in zip(length, sound, strict=True)
    )
    times = np.where(legs.turned[:, None], legs.time_ns[:, ::-1], legs.time_ns)
    detour, farthest_m = _chosen_detour(legs, members, xy)
    source, target, source_branch, target_branch = np.array(keys, np.int64).reshape(-1, 4).T
    return _Edges(
        source=source,
        target=target,
        source_branch=source_branch,
        target_branch=target_branch,
        length=length,
        traversals=np.array([len(member) for member in members], np.int64),
        time_ns=tuple(by_begin(times[member]) for member in members),
        leg=leg,
        wander=excess / shown_m,
        detour=detour,
        farthest_m=farthest_m,
    )


def _sound(legs: _Legs, member: IntArray) -> IntArray:
    """The legs of a corridor that were driven straight through, shortest first."""
    ordered = member[np.argsort(legs.length[member], kind="stable")]
    middle = legs.length[ordered[len(ordered) // 2]]
    return np.asarray(ordered[np.abs(legs.length[ordered] - middle) < DRAWING.sound_m])


def _corridors(legs: _Legs) -> dict[_Ends, list[int]]:
    """Indices of the legs through each corridor, by its ends."""
    rows = np.stack([legs.source, legs.target, legs.source_branch, legs.target_branch], axis=1)
    between: dict[tuple[int, int], dict[_Ends, list[int]]] = defaultdict(dict)
    unknown = []
    for k, (s, t, sb, tb) in enumerate(rows.tolist()):
        if NO_BRANCH in (sb, tb):
            unknown.append((k, (s, t, sb, tb)))
        else:
            between[s, t].setdefault((s, t, sb, tb), []).append(k)
    for k, ends in unknown:
        corridors = between[ends[:2]]
        corridors.setdefault(_fitting(legs, corridors, ends, k), []).append(k)
    return {ends: member for found in between.values() for ends, member in found.items()}


def _chosen_detour(legs: _Legs, corridors: list[IntArray], xy: FloatArray) -> tuple[float, float]:
    """Root mean square share of detours that differ from drive to drive, and their largest
    plausible length [m].

    A drive's length beyond the chord is the corridor's bend or the robot's detour; repeated drives
    separate them, since a bend is the same each time. The lengths of the other drives beyond the
    shortest one estimate the detours (without bias if these are exponentially distributed); the
    shortest gives no estimate. In straight corridors all of the excess is detour, however small, so
    that a share found there does not apply to bends of several metres: hence the limit.
    """
    repeated = [member for member in corridors if len(member) > 1]
    if not repeated:
        return 0.0, 0.0
    row = np.concatenate(repeated)
    shortest = np.concatenate([np.full(len(m), legs.length[m].min()) for m in repeated])
    chord = np.hypot(*(xy[legs.target[row]] - xy[legs.source[row]]).T)
    detour, excess = legs.length[row] - shortest, legs.length[row] - chord
    mean_square = float((detour**2).sum()) / (len(row) - len(repeated))
    share = mean_square / max(float(np.mean(excess**2)), 1e-9)
    return float(np.sqrt(min(share, 1.0))), LIKE_SIGMAS * float(np.sqrt(mean_square))


def _fitting(legs: _Legs, corridors: dict[_Ends, list[int]], ends: _Ends, k: int) -> _Ends:
    """The corridor that leg k, with an unknown branch, belongs to; its own ends if none fits."""
    best, best_difference = ends, DRAWING.sound_m
    for key, members in corridors.items():
        known = zip(ends[2:], key[2:], strict=True)
        if any(branch not in (NO_BRANCH, other) for branch, other in known):
            continue
        difference = abs(float(np.median(legs.length[members])) - legs.length[k])
        if difference < best_difference:
            best, best_difference = key, difference
    return best


def _paths(legs: _Legs, edges: _Edges) -> tuple[FloatArray, ...]:
    """Path of every edge from vertex to vertex in the map's frame, simplified."""
    ways = (legs.path[k][:: -1 if legs.turned[k] else 1] for k in edges.leg.tolist())
    return tuple(simplify(way, DRAWING.path_tolerance_m) for way in ways)


def _length_sigma(
    edges: _Edges,
    paths: Sequence[FloatArray],
    xy: FloatArray,
    noise: RunNoise,
    errors: VertexErrors,
) -> FloatArray:
    """(m,) standard deviation of the corridors' lengths [m].

    To first order, a path fitted to its two ends changes in length by the error of the chord times
    the chord's share c of the length. Of the odometry's scale error, common to all drives, this
    includes the share c² (variance: c⁴); the rest of its variance, 1 - c⁴, is added.

    The rest are errors of the odometry on a bent path: along the path, of which the fit removes a
    share of c²; and of heading, which move the ends (`turning_variance`) though the length is
    right. Wandering and detours are estimated from repeated drives (`corridor_lengths`,
    `_chosen_detour`). Since no corridor is shorter than its chord, a detour is at most the length
    beyond the chord.
    """
    chord, straight = straightness(xy, edges.source, edges.target, edges.length)
    ends = errors.distance_sigma(xy, edges.source, edges.target)
    times = np.maximum(edges.traversals, 1)
    along = (1 - straight**2) * noise.along_m_per_sqrt_m**2 * edges.length
    driven = along + straight**2 * turning_variance(paths, noise)
    beyond = np.maximum(edges.length - chord, 0.0)
    detour = np.minimum(edges.detour * beyond, edges.farthest_m)
    chosen = np.minimum(edges.wander * edges.length + detour**2 / times, beyond**2)
    common = (1 - straight**4) * (noise.scale * edges.length) ** 2
    variance = (straight * ends) ** 2 + (driven + chosen) / times + common + LEAST_M**2
    return np.asarray(np.sqrt(variance))
