"""Merges as documents, `merged.json`, and back; their schema is in `merged_schema.py`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from ..topology.arrays import FloatArray
from ..topology.digits import BITS, BRANCH, METRES, TURN, rounded, significant
from ..topology.document import edge_fields, edges_to_document, vertex_fields
from ..topology.files import read_json, write_json
from ..topology.map_schema import validated
from .merged_schema import MERGED_SCHEMA, MergedDocument, MergeEntry, Placed, Pose, RunnerUp
from .result import (
    Alignment,
    Component,
    CopyTest,
    FusedMap,
    MergeResult,
    PairVerdict,
    Unlisted,
    Verdict,
    by_run,
)

EXTRA = ("against_chance_bits", "same_place_bits")
"""Entries added by the robust method."""

ALIKE = (
    "a", "b", "verdict", "accepted", "evidence_bits", "reason", "margin_bits", "advice", "locked",
    "threshold_bits", "accepted_by", "lead_needed_bits",
)  # fmt: skip
"""What verdicts and their entries hold in the same form."""


def pose_to_document(pose: Any) -> dict[str, float]:
    """{"x", "y", "theta"} of a (3,) pose."""
    x, y = rounded(pose[:2], METRES)
    return {"x": x, "y": y, "theta": rounded(pose[2], TURN)}


def _alignment(alignment: Alignment) -> dict[str, Any]:
    return {
        "transform": pose_to_document(alignment.transform),
        "evidence_bits": rounded(alignment.evidence_bits, BITS),
        "matched": alignment.matched.tolist(),
        "corridors": alignment.corridors,
        "rmse_m": rounded(alignment.rmse_m, METRES),
        "contradictions": list(alignment.contradictions),
        **_contradicting(alignment),
        **_known(copy_test=alignment.copy_test and asdict(alignment.copy_test)),
    }


def _contradicting(alignment: Alignment) -> dict[str, Any]:
    found = [{"a": list(a), "b": list(b)} for a, b in alignment.contradicting]
    return {"contradicting": found} if found else {}


def sigmas_to_document(placed: tuple[float, float] | None) -> dict[str, float] | None:
    """{"sigma_m", "sigma_rad"}, or None."""
    return placed and {"sigma_m": significant(placed[0]), "sigma_rad": significant(placed[1])}


def bits_to_document(bits: float | None) -> float | None:
    """Evidence rounded for documents, or None."""
    return None if bits is None else float(rounded(bits, BITS))


def entry_of(pair: PairVerdict) -> dict[str, Any]:
    """A verdict as in the document; see `MergeEntry`."""
    entry: dict[str, Any] = {
        "a": pair.a,
        "b": pair.b,
        "verdict": str(pair.verdict),
        "accepted": pair.accepted,
        "evidence_bits": rounded(pair.evidence_bits, BITS),
        "reason": pair.reason,
    }
    entry |= _known(
        threshold_bits=bits_to_document(pair.threshold_bits),
        accepted_by=pair.accepted_by,
        together=pair.together and [list(runs) for runs in pair.together],
        through=list(pair.through) or None,
        placed=sigmas_to_document(pair.placed),
        transform_sigma=sigmas_to_document(pair.transform_sigma),
        locked=pair.locked,
    )
    if pair.verdict is Verdict.UNRELATED:
        # In short: most pairs of a fleet are unrelated.
        return entry | {name: pair.extra[name] for name in EXTRA if name in pair.extra}
    if pair.best is not None:
        entry |= {**_alignment(pair.best), "evidence_bits": entry["evidence_bits"]}
    entry |= _known(
        runner_up=pair.runner_up and _alignment(pair.runner_up),
        margin_bits=bits_to_document(pair.margin_bits),
        advice=pair.advice,
        lacks=pair.lacks or None,
        lead_needed_bits=pair.lead_needed_bits,
    )
    return entry | dict(pair.extra)


def _known(**values: Any) -> dict[str, Any]:
    return {name: value for name, value in values.items() if value is not None}


def merged_to_document(result: MergeResult) -> dict[str, Any]:
    """The node-link dict of a merge, ready for `json`."""
    parts = _parts(result)
    return {key: list(part) if isinstance(part, Iterator) else part for key, part in parts.items()}


def _parts(result: MergeResult) -> dict[str, Any]:
    """The document; lists that may be long are iterators."""
    graph: dict[str, Any] = {
        "components": [
            {
                "id": c.id,
                **({"site": c.site} if c.site else {}),
                "runs": {run: pose_to_document(c.poses[run]) for run in sorted(c.poses)},
            }
            for c in result.components
        ]
    }
    if result.unlisted is not None:
        graph["unlisted"] = asdict(result.unlisted)
    graph |= {k: v for k, v in sorted(result.info.items()) if k not in graph}
    return {
        "schema": MERGED_SCHEMA,
        "directed": False,
        "multigraph": True,
        "graph": graph,
        "nodes": _nodes(result.fused),
        "edges": _edges(result.fused),
        "merges": map(entry_of, result.verdicts),
    }


def _nodes(fused: FusedMap) -> Iterator[dict[str, Any]]:
    xy = rounded(np.asarray(fused.xy).reshape(-1, 2), METRES)
    branches, stops = rounded(fused.branches.values, BRANCH), fused.branches.offsets.tolist()
    for i, component in enumerate(fused.component.tolist()):
        yield {
            "id": i,
            "component": component,
            "x": xy[i][0],
            "y": xy[i][1],
            "kind": fused.kind[i],
            "branches": branches[stops[i] : stops[i + 1]],
            "members": {run: list(ids) for run, ids in sorted(fused.members[i].items())},
            "observations": [
                {"run": run, "time_ns": time_ns} for run, time_ns in fused.observations[i]
            ],
            **_place_sigma(fused, i),
        }


def _place_sigma(fused: FusedMap, vertex: int) -> dict[str, float]:
    """The sigma of a fused vertex, if known."""
    known = fused.position_sigma
    if known is None or not np.isfinite(known[vertex]):
        return {}
    return {"sigma_m": significant(float(known[vertex]))}


def _edges(fused: FusedMap) -> Iterator[dict[str, Any]]:
    for edge, members in zip(edges_to_document(fused), fused.edge_members, strict=True):
        own = {run: list(rows) for run, rows in by_run(sorted(members)).items()}
        yield edge | {"members": own}


def _pose_from(pose: Pose) -> FloatArray:
    return np.array([pose.x, pose.y, pose.theta])


def result_from_document(document: MergedDocument) -> MergeResult:
    """The result that a document was written from: numbers as rounded there, unrelated pairs
    without their alignments, placements without their covariance.

    Raises ValueError if the document names a vertex, a branch or a component that it lacks, or
    fuses what is of two components.
    """
    graph = document.graph
    components = tuple(
        Component(
            c.id,
            {run: _pose_from(pose) for run, pose in sorted(c.runs.items())},
            site=c.site or "",
        )
        for c in graph.components
    )
    fused = _fused_from(document)
    _check_components(components, fused)
    named = graph.model_dump(exclude_unset=True)
    own = ("components", "unlisted")
    info: dict[str, Any] = {key: value for key, value in named.items() if key not in own}
    verdicts = tuple(map(_verdict_from, document.merges))
    counted = None if graph.unlisted is None else Unlisted(**graph.unlisted.model_dump())
    return MergeResult(components, fused, verdicts, info, counted)


def _check_components(components: Sequence[Component], fused: FusedMap) -> None:
    """ValueError if what is fused is not of one component alone, or of one that is not there."""
    home = {run: c.id for c in components for run in c.poses}
    strange = sorted(set(fused.component.tolist()) - {c.id for c in components})
    if strange:
        raise ValueError(f"there is no component {strange[0]}")
    if np.any(fused.component[fused.source] != fused.component[fused.target]):
        raise ValueError("a corridor joins two components")
    of_edges = fused.component[fused.source].tolist()
    members = [*zip(fused.component.tolist(), fused.members, strict=True)]
    members += zip(of_edges, map(by_run, fused.edge_members), strict=True)
    for component, runs in members:
        for run in runs:
            if home.get(run) != component:
                raise ValueError(f"run {run!r} is a member of what is not its component")


def _fused_from(document: MergedDocument) -> FusedMap:
    nodes, edges = document.nodes, document.edges
    if [node.id for node in nodes] != list(range(len(nodes))):
        raise ValueError("node ids must be 0, 1, 2, … in order")
    places, corridors = vertex_fields(nodes), edge_fields(edges)
    for name in ("source", "target"):
        if np.any(corridors[name] >= len(nodes)):
            raise ValueError(f"an edge's {name} is no node")
        if np.any(corridors[f"{name}_branch"] >= places["branches"].counts[corridors[name]]):
            raise ValueError(f"an edge's {name}_branch is none of its node's")
    sigma = [np.nan if node.sigma_m is None else node.sigma_m for node in nodes]
    places["position_sigma"] = np.array(sigma) if np.isfinite(sigma).any() else None
    return FusedMap(
        component=np.array([node.component for node in nodes], np.int64),
        members=tuple({run: tuple(ids) for run, ids in node.members.items()} for node in nodes),
        observations=tuple(tuple((o.run, o.time_ns) for o in node.observations) for node in nodes),
        edge_members=tuple(
            tuple(sorted((run, k) for run, rows in e.members.items() for k in rows)) for e in edges
        ),
        **places,
        **corridors,
    )


def _verdict_from(entry: MergeEntry) -> PairVerdict:
    """The verdict that an entry was written from: rounded, and without the alignments of unrelated
    pairs."""
    best = None
    if entry.transform is not None:
        best = _alignment_from(entry, entry.transform, entry.matched or [])
    second = entry.runner_up
    together = None
    if entry.together is not None:
        together = (tuple(entry.together[0]), tuple(entry.together[1]))
    return PairVerdict(
        **{name: getattr(entry, name) for name in ALIKE},
        best=best,
        runner_up=None
        if second is None
        else _alignment_from(second, second.transform, second.matched),
        through=tuple(entry.through or ()),
        placed=_sigmas_from(entry.placed),
        together=together,
        transform_sigma=_sigmas_from(entry.transform_sigma),
        lacks=entry.lacks or "",
        extra=entry.model_dump(include=set(EXTRA), exclude_none=True),
    )


def _sigmas_from(placed: Placed | None) -> tuple[float, float] | None:
    return None if placed is None else (placed.sigma_m, placed.sigma_rad)


def _alignment_from(
    entry: MergeEntry | RunnerUp, transform: Pose, matched: list[tuple[int, int]]
) -> Alignment:
    tested = entry.copy_test
    return Alignment(
        transform=_pose_from(transform),
        evidence_bits=entry.evidence_bits,
        matched=np.array(matched, np.int64),
        rmse_m=entry.rmse_m,
        corridors=entry.corridors,
        contradictions=tuple(entry.contradictions),
        contradicting=tuple((tuple(c.a), tuple(c.b)) for c in entry.contradicting),
        copy_test=None if tested is None else CopyTest(**tested.model_dump()),
    )


def read_merged(path: Path) -> MergedDocument:
    """A validated `merged.json`; DocumentError if it cannot be read or does not follow the
    schema."""
    return validated(MergedDocument, read_json(path), str(path))


def write_merged(path: Path, result: MergeResult) -> None:
    """Write `merged.json`."""
    write_json(path, _parts(result))
