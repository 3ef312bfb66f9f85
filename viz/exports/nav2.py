"""GeoJSON for the Nav2 route server (nav2_route, `GeoJsonGraphFileLoader`).

The loader needs unsigned ids that are unique over nodes and edges, at least one of each, and
directed edges. It ignores the geometry of edges (for GIS programs), so a curved corridor has nodes
along it. Metadata that is read as float (`abs_time_taken`, in seconds, by its TimeScorer) must not
be written as an integer. Of the collection it reads only the features: `length_scale_sigma` is
informative.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from ...topology.digits import METRES, rounded, significant
from ...topology.errors import DataError
from ...topology.topomap import TopoMap
from .route_graph import VIA, RouteGraph, gone_properties, route_graph

SECONDS = 2
"""Decimals of times: passes are stamped to about 0.1 s."""


def nav2_geojson(topomap: TopoMap, max_error_m: float) -> str:
    """The route graph of a map, every corridor both ways.

    Raises DataError for a map without corridors, which the loader rejects.
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


def feature(shape: str, coordinates: Any, properties: Mapping[str, Any]) -> dict[str, Any]:
    """A feature of GeoJSON. shape: Point or LineString; coordinates: (x, y), or a list of them."""
    geometry = {"type": shape, "coordinates": coordinates}
    return {"type": "Feature", "properties": properties, "geometry": geometry}


def _nodes(topomap: TopoMap, graph: RouteGraph) -> list[dict[str, Any]]:
    """A feature for each point, of junctions with their kind and number."""
    xy = rounded(graph.xy, METRES)
    ways = zip(graph.vertex.tolist(), graph.number.tolist(), strict=True)
    about: list[dict[str, Any]] = [
        {"kind": "via"} if v == VIA else {"kind": topomap.kind[v], "junction": number}
        for v, number in ways
    ]
    return [
        feature("Point", xy[k], {"id": k, "frame": topomap.frame, "metadata": metadata})
        for k, metadata in enumerate(about)
    ]


def _edges(topomap: TopoMap, graph: RouteGraph) -> list[dict[str, Any]]:
    """Two features for each piece, there and back; ids continue after those of the nodes."""
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
            **gone_properties(topomap, edge),
        }
        if seconds[k] == seconds[k]:
            metadata["abs_time_taken"] = max(float(rounded(seconds[k], SECONDS)), 10.0**-SECONDS)
        if spread[k] == spread[k]:
            metadata["time_sigma"] = float(rounded(spread[k], SECONDS))
        ends = int(graph.source[k]), int(graph.target[k])
        for start, end in (ends, ends[::-1]):
            own = {"id": number, "startid": start, "endid": end, "metadata": metadata}
            out.append(feature("LineString", [xy[start], xy[end]], own))
            number += 1
    return out
