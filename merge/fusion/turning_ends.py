"""Turning points of a component's runs, attached to the junctions of its fused map.

A robot may turn round anywhere, so that turning points do not identify places. The deepest one by a
branch of a junction is the end of the corridor. A turning point is dropped if a corridor leaves by
its branch, since another run drove on there.
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

    seen: (run, time) of every drive to it; member, edge: its run, and the numbers of its vertex and
    edge in the run's map (`with_turning_points`).
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
    """The fused map with the turning points of its runs as last vertices, and the corridors to them
    as last edges. maps: of all runs, sorted by name. O(n log n).

    Only those that `group_by_dead_end` keeps, as in the maps of single runs.
    """
    if not any(len(m.turning_points) for m in maps):
        return fused
    ends = sorted(_ends(fused, components, maps), key=lambda e: -e.length)
    groups = group_by_dead_end(
        enumerate(ends),
        fused,
        _corridors(fused, DRAWING.sound_m / 4),
        sound_m=DRAWING.sound_m,
        near_m=DRAWING.sound_m,
    )
    return _appended(fused, groups)


def _corridors(fused: FusedMap, step_m: float) -> Callable[[int], Ways]:
    """For a fused vertex the corridors of its component, computed once per component."""
    component_of = fused.component

    @cache
    def of(component: int) -> Ways:
        rows = np.flatnonzero(component_of[fused.source] == component).tolist()
        return Ways([fused.paths[k] for k in rows], step_m)

    return lambda vertex: of(int(component_of[vertex]))


def _ends(
    fused: FusedMap, components: Sequence[Component], maps: Sequence[TopoMap]
) -> Iterator[_End]:
    """The turning points of all runs, attached to fused vertices."""
    poses = {run: pose for c in components for run, pose in c.poses.items()}
    vertex_of = fused_of(fused.members)
    for m in maps:
        pose, turning_points = poses[m.run], m.turning_points
        for row in range(len(turning_points)):
            vertex, branch = int(turning_points.vertex[row]), int(turning_points.branch[row])
            fused_vertex = vertex_of[m.run, vertex]
            path = apply(pose, turning_points.paths[row])
            path = path + (fused.xy[fused_vertex] - path[0])
            fused_branch = NO_BRANCH
            if branch != NO_BRANCH:
                turn_rad = np.abs(
                    wrap(fused.branches[fused_vertex] - (m.branches[vertex][branch] + pose[2]))
                )
                fused_branch = int(turn_rad.argmin()) if turn_rad.min() <= DRIVEN_RAD else NO_BRANCH
            yield _End(
                vertex=fused_vertex,
                branch=fused_branch,
                path=path,
                kind=turning_points.kind[row],
                heading=float(wrap(turning_points.heading[row] + pose[2])),
                length=float(turning_points.length[row]),
                length_sigma=float(turning_points.length_sigma[row]),
                drives=int(turning_points.traversals[row]),
                seen=[(m.run, ns) for ns in turning_points.time_ns[row][:, 0].tolist()],
                member=(m.run, len(m) + row),
                edge=(m.run, len(m.source) + row),
            )


def _appended(fused: FusedMap, groups: Sequence[Sequence[_End]]) -> FusedMap:
    """The fused map with a new vertex for each group of turning points, the farthest first."""
    if not groups:
        return fused
    first_new, count = len(fused), len(groups)
    deepest = [group[0] for group in groups]
    vertices = np.array([e.vertex for e in deepest])
    length_sigma = np.array([e.length_sigma for e in deepest])
    sigma = fused.position_sigma
    rows = {
        "component": fused.component[vertices],
        "xy": [e.path[-1] for e in deepest],
        "branches": Ragged(np.arange(count + 1), np.array([e.heading for e in deepest])),
        "kind": [e.kind for e in deepest],
        "members": [by_run(sorted(e.member for e in group)) for group in groups],
        "observations": [tuple(sorted(o for e in group for o in e.seen)) for group in groups],
        "source": vertices,
        "target": np.arange(first_new, first_new + count),
        "source_branch": [e.branch for e in deepest],
        "target_branch": np.zeros(count, np.int64),
        "length": [e.length for e in deepest],
        "length_sigma": length_sigma,
        "traversals": [sum(e.drives for e in group) for group in groups],
        "paths": [e.path for e in deepest],
        "edge_members": [tuple(sorted(e.edge for e in group)) for group in groups],
        "position_sigma": None if sigma is None else np.hypot(sigma[vertices], length_sigma),
    }
    return replace(fused, **columns_and(fused, rows))
