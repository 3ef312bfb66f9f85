"""The schema of the merged document, `topobatch.merged/1`: pydantic models, as in `map_schema`."""

from __future__ import annotations

import re
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, ConfigDict, Field, model_validator

from ..topology.map_schema import Attributes, Finite, Index, MapEdge, Model, Vertex
from .result import AcceptedBy, UnlistedPairs, Verdict

MERGED_SCHEMA: Literal["topobatch.merged/1"] = "topobatch.merged/1"


def is_site_name(name: str) -> bool:
    """Whether a site can be called so: a plain file name, as exports are called like their site,
    without the colon between two runs. 200 bytes leave room for suffixes."""
    plain = name.isprintable() and not name.startswith(".") and not re.search(r"[/\\:]", name)
    return bool(name.strip()) and plain and len(name.encode()) <= 200


def _checked_site_name(name: str) -> str:
    if not is_site_name(name):
        raise ValueError(f"{name[:40]!r} cannot name a site: it must work as a file name")
    return name


SiteName = Annotated[str, AfterValidator(_checked_site_name)]


class Pose(Model):
    """A rigid transform of the plane: metres and radians."""

    x: Finite = Field(description="Metres.")
    y: Finite = Field(description="Metres.")
    theta: Finite = Field(description="Radians, anticlockwise.")


class ComponentEntry(Model):
    """Runs in one frame; a run's pose takes its map's coordinates to the component's."""

    id: Index = Field(description="Number of the component.")
    site: SiteName | None = Field(
        None,
        description="Its name, which stays from merge to merge where the number may change; no "
        "other component has it.",
    )
    runs: dict[str, Pose] = Field(description="Pose of every run's map in the component's frame.")


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
    layers: dict[str, list[dict[str, Any]]] | None = Field(
        None,
        description="Of every component of several runs, by its first run: all of them by layers "
        "(§4.1 of the paper), layer 0 that run itself; depends_on: the run of the layer below that "
        "one was matched to.",
    )
    warnings: list[str] | None = Field(None, description="What is odd about the runs.")

    @model_validator(mode="after")
    def _sites_differ(self) -> MergedGraph:
        names = [c.site for c in self.components if c.site is not None]
        if len(set(names)) < len(names):
            raise ValueError("two components are called like one site")
        return self

    maps: dict[str, str] | None = Field(
        None,
        description="By run, the BLAKE2b digest (128 bits, hexadecimal) of the file of its map, as "
        "it was merged: b2sum --length 128 maps/RUN.json.",
    )


class MergedNode(Vertex):
    """A fused vertex."""

    component: Index = Field(description="Component in whose frame it is.")
    members: dict[str, list[Index]] = Field(
        description="By run, the vertices of its map that are this place."
    )


class MergedEdge(MapEdge):
    """A fused corridor."""

    members: dict[str, list[Index]] = Field(
        description="By run, the edges of its map that are this corridor, or run through it."
    )


_TRANSFORM = "Pose of run b's map in the frame of run a's."
_MATCHED = "Vertices that are one place: of a's map, of b's map."
_CORRIDORS = (
    "Corridors between matched vertices that agree; accepted_by components: of the two components."
)
_RMSE = "Root mean square distance of the matched vertices under the transform, metres."
_CONTRADICTIONS = (
    "What disagrees, a sentence each; looked for only where the rest says more than chance."
)

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


class CopyAnswer(Model):
    """Whether an alignment is a copy of the place, where that was asked."""

    bits: Finite = Field(description="What says that it is the place itself and not a copy of it.")
    needed_bits: Finite = Field(description="How much of that is needed.")
    repetition: Finite = Field(
        description="0 to 1: how likely it is a copy by its size and by how the building repeats "
        "itself."
    )


class Contradicted(Model):
    """What speaks against an alignment."""

    contradictions: list[str] = Field(default_factory=list, description=_CONTRADICTIONS)
    contradicting: list[Contradiction] = Field(
        default_factory=list, description="One for each of the contradictions, where known."
    )
    copy_test: CopyAnswer | None = Field(
        None, description="The test for a copy of the place; absent where it was not made."
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

    sigma_m: Finite = Field(
        description="Metres: the distance within which the truth lies in 68.3 % of cases."
    )
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
    transform: Pose | None = Field(
        None,
        description=f"{_TRANSFORM} The fit of these two alone; by the poses of graph.components "
        "all maps fit together. Absent of unrelated pairs.",
    )
    matched: list[tuple[Index, Index]] | None = Field(None, description=_MATCHED)
    corridors: Index = Field(0, description=_CORRIDORS)
    rmse_m: Finite = Field(0.0, description=_RMSE)
    runner_up: RunnerUp | None = Field(
        None, description="The next best alignment that places b elsewhere."
    )
    placed: Placed | None = Field(
        None,
        description="How surely the poses of graph.components place the two, where only others "
        "join them.",
    )
    transform_sigma: Placed | None = Field(
        None,
        description="How surely all maps of the component together place an accepted pair: by the "
        "poses of graph.components, not by its own transform.",
    )
    advice: str | None = Field(None, description="What would settle an ambiguous pair.")
    lacks: str | None = Field(
        None, description="What the two maps lack for being merged by themselves, if anything."
    )
    lead_needed_bits: Finite | None = Field(
        None, description="The margin_bits that merging needs; absent of unrelated pairs."
    )
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
    directed: Literal[False] = Field(description="For networkx: corridors lead both ways.")
    multigraph: Literal[True] = Field(description="For networkx: several may join two vertices.")
    graph: MergedGraph = Field(description="What is said of the merge as a whole.")
    nodes: list[MergedNode] = Field(description="The fused vertices of all components.")
    edges: list[MergedEdge] = Field(description="The fused corridors of all components.")
    merges: list[MergeEntry] = Field(
        description="One entry for each pair of runs, but for those in graph.unlisted."
    )

    def entry(self, one: str, other: str) -> MergeEntry | None:
        """What is said of two runs, in whatever order, if it is listed."""
        pair = (min(one, other), max(one, other))
        return next((entry for entry in self.merges if (entry.a, entry.b) == pair), None)
