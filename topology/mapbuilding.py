"""From identified passes to the topological map: vertices, corridors, what was driven."""

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
from .passes import NO_BRANCH, Passes, nearest_branch
from .polyline import join_centres, loop_erased, loop_width, simplify, way_of, with_corners
from .ragged import Ragged
from .se2 import wrap
from .topomap import RunNoise, TopoMap
from .track import by_begin, times_between, track_directions, way_at
from .vertex_errors import VertexErrors
from .visits import PassesAtPlaces, Visits, draw_track

_Ends = tuple[int, int, int, int]
"""Of a corridor: source, target, and the branch at each."""


@dataclass(frozen=True, slots=True)
class MapBuildingSettings:
    """How the final map is drawn."""

    slot_gap_rad: float = 0.35
    """Branch readings of several passes farther apart than this belong to different branches."""
    least_share: float = 0.5
    """Share of a vertex's passes that must have seen a branch which was never driven."""
    match_rad: float = 0.7
    """A branch farther than this from the track's direction was not the one driven."""
    straight_rad: float = 0.35
    """Two branches opposite to within this are no bend."""
    path_step_m: float = 0.1
    path_tolerance_m: float = 0.08
    """Paths are thinned to polylines no farther than this from the track."""
    junction_m: float = 0.7
    """So near to a junction's centre the robot cuts its corner: there a corridor is straight."""
    passable_m: float = 0.5
    """Points of a track so near to each other have no wall between them: robots are about as wide,
    and have driven on either side of it."""
    corner_m: float = 0.5
    """A turn within this to either side is a corner of the corridor, cut by the robot …"""
    corner_rad: float = 0.5
    """… if it turns by this; gentler ones are bends, driven as they are."""
    standing_m: float = 0.05
    """A robot that stands, or turns on the spot, seems to drive no farther: what it does so near to
    a centre is no part of the time that a corridor takes."""
    moved_m: float = 0.05
    """A robot that drove no farther between two visits did not move."""
    same_length_m: float = 1.5
    """A leg with an unknown branch is of the corridor whose median length is within this of its."""
    sound_m: float = 1.0
    """A leg within this of its corridor's median length was driven straight through."""
    repeated_m: float = 50.0
    """Way driven again without wandering at all that a run is taken to have shown beforehand."""


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
    settings: MapBuildingSettings = MapBuildingSettings(),
) -> TopoMap:
    """The map of a run whose passes have been identified.

    errors: of vertices; askew_rad: 1 sigma of headings that all passes of a vertex share; noise,
    fitted_noise: as in TopoMap.
    """
    xy, visits = places.xy, places.visits
    track = track_directions(odometry, visits.time_ns, visits.centre)
    arriving, leaving = track.arriving + visits.pose[:, 2], track.leaving + visits.pose[:, 2]
    slots, votes, keep = _slots(passes, places, (arriving, leaving), settings)
    branches = Ragged.by_owner(slots.owner[keep], slots.mean[keep], len(xy))
    there = branches.take(visits.vertex)
    exit_ = nearest_branch(there, leaving, settings.match_rad)
    entry = nearest_branch(there, arriving, settings.match_rad)
    legs = _legs(odometry, visits, exit_, entry, xy=xy, settings=settings)
    edges = _edges(legs, xy, settings)
    paths = _paths(legs, edges, settings)
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
        kind=tuple(_kind(branches[i], settings) for i in range(len(xy))),
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
    """(count,) mean of the values of each group, 1 for a group without any."""
    size = np.bincount(group, minlength=count)
    total = np.bincount(group, values, count)
    return np.where(size > 0, total / np.maximum(size, 1), 1.0)


def _slots(
    passes: Passes,
    places: PassesAtPlaces,
    driven_rad: tuple[FloatArray, FloatArray],
    settings: MapBuildingSettings,
) -> tuple[AngleClusters, IntArray, BoolArray]:
    """Branches of every vertex, by how many passes each was seen, and which of them stay: driven,
    or seen by enough passes. driven_rad: (v,) directions each, in which the track leaves visits."""
    pass_vertex, visited = np.where(places.fair, places.place, -1), places.visits.vertex
    owner = passes.branches.owner
    known = pass_vertex[owner] >= 0
    angle = (passes.branches.values + places.turn[owner])[known]
    home = pass_vertex[owner][known]
    slots = cluster_angles(angle, home, settings.slot_gap_rad)
    votes = slots.votes(owner[known])
    visits = np.bincount(pass_vertex[pass_vertex >= 0])
    share = votes / visits[slots.owner]
    rows = Ragged.by_owner(slots.owner, slots.mean, len(visits))
    driven = np.zeros(len(slots), bool)
    there = rows.take(visited)
    for direction in driven_rad:
        local = nearest_branch(there, direction, settings.match_rad)
        hit = local != NO_BRANCH
        driven[rows.offsets[visited[hit]] + local[hit]] = True
    return slots, votes, driven | slots.well_seen(share, settings.least_share)


def _kind(branches: FloatArray, settings: MapBuildingSettings) -> str:
    if len(branches) == 1:
        return "dead_end"
    if len(branches) == 2:
        opposite = abs(abs(float(wrap(branches[0] - branches[1]))) - np.pi)
        return "junction" if opposite < settings.straight_rad else "bend"
    return "junction"


@dataclass(frozen=True, slots=True, eq=False)
class _Legs:
    """Drives from a visit to the next: ends with their branches, and the way from centre to centre.

    length: (l,) of `path` [m]; path: l polylines from the first visit's vertex to the next one's;
    time_ns: (l, 2) when the robot left the first visit's centre and came to the next one's.
    """

    source: IntArray
    target: IntArray
    source_branch: IntArray
    target_branch: IntArray
    length: FloatArray
    path: list[FloatArray]
    turned: BoolArray
    """Driven from target to source."""
    time_ns: IntArray


def _legs(
    odometry: Odometry,
    visits: Visits,
    exit_: IntArray,
    entry: IntArray,
    *,
    xy: FloatArray,
    settings: MapBuildingSettings,
) -> _Legs:
    """Legs within an unbroken track; turning back in a corridor makes no edge."""
    first = np.arange(len(visits.time_ns) - 1)
    u, v = visits.vertex[:-1], visits.vertex[1:]
    a, b = exit_[:-1], entry[1:]
    loop = (u == v) & ((a == b) | (a == NO_BRANCH) | (b == NO_BRANCH))
    driven = np.diff(way_at(odometry, visits.time_ns)) > settings.moved_m
    fine = (np.diff(visits.piece) == 0) & ~loop & driven
    path = _between_centres(odometry, visits, xy, first[fine], settings)
    length = np.array([way_of(p)[-1] for p in path])
    away = (u != v)[fine] | np.array([is_ring(p, settings) for p in path], bool)
    first, u, v, a, b = (x[fine][away] for x in (first, u, v, a, b))
    path, length = [p for p, some in zip(path, away.tolist(), strict=True) if some], length[away]
    # Each corridor in one direction: from the smaller (vertex, branch).
    swap = (u > v) | ((u == v) & (a > b))
    s, t = np.where(swap, v, u), np.where(swap, u, v)
    sb, tb = np.where(swap, b, a), np.where(swap, a, b)
    time_ns = times_between(odometry, visits.time_ns, first, settings.standing_m)
    return _Legs(s, t, sb, tb, length, path, swap, time_ns)


def _between_centres(
    odometry: Odometry,
    visits: Visits,
    xy: FloatArray,
    first: IntArray,
    settings: MapBuildingSettings,
) -> list[FloatArray]:
    """The way of each leg from the centre of one junction to that of the next, in the map's frame.

    The robot passes beside a centre, and before it where it turns: what it drove there is no part
    of the corridor, nor is what it drove out and back. In between the track is drawn as both
    junctions see it.
    """
    track = draw_track(odometry, visits, xy, first, settings.path_step_m)
    out = []
    for k, visit in enumerate(first.tolist()):
        drawn = track.xy[track.offsets[k] : track.offsets[k + 1]]
        begin, end = xy[visits.vertex[visit : visit + 2]]
        loop = visits.vertex[visit] == visits.vertex[visit + 1]
        out.append(centre_line(drawn, begin, end, settings, loop=bool(loop)))
    return out


def centre_line(
    drawn: FloatArray,
    begin: FloatArray,
    end: FloatArray,
    settings: MapBuildingSettings,
    *,
    loop: bool = False,
) -> FloatArray:
    """(p, 2) the corridor between the centres of two junctions, or of one that it comes back to
    (loop), from a track drawn (k, 2) in the map that led from one to the other."""
    path = join_centres(drawn, begin, end, settings.junction_m)
    # Where a track was joined to a centre it has an angle, but nobody cut a corner there.
    inner = path[1:-1]
    if not loop:  # a loop comes back, that is all it is
        inner = loop_erased(inner, settings.passable_m)
    inner = with_corners(inner, settings.corner_m, settings.corner_rad)
    return np.concatenate([path[:1], inner, path[-1:]])


def is_ring(path: FloatArray, settings: MapBuildingSettings) -> bool:
    """Whether a path back to where it began goes round something: who turns about, in a junction
    or on the way, may seem to leave it by one branch and to enter by another."""
    long = float(way_of(path)[-1]) > 2 * settings.junction_m
    return long and loop_width(path) > settings.passable_m


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
    """The leg whose track is drawn (`corridor_lengths`)."""
    wander: float
    """Variance, per metre, of the ways driven through one corridor."""
    detour: float
    """How much of what ways go round between their ends was the robots' choice, not the corridors'
    …"""
    farthest_m: float
    """… and how far hardly any goes round by choice (`_chosen_detour`)."""


def _edges(legs: _Legs, xy: FloatArray, settings: MapBuildingSettings) -> _Edges:
    """Legs between the same branches of the same vertices are one corridor.

    A leg with an unknown branch joins the corridor between its vertices that fits its length.
    """
    groups = _corridors(legs, settings)
    keys = sorted(groups)
    members = [np.array(groups[key]) for key in keys]
    sound = [_sound(legs, member, settings) for member in members]
    line = np.hypot(*(xy[legs.target] - xy[legs.source]).T)
    length, leg = corridor_lengths(legs.length, line, sound)
    excess = sum(float(np.var(legs.length[some]) * len(some)) for some in sound)
    way = settings.repeated_m + sum(
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


def _sound(legs: _Legs, member: IntArray, settings: MapBuildingSettings) -> IntArray:
    """The legs through a corridor that nothing held up, the shortest first."""
    ordered = member[np.argsort(legs.length[member], kind="stable")]
    middle = legs.length[ordered[len(ordered) // 2]]
    sound: IntArray = ordered[np.abs(legs.length[ordered] - middle) < settings.sound_m]
    return sound


def _corridors(legs: _Legs, settings: MapBuildingSettings) -> dict[_Ends, list[int]]:
    """Numbers of the legs through each corridor, by its ends."""
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
        corridors.setdefault(_fitting(legs, corridors, ends, k, settings), []).append(k)
    return {ends: member for some in between.values() for ends, member in some.items()}


def _chosen_detour(legs: _Legs, corridors: list[IntArray], xy: FloatArray) -> tuple[float, float]:
    """Root mean square share of the detours driven that a robot takes one time and not another, and
    how long [m] hardly any is.

    What a way is longer than the line between its ends is the corridor's bend, or the robot's
    wandering: what it drives again tells how much of it is not there the next time. Beyond the
    shortest of several ways the others go as far as one goes beyond the corridor (were ways longer
    by exponential amounts, exactly); the shortest itself tells nothing. What drives of straight
    corridors differ by, which is all of their detours, says nothing of bends of metres.
    """
    again = [member for member in corridors if len(member) > 1]
    if not again:
        return 0.0, 0.0
    row = np.concatenate(again)
    shortest = np.concatenate([np.full(len(m), legs.length[m].min()) for m in again])
    line = np.hypot(*(xy[legs.target[row]] - xy[legs.source[row]]).T)
    chosen, gone = legs.length[row] - shortest, legs.length[row] - line
    usual = float((chosen**2).sum()) / (len(row) - len(again))
    share = usual / max(float(np.mean(gone**2)), 1e-9)
    return float(np.sqrt(min(share, 1.0))), LIKE_SIGMAS * float(np.sqrt(usual))


def _fitting(
    legs: _Legs,
    corridors: dict[_Ends, list[int]],
    ends: _Ends,
    k: int,
    settings: MapBuildingSettings,
) -> _Ends:
    """Of the corridors between its vertices, the one that leg k belongs to, of whose ends some
    branch is unknown; its own ends if none fits."""
    best, best_off = ends, settings.same_length_m
    for key, member in corridors.items():
        if any(mine not in (NO_BRANCH, its) for mine, its in zip(ends[2:], key[2:], strict=True)):
            continue
        off = abs(float(np.median(legs.length[member])) - legs.length[k])
        if off < best_off:
            best, best_off = key, off
    return best


def _paths(legs: _Legs, edges: _Edges, settings: MapBuildingSettings) -> tuple[FloatArray, ...]:
    """The way of every edge, in the map frame, from vertex to vertex, thinned."""
    ways = (legs.path[k][:: -1 if legs.turned[k] else 1] for k in edges.leg.tolist())
    return tuple(simplify(way, settings.path_tolerance_m) for way in ways)


def _length_sigma(
    edges: _Edges,
    paths: Sequence[FloatArray],
    xy: FloatArray,
    noise: RunNoise,
    errors: VertexErrors,
) -> FloatArray:
    """(m,) 1 sigma [m] of the corridors' lengths.

    A path bent onto its two ends gets longer by their error along the chord times the share of the
    chord in it (the mean of its directions), to first order. That holds the scale of the odometry
    to the share squared, and the rest of the way to the rest: one error of the whole length.

    What is left of a way that winds is the odometry's. Of what it errs by along the way, to bend
    the path takes out the share of the chord, squared; and where it turned wrongly, the ends are
    moved (`turning_variance`) though the length was right. What robots wander in a corridor, and
    go round where none leads them, shows where they drive it again (`corridor_lengths`). No
    corridor is shorter than the line between its ends: a drive is no farther beyond it than beyond
    that.
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
