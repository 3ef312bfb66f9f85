"""One component of a merged document as a map, for all that takes a map."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ..topology.arrays import IntArray
from ..topology.document import edge_fields, vertex_fields
from ..topology.map_pose_graph import map_pose_graph
from ..topology.posegraph.graph import PoseGraph
from ..topology.topomap import ALL_SURE, RunNoise, TopoMap
from ..topology.track import by_begin
from ..topology.turning_points import KINDS
from ..topology.turning_vertices import with_turning_points, without_turning_points
from .document import poses_from_document
from .fusion.joint_graph import settle, usual_scale
from .fusion.vertex_partition import Pool
from .merged_schema import MergedDocument, MergedNode
from .result import fused_confidence, fused_of


def component_map(
    document: MergedDocument,
    component: int,
    name: str,
    maps: Mapping[str, TopoMap] | None = None,
) -> TopoMap:
    """The fused map of one component, as the map of a run called `name` in a frame called `name`.

    maps: the maps of its runs, by name; with all of them, unchanged since the merge, the result has
    the times of its traversals. `info["members"]` holds for every vertex and edge the vertices and
    edges of the runs that it was fused from, `info["numbers"]` the vertices' ids in the document.
    Observations are those of all runs, by time. Raises ValueError if the component does not exist
    or is inconsistent.
    """
    chosen = [node for node in document.nodes if node.component == component]
    number = {node.id: k for k, node in enumerate(chosen)}
    if not chosen and component not in {c.id for c in document.graph.components}:
        raise ValueError(f"there is no component {component}")
    edges = [e for e in document.edges if e.source in number]
    runs = document.graph.runs_of(component)
    named = {run for n in chosen for run in n.members} | {run for e in edges for run in e.members}
    strange = named - set(runs)
    if strange:
        raise ValueError(f"run {min(strange)!r} is a member of what is not its component")
    if any(e.target not in number for e in edges):
        raise ValueError("a corridor joins two components")
    seen = sorted((o.time_ns, number[node.id]) for node in chosen for o in node.observations)
    corridors = edge_fields(edges)
    for end in ("source", "target"):
        corridors[end] = np.array([number[node] for node in corridors[end].tolist()], np.int64)
    times, sure, noise = None, ALL_SURE, RunNoise()
    if maps is not None and not stale_runs(document, component, maps):
        whole = {run: with_turning_points(maps[run]) for run in sorted(runs)}
        members = [node.members for node in chosen]
        times = member_times(
            whole,
            [[(run, k) for run, ids in sorted(e.members.items()) for k in ids] for e in edges],
            fused_of=fused_of(members),
            source=corridors["source"],
            target=corridors["target"],
        )
        sure = fused_confidence(members, whole)
        # Robots of one kind share systematic errors: their scales do not average out.
        noise = replace(noise, scale=usual_scale([maps[run] for run in runs]))
    fused = TopoMap(
        run=name,
        frame=name,
        **vertex_fields(chosen),
        **corridors,
        observation_vertex=np.array([v for _, v in seen], np.int64),
        observation_time_ns=np.array([t for t, _ in seen], np.int64),
        traversal_ns=times,
        confidence=sure,
        noise=noise,
        info={
            "numbers": tuple(node.id for node in chosen),
            "members": {
                "nodes": [node.members for node in chosen],
                "edges": [e.members for e in edges],
            },
        },
    )
    return without_turning_points(fused)


def places_of(document: MergedDocument, component: int) -> list[MergedNode]:
    """The fused vertices of a component, without turning points of runs."""
    own = (node for node in document.nodes if node.component == component)
    return [node for node in own if node.kind not in KINDS]


def stale_runs(
    document: MergedDocument, component: int, maps: Mapping[str, TopoMap]
) -> dict[str, str]:
    """Runs of a component whose maps are not those that were merged, and why: "is not there", "has
    changed since" (a fused vertex or corridor is not in it, or its passes are others)."""
    nodes = places_of(document, component)
    own = {node.id for node in nodes}
    edges = [e for e in document.edges if e.source in own]
    turned = [n for n in document.nodes if n.component == component and n.kind in KINDS]
    out = {}
    for run in document.graph.runs_of(component):
        if run not in maps:
            out[run] = "is not there"
            continue
        topomap = maps[run]
        late = len(topomap.turning_points)
        vertices, corridors = len(topomap) + late, len(topomap.source) + late
        times = sorted(o.time_ns for node in nodes for o in node.observations if o.run == run)
        same = (
            times == sorted(topomap.observation_time_ns.tolist())
            and sorted(v for node in nodes for v in node.members.get(run, ()))
            == list(range(len(topomap)))
            and all(k < corridors for e in edges for k in e.members.get(run, ()))
            and all(v < vertices for node in turned for v in node.members.get(run, ()))
        )
        if not same:
            out[run] = "has changed since"
    return out


def component_pose_graph(
    document: MergedDocument, component: int, maps: Mapping[str, TopoMap]
) -> PoseGraph:
    """The joint pose graph of a component, solved.

    Poses are the vertices of all its maps, run by run in the order of their names. maps: of all its
    runs, as they were merged. Identities are plain edges; kernels, grid headings and odometry
    scales, which the solution used, are left out of the graph.
    """
    pool = Pool.of([maps[run] for run in document.graph.runs_of(component)])
    where = zip(pool.run, pool.vertex.tolist(), strict=True)
    fused = fused_of([node.members for node in places_of(document, component)])
    label = np.array([fused[pool.maps[r].run, v] for r, v in where], np.int64)
    joint = settle(pool, label, poses_from_document(document))
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


def member_times(
    maps: Mapping[str, TopoMap],
    edge_members: Sequence[Sequence[tuple[str, int]]],
    *,
    fused_of: Mapping[tuple[str, int], int],
    source: IntArray,
    target: IntArray,
) -> tuple[IntArray, ...] | None:
    """`TopoMap.traversal_ns` of a fused map; None if some run's map does not have it.

    edge_members: for each fused edge the (run, edge) it was fused from; fused_of[run, vertex]: the
    fused vertex; source, target: (m,) of the fused edges. A corridor that a run drove past a
    junction undetected, a member of both its parts, gives no times. O(members).
    """
    if any(m.traversal_ns is None for m in maps.values()):
        return None
    out = []
    for members, *fused in zip(edge_members, source.tolist(), target.tolist(), strict=True):
        rows = [np.zeros((0, 2), np.int64)]
        for run, k in members:
            topomap = maps[run]
            assert topomap.traversal_ns is not None
            ends = [fused_of[run, int(v[k])] for v in (topomap.source, topomap.target)]
            if {*ends} == {*fused}:
                turned = ends[0] == fused[1]
                rows.append(topomap.traversal_ns[k][:, :: -1 if turned else 1])
        out.append(by_begin(np.concatenate(rows)))
    return tuple(out)
