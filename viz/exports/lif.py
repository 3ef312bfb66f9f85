"""VDMA LIF 1.0 (Layout Interchange Format), which VDA 5050 names for exchanging layouts.

Junctions are nodes; each corridor is two edges, one each way. A curved corridor has a trajectory: a
NURBS of degree 1, whose control points are the points of its polyline.
"""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from ...topology.digits import METRES, rounded, significant
from ...topology.polyline import way_of
from ...topology.topomap import TopoMap
from ...topology.wording import utc
from .route_graph import corridor_line, driving_speed, gone_properties, last_pass_ns

LIF_VERSION = "1.0.0"
VEHICLE_TYPE = "any"


def lif_json(topomap: TopoMap, max_error_m: float) -> str:
    """The layout of a map. Speeds, where known, are those at which robots drove.

    Its time stamp is the map's newest observation, so that the same map gives the same file.
    """
    speed = driving_speed(topomap).tolist()
    xy = rounded(topomap.xy, METRES)
    edges = []
    for e, (u, v) in enumerate(zip(topomap.source.tolist(), topomap.target.tolist(), strict=True)):
        way = corridor_line(topomap, e, max_error_m)
        for name, start, end, path in ((f"{e}", u, v, way), (f"{e}r", v, u, way[::-1])):
            edges.append(
                {
                    "edgeId": name,
                    "startNodeId": str(start),
                    "endNodeId": str(end),
                    **({"edgeDescription": "gone"} if gone_properties(topomap, e) else {}),
                    "vehicleTypeEdgeProperties": [_properties(path, speed[e])],
                }
            )
    document = {
        "metaInformation": {
            "projectIdentification": topomap.run,
            "creator": "topobatch",
            "exportTimestamp": utc(last_pass_ns(topomap), "%Y-%m-%dT%H:%M:%SZ"),
            "lifVersion": LIF_VERSION,
        },
        "layouts": [
            {
                "layoutId": topomap.run,
                "layoutVersion": "1",
                "nodes": [
                    {
                        "nodeId": str(k),
                        "nodeDescription": topomap.kind[k],
                        "mapId": topomap.frame,
                        "nodePosition": {"x": x, "y": y},
                        "vehicleTypeNodeProperties": [{"vehicleTypeId": VEHICLE_TYPE}],
                    }
                    for k, (x, y) in enumerate(xy)
                ],
                "edges": edges,
                "stations": [],
            }
        ],
    }
    return json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def _properties(path: np.ndarray[Any, np.dtype[np.float64]], speed: float) -> dict[str, Any]:
    """How a corridor is driven. path: (k, 2) [m]; speed: [m/s], NaN if unknown."""
    out: dict[str, Any] = {
        "vehicleTypeId": VEHICLE_TYPE,
        "orientationType": "TANGENTIAL",
        "rotationAllowed": True,
        "reentryAllowed": True,
    }
    if np.isfinite(speed):
        out["maxSpeed"] = significant(speed)
    if len(path) > 2:
        way = way_of(path)
        inner = rounded(way[1:-1] / way[-1])
        out["trajectory"] = {
            "degree": 1,
            "knotVector": [0.0, 0.0, *inner, 1.0, 1.0],
            "controlPoints": [{"x": x, "y": y, "weight": 1.0} for x, y in rounded(path, METRES)],
        }
    return out
