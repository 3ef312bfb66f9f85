"""The map document, `maps/<run>.json`: schema `topobatch.map/1`.

The pydantic models are the schema: they validate what is read, write what is saved, and publish
the JSON Schema. Documents are deterministic (same map, same bytes) and load with
`networkx.node_link_graph(doc, edges="edges")`.
"""

from __future__ import annotations

import json
import os
import re
import stat
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, model_validator
from pydantic_core import from_json

from .digits import BITS, BRANCH, METRES, rounded, significant
from .errors import DocumentError
from .passes import NO_BRANCH
from .ragged import Ragged
from .topomap import Closure, RunNoise, TopoMap

MAP_SCHEMA: Literal["topobatch.map/1"] = "topobatch.map/1"

FARTHEST_M = 1e9
"""Where a vertex can lie: logs are believed as far. Eastings with a zone in front reach 6e7."""

LONGEST_M = 1e5
LONGEST_TOGETHER_M = 1e6
"""A corridor, and all of a map, can be no longer: merging looks at a corridor every 0.25 m, and
takes 60 MB for 100 km."""

MOST_BRANCHES = 64
"""At one junction. Ingest holds branches closer than 0.3 rad for one, which leaves 20 at most."""

LARGEST_BYTES = 1 << 30
"""A document can be no larger: one junction with its corridors takes about 1 kB."""

LEFT_OVER = re.compile(r"\.topobatch-\w{8}\.tmp")
"""Names of the files that `write_atomically` fills; only a process that was killed leaves any."""

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


class Observation(Model):
    """One pass of a robot by a vertex."""

    run: str = Field(description="The run that passed.")
    time_ns: Nanoseconds = Field(
        description="When the robot was nearest to the centre: nanoseconds since 1970, by the "
        "clock of the log."
    )


class MapNode(Model):
    """A vertex of a map."""

    id: Index = Field(description="0, 1, 2, … in the order of the list.")
    x: Metres = Field(description="Position in the map's frame, metres.")
    y: Metres = Field(description="Position in the map's frame, metres.")
    kind: str = Field(description="junction, dead_end (one branch) or bend (two, not opposite).")
    branches: list[Finite] = Field(
        max_length=MOST_BRANCHES,
        description="Direction in which each branch leaves, driven or only seen: radians in the "
        "map's frame, ascending in [-π, π).",
    )
    observations: list[Observation] = Field(description="The passes of the robot, by time.")
    sigma_m: Noise | None = Field(
        None,
        description="1 sigma of each coordinate, metres, with the map as a whole laid over the "
        "truth; absent where it is not known.",
    )
    branch_sigmas: list[Noise] | None = Field(
        None, description="1 sigma of each branch's direction, radians, likewise."
    )

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
        "earlier one. Standing and turning round at the ends is not counted. Absent where unknown.",
    )


class ClosureRecord(Model):
    """An identification that was made, refused, or taken back.

    round: of the loop closure, from 1 on; accepted_round: in which it had been accepted, where this
    takes it back; revised: a later round answered otherwise.
    """

    time_ns: tuple[Nanoseconds, Nanoseconds] = Field(
        description="Times of the two passes that were asked to be one place."
    )
    accepted: bool = Field(description="Whether they were taken for one place.")
    bits: Finite = Field(description="Evidence: log2 of the odds that they are one place.")
    reason: str = Field(description="The answer in words.")
    round: Index | None = Field(None, description="Round of the loop closure, from 1 on.")
    accepted_round: Index | None = Field(
        None, description="Round in which it had been accepted, where this takes it back."
    )
    revised: bool = Field(False, description="A later round answered otherwise.")


class MapGraph(Model):
    """Attributes of a whole map."""

    run: str = Field(description="Name of the run, unique in a workspace.")
    frame: str = Field(description="Frame of the odometry; the map's own frame is called the same.")
    pieces: int = Field(
        1,
        ge=1,
        description="Parts of which nothing tells how they lie to each other; they are drawn side "
        "by side.",
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


def _as_false(value: Any) -> Any:
    if value is not False:
        raise ValueError("must be false")
    return value


def _as_true(value: Any) -> Any:
    if value is not True:
        raise ValueError("must be true")
    return value


Undirected = Annotated[Literal[False], BeforeValidator(_as_false)]
Multigraph = Annotated[Literal[True], BeforeValidator(_as_true)]


class MapDocument(Model):
    """`maps/<run>.json`."""

    model_config = ConfigDict(extra="allow", frozen=True, serialize_by_alias=True)

    # The alias keeps pydantic's own `schema` method free.
    schema_name: Literal["topobatch.map/1"] = Field(
        alias="schema", description="Name and version of this schema."
    )
    directed: Undirected = Field(description="For networkx: corridors lead both ways.")
    multigraph: Multigraph = Field(description="For networkx: several may join two vertices.")
    graph: MapGraph = Field(description="What is said of the map as a whole.")
    nodes: list[MapNode] = Field(description="The junctions, bends and dead ends.")
    edges: list[MapEdge] = Field(description="The corridors between them.")


def edge_keys(source: NDArray[np.int64], target: NDArray[np.int64]) -> list[int]:
    """The `key` of every edge: its number among the edges that join the same two vertices."""
    seen: dict[tuple[int, int], int] = {}
    keys = []
    for u, v in zip(source.tolist(), target.tolist(), strict=True):
        pair = (min(u, v), max(u, v))
        keys.append(seen.get(pair, 0))
        seen[pair] = keys[-1] + 1
    return keys


def map_to_document(topomap: TopoMap) -> dict[str, Any]:
    """The node-link dict of a map, ready for `json`; inverse of `map_from_document`."""
    observations: list[list[dict[str, Any]]] = [[] for _ in range(len(topomap))]
    for vertex, time_ns in zip(
        topomap.observation_vertex.tolist(), topomap.observation_time_ns.tolist(), strict=True
    ):
        observations[vertex].append({"run": topomap.run, "time_ns": time_ns})
    xy = rounded(topomap.xy, METRES)
    graph: dict[str, Any] = {"run": topomap.run, "frame": topomap.frame}
    graph |= {k: v for k, v in sorted(topomap.info.items()) if k not in graph}
    names = RunNoise.__dataclass_fields__
    graph["noise"] = {name: significant(getattr(topomap.noise, name)) for name in names}
    if topomap.fitted_noise is not None:
        graph["fitted_noise"] = {
            name: significant(getattr(topomap.fitted_noise, name)) for name in names
        }
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
                **_node_sigmas(topomap, i),
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


def _node_sigmas(topomap: TopoMap, vertex: int) -> dict[str, Any]:
    """What is known of the errors of a vertex; nothing for maps that were not made from a run."""
    out: dict[str, Any] = {}
    if topomap.position_sigma is not None:
        out["sigma_m"] = significant(float(topomap.position_sigma[vertex]))
    if topomap.branch_sigma is not None:
        out["branch_sigmas"] = [significant(s) for s in topomap.branch_sigma[vertex].tolist()]
    return out


def edges_to_document(graph: Any) -> list[dict[str, Any]]:
    """The `edges` of a document, from anything that has the edge arrays of a TopoMap."""

    def branch(index: int) -> int | None:
        return None if index == NO_BRANCH else index

    keys = edge_keys(graph.source, graph.target)
    length = rounded(np.maximum(graph.length, SHORTEST_M), METRES)
    times = getattr(graph, "traversal_ns", None)
    return [
        {
            "source": int(graph.source[i]),
            "target": int(graph.target[i]),
            "key": keys[i],
            "length": length[i],
            "length_sigma": significant(max(float(graph.length_sigma[i]), SHORTEST_M)),
            "source_branch": branch(int(graph.source_branch[i])),
            "target_branch": branch(int(graph.target_branch[i])),
            "path": rounded(graph.paths[i], METRES),
            "traversals": int(graph.traversals[i]),
            **({} if times is None else {"traversal_ns": times[i].tolist()}),
        }
        for i in range(len(keys))
    ]


def map_from_document(doc: Any, name: str = "map document") -> TopoMap:
    """The map that a parsed document describes; `name` (a path) appears in errors.

    Raises DocumentError with the place of the first fault if the schema is not followed.
    """
    d = validated(MapDocument, doc, name)
    if [node.id for node in d.nodes] != list(range(len(d.nodes))):
        raise DocumentError(f"{name}: node ids must be 0, 1, 2, … in order")
    seen = sorted((o.time_ns, node.id) for node in d.nodes for o in node.observations)
    known = set(MapGraph.model_fields) - {"pieces"}
    info = {k: v for k, v in d.graph.model_dump(exclude_unset=True).items() if k not in known}
    noise, fitted = _noise(d.graph.noise), d.graph.fitted_noise
    paths = tuple(np.array(e.path) for e in d.edges)
    lengths = [np.hypot(*np.diff(path, axis=0).T).sum() for path in paths]
    for k, length in enumerate(lengths):
        if length > LONGEST_M:
            raise DocumentError(f"{name}: edges.{k}.path: is longer than {LONGEST_M / 1000:.0f} km")
    if sum(lengths) > LONGEST_TOGETHER_M:
        most = f"{LONGEST_TOGETHER_M / 1000:.0f} km"
        raise DocumentError(f"{name}: edges: all paths together are longer than {most}")

    def branches(name: str) -> list[int]:
        found = (getattr(edge, name) for edge in d.edges)
        return [NO_BRANCH if branch is None else branch for branch in found]

    try:
        return TopoMap(
            run=d.graph.run,
            frame=d.graph.frame,
            xy=np.array([(node.x, node.y) for node in d.nodes]).reshape(-1, 2),
            branches=Ragged.from_rows(node.branches for node in d.nodes),
            kind=tuple(node.kind for node in d.nodes),
            source=np.array([e.source for e in d.edges], np.int64),
            target=np.array([e.target for e in d.edges], np.int64),
            source_branch=np.array(branches("source_branch"), np.int64),
            target_branch=np.array(branches("target_branch"), np.int64),
            length=np.array([e.length for e in d.edges], np.float64),
            length_sigma=np.array([e.length_sigma for e in d.edges], np.float64),
            traversals=np.array([e.traversals for e in d.edges], np.int64),
            paths=paths,
            observation_vertex=np.array([v for _, v in seen], np.int64),
            observation_time_ns=np.array([t for t, _ in seen], np.int64),
            noise=noise,
            fitted_noise=None if fitted is None else _noise(fitted),
            position_sigma=_all_known([node.sigma_m for node in d.nodes]),
            branch_sigma=_rows_known([node.branch_sigmas for node in d.nodes]),
            traversal_ns=_times_known([edge.traversal_ns for edge in d.edges]),
            closures=tuple(
                Closure(
                    *c.time_ns,
                    accepted=c.accepted,
                    bits=c.bits,
                    reason=c.reason,
                    round=c.round,
                    accepted_round=c.accepted_round,
                    revised=c.revised,
                )
                for c in d.graph.closures
            ),
            info=info,
        )
    except ValueError as error:
        raise DocumentError(f"{name}: {error}") from error


def _noise(values: dict[str, float]) -> RunNoise:
    return RunNoise(**{k: v for k, v in values.items() if k in RunNoise.__dataclass_fields__})


def _all_known(values: Sequence[float | None]) -> NDArray[np.float64] | None:
    known = [v for v in values if v is not None]
    return np.array(known) if known and len(known) == len(values) else None


def _rows_known(rows: Sequence[list[float] | None]) -> Ragged | None:
    known = [row for row in rows if row is not None]
    return Ragged.from_rows(known) if known and len(known) == len(rows) else None


def _times_known(
    rows: Sequence[list[tuple[int, int]] | None],
) -> tuple[NDArray[np.int64], ...] | None:
    known = [np.array(row, np.int64).reshape(-1, 2) for row in rows if row is not None]
    return tuple(known) if known and len(known) == len(rows) else None


M = TypeVar("M", bound=BaseModel)


def validated(model: type[M], doc: Any, name: str) -> M:
    """`doc` as the given model, or a DocumentError that names the place of the first fault."""
    try:
        return model.model_validate(doc)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = ".".join(str(part) for part in first["loc"]) or "document"
        more = f" (and {error.error_count() - 1} more)" if error.error_count() > 1 else ""
        raise DocumentError(f"{name}: {place}: {first['msg']}{more}") from error


def read_json(path: Path) -> Any:
    """A parsed JSON file, or a DocumentError that names it.

    Refused are files that are none (links, FIFOs, devices), implausibly long ones, nesting deeper
    than 200, text that is no UTF-8 or holds halves of characters, numbers that are none.
    """
    try:
        return from_json(read_bytes(path), allow_inf_nan=False)
    except OSError as error:
        raise DocumentError(f"{path}: cannot be read: {error.strerror or error}") from error
    except ValueError as error:
        raise DocumentError(f"{path}: is not JSON: {error}") from error


def read_bytes(path: Path) -> bytes:
    """The bytes of a document; nothing that could block or act on being opened is opened. Raises
    DocumentError on what is no file, OSError where it cannot be read."""
    if not stat.S_ISREG(os.lstat(path).st_mode):
        raise DocumentError(f"{path}: is a {kind_of(path)}, not a document; remove it")
    # Whoever puts something else there meanwhile is refused as well.
    flags = os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
    with open(os.open(path, flags | getattr(os, "O_BINARY", 0)), "rb") as file:
        if os.fstat(file.fileno()).st_size > LARGEST_BYTES:
            raise DocumentError(f"{path}: is larger than {LARGEST_BYTES >> 30} GiB")
        return file.read()


def kind_of(path: Path) -> str:
    """What lies at a path, in a word."""
    mode = os.lstat(path).st_mode
    kinds = {stat.S_IFREG: "file", stat.S_IFDIR: "folder", stat.S_IFLNK: "link"}
    return kinds.get(stat.S_IFMT(mode), "FIFO, a device or a socket")


def read_map(path: Path) -> TopoMap:
    """The map of a `maps/<run>.json`; DocumentError if it cannot be read or is no such document."""
    return map_from_document(read_json(path), str(path))


def write_json(path: Path, doc: Any) -> None:
    """Write a document atomically: after a crash the old file or the new one is there, whole."""
    text = json.dumps(doc, separators=(",", ":"), allow_nan=False, ensure_ascii=False)
    write_atomically(path, lambda temporary: temporary.write_text(text + "\n", encoding="utf-8"))


def write_atomically(path: Path, write: Callable[[Path], object]) -> None:
    """Let `write` fill a temporary file beside `path`, then move it there in one step."""
    write_together({path: write})


def write_together(writes: Mapping[Path, Callable[[Path], object]]) -> None:
    """Write files that belong together: all are filled before the first is moved to its place.

    Where one cannot be written (a full disk), none is. They are moved in their order.
    """
    with ExitStack() as stack:
        filled = {}
        for path, write in writes.items():
            with _named(path):
                filled[path] = stack.enter_context(_temporary(path.parent))
                write(filled[path])
                filled[path].chmod(0o666 & ~_umask())
        for path, temporary in filled.items():
            with _named(path):
                os.replace(temporary, path)


@contextmanager
def _temporary(folder: Path) -> Iterator[Path]:
    """An empty file, which is gone afterwards unless it was moved."""
    folder.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(prefix=".topobatch-", suffix=".tmp", dir=folder)
    os.close(handle)
    try:
        yield Path(name)
    finally:
        Path(name).unlink(missing_ok=True)


@contextmanager
def _named(path: Path) -> Iterator[None]:
    """Errors name the file that was to be written, and not what stood for it meanwhile."""
    try:
        yield
    except OSError as error:
        name = error.filename
        if name is None or LEFT_OVER.fullmatch(Path(os.fsdecode(name)).name):
            error.filename = str(path)
            error.filename2 = None
        raise


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def write_map(path: Path, topomap: TopoMap) -> None:
    """Write `maps/<run>.json`."""
    write_json(path, map_to_document(topomap))
