"""Maps as documents, `maps/<run>.json`, and back.

Documents are deterministic (same map, same bytes) and load with
`networkx.node_link_graph(doc, edges="edges")`; their schema is in `map_schema.py`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from .arrays import FloatArray, IntArray
from .digits import BITS, BRANCH, METRES, rounded, significant
from .errors import DocumentError
from .files import read_json, write_json, write_together
from .map_schema import (
    ABOUT,
    LONGEST_M,
    LONGEST_TOGETHER_M,
    MAP_SCHEMA,
    SHORTEST_M,
    ClosureRecord,
    MapDocument,
    MapEdge,
    MapGraph,
    Vertex,
    validated,
)
from .passes import NO_BRANCH
from .ragged import Ragged, parted
from .topomap import Closure, Graph, RunNoise, TopoMap
from .turning_vertices import with_turning_points, without_turning_points
from .view_file import record_of, view_writes, with_views

Number = TypeVar("Number", np.float64, np.int64)

ANSWER_FIELDS = set(ClosureRecord.model_fields) - {"time_ns"}


def edge_keys(source: IntArray, target: IntArray) -> list[int]:
    """The `key` of every edge: its index among the edges between the same two vertices."""
    seen: dict[tuple[int, int], int] = {}
    keys = []
    for u, v in zip(source.tolist(), target.tolist(), strict=True):
        pair = (min(u, v), max(u, v))
        keys.append(seen.get(pair, 0))
        seen[pair] = keys[-1] + 1
    return keys


def map_to_document(topomap: TopoMap) -> dict[str, Any]:
    """The node-link dict of a map, ready for `json`; inverse of `map_from_document`. Turning points
    become its last nodes."""
    topomap = with_turning_points(topomap)
    observations: list[list[dict[str, Any]]] = [[] for _ in range(len(topomap))]
    for vertex, time_ns in zip(
        topomap.observation_vertex.tolist(), topomap.observation_time_ns.tolist(), strict=True
    ):
        observations[vertex].append({"run": topomap.run, "time_ns": time_ns})
    xy = rounded(topomap.xy, METRES)
    graph: dict[str, Any] = {"run": topomap.run, "frame": topomap.frame}
    graph |= {k: v for k, v in sorted(topomap.info.items()) if k not in graph}
    if len(topomap.views):
        graph["views"] = record_of(topomap.views)
    graph["noise"] = _noise_to_document(topomap.noise)
    if topomap.fitted_noise is not None:
        graph["fitted_noise"] = _noise_to_document(topomap.fitted_noise)
    if not topomap.shows_bends:
        graph["shows_bends"] = False
    graph["closures"] = [_closure_to_document(c) for c in topomap.closures]
    return {
        "schema": MAP_SCHEMA,
        "directed": False,
        "multigraph": True,
        "graph": graph,
        "nodes": [
            {
                "id": i,
                "x": xy[i][0],
                "y": xy[i][1],
                "kind": topomap.kind[i],
                "branches": rounded(topomap.branches[i], BRANCH),
                "observations": observations[i],
                **_node_certainty(topomap, i),
            }
            for i in range(len(topomap))
        ],
        "edges": edges_to_document(topomap),
    }


def _closure_to_document(closure: Closure) -> dict[str, Any]:
    record = {
        "time_ns": [closure.time_a_ns, closure.time_b_ns],
        "accepted": closure.accepted,
        "bits": rounded(closure.bits, BITS),
        "reason": closure.reason,
        "round": closure.round,
        "accepted_round": closure.accepted_round,
        "revised": closure.revised or None,
    }
    return {name: value for name, value in record.items() if value is not None}


def _node_certainty(topomap: TopoMap, vertex: int) -> dict[str, Any]:
    """The sigmas and the size of a vertex where they are known, and its confidence if it is below
    1."""
    out: dict[str, Any] = {}
    if topomap.position_sigma is not None:
        out["sigma_m"] = significant(float(topomap.position_sigma[vertex]))
    if topomap.branch_sigma is not None:
        out["branch_sigmas"] = [significant(s) for s in topomap.branch_sigma[vertex].tolist()]
    if topomap.confidence[vertex] < 1:
        out["confidence"] = significant(float(topomap.confidence[vertex]))
    for name in ("area_m2", "width_m"):
        known = getattr(topomap, name)
        if known is not None and known[vertex] > 0:
            out[name] = significant(float(known[vertex]))
    return out


def edges_to_document(graph: Graph) -> list[dict[str, Any]]:
    """The `edges` of a document."""

    def branch(index: int) -> int | None:
        return None if index == NO_BRANCH else index

    keys = edge_keys(graph.source, graph.target)
    length = rounded(np.maximum(graph.length, SHORTEST_M), METRES)
    times = getattr(graph, "traversal_ns", None)
    paths, stops = _rounded_together(graph.paths)
    ends = [graph.source.tolist(), graph.target.tolist()]
    branches = [graph.source_branch.tolist(), graph.target_branch.tolist()]
    return [
        {
            "source": ends[0][i],
            "target": ends[1][i],
            "key": keys[i],
            "length": length[i],
            "length_sigma": significant(max(float(graph.length_sigma[i]), SHORTEST_M)),
            "source_branch": branch(branches[0][i]),
            "target_branch": branch(branches[1][i]),
            "path": paths[stops[i] : stops[i + 1]],
            "traversals": int(graph.traversals[i]),
            **({} if times is None else {"traversal_ns": times[i].tolist()}),
        }
        for i in range(len(keys))
    ]


def _rounded_together(paths: Sequence[FloatArray]) -> tuple[list[list[float]], list[int]]:
    """The points of all paths, rounded for documents, and the offsets of the paths in them."""
    stops = np.cumsum([0, *map(len, paths)]).tolist()
    return rounded(np.concatenate([np.zeros((0, 2)), *paths]), METRES), stops


def map_from_document(doc: Any, name: str = "map document") -> TopoMap:
    """The map of a parsed document; `name` (a path) appears in errors.

    Raises DocumentError with the location of the first fault if the schema is not followed.
    """
    d = validated(MapDocument, doc, name)
    if [node.id for node in d.nodes] != list(range(len(d.nodes))):
        raise DocumentError(f"{name}: node ids must be 0, 1, 2, … in order")
    seen = sorted((o.time_ns, node.id) for node in d.nodes for o in node.observations)
    known = set(MapGraph.model_fields) - ABOUT
    info = {k: v for k, v in d.graph.model_dump(exclude_unset=True).items() if k not in known}
    noise, fitted = _noise(d.graph.noise), d.graph.fitted_noise
    edges = edge_fields(d.edges)
    lengths = _lengths(edges["paths"])
    for k, length in enumerate(lengths.tolist()):
        if length > LONGEST_M:
            raise DocumentError(f"{name}: edges.{k}.path: is longer than {LONGEST_M / 1000:.0f} km")
    if sum(lengths) > LONGEST_TOGETHER_M:
        most = f"{LONGEST_TOGETHER_M / 1000:.0f} km"
        raise DocumentError(f"{name}: edges: all paths together are longer than {most}")

    try:
        topomap = TopoMap(
            run=d.graph.run,
            frame=d.graph.frame,
            **vertex_fields(d.nodes),
            **edges,
            observation_vertex=np.array([v for _, v in seen], np.int64),
            observation_time_ns=np.array([t for t, _ in seen], np.int64),
            noise=noise,
            fitted_noise=None if fitted is None else _noise(fitted),
            branch_sigma=_rows_known([node.branch_sigmas for node in d.nodes]),
            traversal_ns=_times_known([edge.traversal_ns for edge in d.edges]),
            confidence=np.array([node.confidence for node in d.nodes], np.float64),
            area_m2=_sizes_known([node.area_m2 for node in d.nodes]),
            width_m=_sizes_known([node.width_m for node in d.nodes]),
            shows_bends=d.graph.shows_bends,
            closures=tuple(
                Closure(*c.time_ns, **c.model_dump(include=ANSWER_FIELDS)) for c in d.graph.closures
            ),
            info=info,
        )
        return without_turning_points(topomap)
    except ValueError as error:
        raise DocumentError(f"{name}: {error}") from error


def _lengths(paths: Sequence[FloatArray]) -> FloatArray:
    """(k,) lengths [m] of paths of two points or more; of a whole map at once, as path by path
    takes a sixth of the time of reading a document."""
    size = np.array([len(path) for path in paths], np.int64)
    step = np.diff(np.concatenate([np.zeros((0, 2)), *paths]), axis=0)
    between = np.cumsum(size)[:-1] - 1
    long = np.hypot(step[:, 0], step[:, 1])
    long[between] = 0.0
    owner = np.arange(len(paths)).repeat(size)[1:]
    return np.asarray(np.bincount(owner, long, len(paths)), np.float64)


def _noise_to_document(noise: RunNoise) -> dict[str, float]:
    return {name: significant(value) for name, value in asdict(noise).items()}


def _noise(values: dict[str, float]) -> RunNoise:
    return RunNoise(**{k: v for k, v in values.items() if k in RunNoise.__dataclass_fields__})


def vertex_fields(nodes: Sequence[Vertex]) -> dict[str, Any]:
    """The nodes of a document as fields of a TopoMap."""
    sigma = [node.sigma_m for node in nodes if node.sigma_m is not None]
    return {
        "xy": np.array([(node.x, node.y) for node in nodes], np.float64).reshape(-1, 2),
        "branches": Ragged.from_rows(node.branches for node in nodes),
        "kind": tuple(node.kind for node in nodes),
        "position_sigma": np.array(sigma) if sigma and len(sigma) == len(nodes) else None,
    }


def edge_fields(edges: Sequence[MapEdge]) -> dict[str, Any]:
    """The edges of a document as fields of a TopoMap; their ends are ids of nodes."""
    whole = ("source", "target", "traversals")
    branches = ("source_branch", "target_branch")
    return {
        **{name: np.array([getattr(e, name) for e in edges], np.int64) for name in whole},
        **{
            name: np.array([_branch(getattr(e, name)) for e in edges], np.int64)
            for name in branches
        },
        "length": np.array([e.length for e in edges], np.float64),
        "length_sigma": np.array([e.length_sigma for e in edges], np.float64),
        "paths": _in_rows([e.path for e in edges], np.float64),
    }


def _branch(named: int | None) -> int:
    return NO_BRANCH if named is None else named


def _rows_known(rows: Sequence[list[float] | None]) -> Ragged | None:
    known = [row for row in rows if row is not None]
    return Ragged.from_rows(known) if known and len(known) == len(rows) else None


def _sizes_known(sizes: Sequence[float | None]) -> FloatArray | None:
    known = any(size is not None for size in sizes)
    return np.array([size or 0.0 for size in sizes]) if known else None


def _times_known(rows: Sequence[list[tuple[int, int]] | None]) -> tuple[IntArray, ...] | None:
    known = [row for row in rows if row is not None]
    return _in_rows(known, np.int64) if known and len(known) == len(rows) else None


def _in_rows(
    rows: Sequence[Sequence[tuple[float, float]]], dtype: type[Number]
) -> tuple[NDArray[Number], ...]:
    """Rows of pairs as arrays (k, 2); converted together, three times as fast as one by one."""
    numbers = chain.from_iterable(chain.from_iterable(rows))
    flat = np.fromiter(numbers, dtype, 2 * sum(map(len, rows))).reshape(-1, 2)
    return parted(flat, map(len, rows))


def read_map(path: Path) -> TopoMap:
    """The map of a `maps/<run>.json`, with the views beside it. Raises DocumentError if it cannot
    be read or does not follow the schema."""
    return with_views(map_from_document(read_json(path), str(path)), path)


def write_map(path: Path, topomap: TopoMap) -> None:
    """Write `maps/<run>.json`, and the map's views beside it."""
    document = partial(write_json, doc=map_to_document(topomap))
    write_together({**view_writes(path, topomap), path: document})
