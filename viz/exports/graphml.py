"""GraphML, written by networkx: for Gephi, yEd, Cytoscape and graph libraries.

GraphML values are scalars, so headings, paths and members are written as JSON strings.
"""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from ...topology.digits import significant
from ...topology.document import map_to_document
from ...topology.topomap import TopoMap
from .route_graph import driving_seconds, gone_properties, known_seconds, seconds_sigma


def graphml(topomap: TopoMap) -> str:
    """The undirected multigraph of a map, with ids, attributes and keys as in its document."""
    import networkx as nx

    scale = significant(topomap.measured.scale)
    graph = nx.MultiGraph(run=topomap.run, frame=topomap.frame, length_scale_sigma=scale)
    document = map_to_document(topomap)
    members = topomap.info.get("members", {})
    times = np.stack([driving_seconds(topomap), seconds_sigma(topomap)], axis=1).tolist()
    for k, node in enumerate(document["nodes"]):
        more = {"members": members["nodes"][k]} if members else {}
        graph.add_node(node["id"], **_scalars({**node, **more}, leave={"id", "observations"}))
        graph.nodes[node["id"]]["passes"] = len(node["observations"])
    for k, edge in enumerate(document["edges"]):
        more = {"members": members["edges"][k]} if members else {}
        more |= gone_properties(topomap, k) | known_seconds(*times[k])
        values = _scalars({**edge, **more}, leave={"source", "target", "key", "traversal_ns"})
        graph.add_edge(edge["source"], edge["target"], key=edge["key"], **values)
    return "\n".join(nx.generate_graphml(graph, named_key_ids=False)) + "\n"


def _scalars(values: dict[str, Any], leave: set[str]) -> dict[str, Any]:
    """The values with lists and mappings as JSON strings, without None."""
    return {
        name: json.dumps(value) if isinstance(value, (list, dict)) else value
        for name, value in values.items()
        if name not in leave and value is not None
    }
