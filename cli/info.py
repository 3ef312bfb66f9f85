"""`topobatch info`: what a log holds and what ingest would use of it."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..topology.errors import DataError, LogError, UsageError
from ..topology.wording import counted, utc
from .options import DEFAULT_WORKSPACE, JsonOption, WorkspaceOption, grouped
from .output import Screen, complain, say, say_lines, table, warn
from .read_options import ReadOptions
from .settings_file import settings_of, told_settings
from .workspace import Workspace

if TYPE_CHECKING:
    from ..ingest.reading import LogInfo, ReadSettings
    from ..ingest.remote.path import LogPath

WHOLE_BYTES = 64_000_000
"""Logs up to this size are read whole, without their scans: a fraction of a second."""


@grouped
def info(
    logs: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="LOG",
            help="MCAP files, ROS 1 bags, ROS 2 bag folders, or folders of logs; here, or "
            "elsewhere (s3://, gs://, az://, https://). Without any, the workspace's settings.",
        ),
    ] = None,
    read: ReadOptions = ReadOptions(),  # noqa: B008 - frozen
    try_all: Annotated[
        bool,
        typer.Option(
            "--try",
            help="Read logs as ingest does, whatever their size, and match their scans: takes as "
            "long as ingest.",
        ),
    ] = False,
    as_json: JsonOption = False,
    workspace: WorkspaceOption = DEFAULT_WORKSPACE,
) -> None:
    """Show what logs hold and what ingest would use.

    Their topics, types and counts, how long they are, which topics would be used and why. Exits
    with 1 if a log is damaged, if ingest could not use its topics, or if it would refuse what they
    hold. For that, logs of up to 64 MB on this machine are read whole, except for scans and clouds:
    --try reads these as well, and tells where no junction shows in them. Of others that have an
    index only the index is read. A line says what is usable. Options about reading are those of
    ingest, also those that the workspace remembers (topobatch init), which are shown first.

    \b
      topobatch info run1.mcap
      topobatch info logs/ --json
    """
    from ..ingest.reading import inspect_log
    from .run_names import run_names

    settings, place = read.settings(), Workspace(workspace)
    if (remembered := settings_of(place)) and not as_json:
        say(f"{place.settings_toml}: {told_settings(remembered)}")
    if not logs and not remembered:
        raise UsageError("name a log: topobatch info LOG")
    known, missing = read.logs(logs or (), warn)
    for _, error in missing:
        complain(str(error))
    failed, told = bool(missing), []
    for each, run in run_names(known).items():
        try:
            found = replace(inspect_log(each, settings), name=run)
        except LogError as error:
            complain(str(error))
            failed = True
            continue
        how = _trial(found, settings, try_all)
        if how is not None:
            found = _tried(found, each, replace(how, strict=not found.problems))
        if as_json:
            told.append(_as_json(found))
        else:
            for line in described(found):
                say(line)
            _show_faults(found, tried=how is not None)
        failed |= bool(found.problems)
    if as_json:
        say_lines(json.dumps(told))
    if failed:
        raise typer.Exit(1)


def _as_json(found: LogInfo) -> dict[str, Any]:
    """The content of `described` as JSON values."""
    path = str(found.path).encode("utf-8", "backslashreplace").decode()
    return asdict(found) | {"path": path}


def _show_faults(found: LogInfo, *, tried: bool) -> None:
    for problem in found.problems:
        say(f"problem: {problem}")
    for warning in found.warnings:
        say(f"warning: {warning}")
    if found.usable and not (tried and not found.problems):
        what = "ingest takes what could be read" if found.problems else "by its topics"
        scans = "" if tried else "; not read whole yet (--try does, and takes as long as ingest)"
        say(f"usable: {what}{scans}")


def _trial(found: LogInfo, settings: ReadSettings, try_all: bool) -> ReadSettings | None:
    """How a log is read to find out what ingest would refuse; None if it is not. Scans take minutes
    and are left out, unless all is wanted."""
    if not isinstance(found.path, Path) or try_all:
        return settings if try_all else None
    uses = {topic.use for topic in found.topics}
    if found.bytes > WHOLE_BYTES or (uses & {"scans", "clouds"} and "junctions" not in uses):
        return None
    return replace(settings, junctions_from="topic") if "junctions" in uses else settings


def _tried(found: LogInfo, log: LogPath, settings: ReadSettings) -> LogInfo:
    """The contents of a log with why ingest with these settings would reject it, or warn of it,
    beyond the problems that are known."""
    from ..ingest.inspection import as_read
    from ..ingest.mapping import require_junctions
    from ..ingest.reading import log_size, read_log

    done = 0
    with Screen(quiet=False).progress("trying to read it", log_size(log), "bytes") as advance:

        def on_bytes(more: int) -> None:
            nonlocal done
            done += more
            advance(done)

        try:
            run = read_log(log, settings, on_bytes=on_bytes)
            require_junctions(run)
        except (DataError, UsageError) as error:
            told = str(error)
            for problem in found.problems:
                told = told.replace(f"; {problem}", "")
            problems = tuple(dict.fromkeys([*found.problems, told]))
            return replace(found, problems=problems, usable=False)
    found = as_read(found, run.source)
    return replace(found, warnings=tuple(w for w in run.warnings if w not in found.problems))


def described(found: LogInfo) -> list[str]:
    """The lines that describe a log, without its problems."""
    head = f"{found.path}: run {found.name}, {found.format}, {found.bytes / 1e6:,.1f} MB"
    if not any(topic.messages for topic in found.topics):
        head += ", no messages"
    elif found.start_ns is not None:
        begin = utc(found.start_ns, "%Y-%m-%d %H:%M:%S UTC")
        head += f", {found.duration_s:,.1f} s from {begin}"
    rows = [
        (topic.topic, topic.type_name, f"{topic.messages:,}", _use(topic.use, topic.why))
        for topic in found.topics
    ]
    lines = [head, *table(("topic", "type", "messages", "used as"), rows)]
    uses = {topic.use for topic in found.topics}
    if uses & {"scans", "clouds"} and "odometry" not in uses:
        lines.append("  no odometry: each scan will be matched to the one before")
    if not rows:
        lines = [head, f"  {counted(0, 'topic')}"]
    return lines


def _use(use: str, why: str) -> str:
    return f"{use}: {why}" if use and why else use or why
