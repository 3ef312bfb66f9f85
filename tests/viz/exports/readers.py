"""Readers of what is exported: made by others where there are any, else written from the rules that
their loaders are documented by. Each raises on what its format does not allow."""

from __future__ import annotations

import csv
import io
import json
import math
from pathlib import Path
from typing import Any, NamedTuple

import gtsam
import jsonschema
import networkx as nx
import numpy as np
from evo.core.trajectory import PoseTrajectory3D
from evo.tools.file_interface import read_tum_trajectory_file
from ruamel.yaml import YAML
from vdma_lif.models import LIFLayoutCollection
from vdma_lif.parser import LIFParser

from topobatch.topology.topomap import TopoMap
from topobatch.viz.exports import MAP_FORMATS

UNSIGNED = 2**32
BOUND_M = 0.05


def require(fine: bool, what: object) -> None:
    if not fine:
        raise ValueError(f"not allowed: {what}")


def read_nav2(text: str) -> nx.MultiDiGraph:
    """What nav2_route's GeoJsonGraphFileLoader makes of a file: nodes with xy, directed edges."""
    document = json.loads(text)
    require(document["type"] == "FeatureCollection", document["type"])
    graph, edges = nx.MultiDiGraph(), []
    for feature in document["features"]:
        properties, kind = feature["properties"], feature["geometry"]["type"]
        require(type(properties["id"]) is int and 0 <= properties["id"] < UNSIGNED, properties)
        _nav2_metadata(properties.get("metadata", {}))
        for operation in properties.get("operations", []):
            require({"type", "trigger"} <= set(operation), operation)
        if kind == "Point":
            x, y = feature["geometry"]["coordinates"][:2]
            require(isinstance(properties.get("frame", ""), str), properties)
            graph.add_node(properties["id"], xy=(float(x), float(y)), **properties)
        elif kind in ("LineString", "MultiLineString"):
            edges.append(properties)
    require(len(graph) > 0 and len(edges) > 0, "no nodes or no edges")
    ids = [*graph.nodes, *(edge["id"] for edge in edges)]
    require(len(set(ids)) == len(document["features"]), "an id twice")
    for edge in edges:
        for end in (edge["startid"], edge["endid"]):
            require(end in graph, f"edge {edge['id']}: no node {end}")
        graph.add_edge(edge["startid"], edge["endid"], key=edge["id"], **edge.get("metadata", {}))
    return graph


def _nav2_metadata(metadata: dict[str, Any]) -> None:
    """Strings, numbers, booleans, lists of them, objects. What is read as a float must be one."""
    for key, value in metadata.items():
        if isinstance(value, dict):
            _nav2_metadata(value)
            continue
        for one in value if isinstance(value, list) else [value]:
            require(isinstance(one, (str, bool, int, float)), (key, one))
            require(not isinstance(one, float) or math.isfinite(one), (key, one))
        if key in ("abs_time_taken", "abs_speed_limit", "speed_limit", "penalty"):
            require(type(value) is float and value > 0, (key, value))


def read_lif(text: str) -> LIFLayoutCollection:
    """What vdma-lif makes of a file, with the rules of LIF 1.0 that it leaves to its users."""
    collection = LIFParser.from_json(text)
    require(collection.meta_information.lif_version.startswith("1.0"), "version")
    for layout in collection.layouts:
        nodes = {node.node_id: node.node_position for node in layout.nodes}
        require(len(nodes) == len(layout.nodes), "a node id twice")
        require(len({e.edge_id for e in layout.edges}) == len(layout.edges), "an edge id twice")
        for edge in layout.edges:
            ends = nodes[edge.start_node_id], nodes[edge.end_node_id]
            require(len(edge.vehicle_type_edge_properties) > 0, "an edge for no vehicle")
            for of_type in edge.vehicle_type_edge_properties:
                require(of_type.max_speed is None or of_type.max_speed > 0, of_type.max_speed)
                if of_type.trajectory is not None:
                    _nurbs(of_type.trajectory, ends)
    return collection


def _nurbs(trajectory: Any, ends: Any) -> None:
    knots, points = trajectory.knot_vector, trajectory.control_points
    degree = 3 if trajectory.degree is None else trajectory.degree
    require(1 <= degree <= 3 and len(knots) == len(points) + degree + 1, "knots")
    require(knots == sorted(knots) and knots[0] == 0 and knots[-1] == 1, "knots from 0 to 1")
    require(len(set(knots[: degree + 1])) == 1 == len(set(knots[-degree - 1 :])), "not clamped")
    for point, end in ((points[0], ends[0]), (points[-1], ends[1])):
        require(math.hypot(point.x - end.x, point.y - end.y) < 2e-3, "does not begin at its node")


def _yaml(text: str) -> Any:
    """By YAML 1.1, as PyYAML reads it."""
    reader = YAML(typ="safe", pure=True)
    reader.version = (1, 1)
    return reader.load(text)


def read_rmf(text: str) -> nx.MultiDiGraph:
    """What rmf_fleet_adapter's parse_graph makes of a navigation graph."""
    document, graph, names = _yaml(text), nx.MultiDiGraph(), set()
    require(isinstance(document["levels"], dict), "levels is no mapping")
    require(document.get("lifts") is not None, "says nothing of lifts")
    for level in document["levels"].values():
        first = len(graph)
        for x, y, options in level["vertices"]:
            require(type(x) is float and type(y) is float, (x, y))
            name = options.get("name", "")
            require(isinstance(name, str) and (not name or name not in names), name)
            names.add(name)
            graph.add_node(len(graph), xy=(x, y), **options)
        for begin, end, options in level["lanes"]:
            require(type(begin) is int and type(end) is int, (begin, end))
            require(max(begin, end) + first < len(graph) and min(begin, end) >= 0, (begin, end))
            limit = options.get("speed_limit", 1.0)
            require(isinstance(limit, (int, float)) and limit > 0, limit)
            require(options.get("orientation_constraint", "forward") in ("forward", "backward"), 0)
            graph.add_edge(begin + first, end + first, **options)
    return graph


_TEXT, _OBJECT = {"type": "string"}, {"type": "object"}
TMAP2_SCHEMA = {
    "type": "object",
    "required": ["meta", "metric_map", "name", "nodes", "pointset"],
    "properties": {
        "meta": {
            "type": "object",
            "required": ["last_updated"],
            "properties": {
                "last_updated": {
                    "type": "string",
                    "pattern": r"^\d{2}-\d{2}-\d{4}_\d{2}-\d{2}-\d{2}$",
                }
            },
        },
        "metric_map": _TEXT,
        "name": _TEXT,
        "pointset": _TEXT,
        "nodes": {
            "type": "array",
            "items": {
                "type": "object",
                "required": ["meta", "node"],
                "properties": {
                    "meta": {
                        "type": "object",
                        "required": ["map", "node", "pointset"],
                        "properties": {"map": _TEXT, "node": _TEXT, "pointset": _TEXT},
                    },
                    "node": {
                        "type": "object",
                        "required": ["edges", "name", "parent_frame", "pose", "verts"],
                        "properties": {
                            "name": _TEXT,
                            "parent_frame": _TEXT,
                            "properties": _OBJECT,
                            "edges": {
                                "type": "array",
                                "items": {
                                    "type": "object",
                                    "required": ["edge_id", "node"],
                                    "properties": {
                                        "edge_id": _TEXT,
                                        "node": _TEXT,
                                        "properties": _OBJECT,
                                    },
                                },
                            },
                        },
                    },
                },
            },
        },
    },
}
"""The rules of LCAS/topological_navigation's map schema (`config/tmap-schema.yaml`), and of the
positions that it uses. Of its two published forms this is the later, with dates day first; nodes
have a `parent_frame`, which only the earlier asks for. LCAS's `validate_map.py` is in no
registry."""


def read_tmap2(text: str) -> nx.MultiDiGraph:
    """A tmap2 document by its schema; what its validator warns of is refused, too, and what its
    map manager, localiser and navigator stumble over."""
    document, graph = _yaml(text), nx.MultiDiGraph()
    jsonschema.validate(document, TMAP2_SCHEMA)
    require(len({e["meta"]["pointset"] for e in document["nodes"]}) <= 1, "several pointsets")
    require(isinstance(document["transformation"]["topo_frame_id"], str), "no frame")
    for action in document["actions"].values():
        require(action["action_type"].count(".") == 2, action["action_type"])
        require(action["action_server"].startswith("/"), action["action_server"])
    for entry in document["nodes"]:
        node = entry["node"]
        require(node["name"] == entry["meta"]["node"] and node["name"] not in graph, node["name"])
        pose = node["pose"]
        require(set("xyz") <= set(pose["position"]), "a position")
        require(set("xyzw") <= set(pose["orientation"]), "an orientation")
        position = pose["position"]
        graph.add_node(node["name"], xy=(position["x"], position["y"]), **node["properties"])
    seen = set()
    for entry in document["nodes"]:
        for edge in entry["node"]["edges"]:
            require(edge["node"] in graph, f"leads to no node: {edge['node']}")
            require(edge["edge_id"] not in seen, f"an edge id twice: {edge['edge_id']}")
            seen.add(edge["edge_id"])
            require(edge["action"] in document["actions"], f"no such action: {edge['action']}")
            require(edge["properties"]["weight"] >= 0, edge["edge_id"])
            graph.add_edge(entry["node"]["name"], edge["node"], **edge["properties"])
    return graph


def read_graphml(text: str) -> nx.MultiGraph:
    """By networkx."""
    graph = nx.parse_graphml(text, node_type=int, edge_key_type=int, force_multigraph=True)
    require(not graph.is_directed(), "directed")
    return graph


class FactorGraph(NamedTuple):
    """poses: (n, 3); ends: (m, 2); measurement: (m, 3); information: (m, 3, 3)."""

    pose: np.ndarray
    ends: np.ndarray
    measurement: np.ndarray
    information: np.ndarray


def read_g2o(text: str, folder: Path) -> FactorGraph:
    """By GTSAM."""
    path = folder / "graph.g2o"
    path.write_text(text)
    factors, values = gtsam.readG2o(str(path), False)
    edges = [factors.at(k) for k in range(factors.size())]
    count = text.count("VERTEX_SE2")
    require(values.size() == count and len(edges) == text.count("EDGE_SE2"), "left out")
    return FactorGraph(
        np.array([_numbers(values.atPose2(k)) for k in range(count)]),
        np.array([edge.keys() for edge in edges]),
        np.array([_numbers(edge.measured()) for edge in edges]),
        np.array([edge.noiseModel().information() for edge in edges]),
    )


def _numbers(pose: gtsam.Pose2) -> tuple[float, float, float]:
    return pose.x(), pose.y(), pose.theta()


def read_tum(text: str, folder: Path) -> PoseTrajectory3D:
    """By evo, which also checks the trajectory; the rest of what it asks for, line by line."""
    path = folder / "trajectory.tum"
    path.write_text(text)
    trajectory = read_tum_trajectory_file(path)
    fine, found = trajectory.check()
    require(fine and trajectory.num_poses == len(text.splitlines()), found)
    return trajectory


def read_csv(text: str) -> list[dict[str, str]]:
    """By the standard library."""
    rows = list(csv.DictReader(io.StringIO(text), strict=True))
    require(all(None not in row and None not in row.values() for row in rows), "ragged rows")
    return rows


def text_of(topomap: TopoMap, form: str, bound_m: float = BOUND_M) -> str:
    """A map in a format of one file."""
    (write,) = MAP_FORMATS[form].values()
    return write(topomap, bound_m)


def route_sigma(length: np.ndarray, sigma: np.ndarray, scale: float) -> float:
    """1 sigma of a route by its edges, as docs/exports.md says: each sigma holds the error of the
    scale, which all lengths share. scale: 0 for what shares none, as times."""
    shared = scale**2 * (length.sum() ** 2 - (length**2).sum())
    return float(np.sqrt((sigma**2).sum() + shared))


def distance(points: np.ndarray, line: np.ndarray) -> np.ndarray:
    """(k,) of points from a polyline."""
    a, d = line[:-1], np.diff(line, axis=0)
    t = ((points[:, None] - a) * d).sum(axis=2) / np.maximum((d * d).sum(axis=1), 1e-12)
    foot = a + np.clip(t, 0, 1)[..., None] * d
    return np.hypot(*(points[:, None] - foot).T).min(axis=0)
