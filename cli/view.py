"""`topobatch view`: open a recording in the rerun viewer."""

from __future__ import annotations

import os
import shlex
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

from ..topology.errors import DataError, UsageError
from .options import DEFAULT_WORKSPACE, WorkspaceOption, complete_run
from .output import say
from .workspace import Workspace, pair_named

ONE_RUN = "--with-log goes with one run: topobatch view RUN --with-log"


def view(
    run: Annotated[
        str | None,
        typer.Argument(
            metavar="RUN|A:B",
            help="Run whose map to open, the --output NAME of a merge, or two runs, for what "
            "topobatch explain found; the merged map without.",
            autocompletion=complete_run,
        ),
    ] = None,
    workspace: WorkspaceOption = DEFAULT_WORKSPACE,
    with_log: Annotated[
        bool,
        typer.Option(
            "--with-log", help="Open the raw log of the run beside its map (MCAP logs only)."
        ),
    ] = False,
) -> None:
    """Open the merged map, a run's, or the explanation of a pair, in the rerun viewer.

    Drag the time line below the map: a run's map grows as it was driven, a merged map as its runs
    were joined. With --with-log a page for every topic of the raw log stands beside it, at the same
    time: speeds, laser echoes, pictures, tables of messages.

    \b
      topobatch view
      topobatch view run1 --with-log
      topobatch explain run1 run2
      topobatch view run1:run2
    """
    place = Workspace(workspace)
    if with_log and run is None:
        raise UsageError(ONE_RUN)
    recording = _recording(place, run)
    if not with_log or run is None:
        _open([recording])
        return
    if recording != place.map_rrd(run):
        raise UsageError(ONE_RUN)
    with _raw_log(place, run, recording) as both:
        _open(both)


def _recording(place: Workspace, run: str | None) -> Path:
    """The recording to open; UsageError or DataError if there is none."""
    if run is None:
        if not place.merged_rrd.is_file():
            place.require_merge()
            raise DataError(f"{place.merged_rrd}: is not there; merge again")
        return place.merged_rrd
    if run in place.runs():
        recording = place.map_rrd(run)
        if not recording.is_file():
            raise DataError(f"{recording}: is not there; ingest the log of {run} again")
        return recording
    merge = place.merge_named(run)
    if merge is not None and merge.merged_rrd.is_file():
        return merge.merged_rrd
    if pair := pair_named(run, place.runs()):
        recording = place.explain_rrd(*pair)
        if not recording.is_file():
            raise DataError(f"{recording}: is not there; {place.call('explain', *pair)} makes it")
        return recording
    raise place.unknown([run], "run, merge or pair A:B named")


@contextmanager
def _raw_log(place: Workspace, run: str, recording: Path) -> Iterator[list[Path]]:
    """The recording of a run with its log, and the blueprint of both: in the workspace or, if that
    is not writable, in a temporary folder while the viewer is open."""
    from ..viz.raw_log import write_raw_log

    log = place.log_of(run)
    if not isinstance(log, Path):
        raise DataError(f"{log}: the viewer reads files only; copy the log here to look at it")
    topomap = place.read_map(run)
    with tempfile.TemporaryDirectory() as spare:
        both, views = place.raw_log_rrd(run), place.raw_log_views_rrd(run)
        try:
            write_raw_log(both, views, log, recording, topomap)
        except PermissionError:
            if not _has_display():
                raise
            both, views = (Path(spare) / file.name for file in (both, views))
            write_raw_log(both, views, log, recording, topomap)
        yield [views, both]


def _open(recordings: list[Path]) -> None:
    """Open recordings in the viewer, or print how to without a display."""
    if not _has_display():
        names = shlex.join(r.name for r in recordings)
        paths = shlex.join(map(str, recordings))
        say(f"{recordings[0]}: there is no display here. To look at it:")
        say(f"  on a machine with a screen:  rerun {names}   (pip install rerun-sdk)")
        say(f"  in a browser, served by this machine:  rerun --web-viewer {paths}")
        return
    import subprocess

    call = [sys.executable, "-m", "rerun", *map(str, recordings)]
    raise typer.Exit(subprocess.call(call))


def _has_display() -> bool:
    if sys.platform in ("darwin", "win32"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
