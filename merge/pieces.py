"""Joining the pieces of one run whose odometry broke: maps that share no frame."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ..topology.arrays import BoolArray, IntArray
from ..topology.columns import joined, take
from ..topology.connected import connected
from ..topology.topomap import Closure, TopoMap
from ..topology.views import NO_VIEWS, Views
from ..topology.wording import counted
from .component_map import component_map
from .merging import merge_maps
from .result import Component, MergeResult, graph_part
from .robust import DEFAULT_ROBUST


def joined_pieces(topomap: TopoMap) -> tuple[TopoMap, ...]:
    """The map of a run in as few pieces as its evidence allows, the one with most passes first.

    In a map with several `pieces` the odometry broke: its connected parts are drawn in one frame,
    but their relative poses are unknown. They are merged like the maps of different runs, with the
    same thresholds. What stays apart becomes a map of its own, named `RUN#2`, `RUN#3`, … by time,
    in a frame of its own, for the merge with other runs; parts too small for any merge are left
    out, with a warning. A map of one piece is returned as it is.
    """
    if topomap.pieces < 2:
        return (topomap,)
    parts, least = _parts(topomap), DEFAULT_ROBUST.min_matches
    small = [part for part in parts if len(part) < least]
    able = {part.run: part for part in parts if len(part) >= least}
    result = merge_maps(list(able.values()))
    # Components come in the order of their first parts, which are named by time.
    found = [_as_piece(topomap, result, c, able) for c in result.components]
    main = max(found or small, key=_passes)
    kept = [main, *(m for m in found if m is not main)]
    small = [m for m in small if m is not main]
    names = [topomap.run, *(f"{topomap.run}#{k}" for k in range(2, len(kept) + 1))]
    text = _describe(len(parts), names, small)
    info = {k: v for k, v in topomap.info.items() if k != "pieces"}
    info["warnings"] = [*info.get("warnings", ()), text]
    return tuple(replace(m, run=name, info=info) for m, name in zip(kept, names, strict=True))


def _passes(topomap: TopoMap) -> int:
    return len(topomap.observation_vertex)


def _describe(pieces: int, names: Sequence[str], small: Sequence[TopoMap]) -> str:
    """One sentence on the result for the pieces."""
    joined = pieces - len(names) - len(small)
    text = f"the odometry broke: {pieces} pieces, {joined} joined to another by what they saw"
    if len(names) > 1:
        text += f"; on their own: {', '.join(names[1:])}"
    if small:
        passes = counted(sum(map(_passes, small)), "junction pass", "junction passes")
        text += f"; left out as too small to be placed: {len(small)} ({passes})"
    return text


def _parts(topomap: TopoMap) -> list[TopoMap]:
    """The connected parts of a map as maps of their own, named by their order in time."""
    label = connected(topomap.source, topomap.target, len(topomap))
    count = int(label.max()) + 1
    first = np.full(count, np.iinfo(np.int64).max)
    np.minimum.at(first, label, _first_passes(topomap))
    order = np.argsort(first, kind="stable")
    width = len(str(count))
    return [_part(topomap, label == k, f"{i:0{width}d}") for i, k in enumerate(order.tolist())]


def _closures_of(topomap: TopoMap, time_ns: IntArray) -> tuple[Closure, ...]:
    """The closures of a map that are about passes at some of these times."""
    times = set(time_ns.tolist())
    return tuple(c for c in topomap.closures if times & {c.time_a_ns, c.time_b_ns})


def _part(topomap: TopoMap, chosen: BoolArray, name: str) -> TopoMap:
    """The chosen vertices of a map, which are connected among themselves only."""
    seen = chosen[topomap.observation_vertex]
    time_ns = topomap.observation_time_ns[seen]
    return replace(
        topomap,
        run=name,
        **graph_part(topomap, chosen),
        observation_vertex=(np.cumsum(chosen) - 1)[topomap.observation_vertex[seen]],
        observation_time_ns=time_ns,
        closures=_closures_of(topomap, time_ns),
        views=_seen_from(topomap, seen),
        info={},
    )


def _seen_from(topomap: TopoMap, chosen: BoolArray) -> Views:
    """The views that are nearest in time to the chosen passes: the pieces of a run follow each
    other."""
    views, times = topomap.views, topomap.observation_time_ns
    if not len(views) or not len(times):
        return NO_VIEWS
    nearest = np.searchsorted((times[1:] + times[:-1]) // 2, views.time_ns)
    return take(views, chosen[nearest])


def _as_piece(
    topomap: TopoMap, result: MergeResult, component: Component, parts: Mapping[str, TopoMap]
) -> TopoMap:
    """A component of the merged parts as the map of their run."""
    piece = component_map(result, component.id, topomap.frame, parts)
    views = joined([parts[run].views.moved(pose) for run, pose in component.poses.items()])
    return replace(
        piece,
        noise=topomap.noise,
        fitted_noise=topomap.fitted_noise,
        shows_bends=topomap.shows_bends,
        closures=_closures_of(topomap, piece.observation_time_ns),
        views=take(views, np.argsort(views.time_ns, kind="stable")),
    )


def _first_passes(topomap: TopoMap) -> IntArray:
    """(n,) time of the first pass by every vertex."""
    first = np.full(len(topomap), np.iinfo(np.int64).max)
    np.minimum.at(first, topomap.observation_vertex, topomap.observation_time_ns)
    return first
