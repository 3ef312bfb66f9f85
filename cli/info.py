"""`topobatch info`: what a log holds and what ingest would use of it."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..topology.errors import LogError
from .ingest import JunctionFields, JunctionTopic, OdometryTopic
from .output import complain, count, say, table
from .scan_options import JunctionsFrom, ScanTopic

if TYPE_CHECKING:
    from ..ingest.reading import LogInfo


def info(
    log: Annotated[
        Path,
        typer.Argument(help="An MCAP file, a ROS 1 bag, a ROS 2 bag folder, or a folder of logs."),
    ],
    odometry_topic: OdometryTopic = None,
    junction_topic: JunctionTopic = None,
    junction_fields: JunctionFields = None,
    junctions_from: JunctionsFrom = None,
    scan_topic: ScanTopic = None,
) -> None:
    """Show what a log holds and what ingest would use.

    Its topics, their types and counts, how long it is, which topics would be used and why. Exits
    with 1 if a log is seen to be damaged, or if ingest could not use its topics. A finished log is
    not read whole: what is wrong inside its messages is told by ingest.
    """
    from ..ingest.reading import ReadSettings, find_logs, inspect_log

    settings = ReadSettings(
        odometry_topic=odometry_topic,
        junction_topic=junction_topic,
        junction_fields=junction_fields,
        junctions_from=junctions_from,
        scan_topic=scan_topic,
    )
    failed = False
    for each in find_logs([log]):
        try:
            found = inspect_log(each, settings)
        except LogError as error:
            complain(str(error))
            failed = True
            continue
        for line in described(found):
            say(line)
        failed |= bool(found.problems)
    if failed:
        raise typer.Exit(1)


def described(found: LogInfo) -> list[str]:
    """The lines that describe a log."""
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
    return lines + [f"problem: {problem}" for problem in found.problems]


def _use(use: str, why: str) -> str:
    return f"{use}: {why}" if use and why else use or why


def _utc(seconds: int) -> str:
    try:
        return datetime.fromtimestamp(seconds, UTC).strftime("%Y-%m-%d %H:%M:%S UTC")
    except (OverflowError, ValueError, OSError):
        return f"second {seconds}"  # a clock far outside of any calendar
