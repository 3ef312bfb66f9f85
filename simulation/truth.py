"""The ground truth of simulated runs, and `truth.json`: schema `topobatch.truth/1`.

    {"schema": "topobatch.truth/1",
     "worlds": {"maze": {"kind": "maze",
                         "vertices": [[x, y], …],
                         "edges": [[source, target, length, [[x, y], …]], …]}},
     "runs": {"run1": {"world": "maze",
                       "T_world_odom": [x, y, theta],
                       "passes": {"start_ns": […], "end_ns": […], "vertex": […],
                                  "messages": […], "fault": […]},
                       "drives": {"edge": […], "start_ns": […], "end_ns": […]},
                       "closed_edges": […], "break_ns": […], "jump_ns": […],
                       "path": [[time_ns, x, y, theta], …],
                       "settings": {…}}},
     "changes": [{"world": "maze", "edge": 7, "time_ns": …, "open": false}],
     "pairs": [{"a": "run1", "b": "run2", "common": [vertex, …], "transform": [x, y, theta]}]}

Metres and radians in the world's frame. Vertices and edges are indices into their world's lists.
`vertex` is -1 for a phantom; a pass with 0 messages was not detected. Times of passes are detector
stamps, those of `path` and `drives` true times. `closed_edges` are the corridors closed during a
run; `changes` those that closed or opened for good between runs, left out without any.
`T_world_odom` is the odometry frame's pose by the run's first pose, without drift. `transform` is
T_a_b by these poses; it and `common` (vertices that both runs detected) are given for every pair of
runs of one world.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from scipy.cluster.hierarchy import DisjointSet

from ..topology.arrays import FloatArray, IntArray
from ..topology.files import write_json
from ..topology.se2 import apply, between, fit_rigid, wrap
from ..topology.topomap import TopoMap
from .detector import NO_VERTEX
from .world import World

TRUTH_SCHEMA = "topobatch.truth/1"

MIXED = -2
"""Vertex of a map's node with passes of several vertices."""


@dataclass(frozen=True, slots=True, eq=False)
class RunTruth:
    """The truth about a run, with the fields of `truth.json` as arrays.

    start_ns, end_ns, vertex, messages (p,), fault (p,): passes by time. drive_edge, drive_start_ns,
    drive_end_ns (l,): corridors driven from end to end. path_ns (k,), path (k, 3).
    """

    name: str
    world: str
    T_world_odom: FloatArray
    start_ns: IntArray
    end_ns: IntArray
    vertex: IntArray
    messages: IntArray
    fault: tuple[str, ...]
    drive_edge: IntArray
    drive_start_ns: IntArray
    drive_end_ns: IntArray
    path_ns: IntArray
    path: FloatArray
    closed_edges: tuple[int, ...] = ()
    break_ns: tuple[int, ...] = ()
    jump_ns: tuple[int, ...] = ()
    settings: Mapping[str, Any] = field(default_factory=dict)

    @property
    def detected(self) -> set[int]:
        """World vertices with at least one detected pass."""
        return set(self.vertex[self.messages > 0].tolist()) - {NO_VERTEX}


@dataclass(frozen=True, slots=True)
class WorldChange:
    """A corridor of a world that closed, or opened, and stays so."""

    world: str
    edge: int
    time_ns: int
    open: bool


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """The worlds and the truth of the runs of a scenario, by name; changes by time."""

    worlds: Mapping[str, World]
    runs: Mapping[str, RunTruth]
    changes: tuple[WorldChange, ...] = ()

    def common(self, a: str, b: str) -> list[int]:
        """World vertices that both runs detected, ascending; none if the worlds differ."""
        if self.runs[a].world != self.runs[b].world:
            return []
        return sorted(self.runs[a].detected & self.runs[b].detected)

    def linked(self) -> list[set[str]]:
        """Groups of runs connected by common vertices: the components of a perfect merge."""
        joined = DisjointSet(self.runs)
        for a, b in combinations(self.runs, 2):
            if self.common(a, b):
                joined.merge(a, b)
        return sorted(joined.subsets(), key=min)


def true_vertex_of_passes(truth: Truth, run: str, time_ns: Any) -> IntArray:
    """(k,) the world vertex that the run was passing at each time, NO_VERTEX for none.

    Only detected passes count. Times are stamps by the detector's clock. O((k + p) log p).
    """
    of_run = truth.runs[run]
    seen = np.flatnonzero(of_run.messages > 0)
    query = np.asarray(time_ns, np.int64)
    if len(seen) == 0:
        return np.full(len(query), NO_VERTEX, np.int64)
    start, end = of_run.start_ns[seen], of_run.end_ns[seen]
    last = np.maximum(np.searchsorted(start, query, side="right") - 1, 0)
    within = (start[last] <= query) & (query <= end[last])
    return np.where(within, of_run.vertex[seen[last]], NO_VERTEX)


def true_vertex_of_nodes(truth: Truth, topomap: TopoMap) -> IntArray:
    """(n,) the world vertex of every vertex of a run's map.

    NO_VERTEX if all its observations are phantoms, MIXED if they are of several vertices, that is
    after a false loop closure.
    """
    of_pass = true_vertex_of_passes(truth, topomap.run, topomap.observation_time_ns)
    out = np.full(len(topomap), NO_VERTEX, np.int64)
    for node, vertex in zip(topomap.observation_vertex.tolist(), of_pass.tolist(), strict=True):
        if out[node] in (NO_VERTEX, vertex):
            out[node] = vertex
        elif vertex != NO_VERTEX:
            out[node] = MIXED
    return out


def best_transform(truth: Truth, map_a: TopoMap, map_b: TopoMap) -> FloatArray:
    """(3,) T_a_b, the least-squares fit of the common vertices of two maps: the result of a perfect
    merge of these maps, with their drift. ValueError if they have no common vertex."""
    in_a, in_b = _common_nodes(truth, map_a, map_b)
    return fit_rigid(map_a.xy[in_a], map_b.xy[in_b])


def placement_error(
    truth: Truth, map_a: TopoMap, map_b: TopoMap, T_a_b: FloatArray
) -> tuple[float, float]:
    """Distance of a transform from the best one: (metres, radians).

    Metres are the mean distance over the common vertices of b, independent of the origin of b's
    frame. ValueError if the maps have no common vertex.
    """
    _, in_b = _common_nodes(truth, map_a, map_b)
    best = best_transform(truth, map_a, map_b)
    off = apply(T_a_b, map_b.xy[in_b]) - apply(best, map_b.xy[in_b])
    return float(np.mean(np.hypot(*off.T))), float(abs(wrap(T_a_b[2] - best[2])))


def _common_nodes(truth: Truth, map_a: TopoMap, map_b: TopoMap) -> tuple[IntArray, IntArray]:
    """Nodes of a and of b that are the same place, row by row; ValueError if there are none."""
    a, b = true_vertex_of_nodes(truth, map_a), true_vertex_of_nodes(truth, map_b)
    same_world = truth.runs[map_a.run].world == truth.runs[map_b.run].world
    in_a, in_b = np.nonzero((a[:, None] == b[None, :]) & (a[:, None] >= 0) & same_world)
    if len(in_a) == 0:
        raise ValueError(f"{map_a.run} and {map_b.run} have no common vertex")
    return in_a, in_b


def write_truth(path: Path, truth: Truth) -> None:
    """Write `truth.json`."""
    pairs = []
    for a, b in combinations(sorted(truth.runs), 2):
        run_a, run_b = truth.runs[a], truth.runs[b]
        if run_a.world == run_b.world:
            transform = _rounded(between(run_a.T_world_odom, run_b.T_world_odom), 6)
            pairs.append({"a": a, "b": b, "common": truth.common(a, b), "transform": transform})
    document = {
        "schema": TRUTH_SCHEMA,
        "worlds": {name: _world_document(w) for name, w in truth.worlds.items()},
        "runs": {name: _run_document(truth.runs[name]) for name in sorted(truth.runs)},
        **({"changes": [asdict(c) for c in truth.changes]} if truth.changes else {}),
        "pairs": pairs,
    }
    write_json(path, document)


def _world_document(world: World) -> dict[str, Any]:
    columns = (world.source.tolist(), world.target.tolist(), world.length, world.paths)
    return {
        "kind": world.kind,
        "vertices": _rounded(world.xy, 3),
        "edges": [
            [u, v, _rounded(length, 3), _rounded(path, 3)]
            for u, v, length, path in zip(*columns, strict=True)
        ],
    }


def _run_document(run: RunTruth) -> dict[str, Any]:
    path = zip(run.path_ns.tolist(), _rounded(run.path, 3), strict=True)
    return {
        "world": run.world,
        "T_world_odom": _rounded(run.T_world_odom, 6),
        "passes": {
            "start_ns": run.start_ns.tolist(),
            "end_ns": run.end_ns.tolist(),
            "vertex": run.vertex.tolist(),
            "messages": run.messages.tolist(),
            "fault": list(run.fault),
        },
        "drives": {
            "edge": run.drive_edge.tolist(),
            "start_ns": run.drive_start_ns.tolist(),
            "end_ns": run.drive_end_ns.tolist(),
        },
        "closed_edges": list(run.closed_edges),
        "break_ns": list(run.break_ns),
        "jump_ns": list(run.jump_ns),
        "path": [[t, *pose] for t, pose in path],
        "settings": dict(run.settings),
    }


def _rounded(values: Any, decimals: int) -> Any:
    return (np.round(np.asarray(values, np.float64), decimals) + 0.0).tolist()
