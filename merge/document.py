"""The merged document, `merged.json`: schema `topobatch.merged/1`."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, Field, model_validator

from ..topology.digits import BITS, BRANCH, METRES, TURN, rounded, significant
from ..topology.document import edges_to_document
from ..topology.files import Json, encoded, read_json, write_json
from ..topology.map_schema import (
    Attributes,
    Finite,
    Index,
    MapEdge,
    Model,
    Multigraph,
    Noise,
    Observation,
    Undirected,
    validated,
)
from .result import (
    AcceptedBy,
    Alignment,
    FusedMap,
    MergeResult,
    PairVerdict,
    Verdict,
    nothing_kept,
)

EXTRA = ("against_chance_bits", "same_place_bits")
"""What the robust method adds to its entries."""

MERGED_SCHEMA: Literal["topobatch.merged/1"] = "topobatch.merged/1"


class Pose(Model):
    """A rigid transform of the plane: metres and radians."""

    x: Finite = Field(description="Metres.")
    y: Finite = Field(description="Metres.")
    theta: Finite = Field(description="Radians, anticlockwise.")


class ComponentEntry(Model):
    """Runs in one frame; a run's pose takes its map's coordinates to the component's."""

    id: Index = Field(description="Number of the component.")
    runs: dict[str, Pose] = Field(description="Pose of every run's map in the component's frame.")


class UnlistedPairs(Model):
    """Pairs of runs that a merge of more than 5,000 pairs counts and does not list in `merges`."""

    joined: Index = Field(description="In one component, through other runs.")
    unrelated: Index = Field(
        description="Not in one component; matched, with nothing that chance would not offer."
    )
    screened: Index = Field(
        description="Not in one component and not matched: no corridors that hang together look "
        "alike enough for the two runs to be merged. They count in threshold_bits like all pairs."
    )


class MergedGraph(Attributes):
    """Attributes of the whole merge."""

    components: list[ComponentEntry] = Field(
        description="Runs that were merged; the frame of each is that of its first run by name."
    )
    unlisted: UnlistedPairs | None = Field(
        None,
        description="Present in large merges: how many pairs are not in `merges`. Such a pair is "
        "unrelated, unless its runs are in one component.",
    )
    method: str | None = Field(None, description="robust or paper.")
    settings: dict[str, Any] | None = Field(
        None, description="What the method was tuned to; false_merge_rate and others."
    )


class MergedNode(Model):
    """A fused vertex."""

    id: Index = Field(description="Number of the vertex.")
    component: Index = Field(description="Component in whose frame it is.")
    x: Finite = Field(description="Position in the component's frame, metres.")
    y: Finite = Field(description="Position in the component's frame, metres.")
    branches: list[Finite] = Field(
        description="Direction in which each branch leaves: radians in the component's frame."
    )
    members: dict[str, list[Index]] = Field(
        description="By run, the vertices of its map that are this place."
    )
    observations: list[Observation] = Field(description="The passes of all runs.")
    sigma_m: Noise | None = Field(
        None,
        description="1 sigma of each coordinate, metres, with the component as a whole laid over "
        "the truth.",
    )


class MergedEdge(MapEdge):
    """A fused corridor."""

    members: dict[str, list[Index]] = Field(
        description="By run, the edges of its map that are this corridor, or run through it."
    )


_TRANSFORM = "Pose of run b's map in the frame of run a's."
_MATCHED = "Vertices that are one place: of a's map, of b's map."
_CORRIDORS = "Corridors between matched vertices that agree."
_RMSE = "Root mean square distance of the matched vertices under the transform, metres."
_CONTRADICTIONS = "What disagrees, a sentence each."

_EVIDENCE = (
    "log2 of the odds that so much agrees because it is one place: each bit doubles them. What "
    "speaks for the alignment, less what chance offers among so many hypotheses, at most 2.5 bits "
    "for each matched junction, less what speaks against it; where the building may repeat itself, "
    "no more than the odds against a copy of the place allow."
)


class Contradiction(Model):
    """Where a sentence of `contradictions` lies: the junctions of the two runs that it speaks of, a
    corridor as its two ends."""

    a: list[Index] = Field(
        min_length=1, max_length=2, description="Of a's map: a junction, or the ends of a corridor."
    )
    b: list[Index] = Field(
        min_length=1, max_length=2, description="Of b's map: a junction, or the ends of a corridor."
    )


class Contradicted(Model):
    """What speaks against an alignment."""

    contradictions: list[str] = Field(default_factory=list, description=_CONTRADICTIONS)
    contradicting: list[Contradiction] = Field(
        default_factory=list, description="One for each of the contradictions, where known."
    )

    @model_validator(mode="after")
    def _one_for_each(self) -> Contradicted:
        if self.contradicting and len(self.contradicting) != len(self.contradictions):
            raise ValueError("contradicting must be as many as contradictions")
        return self


class RunnerUp(Contradicted):
    """The next best alignment and its evidence."""

    transform: Pose = Field(description=_TRANSFORM)
    evidence_bits: Finite = Field(description=_EVIDENCE)
    matched: list[tuple[Index, Index]] = Field(description=_MATCHED)
    corridors: Index = Field(0, description=_CORRIDORS)
    rmse_m: Finite = Field(0.0, description=_RMSE)


class Placed(Model):
    """1 sigma of how two runs of one component lie to each other: of where the middle of one's map
    is, seen from the other's (root mean square of both ways to see it), and of the turn between
    them."""

    sigma_m: Finite = Field(description="Metres, of both coordinates together.")
    sigma_rad: Finite = Field(description="Radians.")


class MergeEntry(Contradicted):
    """What is said about one pair of runs."""

    a: str = Field(description="A run.")
    b: str = Field(description="Another run, later by name.")
    verdict: Verdict = Field(description="merged, ambiguous or unrelated.")
    accepted: bool = Field(
        description="The pair joins a component: verdict merged, and kept by every later check."
    )
    evidence_bits: Finite = Field(
        description=f"{_EVIDENCE} Of the alignment in this entry, else of the best one that was "
        "found; 0 where none was. Of pairs accepted by components: that of the two components."
    )
    threshold_bits: Finite | None = Field(
        None,
        description="The evidence that merging needs: log2(pairs of runs / false-merge rate), with "
        "more than 15 pairs rounded up by an eighth at most; of pairs accepted by components only "
        "the pairs that were not joined by then count.",
    )
    margin_bits: Finite | None = Field(
        None,
        description="evidence_bits less those of the runner-up; absent where there is none. "
        "Negative where a person or other runs chose against the pair's own evidence.",
    )
    against_chance_bits: Finite | None = Field(
        None,
        description="The most evidence of any alignment against chance, whether the place or a "
        "copy of it; absent where none has any.",
    )
    same_place_bits: Finite | None = Field(
        None,
        description="What says that it is the place itself and not a copy of it, on a scale of its "
        "own; absent where that was not asked.",
    )
    reason: str = Field(description="The verdict in words.")
    accepted_by: AcceptedBy | None = Field(
        None,
        description="pair: its own evidence; components: that of the two components it joins; "
        "runs: others place the two as one of their own alignments does; lock: a person.",
    )
    together: tuple[list[str], list[str]] | None = Field(
        None, description="accepted_by components: the runs of the two."
    )
    through: list[str] | None = Field(
        None,
        description="Of two runs that only others join: the runs between them in the shortest "
        "chain of accepted pairs.",
    )
    transform: Pose | None = Field(None, description=f"{_TRANSFORM} Absent of unrelated pairs.")
    matched: list[tuple[Index, Index]] | None = Field(None, description=_MATCHED)
    corridors: Index = Field(0, description=_CORRIDORS)
    rmse_m: Finite = Field(0.0, description=_RMSE)
    runner_up: RunnerUp | None = Field(
        None, description="The next best alignment that places b elsewhere."
    )
    placed: Placed | None = Field(
        None, description="How surely other runs place the two, where only others join them."
    )
    transform_sigma: Placed | None = Field(
        None, description="How surely all maps of the component together place an accepted pair."
    )
    advice: str | None = Field(None, description="What would settle an ambiguous pair.")
    locked: str | None = Field(None, description="same or never, where a person decided.")

    @model_validator(mode="after")
    def _of_a_pair(self) -> MergeEntry:
        if not self.a < self.b:
            raise ValueError(f"a pair is ordered by name: {self.a!r}, {self.b!r}")
        if self.accepted and self.transform is None:
            raise ValueError("an accepted pair needs its transform")
        sides = self.together or ([self.a], [self.b])
        if not any(self.a in x and self.b in y for x, y in (sides, sides[::-1])):
            raise ValueError("together must name the runs of the two components")
        return self


class MergedDocument(Model):
    """`merged.json`."""

    model_config = ConfigDict(extra="allow", frozen=True, serialize_by_alias=True)

    schema_name: Literal["topobatch.merged/1"] = Field(
        alias="schema", description="Name and version of this schema."
    )
    directed: Undirected = Field(description="For networkx: corridors lead both ways.")
    multigraph: Multigraph = Field(description="For networkx: several may join two vertices.")
    graph: MergedGraph = Field(description="What is said of the merge as a whole.")
    nodes: list[MergedNode] = Field(description="The fused vertices of all components.")
    edges: list[MergedEdge] = Field(description="The fused corridors of all components.")
    merges: list[MergeEntry] = Field(
        description="One entry for each pair of runs, but for those in graph.unlisted."
    )


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
    }


def _contradicting(alignment: Alignment) -> dict[str, Any]:
    found = [{"a": list(a), "b": list(b)} for a, b in alignment.contradicting]
    return {"contradicting": found} if found else {}


def _sigmas(placed: tuple[float, float]) -> dict[str, float]:
    return {"sigma_m": significant(placed[0]), "sigma_rad": significant(placed[1])}


def entry_of(pair: PairVerdict) -> dict[str, Any]:
    """A verdict as the document has it; see `MergeEntry`."""
    entry: dict[str, Any] = {
        "a": pair.a,
        "b": pair.b,
        "verdict": str(pair.verdict),
        "accepted": pair.accepted,
        "evidence_bits": rounded(pair.evidence_bits, BITS),
        "reason": pair.reason,
    }
    if pair.threshold_bits is not None:
        entry["threshold_bits"] = rounded(pair.threshold_bits, BITS)
    if pair.accepted_by is not None:
        entry["accepted_by"] = pair.accepted_by
    if pair.together is not None:
        entry["together"] = [list(runs) for runs in pair.together]
    if pair.through:
        entry["through"] = list(pair.through)
    if pair.placed is not None:
        entry["placed"] = _sigmas(pair.placed)
    if pair.transform_sigma is not None:
        entry["transform_sigma"] = _sigmas(pair.transform_sigma)
    if pair.locked is not None:
        entry["locked"] = pair.locked
    if pair.verdict is Verdict.UNRELATED:
        return entry  # in short: most pairs of a fleet are unrelated
    if pair.best is not None:
        best = _alignment(pair.best)
        del best["evidence_bits"]
        entry |= best
    if pair.runner_up is not None:
        entry["runner_up"] = _alignment(pair.runner_up)
    if pair.margin_bits is not None:
        entry["margin_bits"] = rounded(pair.margin_bits, BITS)
    if pair.advice is not None:
        entry["advice"] = pair.advice
    return entry | dict(pair.extra)


def merged_to_document(result: MergeResult) -> dict[str, Any]:
    """The node-link dict of a merge, ready for `json`."""
    unknown = [replace(component, text=b"") for component in result.components]
    parts = _parts(replace(result, kept_entry=nothing_kept, components=tuple(unknown)))
    return {key: list(part) if isinstance(part, Iterator) else part for key, part in parts.items()}


def _parts(result: MergeResult) -> dict[str, Any]:
    """The document; lists that may be long are made entry by entry."""
    graph: dict[str, Any] = {
        "components": [
            {"id": c.id, "runs": {run: pose_to_document(c.poses[run]) for run in sorted(c.poses)}}
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
        **_places(result),
        "merges": (result.kept_entry(pair) or entry_of(pair) for pair in result.verdicts),
    }


def _places(result: MergeResult) -> dict[str, Iterator[Any]]:
    """The fused vertices and corridors, as text where that of all components is known."""
    fused = result.fused
    nodes: list[bytes] = []
    edges: list[bytes] = []
    for component in result.components:
        some, _, more = component.text.partition(BETWEEN)
        nodes += some.splitlines()
        edges += more.splitlines()
    if len(nodes) != len(fused) or len(edges) != len(fused.source):
        return {"nodes": _nodes(fused), "edges": _edges(fused)}
    numbers = enumerate(fused.component.tolist())
    ends = zip(fused.source.tolist(), fused.target.tolist(), strict=True)
    return {
        "nodes": map(partial(_numbered, NODE), numbers, nodes),
        "edges": map(partial(_numbered, EDGE), ends, edges),
    }


BETWEEN = b"\n\n"
"""Stands between the vertices and the corridors of a component, of which each is a line."""

NODE, EDGE = b'{"id":%d,"component":%d,', b'{"source":%d,"target":%d,'
"""How their entries begin: with numbers that hang on the other components."""


def places_text(fused: FusedMap) -> bytes:
    """What the document says of the vertices and corridors of one component, but for `NODE` and
    `EDGE`."""
    both = (_nodes(fused), _edges(fused))
    return BETWEEN.join(b"\n".join(map(_without_numbers, entries)) for entries in both)


def _without_numbers(entry: dict[str, Any]) -> bytes:
    return encoded(dict(islice(entry.items(), 2, None)))[1:]


def _numbered(begin: bytes, numbers: tuple[int, int], rest: bytes) -> Json:
    return Json(begin % numbers + rest)


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
    """How sure a fused vertex is, where that is known."""
    known = fused.position_sigma
    if known is None or not np.isfinite(known[vertex]):
        return {}
    return {"sigma_m": significant(float(known[vertex]))}


def _edges(fused: FusedMap) -> Iterator[dict[str, Any]]:
    for edge, members in zip(edges_to_document(fused), fused.edge_members, strict=True):
        yield edge | {"members": _by_run(members)}


def _by_run(members: tuple[tuple[str, int], ...]) -> dict[str, list[int]]:
    out: dict[str, list[int]] = {}
    for run, index in sorted(members):
        out.setdefault(run, []).append(index)
    return out


def poses_from_document(document: MergedDocument) -> dict[str, NDArray[np.float64]]:
    """(3,) pose of every run in its component."""
    return {
        run: np.array([pose.x, pose.y, pose.theta])
        for component in document.graph.components
        for run, pose in component.runs.items()
    }


def verdict_from_entry(entry: MergeEntry) -> PairVerdict:
    """What a document says about a pair, as the value it was written from: rounded, and without
    the alignments of unrelated pairs."""
    best = None
    if entry.transform is not None:
        best = _alignment_from(entry, entry.transform, entry.matched or [])
    second = entry.runner_up
    extra = {name: getattr(entry, name) for name in EXTRA if getattr(entry, name) is not None}
    return PairVerdict(
        a=entry.a,
        b=entry.b,
        verdict=entry.verdict,
        accepted=entry.accepted,
        evidence_bits=entry.evidence_bits,
        reason=entry.reason,
        best=best,
        runner_up=None
        if second is None
        else _alignment_from(second, second.transform, second.matched),
        margin_bits=entry.margin_bits,
        advice=entry.advice,
        locked=entry.locked,
        threshold_bits=entry.threshold_bits,
        accepted_by=entry.accepted_by,
        through=tuple(entry.through or ()),
        placed=_sigmas_from(entry.placed),
        together=_sides(entry.together),
        transform_sigma=_sigmas_from(entry.transform_sigma),
        extra=extra,
    )


def _sides(
    together: tuple[list[str], list[str]] | None,
) -> tuple[tuple[str, ...], tuple[str, ...]] | None:
    return None if together is None else (tuple(together[0]), tuple(together[1]))


def _sigmas_from(placed: Placed | None) -> tuple[float, float] | None:
    return None if placed is None else (placed.sigma_m, placed.sigma_rad)


def _alignment_from(
    entry: MergeEntry | RunnerUp, transform: Pose, matched: list[tuple[int, int]]
) -> Alignment:
    return Alignment(
        transform=np.array([transform.x, transform.y, transform.theta]),
        evidence_bits=entry.evidence_bits,
        matched=np.array(matched, np.int64),
        rmse_m=entry.rmse_m,
        corridors=entry.corridors,
        contradictions=tuple(entry.contradictions),
        contradicting=tuple((tuple(c.a), tuple(c.b)) for c in entry.contradicting),
    )


def read_merged(path: Path) -> MergedDocument:
    """A checked `merged.json`; DocumentError if it cannot be read or is no such document."""
    return validated(MergedDocument, read_json(path), str(path))


def write_merged(path: Path, result: MergeResult) -> None:
    """Write `merged.json`."""
    write_json(path, _parts(result))
