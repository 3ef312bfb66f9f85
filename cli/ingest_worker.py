"""`topobatch ingest` of one log."""

from __future__ import annotations

import hashlib
import json
import os
import re
import time
from collections.abc import Callable, Mapping, Sequence, Set
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

from pydantic import TypeAdapter, ValidationError

from ..ingest.logs.grids import GridLog
from ..ingest.mapping import map_of_log
from ..ingest.mapping_settings import MappingSettings
from ..ingest.reading import ReadSettings, log_fingerprint, log_size, read_log
from ..ingest.remote.path import LogPath, RemotePath
from ..topology.document import map_to_document
from ..topology.errors import DataError, DocumentError, TopobatchError, UsageError
from ..topology.files import read_json, write_json, write_together
from ..topology.made_from import describe_junctions, describe_unusual
from ..topology.odometry import Odometry
from ..topology.topomap import TopoMap
from ..topology.view_file import view_writes
from ..topology.wording import counted, to_turning_points
from .process import lack_of_memory
from .version import VERSION
from .workspace import Workspace, plain_name

MOST_NAMES = 16
"""Limit on successive renames of one run."""


@dataclass(frozen=True, slots=True)
class IngestJob:
    """One log to turn into a map, and its workspace."""

    log: LogPath
    run: str
    place: Workspace
    read: ReadSettings
    mapping: MappingSettings
    force: bool


@dataclass(frozen=True, slots=True)
class IngestOutcome:
    """The result of one log; `text` is a summary or the error."""

    run: str
    status: Literal["done", "unchanged", "failed"]
    text: str
    warnings: tuple[str, ...] = ()
    needs_option: bool = False
    """The log is valid, but an option is needed, for instance which topic."""
    maps: int = 1
    """Number of maps from the log."""
    details: tuple[str, ...] = ()
    """What was read and how, for --verbose."""
    size: tuple[float, int, int] = (0.0, 0, 0)
    """Length driven [m], numbers of junctions and of corridors."""


def job_size(job: IngestJob) -> int:
    """Bytes to read; 0 for a log that does not exist any more."""
    try:
        return log_size(job.log)
    except (TopobatchError, OSError):
        return 0  # reading it will say why


def ingest_one(job: IngestJob, on_bytes: Callable[[int], None]) -> IngestOutcome:
    """Read a log, build its map, write both files; errors become the outcome.

    `on_bytes` is called with the number of further bytes read.
    """
    try:
        return _ingest_one(job, on_bytes)
    except TopobatchError as error:
        asks = isinstance(error, UsageError)
        return IngestOutcome(job.run, "failed", str(error), needs_option=asks)
    except OSError as error:
        place = error.filename or job.log
        return IngestOutcome(job.run, "failed", f"{place}: {error.strerror or error}")
    except Exception as error:
        if os.environ.get("TOPOBATCH_DEBUG"):
            raise
        # What one log triggers must not stop the others.
        why = f"internal error, please report it: {type(error).__name__}: {error}"
        text = f"{job.log}: {lack_of_memory(error) or why}"
        return IngestOutcome(job.run, "failed", text)
    finally:
        if isinstance(job.log, RemotePath):
            job.log.forget()


def _ingest_one(job: IngestJob, on_bytes: Callable[[int], None]) -> IngestOutcome:
    started = time.monotonic()
    job = replace(job, run=called(job.place, job.run))
    content = log_fingerprint(job.log)
    key = _key(job, content)
    before = job.place.ingested(job.run) or {}
    had = _kept(job, key)
    if had:
        return IngestOutcome(job.run, "unchanged", "unchanged, kept", maps=len(had))
    found = read_log(job.log, job.read, on_bytes=on_bytes)
    found = found if found.name == job.run else replace(found, name=job.run)
    try:
        topomap = map_of_log(found, job.mapping)
    except DataError as error:
        raise DataError(f"{job.log}: {error}") from error
    if isinstance(found, GridLog):
        beside: dict[str, Any] = {"grid": found.grid}
    else:
        beside = {name: getattr(found, name) for name in ("odometry", "detections", "scanned")}
    from ..viz.map_recording import write_map_recording  # which loads rerun

    maps = _in_one_piece(topomap)
    runs = [m.run for m in maps]
    docs = {m.run: map_to_document(m) for m in maps}
    for name, doc in docs.items():
        _refuse_other_log(job, name, doc)
    writes: dict[Path, Callable[[Path], object]] = {}
    for m in maps:
        drawn = partial(write_map_recording, topomap=m, **beside)
        writes[job.place.map_rrd(m.run)] = drawn
        writes |= view_writes(job.place.map_json(m.run), m)
        writes[job.place.map_json(m.run)] = partial(write_json, doc=docs[m.run])
    write_together(writes)
    for m in maps:
        if not len(m.views):
            job.place.map_views(m.run).unlink(missing_ok=True)  # of a map that was replaced
    _clear_away(job.place, before, job.run, set(runs))
    # Written last: a run is finished only when all of its files exist.
    doc = {"key": key, "log": origin(job.log), "runs": runs, "read": asdict(job.read)}
    doc["content"] = content
    if seen := [m.run for m in maps if len(m.views)]:
        doc["views"] = seen
    # Of a log of several files the size of the one that is named, by which `list` goes.
    own = job.log.stat().st_size if isinstance(job.log, Path) and job.log.is_file() else None
    doc |= {"version": VERSION, "bytes": job_size(job) if own is None else own}
    record = partial(write_json, doc=doc)
    write_together({job.place.ingest_record(name): record for name in reversed(runs)})
    odometry = beside.get("odometry")
    text = f"{_summary(maps, odometry)} ({time.monotonic() - started:.1f} s)"
    if unusual := describe_unusual(maps[0].info):
        text += f"; {unusual}"
    told = maps[0].info.get("warnings", ())
    size = (
        0.0 if odometry is None else float(odometry.step_m.sum()),
        sum(map(len, maps)),
        sum(len(m.source) for m in maps),
    )
    return IngestOutcome(
        job.run, "done", text, tuple(told),
        maps=len(maps), details=_details(job, topomap), size=size,
    )  # fmt: skip


def _kept(job: IngestJob, key: str) -> list[str]:
    """The runs that the same log gave before with the same settings, if all files exist; else
    none."""
    before = job.place.ingested(job.run) or {}
    had = _runs_of(before, job.run)
    seen = before.get("views")
    files = [path(run) for run in had for path in (job.place.map_json, job.place.map_rrd)]
    files += [job.place.map_views(run) for run in had if isinstance(seen, list) and run in seen]
    there = all(file.is_file() and not file.is_symlink() for file in files)
    return had if there and not job.force and before.get("key") == key else []


def _details(job: IngestJob, topomap: TopoMap) -> tuple[str, ...]:
    """What was read, and the result of loop closure."""
    source = topomap.info.get("source", {})
    read = [
        f"{what}: {part['messages']:,} messages of {part['type']} on {part['topic']}"
        for what, part in source.items()
        if isinstance(part, dict) and {"messages", "type", "topic"} <= set(part)
    ]
    closed = sum(closure.accepted for closure in topomap.closures)
    closures = f"{closed} of {counted(len(topomap.closures), 'closure')} accepted"
    made_from = filter(None, [describe_junctions(topomap.info)])
    return (f"from {job.log}, {job_size(job):,} bytes", *read, closures, *made_from)


def _in_one_piece(topomap: TopoMap) -> tuple[TopoMap, ...]:
    """The map, or one map for each piece if the odometry broke and nothing connects the pieces."""
    if topomap.pieces < 2:
        return (topomap,)  # most runs: no need to load what merges
    from ..merge.pieces import joined_pieces

    return joined_pieces(topomap)


def read_again(record: Mapping[str, Any]) -> ReadSettings:
    """The settings by which the log of a run was read, from the record of its ingest, as far as
    that states them; damage does not matter any more."""
    try:
        known = TypeAdapter(ReadSettings).validate_python(record.get("read"))
    except (ValidationError, UsageError):
        return ReadSettings()
    return replace(known, strict=False)


def _clear_away(place: Workspace, before: dict[str, Any], run: str, kept: Set[str]) -> None:
    """Remove the maps of pieces that the log no longer gives."""
    for gone in set(_runs_of(before, run)) - kept:
        if (place.ingested(gone) or {}).get("log") == before.get("log"):
            made = (place.map_json(gone), place.map_views(gone), place.map_rrd(gone))
            for file in (*made, place.ingest_record(gone)):
                file.unlink(missing_ok=True)


def _summary(maps: Sequence[TopoMap], odometry: Odometry | None) -> str:
    visits = sum(len(m.observation_vertex) for m in maps)
    found = ", and ".join(
        f"{counted(len(m), 'junction')}, {counted(len(m.source), 'corridor')}"
        f"{to_turning_points(len(m.turning_points))}" + (f" ({m.run})" if len(maps) > 1 else "")
        for m in maps
    )
    if odometry is None:
        return found
    way = f"{odometry.step_m.sum():,.0f} m"
    return f"{way}, {counted(visits, 'junction pass', 'junction passes')} → {found}"


def _key(job: IngestJob, content: str) -> str:
    """A digest of the log's content (its fingerprint), the settings and the program."""
    parts = [VERSION, content, asdict(job.read), asdict(job.mapping)]
    text = json.dumps(parts, sort_keys=True, default=str)
    return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()


def called(place: Workspace, run: str) -> str:
    """The current name of a run after `topobatch rename`."""
    name = run
    for _ in range(MOST_NAMES):
        if place.map_json(name).is_file():
            return name
        name = (place.ingested(name) or {}).get("renamed", run)
        try:
            plain_name(name)
        except (UsageError, TypeError, AttributeError):
            return run  # nothing of ours wrote that
    return run


def _runs_of(record: dict[str, Any], run: str) -> list[str]:
    """The runs that a record's log gave: one, or one per piece of a broken odometry.

    Names that ingest cannot give are ignored: a record must not lead to other files.
    """
    runs, own = record.get("runs"), re.compile(re.escape(run) + "(#[0-9]{1,9})?")
    listed = runs if isinstance(runs, list) else []
    return [name for name in listed if isinstance(name, str) and own.fullmatch(name)]


def origin(log: LogPath) -> str:
    """The path of a log; bytes that are no text are escaped."""
    return str(log.resolve()).encode("utf-8", "backslashreplace").decode()


def _refuse_other_log(job: IngestJob, run: str, doc: dict[str, Any]) -> None:
    """Raise unless the run's existing map was made from this log: others are not overwritten
    without --force."""
    other, path = (job.place.ingested(run) or {}).get("log"), job.place.map_json(run)
    if job.force or not isinstance(other, str) or other == origin(job.log):
        return
    try:
        same = read_json(path) == doc
    except DocumentError:
        return  # nothing is lost: it is not there, or no map
    if not same:
        raise UsageError(
            f"{job.log}: the workspace has a run {run!r} already, made from {other}; "
            "give this one another --name, or replace the map with --force"
        )
