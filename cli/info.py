"""`topobatch info`: what a log holds and what ingest would use of it."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated

import typer

from ..ingest.inspection import as_read
from ..ingest.logs.topics import JUNCTIONS
from ..ingest.mapping import require_junctions
from ..ingest.reading import LogInfo, ReadSettings, inspect_log, log_size, read_log
from ..ingest.remote.path import LogPath
from ..topology.errors import DataError, LogError, UsageError
from ..topology.wording import counted, utc
from .options import Here, JsonOption, ReadOptions, describe_settings, settings_of, verb
from .output import complain, counting, megabytes, progress, say, say_json, say_row, table
from .run_logs import run_names

WHOLE_BYTES = 64_000_000
"""Logs up to this size are read whole, without their scans: a fraction of a second."""

MOST_DETAILED = 8
"""Logs up to which each has lines of its own, four or more: those of more fill several screens."""

SCANS = {*JUNCTIONS["scan"].types, *JUNCTIONS["cloud"].types}
"""Types of topics of lasers and clouds."""


@verb
def info(
    logs: Annotated[
        list[str] | None,
        "LOG",
        "MCAP files, ROS 1 bags, ROS 2 bag folders, or folders of logs; here, or elsewhere (s3://, "
        "gs://, az://, https://). Without any, the workspace's settings.",
    ] = None,
    *,
    read: ReadOptions,
    try_all: Annotated[
        bool,
        "--try",
        "Read logs as ingest does, whatever their size, and match their scans: takes as long as "
        "ingest.",
    ] = False,
    as_json: JsonOption = False,
    place: Here,
) -> None:
    """Show what logs hold and what ingest would use.

    Their topics, types and counts, how long they are, which topics would be used and why. Exits
    with 1 if a log is damaged, if ingest could not use its topics, or if it would refuse what they
    hold. For that, logs of up to 64 MB on this machine are read whole, except for scans and clouds:
    --try reads these as well, and tells where no junction shows in them. Of others that have an
    index only the index is read. Of logs that are damaged or not read whole, a line says what is
    usable. Options about reading are those of ingest, also those that the workspace remembers
    (topobatch init), which are shown first. Of more than 8 logs each is a row of a table; --try, or
    fewer logs, tell all.

    \b
      topobatch info run1.mcap
      topobatch info logs/ --json
    """
    settings = read.settings()
    if (remembered := settings_of(place)) and not as_json:
        say(f"{place.settings_toml}: {describe_settings(remembered)}")
    if not logs and not remembered:
        raise UsageError("name a log: topobatch info LOG")
    known, missing = read.logs(logs or ())
    for _, error in missing:
        complain(str(error))
    failed, brief = bool(missing), len(known) > MOST_DETAILED and not try_all
    described: list[LogInfo] = []
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
        if not (as_json or brief):
            for line in [*_described(found), *_faults(found, tried=how is not None)]:
                say_row(line)
        described.append(found)
        failed |= bool(found.problems)
    if as_json:
        paths = (str(o.path).encode("utf-8", "backslashreplace").decode() for o in described)
        say_json([asdict(o) | {"path": path} for o, path in zip(described, paths, strict=True)])
    elif len(known) + len(missing) > 1:
        _summarise(described, len(known) + len(missing), brief=brief)
    if failed:
        raise typer.Exit(1)


def _summarise(described: list[LogInfo], logs: int, *, brief: bool) -> None:
    """Print how many of all logs are usable; brief: after a row for each of those described."""
    if brief:
        header = ("run", "format", "MB", "seconds", "used", "problem")
        for line in table(header, [_row(found) for found in described]):
            say_row(line)
    usable = [found for found in described if found.usable]
    scanned = sum(any(t.messages and t.type_name in SCANS for t in o.topics) for o in usable)
    each = "; of each more: topobatch info LOG" if brief else ""
    usage = f"{len(usable)} usable, {scanned} of them with a laser or clouds"
    say(f"{counted(logs, 'log')}: {usage}{each}")


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
    with progress("trying to read it", log_size(log), "bytes") as advance:
        try:
            run = read_log(log, settings, on_bytes=counting(advance))
            require_junctions(run)
        except (DataError, UsageError) as error:
            text = str(error)
            for problem in found.problems:
                text = text.replace(f"; {problem}", "")
            problems = tuple(dict.fromkeys([*found.problems, text]))
            return replace(found, problems=problems, usable=False)
    found = as_read(found, run.source)
    return replace(found, warnings=tuple(w for w in run.warnings if w not in found.problems))


def _row(found: LogInfo) -> tuple[str, ...]:
    """A log as a row of a table: what would be used of it, and the first of its problems."""
    seconds = "" if found.duration_s is None else f"{found.duration_s:,.1f}"
    used = ", ".join(dict.fromkeys(t.use for t in found.topics if t.use))
    first = next(iter([*found.problems, *found.warnings]), "")
    more = len(found.problems) + len(found.warnings) - 1
    fault = first.removeprefix(f"{found.path}: ") + (f"; and {more} more" if more > 0 else "")
    return (found.name, found.format, megabytes(found.bytes), seconds, used, fault)


def _described(found: LogInfo) -> list[str]:
    """The lines that describe a log, without its problems."""
    head = f"{found.path}: run {found.name}, {found.format}, {megabytes(found.bytes)} MB"
    if not any(topic.messages for topic in found.topics):
        head += ", no messages"
    elif found.start_ns is not None:
        begin = utc(found.start_ns, "%Y-%m-%d %H:%M:%S UTC")
        head += f", {found.duration_s:,.1f} s from {begin}"
    if not found.topics:
        return [head, f"  {counted(0, 'topic')}"]
    rows = [
        (t.topic, t.type_name, f"{t.messages:,}", ": ".join(filter(None, (t.use, t.why))))
        for t in found.topics
    ]
    lines = [head, *table(("topic", "type", "messages", "used as"), rows)]
    uses = {topic.use for topic in found.topics}
    if uses & {"scans", "clouds"} and "odometry" not in uses:
        lines.append("  no odometry: each scan will be matched to the one before")
    return lines


def _faults(found: LogInfo, *, tried: bool) -> list[str]:
    lines = [f"problem: {problem}" for problem in found.problems]
    lines += [f"warning: {warning}" for warning in found.warnings]
    if found.usable and (found.problems or not tried):
        what = "ingest takes what could be read" if found.problems else "by its topics"
        scans = "" if tried else "; not read whole yet (--try does, and takes as long as ingest)"
        lines.append(f"usable: {what}{scans}")
    return lines
