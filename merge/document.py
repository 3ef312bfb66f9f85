"""Merges as documents, `merged.json`, and back; their schema is in `merged_schema.py`."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
from pydantic import TypeAdapter, ValidationError

from ..topology.arrays import FloatArray
from ..topology.digits import BITS, BRANCH, METRES, TURN, rounded, significant
from ..topology.document import edge_fields, edges_to_document, vertex_fields
from ..topology.errors import UsageError
from ..topology.files import read_json, write_json
from ..topology.map_schema import validated
from .merged_schema import MERGED_SCHEMA, MergedDocument, MergeEntry, Pose
from .result import (
    Alignment,
    Component,
    CopyTest,
    FusedMap,
    MergeResult,
    PairVerdict,
    Verdict,
    by_run,
    home_of,
)

S = TypeVar("S")


def pose_to_document(pose: Any) -> dict[str, float]:
    """{"x", "y", "theta"} of a (3,) pose."""
    x, y = rounded(pose[:2], METRES)
    return {"x": x, "y": y, "theta": rounded(pose[2], TURN)}


def _pose_from(pose: Pose) -> FloatArray:
    return np.array([pose.x, pose.y, pose.theta])


def sigmas_to_document(placed: tuple[float, float] | None) -> dict[str, float] | None:
    """{"sigma_m", "sigma_rad"}, or None."""
    return placed and {"sigma_m": significant(placed[0]), "sigma_rad": significant(placed[1])}


def bits_to_document(bits: float | None) -> float | None:
    """Evidence rounded for documents, or None."""
    return None if bits is None else float(rounded(bits, BITS))


def rounded_copy_test(tested: CopyTest) -> dict[str, float]:
    """The test for a copy, rounded for documents."""
    bits, needed = rounded(tested.bits, BITS), rounded(tested.needed_bits, BITS)
    return {"bits": bits, "needed_bits": needed, "repetition": significant(tested.repetition)}


class Form(NamedTuple):
    """How a field of a verdict or an alignment is written (left out if None), and how it is read
    from the validated entry."""

    written: Callable[[Any], Any] = lambda value: value
    read: Callable[[Any], Any] = lambda value: value


AS_IT_IS, OF_BITS = Form(), Form(bits_to_document)
OF_SIGMAS = Form(sigmas_to_document, lambda placed: placed and (placed.sigma_m, placed.sigma_rad))
OF_TEXT = Form(lambda text: text or None, lambda text: text or "")

ALIGNMENT = {
    "transform": Form(pose_to_document, _pose_from),
    "evidence_bits": OF_BITS,
    "matched": Form(lambda pairs: pairs.tolist(), lambda pairs: np.array(pairs or [], np.int64)),
    "corridors": AS_IT_IS,
    "rmse_m": Form(lambda metres: rounded(metres, METRES)),
    "contradictions": Form(list, tuple),
    "contradicting": Form(
        lambda found: [{"a": list(a), "b": list(b)} for a, b in found] or None,
        lambda found: tuple((tuple(c.a), tuple(c.b)) for c in found),
    ),
    "copy_test": Form(
        lambda tested: tested and rounded_copy_test(tested),
        lambda tested: tested and CopyTest(**tested.model_dump()),
    ),
}
"""Fields of alignments."""

EVERY_PAIR = {
    **dict.fromkeys(("a", "b"), AS_IT_IS),
    "verdict": Form(str),
    "accepted": AS_IT_IS,
    "evidence_bits": OF_BITS,
    "reason": AS_IT_IS,
    "threshold_bits": OF_BITS,
    "accepted_by": AS_IT_IS,
    "together": Form(
        lambda sides: sides and [list(runs) for runs in sides],
        lambda sides: sides and tuple(tuple(runs) for runs in sides),
    ),
    "through": Form(lambda runs: list(runs) or None, lambda runs: tuple(runs or ())),
    "placed": OF_SIGMAS,
    "transform_sigma": OF_SIGMAS,
    "locked": AS_IT_IS,
}
RELATED_PAIR = {
    "margin_bits": OF_BITS,
    "advice": AS_IT_IS,
    "lacks": OF_TEXT,
    "lead_needed_bits": AS_IT_IS,
}
"""Fields of verdicts, and those that unrelated pairs do not have: most pairs of a fleet are."""


def _written(value: object, forms: Mapping[str, Form]) -> dict[str, Any]:
    """The fields of a value that are written."""
    parts = ((name, form.written(getattr(value, name))) for name, form in forms.items())
    return {name: part for name, part in parts if part is not None}


def _read(entry: object, forms: Mapping[str, Form]) -> dict[str, Any]:
    """The fields of a value, from its entry."""
    return {name: form.read(getattr(entry, name)) for name, form in forms.items()}


def entry_of(pair: PairVerdict) -> dict[str, Any]:
    """A verdict as in the document; see `MergeEntry`."""
    entry = _written(pair, EVERY_PAIR)
    if pair.verdict is Verdict.UNRELATED:
        return entry
    if pair.best is not None:
        entry |= {**_written(pair.best, ALIGNMENT), "evidence_bits": entry["evidence_bits"]}
    if pair.runner_up is not None:
        entry["runner_up"] = _written(pair.runner_up, ALIGNMENT)
    return entry | _written(pair, RELATED_PAIR)


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
        graph["unlisted"] = result.unlisted.model_dump()
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
    """The entries of fused vertices."""
    xy = rounded(np.asarray(fused.xy).reshape(-1, 2), METRES)
    branches, stops = rounded(fused.branches.values, BRANCH), fused.branches.offsets.tolist()
    sigma = np.full(len(fused), np.nan) if fused.position_sigma is None else fused.position_sigma
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
            **({"sigma_m": significant(float(sigma[i]))} if np.isfinite(sigma[i]) else {}),
        }


def _edges(fused: FusedMap) -> Iterator[dict[str, Any]]:
    """The entries of fused corridors."""
    for edge, members in zip(edges_to_document(fused), fused.edge_members, strict=True):
        own = {run: list(rows) for run, rows in by_run(sorted(members)).items()}
        yield edge | {"members": own}


def result_from_document(document: MergedDocument) -> MergeResult:
    """The result that a document was written from: numbers as rounded there, unrelated pairs
    without their alignments, placements without their covariance.

    Raises ValueError if the document names a vertex, a branch, a component or a run that it lacks,
    or fuses what is of two components.
    """
    graph = document.graph
    components = tuple(
        Component(
            c.id, {run: _pose_from(pose) for run, pose in sorted(c.runs.items())}, site=c.site or ""
        )
        for c in graph.components
    )
    fused = _fused_from(document)
    verdicts = tuple(map(_verdict_from, document.merges))
    _check_components(components, fused, verdicts)
    named = graph.model_dump(exclude_unset=True)
    own = ("components", "unlisted")
    info: dict[str, Any] = {key: value for key, value in named.items() if key not in own}
    return MergeResult(components, fused, verdicts, info, graph.unlisted)


def _check_components(
    components: Sequence[Component], fused: FusedMap, verdicts: Sequence[PairVerdict]
) -> None:
    """ValueError if what is fused is not of one component alone, or of one that is not there, or a
    verdict is on a run of none."""
    home = home_of(components)
    if unknown := sorted({run for v in verdicts for run in (v.a, v.b)} - home.keys()):
        raise ValueError(f"run {unknown[0]!r} is in no component")
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
    """The fused map of a document; ValueError where its parts do not fit together."""
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
    best, second = (
        None if one is None or one.transform is None else Alignment(**_read(one, ALIGNMENT))
        for one in (entry, entry.runner_up)
    )
    return PairVerdict(**_read(entry, EVERY_PAIR | RELATED_PAIR), best=best, runner_up=second)


def settings_from_document(kind: type[S], values: Mapping[str, Any] | None) -> S:
    """The settings of a method from `graph.settings` of a merge, with defaults for missing ones;
    ValueError on invalid values."""
    try:
        return TypeAdapter(kind).validate_python(dict(values or {}))
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        raise ValueError(": ".join([*map(str, first["loc"]), first["msg"]])) from error
    except UsageError as error:
        raise ValueError(str(error)) from error


def read_merged(path: Path) -> MergedDocument:
    """A validated `merged.json`; DocumentError if it cannot be read or does not follow the
    schema."""
    return validated(MergedDocument, read_json(path), str(path))


def write_merged(path: Path, result: MergeResult) -> None:
    """Write `merged.json`."""
    write_json(path, _parts(result))
