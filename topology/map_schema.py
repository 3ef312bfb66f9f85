"""The schema of the map document, `topobatch.map/1`.

The pydantic models validate what is read, and publish the JSON Schema.
"""

from __future__ import annotations

import re
from math import isfinite
from typing import Annotated, Any, Literal, Self, TypeVar, get_args

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from .digits import METRES
from .errors import DocumentError

MAP_SCHEMA: Literal["topobatch.map/1"] = "topobatch.map/1"

FARTHEST_M = 1e9
"""Where a vertex can lie: logs are believed as far. Eastings with a zone in front reach 6e7."""

LONGEST_M = 1e5
LONGEST_TOGETHER_M = 1e6
"""A corridor, and all of a map, can be no longer: merging looks at a corridor every 0.25 m, and
takes 60 MB for 100 km."""

MOST_BRANCHES = 64
"""At one junction. Ingest holds branches closer than 0.3 rad for one, which leaves 20 at most."""

MOST_VIEWS = 1_000_000
"""Of one map: a view every 3 m of 3,000 km. They are unpacked to 6 kB each."""

SHORTEST_M = 10.0**-METRES
"""Nor shorter, or known better, than a document can say."""

LARGEST_NOISE = 1e6
"""Nor noisier: its square and the product with a length stay far from overflow."""

Finite = Annotated[float, Field(allow_inf_nan=False)]
Metres = Annotated[float, Field(ge=-FARTHEST_M, le=FARTHEST_M, allow_inf_nan=False)]
Extent = Annotated[float, Field(gt=0, le=LONGEST_M, allow_inf_nan=False)]
Noise = Annotated[float, Field(ge=0, le=LARGEST_NOISE, allow_inf_nan=False)]
Index = Annotated[int, Field(ge=0, lt=2**63)]
Nanoseconds = Annotated[int, Field(ge=-(2**63), lt=2**63)]


class Model(BaseModel):
    """A part of a document; unknown keys are kept, known ones checked."""

    model_config = ConfigDict(extra="allow", frozen=True)


class Attributes(Model):
    """Attributes of a graph as a whole. Unknown ones are kept and written again, so that numbers
    too large for a float, which are read as infinite, are refused."""

    @model_validator(mode="after")
    def _finite(self) -> Self:
        for key, value in self:
            if isinstance(value, dict | list | float) and not _is_finite(value):
                raise ValueError(f"{key} holds a number that is too large")
        return self


def _is_finite(value: Any) -> bool:
    if isinstance(value, dict):
        return all(map(_is_finite, value.values()))
    if isinstance(value, list):
        return all(map(_is_finite, value))
    return not isinstance(value, float) or isfinite(value)


class Observation(Model):
    """One pass of a robot by a vertex."""

    run: str = Field(description="The run that passed.")
    time_ns: Nanoseconds = Field(
        description="When the robot was nearest to the centre: nanoseconds since 1970, by the "
        "clock of the log."
    )


class Vertex(Model):
    """A vertex, of a map or fused, in the frame of its map or component."""

    id: Index = Field(description="0, 1, 2, … in the order of the list.")
    x: Metres = Field(description="Position in the frame, metres.")
    y: Metres = Field(description="Position in the frame, metres.")
    kind: str = Field(
        description="junction, dead_end (one branch) or bend (two, not opposite). Of grids also "
        "door (two branches) and room (behind doors, any number of branches). Of runs with scans "
        "also turning_point (the robot drove there out of a junction and back) and track_end "
        "(its log begins or ends there), of grids frontier (the way leads on into the unknown): "
        "these three are matched with nothing, and come after all others, as their corridors do."
    )
    branches: list[Finite] = Field(
        description="Direction in which each branch leaves, driven or only seen: radians in the "
        "frame, ascending in [-π, π)."
    )
    observations: list[Observation] = Field(description="The passes of the robots, by time.")
    sigma_m: Noise | None = Field(
        None,
        description="1 sigma of each coordinate, metres, with the map or component as a whole laid "
        "over the truth; absent where it is not known.",
    )


class MapNode(Vertex):
    """A vertex of a map."""

    branches: list[Finite] = Field(
        max_length=MOST_BRANCHES, description=Vertex.model_fields["branches"].description
    )
    branch_sigmas: list[Noise] | None = Field(
        None, description="1 sigma of each branch's direction, radians, likewise."
    )
    confidence: float = Field(
        1.0,
        gt=0,
        le=1,
        description="How sure it is that the vertex has just these branches: 1 for detections, for "
        "scans and grids the share of variants of the detector's settings that agree.",
    )
    area_m2: Extent | None = Field(
        None, description="Of a room: free space between its walls and doors, square metres."
    )
    width_m: Extent | None = Field(None, description="Of a door: between its posts, metres.")

    @model_validator(mode="after")
    def _one_sigma_per_branch(self) -> MapNode:
        if self.branch_sigmas is not None and len(self.branch_sigmas) != len(self.branches):
            raise ValueError("branch_sigmas must be as many as branches")
        return self


class MapEdge(Model):
    """A corridor between two vertices."""

    source: Index = Field(description="Vertex at one end.")
    target: Index = Field(description="Vertex at the other end; corridors lead both ways.")
    key: Index = Field(description="Number among the corridors between the same two vertices.")
    length: Extent = Field(description="Way from centre to centre along the corridor, metres.")
    length_sigma: Extent = Field(description="1 sigma of the length, metres.")
    source_branch: Index | None = Field(
        description="Which branch of the source it leaves by, counted from 0; null: unknown."
    )
    target_branch: Index | None = Field(
        description="Which branch of the target it leaves by, counted from 0; null: unknown."
    )
    path: list[tuple[Metres, Metres]] = Field(
        min_length=2, description="Its course from source to target in the map's frame, metres."
    )
    traversals: Index = Field(description="How often it was driven from end to end.")
    traversal_ns: list[tuple[Nanoseconds, Nanoseconds]] | None = Field(
        None,
        description="For every time that it was driven, when the robot was at the source and when "
        "at the target (nanoseconds since 1970): driven from target to source, the second is the "
        "earlier one. Standing and turning round at the ends is not counted. Absent where unknown, "
        "and of fused corridors.",
    )


class ClosureRecord(Model):
    """An identification that was made, refused, or taken back.

    round: of the loop closure, from 1 on; accepted_round: in which it had been accepted, where this
    takes it back; revised: another answer stands.
    """

    time_ns: tuple[Nanoseconds, Nanoseconds] = Field(
        description="Times of the two passes that were compared."
    )
    accepted: bool = Field(description="Whether they were taken for one place.")
    bits: Finite = Field(description="Evidence: log2 of the odds that they are one place.")
    reason: str = Field(description="The answer in words.")
    round: Index | None = Field(None, description="Round of the loop closure, from 1 on.")
    accepted_round: Index | None = Field(
        None, description="Round in which it had been accepted, where this takes it back."
    )
    revised: bool = Field(
        False,
        description="A later answer replaces this one: the two passes were identified in a later "
        "round, or refused again, perhaps for another reason.",
    )


class ViewsRecord(Model):
    """The views of a map, in the file beside its document."""

    count: int = Field(ge=0, le=MOST_VIEWS, description="Places that have one.")
    digest: str = Field(
        pattern="^[0-9a-f]{32}$", description="BLAKE2b of their content, 16 bytes in hexadecimal."
    )


class MapGraph(Attributes):
    """Attributes of a whole map."""

    run: str = Field(description="Name of the run, unique in a workspace.")
    frame: str = Field(description="Frame of the odometry; the map's own frame is called the same.")
    pieces: int = Field(
        1,
        ge=1,
        description="Number of parts whose relative poses are unknown: they are drawn side by "
        "side.",
    )
    shows_bends: bool = Field(
        True,
        description="Whether its detector shows places with two branches; in maps from scans and "
        "grids false.",
    )
    noise: dict[str, Noise] = Field(
        default_factory=dict,
        description="How well the run was measured, by name with its unit, as closure and matching "
        "count with it: with caution.",
    )
    fitted_noise: dict[str, Noise] | None = Field(
        None, description="The same as the closed run itself shows it; sigmas come from this."
    )
    closures: list[ClosureRecord] = Field(
        default_factory=list, description="Every identification made, refused or taken back."
    )
    source: dict[str, Any] | None = Field(
        None,
        description="What it was made from: log, topics and their types, clock, tool; of scans how "
        "well they matched.",
    )
    settings: dict[str, Any] | None = Field(None, description="What mapping was tuned to.")
    warnings: list[str] | None = Field(
        None, description="What was wrong with the log, and what was done about it."
    )
    calibration: dict[str, Any] | None = Field(
        None,
        description="Constant errors of the odometry by name: the estimate, its sigma, and what of "
        "it was applied; `length_scale` is the share by which lengths were recorded too long, "
        "`lever_x_m` and `lever_y_m` by how much junctions were seen off in the robot's axes.",
    )
    driven: dict[str, Any] | None = Field(
        None, description="Shares of the way that the map covers, in scans and along corridors."
    )
    jumps: list[Any] | None = Field(
        None,
        description="Where the odometry jumped, and by how much, estimated from revisited places.",
    )
    views: ViewsRecord | None = Field(
        None,
        description="What a laser or a grid showed around places of the run: in `RUN.views` beside "
        "this document. Without that file the map is merged by its junctions alone.",
    )


ABOUT = frozenset(
    {"pieces", "source", "settings", "warnings", "calibration", "driven", "jumps", "views"}
)
"""Fields of `MapGraph` that describe how a map was made: `TopoMap.info`."""


class MapDocument(Model):
    """`maps/<run>.json`."""

    model_config = ConfigDict(extra="allow", frozen=True, serialize_by_alias=True)

    # The alias keeps pydantic's own `schema` method free.
    schema_name: Literal["topobatch.map/1"] = Field(
        alias="schema", description="Name and version of this schema."
    )
    directed: Literal[False] = Field(description="For networkx: corridors lead both ways.")
    multigraph: Literal[True] = Field(description="For networkx: several may join two vertices.")
    graph: MapGraph = Field(description="Attributes of the map as a whole.")
    nodes: list[MapNode] = Field(description="The junctions, bends and dead ends.")
    edges: list[MapEdge] = Field(description="The corridors between them.")


M = TypeVar("M", bound=BaseModel)


WAY_OUT = {
    "map": "ingest its log again with --force",
    "merged": "topobatch merge --all",
    "locks": "move it away, and lock again",
    "discards": "move it away, and discard again",
    "sites": "move it away, and name the sites again",
}
"""What makes a document anew, by its kind."""


def with_way_out(error: DocumentError, kind: str, way: str | None = None) -> DocumentError:
    """The error with what makes a document of this kind anew, said once. way: in place of the usual
    one."""
    usual, text = WAY_OUT[kind], str(error)
    if usual in text:
        return DocumentError(text.replace(usual, way or usual))
    return DocumentError(f"{text} (to make it anew: {way or usual})")


def validated(model: type[M], doc: Any, name: str) -> M:
    """`doc` as the given model, or a DocumentError that names the place of the first fault, or what
    to do about a document of another version."""
    schema = model.model_fields.get("schema_name")
    if schema is not None and isinstance(doc, dict):
        (right,) = get_args(schema.annotation)
        _check_version(doc.get("schema"), right, name)
    try:
        return model.model_validate(doc)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = ".".join(str(part) for part in first["loc"]) or "document"
        more = f" (and {error.error_count() - 1} more)" if error.error_count() > 1 else ""
        raise DocumentError(f"{name}: {place}: {first['msg']}{more}") from error


def _check_version(found: Any, right: str, name: str) -> None:
    """DocumentError on a document of the same kind and another version, with the way out."""
    version = re.fullmatch(rf"{re.escape(right.rpartition('/')[0])}/([0-9]{{1,9}})", str(found))
    if version is None or found == right:
        return
    kind = right.partition(".")[2].partition("/")[0]
    newer = int(version[1]) > int(right.rpartition("/")[2])
    made = "a newer topobatch: install that" if newer else "an older topobatch: make it anew"
    raise DocumentError(
        f"{name}: is {found}, and this topobatch reads {right}; made by {made}"
        f"{', or make it anew' if newer else ''} ({WAY_OUT[kind]})"
    )
