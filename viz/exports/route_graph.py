"""A map as a route planner wants it: straight pieces between points, speeds and times."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...topology.arrays import FloatArray, IntArray
from ...topology.polyline import simplify, way_of
from ...topology.topomap import TopoMap

MAX_ERROR_M = 0.05
"""How far a corridor's path may lie from the straight pieces it is given as: a third of what the
centres of junctions are known to (they are seen with some 0.1 m), and less than robots wander."""

VIA = -1
"""Stands for the vertex of a point between two junctions."""


@dataclass(frozen=True, slots=True, eq=False)
class RouteGraph:
    """Points joined by straight pieces; every piece lies on one corridor and leads both ways.

    xy: (p, 2) [m], the map's n vertices first, then points on the way; vertex: (p,) their vertex,
    or VIA. source, target: (s,) points of each piece, along the direction of its edge; edge: (s,)
    of the map; length, length_sigma: (s,) [m], its share of the corridor's; seconds, seconds_sigma:
    (s,) that driving it takes, NaN where that is not known.
    """

    xy: FloatArray
    vertex: IntArray
    source: IntArray
    target: IntArray
    edge: IntArray
    length: FloatArray
    length_sigma: FloatArray
    seconds: FloatArray
    seconds_sigma: FloatArray


def route_graph(topomap: TopoMap, max_error_m: float = MAX_ERROR_M) -> RouteGraph:
    """The straight pieces of all corridors. A piece takes its share of its corridor's length and
    time, and of their variances: errors along a route add up by their squares. What the odometry's
    scale is off by, which is part of `length_sigma`, is the same share of every length, so that
    pieces add up to their corridor as corridors do to a route (docs/exports.md). The pieces
    themselves cut a bend short, by up to 0.5 %; the length was measured before it was cut.

    Raises ValueError unless max_error_m is positive. O(points of all paths).
    """
    if not max_error_m > 0:
        raise ValueError(f"the largest error must be positive, not {max_error_m:g} m")
    points, vertices = [topomap.xy], [np.arange(len(topomap))]
    source, target, edge, length = [], [], [], []
    count = len(topomap)
    for e in range(len(topomap.source)):
        way = corridor_line(topomap, e, max_error_m)
        inner = np.arange(count, count + len(way) - 2)
        row = np.concatenate([topomap.source[e : e + 1], inner, topomap.target[e : e + 1]])
        points.append(way[1:-1])
        vertices.append(np.full(len(inner), VIA))
        source.append(row[:-1])
        target.append(row[1:])
        edge.append(np.full(len(row) - 1, e))
        length.append(np.diff(way_of(way)))
        count += len(inner)
    none, some = np.zeros(0, np.int64), len(edge) > 0
    of = np.concatenate(edge) if some else none
    lengths = np.concatenate(length) if some else np.zeros(0)
    whole = np.bincount(of, lengths, minlength=len(topomap.source))
    share = lengths / np.maximum(whole[of], 1e-9)
    stretched = (topomap.measured.scale * topomap.length) ** 2
    by_itself = np.maximum(topomap.length_sigma**2 - stretched, 0.0)
    return RouteGraph(
        xy=np.concatenate(points),
        vertex=np.concatenate(vertices).astype(np.int64),
        source=np.concatenate(source) if some else none,
        target=np.concatenate(target) if some else none,
        edge=of,
        length=share * topomap.length[of],
        length_sigma=np.sqrt(share * by_itself[of] + share**2 * stretched[of]),
        seconds=share * driving_seconds(topomap)[of],
        seconds_sigma=np.sqrt(share) * seconds_sigma(topomap)[of],
    )


def corridor_line(topomap: TopoMap, edge: int, max_error_m: float) -> FloatArray:
    """(k, 2) the path of a corridor from its source to its target, in straight pieces."""
    ends = topomap.xy[[topomap.source[edge], topomap.target[edge]]]
    return simplify(np.concatenate([ends[:1], topomap.paths[edge][1:-1], ends[1:]]), max_error_m)


def driving_seconds(topomap: TopoMap) -> FloatArray:
    """(m,) median time [s] of all drives through each corridor, both ways; NaN where unknown."""
    out = np.full(len(topomap.source), np.nan)
    for e, times in enumerate(topomap.traversal_ns or ()):
        if len(times):
            # A drive through a whole corridor takes some time; a document could claim anything.
            took = max(float(np.median(np.abs(times[:, 1] - times[:, 0]))) * 1e-9, 1e-3)
            out[e] = took
    return out


def seconds_sigma(topomap: TopoMap) -> FloatArray:
    """(m,) 1 sigma [s] of `driving_seconds`; NaN where that, or how far drives differ, is unknown.

    Two or three drives do not show how far they differ: all corridors of the map that were driven
    more than once tell together, as the share of their times, and of n drives the mean of that is
    known to one part in the root of n.
    """
    seconds = driving_seconds(topomap)
    times = topomap.traversal_ns or ()
    took = [np.abs(t[:, 1] - t[:, 0]) * 1e-9 for t in times]
    count = np.array([len(t) for t in took] or np.zeros(len(seconds)))
    again = [t / t.mean() - 1 for t in took if len(t) > 1 and t.mean() > 0]
    if not again:
        return np.full(len(seconds), np.nan)
    freedom = sum(len(t) - 1 for t in again)
    differ = np.sqrt(sum(float(t @ t) for t in again) / freedom)
    return np.asarray(differ * seconds / np.sqrt(np.maximum(count, 1)))


def driving_speed(topomap: TopoMap) -> FloatArray:
    """(m,) typical speed [m/s] in each corridor: its length over its median time; NaN: unknown."""
    return np.asarray(topomap.length / driving_seconds(topomap))


def last_pass_ns(topomap: TopoMap) -> int:
    """When the newest of the map's observations was made; 0 without any. Exports that need a date
    take it, so that the same map gives the same file at any time."""
    return int(topomap.observation_time_ns.max(initial=0))
