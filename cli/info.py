"""`topobatch info`: what a log holds and what ingest would use of it."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..topology.errors import LogError
from .ingest import JunctionFields, JunctionTopic, OdometryTopic
from .output import complain, count, say, table

if TYPE_CHECKING:
    from ..ingest.reading import LogInfo, ReadSettings

WHOLE_BYTES = 64_000_000
"""A log of this size is read in a fraction of a second."""


def info(
    log: Annotated[
        Path,
        typer.Argument(help="An MCAP file, a ROS 1 bag, a ROS 2 bag folder, or a folder of logs."),
    ],
    odometry_topic: OdometryTopic = None,
    junction_topic: JunctionTopic = None,
    junction_fields: JunctionFields = None,
) -> None:
    """Show what a log holds and what ingest would use.

    Its topics, their types and counts, how long it is, which topics would be used and why. Exits
    with 1 if a log is seen to be damaged, if ingest could not use its topics, or if what they hold
    would be refused. That is tried with logs of up to 64 MB; of a larger one with an index, no
    message is read, and a line says so.
    """
    from ..ingest.reading import ReadSettings, find_logs, inspect_log

    settings = ReadSettings(
        odometry_topic=odometry_topic,
        junction_topic=junction_topic,
        junction_fields=junction_fields,
    )
    failed = False
    for each in find_logs([log]):
        try:
            found = inspect_log(each, settings)
        except LogError as error:
            complain(str(error))
            failed = True
            continue
        problems = list(found.problems)
        if not problems and found.bytes <= WHOLE_BYTES:
            problems = _refused(each, settings)
        for line in described(found):
            say(line)
        for problem in problems:
            say(f"problem: {problem}")
        if found.bytes > WHOLE_BYTES:
            say("not read whole: what its messages hold may still be refused by ingest")
        failed |= bool(problems)
    if failed:
        raise typer.Exit(1)


def _refused(log: Path, settings: ReadSettings) -> list[str]:
    """Why ingest would refuse to read a log, nothing if it would not."""
    from ..ingest.reading import read_run

    try:
        read_run(log, settings)
    except LogError as error:
        return [str(error)]
    return []


def described(found: LogInfo) -> list[str]:
    """The lines that describe a log, without its problems."""
    start = "no messages"
    if any(topic.messages for topic in found.topics):
        seconds = found.start_ns // 1_000_000_000
        start = f"{found.duration_s:,.1f} s from {_utc(seconds)}"
    head = f"{found.path}: run {found.name}, {found.format}, {found.bytes / 1e6:,.1f} MB, {start}"
    rows = [
        (topic.topic, topic.type_name, f"{topic.messages:,}", _use(topic.use, topic.why))
        for topic in found.topics
    ]
    lines = [head, *table(("topic", "type", "messages", "used as"), rows)]
    if not rows:
        lines = [head, f"  {count(0, 'topic')}"]
    return lines


def _use(use: str, why: str) -> str:
    return f"{use}: {why}" if use and why else use or why


def _utc(seconds: int) -> str:
    try:
        return datetime.fromtimestamp(seconds, UTC).strftime("%Y-%m-%d %H:%M:%S UTC")
    except (OverflowError, ValueError, OSError):
        return f"second {seconds}"  # a clock far outside of any calendar
