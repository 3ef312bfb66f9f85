"""GeoJSON for the Nav2 route server (nav2_route, `GeoJsonGraphFileLoader`).

The loader asks for unsigned ids that are unique over nodes and edges, for one of each at least, and
takes edges as directed; it ignores the geometry of edges, which is there for people who open the
file in a GIS, so a curved corridor gets nodes on its way. Numbers in metadata that are read as
floats (`abs_time_taken`, seconds, by its TimeScorer) must not be written as integers. Of the
collection it reads the features alone: `length_scale_sigma` is for people.
"""

from __future__ import annotations

import json
from typing import Any

from ...topology.digits import METRES, rounded, significant
from ...topology.errors import DataError
from ...topology.topomap import TopoMap
from .route_graph import VIA, RouteGraph, route_graph

SECONDS = 2
"""Decimals of times: passes are stamped to some 0.1 s."""


def nav2_geojson(topomap: TopoMap, max_error_m: float) -> str:
    """The route graph of a map, every corridor both ways.

    Raises DataError on a map without corridors, which the loader refuses.
    """
    graph = route_graph(topomap, max_error_m)
    if len(graph.source) == 0:
        raise DataError(f"{topomap.run}: has no corridor; a Nav2 route graph needs one at least")
    document = {
        "type": "FeatureCollection",
        "name": topomap.run,
        "length_scale_sigma": significant(topomap.measured.scale),
        "features": [*_nodes(topomap, graph), *_edges(topomap, graph)],
    }
    lines = json.dumps(document, ensure_ascii=False, allow_nan=False)
    return lines.replace('{"type": "Feature"', '\n{"type": "Feature"') + "\n"


def _nodes(topomap: TopoMap, graph: RouteGraph) -> list[dict[str, Any]]:
    xy = rounded(graph.xy, METRES)
    kinds = [topomap.kind[v] if v != VIA else "via" for v in graph.vertex.tolist()]
    return [
        {
            "type": "Feature",
            "properties": {"id": k, "frame": topomap.frame, "metadata": {"kind": kinds[k]}},
            "geometry": {"type": "Point", "coordinates": xy[k]},
        }
        for k in range(len(xy))
    ]


def _edges(topomap: TopoMap, graph: RouteGraph) -> list[dict[str, Any]]:
    """Ids go on where those of the nodes end; the way back follows the way there."""
    xy, number = rounded(graph.xy, METRES), len(graph.xy)
    lengths, seconds = rounded(graph.length, METRES), graph.seconds.tolist()
    sigmas, spread = rounded(graph.length_sigma, METRES), graph.seconds_sigma.tolist()
    drives = topomap.traversals.tolist()
    out = []
    for k, edge in enumerate(graph.edge.tolist()):
        metadata = {
            "length": lengths[k],
            "length_sigma": sigmas[k],
            "corridor": edge,
            "traversals": drives[edge],
        }
        if seconds[k] == seconds[k]:
            metadata["abs_time_taken"] = max(float(rounded(seconds[k], SECONDS)), 10.0**-SECONDS)
        if spread[k] == spread[k]:
            metadata["time_sigma"] = float(rounded(spread[k], SECONDS))
        ends = int(graph.source[k]), int(graph.target[k])
        for start, end in (ends, ends[::-1]):
            out.append(
                {
                    "type": "Feature",
                    "properties": {
                        "id": number,
                        "startid": start,
                        "endid": end,
                        "metadata": metadata,
                    },
                    "geometry": {"type": "LineString", "coordinates": [xy[start], xy[end]]},
                }
            )
            number += 1
    return out
