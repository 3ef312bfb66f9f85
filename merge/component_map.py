"""One component of a merge as a map, for all that takes a map."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ..topology.arrays import IntArray
from ..topology.map_pose_graph import map_pose_graph
from ..topology.posegraph.graph import PoseGraph
from ..topology.topomap import ALL_SURE, RunNoise, TopoMap
from ..topology.track import by_begin
from ..topology.turning_vertices import with_turning_points, without_turning_points
from ..topology.views import NO_VIEWS, together
from .fusion.joint_graph import optimise_poses, usual_scale
from .fusion.vertex_partition import Pool
from .result import (
    Component,
    FusedMap,
    MergeResult,
    by_run,
    fused_confidence,
    fused_of,
    graph_part,
    of_sites,
    site_views,
)


def component_map(
    result: MergeResult, component: int, name: str, maps: Mapping[str, TopoMap] | None = None
) -> TopoMap:
    """The fused map of one component, as the map of a run called `name` in a frame called `name`.

    maps: the maps of its runs, by name; with all of them, unchanged since the merge, the result has
    the times of its traversals, and their views. `info["members"]` holds for every vertex and edge
    the vertices and edges of the runs that it was fused from, `info["numbers"]` the vertices'
    numbers in the merge.
    Observations are those of all runs, by time. Raises ValueError if the component does not exist.
    """
    site, fused = _alone(result, component)
    seen = sorted((ns, v) for v, own in enumerate(fused.observations) for _, ns in own)
    time_ns, vertex = np.array(seen, np.int64).reshape(-1, 2).T
    times, sure, noise, views = None, ALL_SURE, RunNoise(), NO_VIEWS
    if maps is not None and not stale_runs(result, component, maps):
        whole = {run: with_turning_points(maps[run]) for run in sorted(site.poses)}
        times = _member_times(whole, fused)
        sure = fused_confidence(fused.members, whole)
        # Robots of one kind share systematic errors: their scales do not average out.
        noise = replace(noise, scale=usual_scale([maps[run] for run in site.poses]))
        views = together(site_views(result.fused, site, maps))
    sigma = fused.position_sigma
    whole_map = TopoMap(
        run=name,
        frame=name,
        **graph_part(fused, np.ones(len(fused), np.bool_)),
        position_sigma=None if sigma is None or not np.isfinite(sigma).all() else sigma,
        observation_vertex=vertex,
        observation_time_ns=time_ns,
        traversal_ns=times,
        confidence=sure,
        noise=noise,
        views=views,
        info={
            "numbers": tuple(np.flatnonzero(result.fused.component == component).tolist()),
            "members": {
                "nodes": list(fused.members),
                "edges": [by_run(members) for members in fused.edge_members],
            },
        },
    )
    return without_turning_points(whole_map)


def _alone(result: MergeResult, component: int) -> tuple[Component, FusedMap]:
    """A component and its part of the fused map; ValueError if it does not exist."""
    part = of_sites(result, [component])
    if not part.components:
        raise ValueError(f"there is no component {component}")
    return part.components[0], part.fused


def stale_runs(result: MergeResult, component: int, maps: Mapping[str, TopoMap]) -> dict[str, str]:
    """Runs of a component whose maps are not those that were merged, and why: "is not there", "has
    changed since" (a fused vertex or corridor is not in it, or its passes are others)."""
    site, fused = _alone(result, component)
    junctions = [
        seen for seen, turned in zip(fused.observations, fused.is_turned, strict=True) if not turned
    ]
    out = {}
    for run in sorted(site.poses):
        if run not in maps:
            out[run] = "is not there"
            continue
        topomap = maps[run]
        n, late = len(topomap), len(topomap.turning_points)
        times = sorted(ns for seen in junctions for whose, ns in seen if whose == run)
        vertices = sorted(v for members in fused.members for v in members.get(run, ()))
        corridors = (k for members in fused.edge_members for whose, k in members if whose == run)
        same = (
            times == sorted(topomap.observation_time_ns.tolist())
            and vertices[:n] == list(range(n))
            and all(v < n + late for v in vertices)
            and all(k < len(topomap.source) + late for k in corridors)
        )
        if not same:
            out[run] = "has changed since"
    return out


def component_pose_graph(
    result: MergeResult, component: int, maps: Mapping[str, TopoMap]
) -> PoseGraph:
    """The joint pose graph of a component, solved.

    Poses are the vertices of all its maps, run by run in the order of their names. maps: of all its
    runs, as they were merged. Identities are plain edges; kernels, grid headings and odometry
    scales, which the solution used, are left out of the graph.
    """
    site, fused = _alone(result, component)
    pool = Pool.of([maps[run] for run in site.poses])
    place_of = fused_of(fused.members)
    rows = zip(pool.run.tolist(), pool.vertex.tolist(), strict=True)
    label = np.array([place_of[pool.maps[r].run, v] for r, v in rows], np.int64)
    joint = optimise_poses(pool, label, site.poses)
    if joint.graph is None:
        return map_pose_graph(pool.maps[0])
    graph = joint.graph
    return PoseGraph(
        pose=joint.pose,
        source=graph.source,
        target=graph.target,
        measurement=graph.measurement,
        information=graph.information,
    )


def _member_times(maps: Mapping[str, TopoMap], fused: FusedMap) -> tuple[IntArray, ...] | None:
    """`TopoMap.traversal_ns` of a fused map; None if some run's map does not have it.

    A corridor that a run drove past a junction undetected, a member of both its parts, gives no
    times. O(members).
    """
    if any(m.traversal_ns is None for m in maps.values()):
        return None
    place_of = fused_of(fused.members)
    ends_of = zip(fused.source.tolist(), fused.target.tolist(), strict=True)
    out = []
    for members, (source, target) in zip(fused.edge_members, ends_of, strict=True):
        rows = [np.zeros((0, 2), np.int64)]
        for run, k in members:
            topomap = maps[run]
            assert topomap.traversal_ns is not None
            ends = [place_of[run, int(v[k])] for v in (topomap.source, topomap.target)]
            if {*ends} == {source, target}:
                turned = ends[0] == target
                rows.append(topomap.traversal_ns[k][:, :: -1 if turned else 1])
        out.append(by_begin(np.concatenate(rows)))
    return tuple(out)
