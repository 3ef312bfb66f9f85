"""Open-RMF's navigation graph (rmf_fleet_adapter, `parse_graph`).

One level; lanes are directed and straight, so curved corridors have waypoints along them. Names
must be unique: only junctions have one.
"""

from __future__ import annotations

from typing import Any

from ...topology.digits import METRES, rounded, significant
from ...topology.topomap import TopoMap
from .route_graph import VIA, gone_properties, route_graph
from .yaml_lines import yaml_text

LEVEL = "L1"


def rmf_yaml(topomap: TopoMap, max_error_m: float) -> str:
    """The navigation graph of a map, every corridor both ways.

    A lane's `speed_limit` [m/s], where known, is the speed at which robots drove it, so that
    planned times match the drives.
    """
    graph = route_graph(topomap, max_error_m)
    vertices: list[Any] = []
    for (x, y), number in zip(rounded(graph.xy, METRES), graph.number.tolist(), strict=True):
        options: dict[str, Any] = {"name": f"junction_{number}" if number != VIA else ""}
        vertices.append([x, y, options])
    lanes: list[Any] = []
    for k in range(len(graph.source)):
        options = gone_properties(topomap, int(graph.edge[k]))
        if graph.seconds[k] > 0 and graph.length[k] > 0:
            options["speed_limit"] = significant(float(graph.length[k] / graph.seconds[k]))
        ends = int(graph.source[k]), int(graph.target[k])
        lanes += [[*ends, options], [*ends[::-1], options]]
    document = {
        "building_name": topomap.run,
        "levels": {LEVEL: {"vertices": vertices, "lanes": lanes}},
        "doors": {},
        "lifts": {},
    }
    return yaml_text(document, 4)
