"""A merge read from its document: the value that `merged.json` was written from."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..topology.map_schema import FARTHEST_M
from ..topology.passes import NO_BRANCH
from ..topology.ragged import Ragged
from .document import MergedDocument, verdict_from_entry
from .result import Component, FusedMap, MergeResult, Unlisted


def result_from_document(document: MergedDocument) -> MergeResult:
    """The result that a document was written from: its numbers as rounded there, unrelated pairs
    without their alignments, placements without their covariance.

    Raises ValueError where the document names a vertex, a branch or a component that it lacks.
    """
    graph = document.graph
    components = tuple(
        Component(c.id, {run: np.array([p.x, p.y, p.theta]) for run, p in sorted(c.runs.items())})
        for c in graph.components
    )
    fused = _fused(document)
    known = {c.id for c in components}
    strange = sorted(set(fused.component.tolist()) - known)
    if strange:
        raise ValueError(f"there is no component {strange[0]}")
    named = graph.model_dump(exclude_unset=True)
    own = ("components", "unlisted")
    info: dict[str, Any] = {key: value for key, value in named.items() if key not in own}
    verdicts = tuple(map(verdict_from_entry, document.merges))
    counted = None if graph.unlisted is None else Unlisted(**graph.unlisted.model_dump())
    return MergeResult(components, fused, verdicts, info, counted)


def _fused(document: MergedDocument) -> FusedMap:
    nodes, edges = document.nodes, document.edges
    if [node.id for node in nodes] != list(range(len(nodes))):
        raise ValueError("node ids must be 0, 1, 2, … in order")
    xy = np.array([(node.x, node.y) for node in nodes], np.float64).reshape(-1, 2)
    if np.any(np.abs(xy) > FARTHEST_M):
        raise ValueError(f"a node lies farther than {FARTHEST_M / 1000:.0f} km from its origin")
    branches = Ragged.from_rows(node.branches for node in nodes)
    ends: dict[str, NDArray[np.int64]] = {}
    for name in ("source", "target"):
        vertex = np.array([getattr(e, name) for e in edges], np.int64)
        if np.any(vertex >= len(nodes)):
            raise ValueError(f"an edge's {name} is no node")
        known = [getattr(e, f"{name}_branch") for e in edges]
        branch = np.array([NO_BRANCH if b is None else b for b in known], np.int64)
        if np.any(branch >= branches.counts[vertex]):
            raise ValueError(f"an edge's {name}_branch is none of its node's")
        ends |= {name: vertex, f"{name}_branch": branch}
    sigma = [np.nan if node.sigma_m is None else node.sigma_m for node in nodes]
    return FusedMap(
        component=np.array([node.component for node in nodes], np.int64),
        xy=xy,
        branches=branches,
        kind=tuple(str((node.model_extra or {}).get("kind", "junction")) for node in nodes),
        members=tuple({run: tuple(ids) for run, ids in node.members.items()} for node in nodes),
        observations=tuple(tuple((o.run, o.time_ns) for o in node.observations) for node in nodes),
        source=ends["source"],
        target=ends["target"],
        source_branch=ends["source_branch"],
        target_branch=ends["target_branch"],
        length=np.array([e.length for e in edges], np.float64),
        length_sigma=np.array([e.length_sigma for e in edges], np.float64),
        traversals=np.array([e.traversals for e in edges], np.int64),
        paths=tuple(np.array(e.path, np.float64) for e in edges),
        edge_members=tuple(
            tuple(sorted((run, k) for run, rows in e.members.items() for k in rows)) for e in edges
        ),
        position_sigma=np.array(sigma) if np.isfinite(sigma).any() else None,
    )
