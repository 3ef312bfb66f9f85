"""From passes assigned to places to the topological map: vertices, branches, corridors."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .arrays import BoolArray, FloatArray, IntArray
from .circular import AngleClusters, cluster_angles
from .corridor_lengths import (
    LEAST_M,
    LIKE_SIGMAS,
    corridor_lengths,
    straightness,
    turning_variance,
)
from .odometry import Odometry
from .passes import NO_BRANCH, ONE_WAY_RAD, Passes, nearest_branch
from .polyline import join_centres, loop_erased, loop_width, simplify, way_of, with_corners
from .ragged import Ragged
from .se2 import wrap
from .topomap import RunNoise, TopoMap
from .track import by_begin, times_between, track_directions, way_at
from .vertex_errors import VertexErrors
from .visits import PassesAtPlaces, Visits, draw_track

_Ends = tuple[int, int, int, int]
"""Ends of a corridor: source, target, and the branch at each."""


@dataclass(frozen=True, slots=True)
class MapBuildingSettings:
    """Geometry of the final map."""

    least_share: float = 0.5
    """A branch that was never driven is kept if this share of the vertex's passes saw it."""
    path_tolerance_m: float = 0.08
    """Tolerance of simplified paths."""
    junction_m: float = 0.7
    """Radius around a junction's centre in which robots cut corners: the path is replaced by a
    straight line there. The track passes a place if it comes as near to its centre."""
    passable_m: float = 0.5
    """Points of tracks closer than this have no wall between them: about the width of a robot on
    either side."""
    corner_m: float = 0.5
    """Corners that the robot cut: the track's turn is measured over this distance to either
    side."""
    corner_rad: float = 0.5
    """A turn at least this large is a corner of the corridor, a smaller one a bend."""
    standing_m: float = 0.05
    """A robot that drove less than this between two visits did not move. Time that it spends within
    this path length of a centre, standing or turning on the spot, is not counted as driving
    time."""
    sound_m: float = 1.0
    """A leg within this of its corridor's median length was driven straight through; one with an
    unknown branch belongs to a corridor whose median length differs by less."""
    repeated_m: float = 50.0
    """Prior for the variance of wandering: this length driven again without any."""


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
    there = branches.take(visits.vertex)
    exit_ = nearest_branch(there, leaving)
    entry = nearest_branch(there, arriving)
    legs = _legs(odometry, visits, exit_, entry, xy=xy)
    edges = _edges(legs, xy)
    paths = _paths(legs, edges)
    seen = np.flatnonzero(places.place >= 0)
    observed = places.place[seen]
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
        observation_time_ns=passes.time_ns[seen],
        noise=noise,
        fitted_noise=fitted_noise,
        position_sigma=shape.position_sigma(),
        branch_sigma=Ragged(branches.offsets, shape.branch_sigma(branches.owner, reading)),
        traversal_ns=edges.time_ns,
        confidence=mean_of((passes.confidence * places.fair)[seen], observed, len(xy)),
    )


def mean_of(values: FloatArray, group: IntArray, count: int) -> FloatArray:
    """(count,) mean of the values in each group, 1 for an empty group."""
    size = np.bincount(group, minlength=count)
    total = np.bincount(group, values, count)
    return np.where(size > 0, total / np.maximum(size, 1), 1.0)


def _slots(
    passes: Passes,
    places: PassesAtPlaces,
    driven_rad: tuple[FloatArray, FloatArray],
) -> tuple[AngleClusters, IntArray, BoolArray]:
    """Branches of every vertex as clusters of readings, the number of passes that saw each, and
    which are kept: driven ones, and those seen by enough passes. driven_rad: two arrays (v,) of
    track directions at the visits."""
    pass_vertex, visited = np.where(places.fair, places.place, -1), places.visits.vertex
    owner = passes.branches.owner
    known = pass_vertex[owner] >= 0
    angle = (passes.branches.values + places.turn[owner])[known]
    home = pass_vertex[owner][known]
    slots = cluster_angles(angle, home, ONE_WAY_RAD)
    votes = slots.votes(owner[known])
    visits = np.bincount(pass_vertex[pass_vertex >= 0])
    share = votes / visits[slots.owner]
    rows = Ragged.by_owner(slots.owner, slots.mean, len(visits))
    driven = np.zeros(len(slots), bool)
    there = rows.take(visited)
    for direction in driven_rad:
        local = nearest_branch(there, direction)
        hit = local != NO_BRANCH
        driven[rows.offsets[visited[hit]] + local[hit]] = True
    return slots, votes, driven | slots.well_seen(share, DRAWING.least_share)


def _kind(branches: FloatArray) -> str:
    """What a vertex with these branches is: one is a dead end, two that are not opposite a bend."""
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
    odometry: Odometry,
    visits: Visits,
    exit_: IntArray,
    entry: IntArray,
    *,
    xy: FloatArray,
) -> _Legs:
    """Legs within unbroken parts of the track, without those that turn back in a corridor."""
    first = np.arange(len(visits.time_ns) - 1)
    u, v = visits.vertex[:-1], visits.vertex[1:]
    a, b = exit_[:-1], entry[1:]
    loop = (u == v) & ((a == b) | (a == NO_BRANCH) | (b == NO_BRANCH))
    driven = np.diff(way_at(odometry, visits.time_ns)) > DRAWING.standing_m
    fine = (np.diff(visits.piece) == 0) & ~loop & driven
    path = _between_centres(odometry, visits, xy, first[fine])
    length = np.array([way_of(p)[-1] for p in path])
    away = (u != v)[fine] | np.array([is_ring(p) for p in path], bool)
    first, u, v, a, b = (x[fine][away] for x in (first, u, v, a, b))
    path, length = [p for p, some in zip(path, away.tolist(), strict=True) if some], length[away]
    # Corridors have one direction: from the smaller (vertex, branch).
    swap = (u > v) | ((u == v) & (a > b))
    s, t = np.where(swap, v, u), np.where(swap, u, v)
    sb, tb = np.where(swap, b, a), np.where(swap, a, b)
    time_ns = times_between(odometry, visits.time_ns, first, DRAWING.standing_m)
    return _Legs(s, t, sb, tb, length, path, swap, time_ns)


def _between_centres(
    odometry: Odometry,
    visits: Visits,
    xy: FloatArray,
    first: IntArray,
) -> list[FloatArray]:
    """For each leg its path between the centres of both junctions, in the map's frame.

    A robot passes beside a centre and cuts corners: the track near a centre, and where it went out
    and back, is no part of the corridor's path. In between the track is interpolated between its
    placements at both junctions.
    """
    track = draw_track(odometry, visits, xy, first)
    out = []
    for k, visit in enumerate(first.tolist()):
        drawn = track.xy[track.offsets[k] : track.offsets[k + 1]]
        begin, end = xy[visits.vertex[visit : visit + 2]]
        loop = visits.vertex[visit] == visits.vertex[visit + 1]
        out.append(centre_line(drawn, begin, end, loop=bool(loop)))
    return out


def centre_line(
    drawn: FloatArray,
    begin: FloatArray,
    end: FloatArray,
    *,
    loop: bool = False,
) -> FloatArray:
    """(p, 2) the corridor's path between the centres of two junctions, or back to the same one
    (loop), from a track (k, 2) in the map's frame that was driven between them."""
    path = join_centres(drawn, begin, end, DRAWING.junction_m)
    # The angles where the track is connected to a centre are no corners.
    inner = path[1:-1]
    if not loop:
        inner = loop_erased(inner, DRAWING.passable_m)
    inner = with_corners(inner, DRAWING.corner_m, DRAWING.corner_rad)
    return np.concatenate([path[:1], inner, path[-1:]])


def is_ring(path: FloatArray) -> bool:
    """Whether a path back to its beginning goes round something. A robot that turns about in a
    junction or a corridor may seem to leave by one branch and enter by another."""
    long = float(way_of(path)[-1]) > 2 * DRAWING.junction_m
    return long and loop_width(path) > DRAWING.passable_m


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

    A leg with an unknown branch joins the corridor between its vertices that fits its length.
    """
    groups = _corridors(legs)
    keys = sorted(groups)
    members = [np.array(groups[key]) for key in keys]
    sound = [_sound(legs, member) for member in members]
    line = np.hypot(*(xy[legs.target] - xy[legs.source]).T)
    length, leg = corridor_lengths(legs.length, line, sound)
    excess = sum(float(np.var(legs.length[some]) * len(some)) for some in sound)
    way = DRAWING.repeated_m + sum(
        float(shown * (len(some) - 1)) for shown, some in zip(length, sound, strict=True)
    )
    at = np.where(legs.turned[:, None], legs.time_ns[:, ::-1], legs.time_ns)
    detour, farthest_m = _chosen_detour(legs, members, xy)
    source, target, source_branch, target_branch = np.array(keys, np.int64).reshape(-1, 4).T
    return _Edges(
        source=source,
        target=target,
        source_branch=source_branch,
        target_branch=target_branch,
        length=length,
        traversals=np.array([len(member) for member in members], np.int64),
        time_ns=tuple(by_begin(at[member]) for member in members),
        leg=leg,
        wander=excess / way,
        detour=detour,
        farthest_m=farthest_m,
    )


def _sound(legs: _Legs, member: IntArray) -> IntArray:
    """The legs that were driven straight through a corridor, shortest first."""
    ordered = member[np.argsort(legs.length[member], kind="stable")]
    middle = legs.length[ordered[len(ordered) // 2]]
    sound: IntArray = ordered[np.abs(legs.length[ordered] - middle) < DRAWING.sound_m]
    return sound


def _corridors(legs: _Legs) -> dict[_Ends, list[int]]:
    """Indices of the legs through each corridor, by its ends."""
    rows = np.stack([legs.source, legs.target, legs.source_branch, legs.target_branch], axis=1)
    between: dict[tuple[int, int], dict[_Ends, list[int]]] = defaultdict(dict)
    vague = []
    for k, (s, t, sb, tb) in enumerate(rows.tolist()):
        if NO_BRANCH in (sb, tb):
            vague.append((k, (s, t, sb, tb)))
        else:
            between[s, t].setdefault((s, t, sb, tb), []).append(k)
    for k, ends in vague:
        corridors = between[ends[:2]]
        corridors.setdefault(_fitting(legs, corridors, ends, k), []).append(k)
    return {ends: member for some in between.values() for ends, member in some.items()}


def _chosen_detour(legs: _Legs, corridors: list[IntArray], xy: FloatArray) -> tuple[float, float]:
    """Root mean square share of detours that differ from drive to drive, and their largest
    plausible length [m].

    A drive's length beyond the chord is the corridor's bend or the robot's detour; repeated drives
    separate them, since a bend is the same each time. The lengths of the other drives beyond the
    shortest one estimate the detours (without bias if these are exponentially distributed); the
    shortest gives no estimate. In straight corridors all of the excess is detour, however small, so
    that a share found there does not apply to bends of several metres: hence the limit.
    """
    again = [member for member in corridors if len(member) > 1]
    if not again:
        return 0.0, 0.0
    row = np.concatenate(again)
    shortest = np.concatenate([np.full(len(m), legs.length[m].min()) for m in again])
    line = np.hypot(*(xy[legs.target[row]] - xy[legs.source[row]]).T)
    detour, excess = legs.length[row] - shortest, legs.length[row] - line
    usual = float((detour**2).sum()) / (len(row) - len(again))
    share = usual / max(float(np.mean(excess**2)), 1e-9)
    return float(np.sqrt(min(share, 1.0))), LIKE_SIGMAS * float(np.sqrt(usual))


def _fitting(
    legs: _Legs,
    corridors: dict[_Ends, list[int]],
    ends: _Ends,
    k: int,
) -> _Ends:
    """The corridor that leg k, with an unknown branch, belongs to; its own ends if none fits."""
    best, best_off = ends, DRAWING.sound_m
    for key, member in corridors.items():
        if any(mine not in (NO_BRANCH, its) for mine, its in zip(ends[2:], key[2:], strict=True)):
            continue
        off = abs(float(np.median(legs.length[member])) - legs.length[k])
        if off < best_off:
            best, best_off = key, off
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
