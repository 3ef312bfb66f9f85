"""`topobatch ingest` of one log, and of many in several processes."""

from __future__ import annotations

import hashlib
import json
import os
import time
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, wait
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

from ..ingest.logs.grids import GridLog
from ..ingest.mapping import map_of_log
from ..ingest.mapping_settings import MappingSettings
from ..ingest.reading import ReadSettings, log_fingerprint, log_size, read_log
from ..ingest.remote.path import LogPath, RemotePath
from ..topology.document import map_to_document
from ..topology.errors import DataError, TopobatchError, UsageError
from ..topology.files import write_json, write_together
from ..topology.made_from import describe_junctions, describe_unusual
from ..topology.odometry import Odometry
from ..topology.topomap import TopoMap
from ..topology.view_file import view_writes
from ..topology.wording import counted, to_turning_points
from .ingest_record import IngestRecord, origin
from .output import counting
from .process import forking_server, lack_of_memory, processes
from .version import VERSION
from .workspace import Workspace

POLL_S = 0.1
"""Between looks how far the processes have read: ten a second move a bar smoothly."""


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


def outcomes_of(
    jobs: Sequence[IngestJob], workers: int, advance: Callable[[int], None]
) -> Generator[IngestOutcome, None, None]:
    """Outcomes as they are completed, in this process or in several; `advance` is called with the
    bytes read so far over all logs."""
    if workers == 1:
        on_bytes = counting(advance)
        yield from (ingest_one(job, on_bytes) for job in jobs)
        return
    left = [*jobs]
    yield from _side_by_side(left, workers, advance)
    # Where a process was killed, it ended the others: one by one each has all memory for itself.
    for job in [*left]:
        alone = [job]
        yield from _side_by_side(alone, 1, advance)
        if alone:
            text = f"{job.log}: the process that read it was killed (out of memory?)"
            yield IngestOutcome(job.run, "failed", text, maps=0)


def _side_by_side(
    left: list[IngestJob], workers: int, advance: Callable[[int], None]
) -> Iterator[IngestOutcome]:
    """Outcomes of jobs, which are taken from the list; those that a killed process ended stay."""
    context = forking_server(__name__, "rerun")
    read = context.Value("q")
    with processes(workers, context, _share, read) as pool:
        waiting = {pool.submit(_ingest, job): job for job in left}
        while waiting:
            done, _ = wait(waiting, POLL_S, FIRST_COMPLETED)
            advance(read.value)
            for future in done:
                job = waiting.pop(future)
                if not isinstance(future.exception(), BrokenExecutor):
                    left.remove(job)
                    yield future.result()


_shared: list[Any] = []
"""In a process of its own: the number of bytes read by all of them."""


def _share(read: Any) -> None:
    _shared.append(read)


def _ingest(job: IngestJob) -> IngestOutcome:
    """`ingest_one` in a process of its own."""
    (read,) = _shared

    def on_bytes(more: int) -> None:
        with read.get_lock():
            read.value += more

    return ingest_one(job, on_bytes)


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
    failed = partial(IngestOutcome, job.run, "failed", maps=0)
    try:
        return _ingest_one(job, on_bytes)
    except TopobatchError as error:
        return failed(str(error), needs_option=isinstance(error, UsageError))
    except OSError as error:
        return failed(f"{error.filename or job.log}: {error.strerror or error}")
    except Exception as error:
        if os.environ.get("TOPOBATCH_DEBUG"):
            raise
        # What one log triggers must not stop the others.
        why = f"internal error, please report it: {type(error).__name__}: {error}"
        return failed(f"{job.log}: {lack_of_memory(error) or why}")
    finally:
        if isinstance(job.log, RemotePath):
            job.log.forget()


def _ingest_one(job: IngestJob, on_bytes: Callable[[int], None]) -> IngestOutcome:
    started, place = time.monotonic(), job.place
    content, before = log_fingerprint(job.log), place.ingested(job.run)
    parts = [VERSION, content, asdict(job.read), asdict(job.mapping)]
    text = json.dumps(parts, sort_keys=True, default=str)
    key = hashlib.blake2b(text.encode(), digest_size=16).hexdigest()
    if not job.force and before.key == key and _whole(place, before, job.run):
        pieces = before.pieces(job.run)
        if before.log != origin(job.log):  # it was moved
            _write_record(place, replace(before, log=origin(job.log)), pieces)
        return IngestOutcome(job.run, "unchanged", "unchanged, kept", maps=len(pieces))
    found = replace(read_log(job.log, job.read, on_bytes=on_bytes), name=job.run)
    try:
        topomap = map_of_log(found, job.mapping)
    except DataError as error:
        raise DataError(f"{job.log}: {error}") from error
    maps: tuple[TopoMap, ...] = (topomap,)
    if topomap.pieces > 1:  # few runs: the others need not load what merges
        from ..merge.pieces import joined_pieces

        maps = joined_pieces(topomap)
    if isinstance(found, GridLog):
        odometry, drawn = None, {"grid": found.grid}
    else:
        odometry = found.odometry
        drawn = {name: getattr(found, name) for name in ("odometry", "detections", "scanned")}
    _write(job, maps, drawn)
    runs = [m.run for m in maps]
    for gone in set(before.pieces(job.run)) - set(runs):
        if place.ingested(gone).log == before.log:
            place.remove_run(gone)
    # Of several files that of the one that is named, by which `list` tells that a log changed.
    named = isinstance(job.log, Path) and job.log.is_file()
    size = job.log.stat().st_size if named else job_size(job)
    # Written last: a run is finished only when all of its files exist.
    record = IngestRecord(
        log=origin(job.log),
        content=content,
        key=key,
        bytes=size,
        read=asdict(job.read),
        version=VERSION,
        runs=runs,
        views=[m.run for m in maps if len(m.views)],
    )
    _write_record(place, record, runs)
    text = f"{_summary(maps, odometry)} ({time.monotonic() - started:.1f} s)"
    if unusual := describe_unusual(maps[0].info):
        text += f"; {unusual}"
    length_m = 0.0 if odometry is None else float(odometry.step_m.sum())
    return IngestOutcome(
        job.run,
        "done",
        text,
        tuple(maps[0].info.get("warnings", ())),
        maps=len(maps),
        details=_details(job, topomap),
        size=(length_m, sum(map(len, maps)), sum(len(m.source) for m in maps)),
    )


def _write_record(place: Workspace, record: IngestRecord, runs: Sequence[str]) -> None:
    """Write the record of a log for the runs that it gave: for the first of them last."""
    write = partial(write_json, doc=asdict(record))
    write_together({place.ingest_record(run): write for run in reversed(runs)})


def _whole(place: Workspace, record: IngestRecord, run: str) -> bool:
    """Whether all files are there that a run's log gave."""
    runs = record.pieces(run)
    files = [path(each) for each in runs for path in (place.map_json, place.map_rrd)]
    files += [place.map_views(each) for each in runs if each in record.views]
    return bool(runs) and all(file.is_file() and not file.is_symlink() for file in files)


def _write(job: IngestJob, maps: Sequence[TopoMap], drawn: Mapping[str, Any]) -> None:
    """Write the maps of a log with their views and recordings, all or none. drawn: what else the
    recordings show."""
    from ..viz.map_recording import write_map_recording  # which loads rerun

    place = job.place
    writes: dict[Path, Callable[[Path], object]] = {}
    for m in maps:
        _refuse_other_log(job, m.run)
        writes[place.map_rrd(m.run)] = partial(write_map_recording, topomap=m, **drawn)
        writes |= view_writes(place.map_json(m.run), m)
        writes[place.map_json(m.run)] = partial(write_json, doc=map_to_document(m))
    write_together(writes)
    for m in maps:
        if not len(m.views):
            place.map_views(m.run).unlink(missing_ok=True)  # of a map that was replaced


def _refuse_other_log(job: IngestJob, run: str) -> None:
    """Raise unless the run's existing map was made from this log: others are not overwritten
    without --force."""
    other = job.place.ingested(run).log
    if job.force or other in (None, origin(job.log)):
        return
    if job.place.map_json(run).exists():
        raise UsageError(
            f"{job.log}: the workspace has a run {run!r} already, made from {other}; "
            "give this one another --name, or replace the map with --force"
        )


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
