"""Topological maps of LCAS/topological_navigation, format 2 (`tmap-schema.yaml`).

Nodes hold their outgoing edges and a zone of influence (`verts`). An edge is driven by a navigation
action along any path, so curved corridors have nodes along them.

Versions of the package read different fields beyond the schema; the file has all of them. Until
2025 an edge holds its goal, and the frame is `transformation.child`. Since 2026 the localiser reads
the frame from `transformation.topo_frame_id`, the navigator its action servers from `actions`, and
routes minimise `properties.weight`: in metres, as the heuristic of its A*.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...topology.digits import METRES, rounded, significant
from ...topology.topomap import TopoMap
from ...topology.wording import utc
from .route_graph import VIA, RouteGraph, gone_properties, known_seconds, last_pass_ns, route_graph
from .yaml_lines import yaml_text

ACTION = "navigate_to_pose"
ACTION_TYPE = "nav2_msgs.action.NavigateToPose"
ACTIONS = {
    ACTION: {
        "action_type": ACTION_TYPE,
        "action_server": f"/{ACTION}",
        "composable": False,
        "action_goal_template": {
            "pose": {"header": {"frame_id": "${node.nav_frame}"}, "pose": "${node.pose}"}
        },
    }
}
"""How the navigator drives an edge; `${…}` is replaced by values of the edge's target node."""
GOAL = {"target_pose": {"header": {"frame_id": "$node.parent_frame"}, "pose": "$node.pose"}}
"""The same for versions until 2025."""
NO_TURN = {"w": 1.0, "x": 0.0, "y": 0.0, "z": 0.0}
ZONE_M = 0.5
"""Half the side of a zone, at most: zones do not overlap."""
GOAL_TOLERANCE_M = 0.3
ANY_YAW_RAD = 6.283
"""Tolerance that accepts any heading at a node."""


def tmap2_yaml(topomap: TopoMap, max_error_m: float) -> str:
    """The topological map of a map, every corridor both ways.

    Its date is the map's newest observation, so that the same map gives the same file. The frame
    has the map's name: the map manager publishes its transform from `map`, which would be wrong for
    the robot's odometry frame.
    """
    graph, name = route_graph(topomap, max_error_m), topomap.run
    names = _names(graph)
    edges = _edges(topomap, graph, names)
    zone = _zones(graph.xy)
    nodes = []
    for k, (x, y) in enumerate(rounded(graph.xy, METRES)):
        half = zone[k]
        node = {
            "name": names[k],
            "parent_frame": name,
            "pose": {"position": {"x": x, "y": y, "z": 0.0}, "orientation": NO_TURN},
            "properties": {
                "xy_goal_tolerance": min(GOAL_TOLERANCE_M, half),
                "yaw_goal_tolerance": ANY_YAW_RAD,
                "kind": topomap.kind[graph.vertex[k]] if graph.vertex[k] != VIA else "via",
            },
            "verts": [{"x": a * half, "y": b * half} for a, b in _SQUARE],
            "restrictions_planning": "True",
            "restrictions_runtime": "True",
            "localise_by_topic": "",
            "edges": edges[k],
        }
        nodes.append({"meta": {"map": name, "node": names[k], "pointset": name}, "node": node})
    document = {
        "meta": {
            "last_updated": utc(last_pass_ns(topomap), "%d-%m-%Y_%H-%M-%S"),
            "length_scale_sigma": significant(topomap.measured.scale),
        },
        "metric_map": name,
        "name": name,
        "pointset": name,
        "transformation": {
            "child": name,
            "topo_frame_id": name,
            "parent": "map",
            "rotation": NO_TURN,
            "translation": {"x": 0.0, "y": 0.0, "z": 0.0},
        },
        "actions": ACTIONS,
        "nodes": nodes,
    }
    return yaml_text(document, 5)


_SQUARE = ((-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0))
"""Corners of a node's zone, in half sides."""


def _names(graph: RouteGraph) -> list[str]:
    """The name of each point: of junctions by their numbers."""
    return [
        f"junction_{v}" if v != VIA else f"via_{k}" for k, v in enumerate(graph.number.tolist())
    ]


def _edges(topomap: TopoMap, graph: RouteGraph, names: list[str]) -> list[list[dict[str, Any]]]:
    """The edges that leave each node; parallel ones are numbered."""
    out: list[list[dict[str, Any]]] = [[] for _ in names]
    used: dict[str, int] = {}
    for k in range(len(graph.source)):
        ends = int(graph.source[k]), int(graph.target[k])
        for start, end in (ends, ends[::-1]):
            edge_id = f"{names[start]}_{names[end]}"
            used[edge_id] = used.get(edge_id, 0) + 1
            again = f"_{used[edge_id]}" if used[edge_id] > 1 else ""
            length = rounded(graph.length[k], METRES)
            properties = {
                "weight": length,
                "length": length,
                "length_sigma": rounded(graph.length_sigma[k], METRES),
                **gone_properties(topomap, int(graph.edge[k])),
                **known_seconds(float(graph.seconds[k]), float(graph.seconds_sigma[k])),
            }
            out[start].append(
                {
                    "action": ACTION,
                    "action_type": ACTION_TYPE,
                    "edge_id": f"{edge_id}{again}",
                    "node": names[end],
                    "goal": GOAL,
                    "config": [],
                    "fail_policy": "fail",
                    "fluid_navigation": True,
                    "recovery_behaviours_config": "",
                    "restrictions_planning": "True",
                    "restrictions_runtime": "True",
                    "properties": properties,
                }
            )
    return out


def _zones(xy: np.ndarray[Any, np.dtype[np.float64]]) -> list[float]:
    """Half the side of each node's zone [m], so small that the nearest node's zone is not
    touched."""
    from scipy.spatial import cKDTree

    if len(xy) < 2:
        return [ZONE_M] * len(xy)
    nearest = np.asarray(cKDTree(xy).query(xy, k=2)[0])[:, 1]
    # A square extends √2 times half its side along its diagonals.
    half = np.clip(nearest / 2 / np.sqrt(2), 10.0**-METRES, ZONE_M)
    return [float(h) for h in rounded(half, METRES)]
