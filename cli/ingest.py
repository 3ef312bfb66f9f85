"""`topobatch ingest`: logs in, one map per run out."""

from __future__ import annotations

import os
from collections.abc import Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..ingest.remote.path import LogPath
from ..topology.errors import LogError, UsageError
from ..topology.wording import counted, listed
from .journal import note
from .options import (
    Extra,
    Here,
    JsonOption,
    MapOptions,
    QuietOption,
    ReadOptions,
    VerboseOption,
    by_settings,
    verb,
)
from .output import complain, detail, megabytes, progress, say, say_json, show, tell, warn
from .run_logs import run_names
from .workspace import Workspace

if TYPE_CHECKING:  # what takes a second to load
    from .ingest_worker import IngestJob, IngestOutcome

WORTH_A_PROCESS_BYTES = 32_000_000
"""A process takes about as long to start as reading this takes."""


@verb
def ingest(
    context: typer.Context,
    logs: Annotated[
        list[str],
        "LOG",
        "Logs, or folders to search for logs; here, or elsewhere (s3://, gs://, az://, https://).",
    ],
    place: Here,
    read: ReadOptions,
    mapping: MapOptions,
    name: Annotated[
        str | None, "--name RUN", "Name of the run (one log only); default: the log's name."
    ] = None,
    jobs: Annotated[int, "--jobs -j N", "Logs read at once; 0: one per core.", Extra(min=0)] = 0,
    force: Annotated[
        bool, "--force", "Redo finished runs; replace maps made from other logs."
    ] = False,
    strict: Annotated[
        bool, "--strict", "Refuse damaged logs instead of salvaging what they hold, with a warning."
    ] = False,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
    verbose: VerboseOption = False,
) -> None:
    """Turn logs into topological maps, one per run.

    Writes maps/RUN.json and maps/RUN.rrd in the workspace; where the odometry was reset and nothing
    ties the pieces together, also RUN#2 and so on.

    Reads .mcap, .bag and ROS 2 bag folders, recognised by content; parts of a split recording are
    one. A run is named after its log, with - for colons; where several logs have one name, after
    their folders as well (robot1-run01). It keeps its name. Without junction detections, junctions
    are found in laser scans, clouds of points or a grid. Finished runs are skipped unless their log
    or the settings changed. One bad log does not stop the others; the exit code is then 1, or 2 if
    all that is wrong is a missing option.

    Of a log in a bucket (s3://bucket/prefix/), the index and the chunks that hold wanted topics are
    read, and nothing is copied here; needs topobatch[remote].

    \b
      topobatch ingest run1.mcap run2.bag rosbag2_folder/
      topobatch ingest logs/ --odometry-topic /odom --workspace ws
    """
    from .ingest_worker import IngestJob

    show(quiet=quiet or as_json, verbose=verbose)
    settings = read.settings(strict=strict)
    found, missing = read.logs(logs)
    like = IngestJob(Path(), "", place, settings, mapping.settings(), force)
    planned = _plan(found, missing, name, like)
    with place.held(make=True):
        outcomes: list[IngestOutcome] = []
        try:
            _run_all(planned, jobs, outcomes)
        except (KeyboardInterrupt, SystemExit):
            tell(f"{len(outcomes)} of {counted(len(planned), 'log')} finished; run again to go on")
            raise
        finally:
            new = sorted(outcome.run for outcome in outcomes if outcome.status == "done")
            if new:
                text = f"{counted(len(new), 'log')}: {listed(new)}"
                note(place, "ingest", f"{text}{by_settings(context, place)}")
    if as_json:
        fields = ("run", "status", "text", "maps", "warnings")
        say_json([{name: getattr(o, name) for name in fields} for o in outcomes])
    _summarise(outcomes, place)
    failed = [outcome for outcome in outcomes if outcome.status == "failed"]
    if failed:
        raise typer.Exit(2 if all(outcome.needs_option for outcome in failed) else 1)


def _plan(
    logs: Sequence[LogPath],
    missing: Sequence[tuple[LogPath, LogError]],
    name: str | None,
    like: IngestJob,
) -> list[IngestJob | IngestOutcome]:
    """A job for each log, with the settings of one, or its outcome if it is known already.

    missing: paths without logs, and why.
    """
    from .ingest_worker import IngestOutcome

    planned: list[IngestJob | IngestOutcome] = [
        IngestOutcome(path.name, "failed", str(error), maps=0) for path, error in missing
    ]
    if name is not None and len(logs) + len(planned) != 1:
        raise UsageError(f"--name goes with one log; found {len(logs) + len(planned)}")
    # Of several ways to one log, the first counts.
    logs = list({_at(log): log for log in reversed(logs)}.values())[::-1]
    names = dict.fromkeys(logs, name) if name is not None else {}
    names = names or run_names(logs, like.place, replace=like.force)
    used: dict[str, LogPath] = {}
    for log, run in names.items():
        try:
            like.place.check_run(run)
            if run in used:
                raise UsageError(f"{used[run]} would become run {run!r} as well")
        except UsageError as error:
            text = f"{log}: {error}; give it another by --name"
            planned.append(IngestOutcome(log.name, "failed", text, needs_option=True, maps=0))
            continue
        used[run] = log
        planned.append(replace(like, log=log, run=run))
    return planned


def _at(log: LogPath) -> LogPath:
    """The log's path with links resolved."""
    try:
        return log.resolve()
    except (OSError, RuntimeError):  # links in a circle, of which reading will tell
        return log


def _run_all(
    planned: list[IngestJob | IngestOutcome], jobs_at_once: int, outcomes: list[IngestOutcome]
) -> None:
    """Run all jobs, in this process or in several; a line per finished log. Outcomes are added to
    the list as they are known."""
    from .ingest_worker import IngestJob, IngestOutcome, job_size, outcomes_of

    jobs = [entry for entry in planned if isinstance(entry, IngestJob)]
    outcomes += [entry for entry in planned if isinstance(entry, IngestOutcome)]
    for outcome in outcomes:
        _show(outcome)
    sizes = {job.run: job_size(job) for job in jobs}
    total = sum(sizes.values())
    worth = min(os.cpu_count() or 1, total // WORTH_A_PROCESS_BYTES)
    workers = max(1, min(jobs_at_once or worth, len(jobs)))
    # Reading a log is half of the work, making its map the other half.
    with progress("ingesting", 2 * total) as advance:
        read = finished = mapped = kept = 0

        def on_bytes(so_far: int) -> None:
            nonlocal read
            read = max(read, so_far)
            found = min(max(kept + read, mapped), total)
            done = f"{megabytes(found)} of {megabytes(total)} MB"
            advance(found + mapped, f"{finished}/{len(jobs)} logs, {done}", kept=2 * kept)

        with closing(outcomes_of(jobs, workers, on_bytes)) as known:
            for outcome in known:
                outcomes.append(outcome)
                finished += 1
                mapped += sizes[outcome.run]
                kept += sizes[outcome.run] if outcome.status == "unchanged" else 0
                on_bytes(0)
                _show(outcome)


def _show(outcome: IngestOutcome) -> None:
    if outcome.status == "failed":
        complain(outcome.text)
        return
    say(f"{outcome.run}: {outcome.text}")
    for each in outcome.details:
        detail(f"{outcome.run}: {each}")
    for warning in outcome.warnings:
        warn(f"{outcome.run}: {warning}")


def _summarise(outcomes: list[IngestOutcome], place: Workspace) -> None:
    failed = sorted(outcome.run for outcome in outcomes if outcome.status == "failed")
    unchanged = sum(outcome.maps for outcome in outcomes if outcome.status == "unchanged")
    good = sum(outcome.maps for outcome in outcomes)
    done = [outcome.size for outcome in outcomes if outcome.status == "done"]
    logs = counted(len(outcomes), "log")
    if len(done) > 1:
        length_m, junctions, corridors = map(sum, zip(*done, strict=True))
        way = f", {length_m:,.0f} m" if length_m else ""
        found = f"{counted(junctions, 'junction')}, {counted(corridors, 'corridor')}"
        say(f"{counted(len(done), 'log')}{way} → {found}")
    if good:
        same = f" ({unchanged} unchanged)" if unchanged else ""
        maps = f"{counted(good, 'map')} of {logs} in {place.maps}{same}"
        say(f"{maps}; next: {place.call('merge', '--all')}")
    if failed and len(outcomes) > 1:
        complain(f"{len(failed)} of {logs} failed: {listed(failed)}")
