"""Turning points of a component's runs, attached to the junctions of its fused map.

Where a robot turns round is arbitrary, so that turning points do not identify places. Of those by
one branch of a junction the deepest is the end of the corridor. One is dropped where a corridor
leaves by its branch, since another run drove on there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import cache
from typing import NamedTuple

import numpy as np

from ...topology.arrays import FloatArray
from ...topology.columns import columns_and
from ...topology.mapbuilding import DRAWING
from ...topology.passes import DRIVEN_RAD, NO_BRANCH
from ...topology.polyline import Ways
from ...topology.ragged import Ragged
from ...topology.se2 import apply, wrap
from ...topology.topomap import TopoMap
from ...topology.turning_back import group_by_dead_end
from ..result import Component, FusedMap, by_run, fused_of


class _End(NamedTuple):
    """A turning point of a run, attached to a fused vertex, in its component's frame.

    seen: (run, time) of every drive to it; member, edge: its run, and the numbers of the vertex and
    of the edge that it is there (`with_turning_points`).
    """

    vertex: int
    branch: int
    path: FloatArray
    kind: str
    heading: float
    length: float
    length_sigma: float
    drives: int
    seen: list[tuple[str, int]]
    member: tuple[str, int]
    edge: tuple[str, int]


def with_turning_ends(
    fused: FusedMap, components: Sequence[Component], maps: Sequence[TopoMap]
) -> FusedMap:
    """The fused map with the turning points of its runs as its last vertices, and the corridors to
    them as its last edges. maps: of all runs, sorted by name. O(n log n).

    Keeps those that `group_by_dead_end` keeps, as in the maps of single runs.
    """
    if not any(len(m.turning_points) for m in maps):
        return fused
    found = sorted(_ends(fused, components, maps), key=lambda e: -e.length)
    kept = group_by_dead_end(
        enumerate(found),
        fused,
        _corridors(fused, DRAWING.sound_m / 4),
        sound_m=DRAWING.sound_m,
        near_m=DRAWING.sound_m,
    )
    return _appended(fused, kept)


def _corridors(fused: FusedMap, step_m: float) -> Callable[[int], Ways]:
    """For a fused vertex the corridors of its component, computed once per component."""
    home = fused.component

    @cache
    def of(component: int) -> Ways:
        rows = np.flatnonzero(home[fused.source] == component).tolist()
        return Ways([fused.paths[k] for k in rows], step_m)

    return lambda vertex: of(int(home[vertex]))


def _ends(
    fused: FusedMap, components: Sequence[Component], maps: Sequence[TopoMap]
) -> Iterator[_End]:
    """The turning points of all runs, attached to fused vertices."""
    poses = {run: pose for c in components for run, pose in c.poses.items()}
    home = fused_of(fused.members)
    for m in maps:
        T, t = poses[m.run], m.turning_points
        for row in range(len(t)):
            vertex, branch = int(t.vertex[row]), int(t.branch[row])
            at = home[m.run, vertex]
            path = apply(T, t.paths[row])
            path = path + (fused.xy[at] - path[0])
            its = NO_BRANCH
            if branch != NO_BRANCH:
                off = np.abs(wrap(fused.branches[at] - (m.branches[vertex][branch] + T[2])))
                its = int(off.argmin()) if off.min() <= DRIVEN_RAD else NO_BRANCH
            yield _End(
                vertex=at,
                branch=its,
                path=path,
                kind=t.kind[row],
                heading=float(wrap(t.heading[row] + T[2])),
                length=float(t.length[row]),
                length_sigma=float(t.length_sigma[row]),
                drives=int(t.traversals[row]),
                seen=[(m.run, ns) for ns in t.time_ns[row][:, 0].tolist()],
                member=(m.run, len(m) + row),
                edge=(m.run, len(m.source) + row),
            )


def _appended(fused: FusedMap, kept: Sequence[Sequence[_End]]) -> FusedMap:
    """kept: for every new vertex the turning points that are fused in it, the farthest first."""
    if not kept:
        return fused
    n, k = len(fused), len(kept)
    deepest = [group[0] for group in kept]
    at = np.array([e.vertex for e in deepest])
    length_sigma = np.array([e.length_sigma for e in deepest])
    own = fused.position_sigma
    more = {
        "component": fused.component[at],
        "xy": [e.path[-1] for e in deepest],
        "branches": Ragged(np.arange(k + 1), np.array([e.heading for e in deepest])),
        "kind": [e.kind for e in deepest],
        "members": [by_run(sorted(e.member for e in group)) for group in kept],
        "observations": [tuple(sorted(o for e in group for o in e.seen)) for group in kept],
        "source": at,
        "target": np.arange(n, n + k),
        "source_branch": [e.branch for e in deepest],
        "target_branch": np.zeros(k, np.int64),
        "length": [e.length for e in deepest],
        "length_sigma": length_sigma,
        "traversals": [sum(e.drives for e in group) for group in kept],
        "paths": [e.path for e in deepest],
        "edge_members": [tuple(sorted(e.edge for e in group)) for group in kept],
        "position_sigma": None if own is None else np.hypot(own[at], length_sigma),
    }
    return replace(fused, **columns_and(fused, more))
