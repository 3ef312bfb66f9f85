"""`topobatch ingest`: logs in, one map per run out."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..topology.errors import UsageError
from ..topology.wording import counted, listed
from .journal import note
from .options import (
    DEFAULT_WORKSPACE,
    JsonOption,
    QuietOption,
    VerboseOption,
    WorkspaceOption,
    grouped,
)
from .output import Screen, say_lines
from .read_options import MapOptions, ReadOptions
from .settings_file import by_settings
from .workspace import Workspace, checked_run_name

if TYPE_CHECKING:
    from ..ingest.remote.path import LogPath
    from ..topology.errors import LogError
    from .ingest_worker import IngestJob, IngestOutcome

# A process takes about as long to start as reading this takes.
WORTH_A_PROCESS_BYTES = 32_000_000
WORTH_A_PROCESS_LOGS = 8


@grouped
def ingest(
    logs: Annotated[
        list[str],
        typer.Argument(
            metavar="LOG",
            help="Logs, or folders to search for logs; here, or elsewhere (s3://, gs://, az://, "
            "https://).",
        ),
    ],
    workspace: WorkspaceOption = DEFAULT_WORKSPACE,
    read: ReadOptions = ReadOptions(),  # noqa: B008 - frozen
    mapping: MapOptions = MapOptions(),  # noqa: B008 - frozen
    name: Annotated[
        str | None,
        typer.Option(
            metavar="RUN", help="Name of the run (one log only); default: the log's name."
        ),
    ] = None,
    jobs: Annotated[
        int,
        typer.Option(
            "--jobs", "-j", metavar="N", min=0, help="Logs read at once; 0: one per core."
        ),
    ] = 0,
    force: Annotated[
        bool, typer.Option("--force", help="Redo finished runs; replace maps made from other logs.")
    ] = False,
    strict: Annotated[
        bool,
        typer.Option(
            "--strict",
            help="Refuse damaged logs instead of salvaging what they hold, with a warning.",
        ),
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

    settings = read.settings(strict=strict)
    place, screen = Workspace(workspace), Screen(quiet or as_json, verbose)
    found, missing = read.logs(logs, screen.warn)
    planned = _plan(
        found, missing, name, IngestJob(Path(), "", place, settings, mapping.settings(), force)
    )
    with place.held(screen.warn):
        outcomes: list[IngestOutcome] = []
        try:
            _run_all(planned, jobs, screen, outcomes)
        except (KeyboardInterrupt, SystemExit):
            done = f"{len(outcomes)} of {counted(len(planned), 'log')} finished"
            screen.stopped(f"{done}; run again to go on")
            raise
        finally:
            new = sorted(outcome.run for outcome in outcomes if outcome.status == "done")
            if new:
                text = f"{counted(len(new), 'log')}: {listed(new)}"
                note(place, "ingest", f"{text}{by_settings(place)}", screen.warn)
    if as_json:
        fields = ("run", "status", "text", "maps", "warnings")
        say_lines(json.dumps([{name: getattr(o, name) for name in fields} for o in outcomes]))
    _summarise(outcomes, place, screen)
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
    from .run_names import run_names

    planned: list[IngestJob | IngestOutcome] = [
        IngestOutcome(path.name, "failed", str(error)) for path, error in missing
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
            like.place.check_run(checked_run_name(run))
            if run in used:
                raise UsageError(f"{used[run]} would become run {run!r} as well")
        except UsageError as error:
            text = f"{log}: {error}; give it another by --name"
            planned.append(IngestOutcome(log.name, "failed", text, needs_option=True))
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


def _workers(asked: int, logs: int, total_bytes: int) -> int:
    """Number of processes: as asked, or one per core as far as there is enough work."""
    enough = asked or max(total_bytes // WORTH_A_PROCESS_BYTES, logs // WORTH_A_PROCESS_LOGS)
    return max(1, min(asked or os.cpu_count() or 1, enough, logs))


def _run_all(
    planned: list[IngestJob | IngestOutcome],
    asked: int,
    screen: Screen,
    outcomes: list[IngestOutcome],
) -> None:
    """Run all jobs, in this process or in several; a line per finished log. Outcomes are added to
    the list as they are known."""
    from .ingest_pool import outcomes_of
    from .ingest_worker import IngestJob, IngestOutcome, job_size

    jobs = [entry for entry in planned if isinstance(entry, IngestJob)]
    outcomes += [entry for entry in planned if isinstance(entry, IngestOutcome)]
    for outcome in outcomes:
        _show(outcome, screen)
    sizes = {job.run: job_size(job) for job in jobs}
    total = sum(sizes.values())
    with screen.progress("ingesting", 2 * total) as advance:
        finished: list[str] = []
        so_far = 0

        def on_bytes(read: int) -> None:
            nonlocal so_far
            so_far = max(so_far, read)
            kept = sum(2 * sizes.get(o.run, 0) for o in outcomes if o.status == "unchanged")
            advance(*_done(so_far, finished, sizes), kept=kept)

        workers = _workers(asked, len(jobs), total)
        with closing(outcomes_of(jobs, workers, on_bytes)) as known:
            for outcome in known:
                outcomes.append(outcome)
                finished.append(outcome.run)
                on_bytes(0)
                _show(outcome, screen)


def _done(read: int, finished: Sequence[str], sizes: Mapping[str, int]) -> tuple[int, str]:
    """How much of twice the bytes is done, and in words: reading a log is half of the work, making
    its map the other half. read: bytes of all logs; finished: runs, also those that were not
    read."""
    total = sum(sizes.values())
    mapped = sum(sizes.get(run, 0) for run in finished)
    read = min(max(read, mapped), total)
    told = f"{len(finished)}/{len(sizes)} logs, {read / 1e6:,.0f} of {total / 1e6:,.0f} MB"
    return mapped + read, told


def _show(outcome: IngestOutcome, screen: Screen) -> None:
    if outcome.status == "failed":
        screen.complain(outcome.text)
        return
    screen.line(f"{outcome.run}: {outcome.text}")
    for detail in outcome.details:
        screen.detail(f"{outcome.run}: {detail}")
    for warning in outcome.warnings:
        screen.warn(f"{outcome.run}: {warning}")


def _summarise(outcomes: list[IngestOutcome], place: Workspace, screen: Screen) -> None:
    failed = sorted(outcome.run for outcome in outcomes if outcome.status == "failed")
    unchanged = sum(outcome.maps for outcome in outcomes if outcome.status == "unchanged")
    good = sum(outcome.maps for outcome in outcomes if outcome.status != "failed")
    done = [outcome.size for outcome in outcomes if outcome.status == "done"]
    if len(done) > 1:
        length_m = sum(length for length, _, _ in done)
        way = f", {length_m:,.0f} m" if length_m else ""
        junctions = counted(sum(number for _, number, _ in done), "junction")
        corridors = counted(sum(number for _, _, number in done), "corridor")
        screen.line(f"{counted(len(done), 'log')}{way} → {junctions}, {corridors}")
    if good:
        same = f" ({unchanged} unchanged)" if unchanged else ""
        logs = counted(len(outcomes), "log")
        told = f"{counted(good, 'map')} of {logs} in {place.maps}{same}"
        screen.line(f"{told}; next: {place.call('merge', '--all')}")
    if failed and len(outcomes) > 1:
        screen.complain(
            f"{len(failed)} of {counted(len(outcomes), 'log')} failed: {listed(failed)}"
        )
