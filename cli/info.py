"""`topobatch info`: what a log holds and what ingest would use of it."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..topology.errors import LogError
from .ingest import JunctionFields, JunctionTopic, OdometryTopic
from .output import complain, count, say, say_lines, table

if TYPE_CHECKING:
    from ..ingest.reading import LogInfo


def info(
    logs: Annotated[
        list[Path],
        typer.Argument(
            metavar="LOG...",
            help="MCAP files, ROS 1 bags, ROS 2 bag folders, or folders of logs.",
        ),
    ],
    odometry_topic: OdometryTopic = None,
    junction_topic: JunctionTopic = None,
    junction_fields: JunctionFields = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Show what logs hold and what ingest would use.

    Their topics, types and counts, how long they are, which topics would be used and why. Exits
    with 1 if a log is seen to be damaged, or if ingest could not use its topics. A finished log is
    not read whole: what is wrong inside its messages is told by ingest.
    """
    from ..ingest.reading import ReadSettings, find_logs, inspect_log

    settings = ReadSettings(
        odometry_topic=odometry_topic,
        junction_topic=junction_topic,
        junction_fields=junction_fields,
    )
    failed, told = False, []
    for each in _each_log(logs, find_logs):
        try:
            if isinstance(each, LogError):
                raise each
            found = inspect_log(each, settings)
        except LogError as error:
            complain(str(error))
            failed = True
            continue
        if as_json:
            told.append(_as_json(found))
        for line in () if as_json else described(found):
            say(line)
        failed |= bool(found.problems)
    if as_json:
        say_lines(json.dumps(told))
    if failed:
        raise typer.Exit(1)


def _each_log(
    given: list[Path], find_logs: Callable[[list[Path]], Iterable[Path]]
) -> Iterator[Path | LogError]:
    """Every log once; an error in place of what holds none."""
    seen: set[Path] = set()
    for path in given:
        try:
            found = list(find_logs([path]))
        except LogError as error:
            yield error
            continue
        yield from (log for log in found if log not in seen)
        seen.update(found)


def _as_json(found: LogInfo) -> dict[str, Any]:
    """What `described` shows, as JSON values."""
    path = str(found.path).encode("utf-8", "backslashreplace").decode()
    return asdict(found) | {"path": path}


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
