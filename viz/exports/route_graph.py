"""A map as a graph of straight pieces with lengths and driving times, for route planners."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ...topology.arrays import FloatArray, IntArray
from ...topology.digits import significant
from ...topology.polyline import simplify, way_of
from ...topology.topomap import TopoMap
from ...topology.wording import utc

MAX_ERROR_M = 0.05
"""Largest distance of a corridor's path from its straight pieces: about as far as robots wander."""

VIA = -1
"""`RouteGraph.vertex` of a point that is no vertex of the map."""


@dataclass(frozen=True, slots=True, eq=False)
class RouteGraph:
    """Points joined by straight pieces; every piece belongs to one corridor and is driven both
    ways.

    xy: (p, 2) [m], first the map's n vertices, then points along corridors; vertex: (p,) the map's
    vertex or VIA; number: (p,) that vertex as pictures number it, of a site as its document does.
    source, target: (s,) points of each piece, in its edge's direction; edge: (s,) of
    the map; length, length_sigma: (s,) [m]; seconds, seconds_sigma: (s,) driving time, NaN if
    unknown.
    """

    xy: FloatArray
    vertex: IntArray
    number: IntArray
    source: IntArray
    target: IntArray
    edge: IntArray
    length: FloatArray
    length_sigma: FloatArray
    seconds: FloatArray
    seconds_sigma: FloatArray


def route_graph(topomap: TopoMap, max_error_m: float = MAX_ERROR_M) -> RouteGraph:
    """The straight pieces of all corridors.

    A piece has a share of its corridor's length and time by its own length, and of their variances,
    so that independent errors along a route add up in squares. The odometry's scale error, a part
    of `length_sigma`, is common to all pieces and adds up linearly (docs/exports.md). The pieces'
    geometry is up to 0.5 % shorter than the measured length, since it cuts bends.

    Raises ValueError unless max_error_m is positive. O(points of all paths).
    """
    if not max_error_m > 0:
        raise ValueError(f"the largest error must be positive, not {max_error_m:g} m")
    n, m, none = len(topomap), len(topomap.source), np.zeros(0, np.int64)
    ways = [corridor_line(topomap, e, max_error_m) for e in range(m)]
    inner = np.array([len(way) - 2 for way in ways], np.int64)
    stops = n + np.cumsum(inner)
    ends = (topomap.source, topomap.target, stops - inner, stops)
    rows = [np.r_[u, begin:stop, v] for u, v, begin, stop in zip(*ends, strict=True)]
    vertex = np.concatenate([np.arange(n), np.full(inner.sum(), VIA)])
    known = topomap.info.get("numbers")  # of a document it could be anything but a tuple
    own = known if isinstance(known, tuple) else range(len(topomap))
    numbers = np.array([*own, VIA], np.int64)
    of = np.arange(m).repeat(inner + 1)
    lengths = np.concatenate([np.zeros(0), *(np.diff(way_of(way)) for way in ways)])
    whole = np.bincount(of, lengths, minlength=m)
    share = lengths / np.maximum(whole[of], 1e-9)
    stretched = (topomap.measured.scale * topomap.length) ** 2
    by_itself = np.maximum(topomap.length_sigma**2 - stretched, 0.0)
    return RouteGraph(
        xy=np.concatenate([topomap.xy, *(way[1:-1] for way in ways)]),
        vertex=vertex,
        number=numbers[vertex],
        source=np.concatenate([none, *(row[:-1] for row in rows)]),
        target=np.concatenate([none, *(row[1:] for row in rows)]),
        edge=of,
        length=share * topomap.length[of],
        length_sigma=np.sqrt(share * by_itself[of] + share**2 * stretched[of]),
        seconds=share * driving_seconds(topomap)[of],
        seconds_sigma=np.sqrt(share) * seconds_sigma(topomap)[of],
    )


def corridor_line(topomap: TopoMap, edge: int, max_error_m: float) -> FloatArray:
    """(k, 2) a corridor's path from source to target, simplified to within max_error_m."""
    ends = topomap.xy[[topomap.source[edge], topomap.target[edge]]]
    return simplify(np.concatenate([ends[:1], topomap.paths[edge][1:-1], ends[1:]]), max_error_m)


def gone_properties(topomap: TopoMap, edge: int) -> dict[str, Any]:
    """What exports say of a corridor that the latest runs did not find, and which run found it last
    and when: `info["gone"]` of the map, a witness by the edge; {} of others."""
    known = topomap.info.get("gone")  # of a document it could be anything but a dict with numbers
    last = known.get(edge) if isinstance(known, dict) else None
    if last is None:
        return {}
    when = utc(last.last_ns, "%Y-%m-%dT%H:%M:%SZ")
    return {"gone": True, "last_run": last.run, "last_found": when}


def driving_seconds(topomap: TopoMap) -> FloatArray:
    """(m,) median time of all drives through each corridor, both directions [s]; NaN if unknown."""
    out = np.full(len(topomap.source), np.nan)
    for e, times in enumerate(topomap.traversal_ns or ()):
        if len(times):
            # At least a millisecond: documents may hold any times.
            took = max(float(np.median(np.abs(times[:, 1] - times[:, 0]))) * 1e-9, 1e-3)
            out[e] = took
    return out


def seconds_sigma(topomap: TopoMap) -> FloatArray:
    """(m,) standard deviation of `driving_seconds` [s]; NaN where that, or the spread of drives, is
    unknown.

    The relative spread of driving times is pooled over all corridors with several drives, since
    single corridors have too few; the mean of n drives has this over √n.
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


def known_seconds(seconds: float, sigma: float) -> dict[str, float]:
    """A driving time and its standard deviation for an export, without what is unknown."""
    both = {"seconds": seconds, "seconds_sigma": sigma}
    return {name: significant(value) for name, value in both.items() if np.isfinite(value)}


def driving_speed(topomap: TopoMap) -> FloatArray:
    """(m,) length over median driving time of each corridor [m/s]; NaN if unknown."""
    return np.asarray(topomap.length / driving_seconds(topomap))


def last_pass_ns(topomap: TopoMap) -> int:
    """Time of the map's newest observation, 0 without any: the date of exports that need one, so
    that the same map gives the same file."""
    return int(topomap.observation_time_ns.max(initial=0))
