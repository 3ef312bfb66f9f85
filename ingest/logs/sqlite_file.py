"""ROS 2 bags in sqlite3: messages still in a write-ahead log are read, damage ends a read early."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from ...topology.errors import LogError
from .messages import (
    SCHEMA_BYTES,
    Block,
    Channel,
    Findings,
    Progress,
    Survey,
    Want,
    normal_topic,
    normal_type,
    one_line,
    printable,
)

MAGIC = b"SQLite format 3\x00"
ROWS = 2048


class SqliteFile:
    """One `.db3` file."""

    format = "sqlite3"

    def __init__(self, path: Path) -> None:
        self.path = path

    def survey(self, exact: bool = False) -> Survey | None:
        """Channels with their counts; None where the tables cannot be read.

        exact: count all rows. Else a channel that has any message counts as 1: counting reads
        every row's page, which takes as long as reading the run.
        """
        try:
            with closing(_connect(self.path)) as base:
                channels = _channels(base)
                present = _counts(base) if exact else _present(base, list(channels))
                counts = dict.fromkeys(channels.values(), 0)
                for key, count in present.items():
                    if key in channels:
                        counts[channels[key]] += count
                span = base.execute("SELECT min(timestamp), max(timestamp) FROM messages")
                first, last = span.fetchone()
        except (sqlite3.Error, ValueError, TypeError, OverflowError):
            return None
        return Survey(counts, first or 0, last or 0)

    def blocks(
        self, want: Want, findings: Findings, progress: Progress | None = None
    ) -> Iterator[Block]:
        """All wanted messages in the order of their rows."""
        total = self.path.stat().st_size
        try:
            with closing(_connect(self.path)) as base:
                channels = _channels(base)
                sinks = {key: want(channel) for key, channel in channels.items()}
                # Rows of topics that are described nowhere come along, to be counted.
                unwanted = [key for key, sink in sinks.items() if sink < 0]
                marks = ",".join("?" * len(unwanted))
                cursor = base.execute(
                    "SELECT topic_id, timestamp, data FROM messages "
                    f"WHERE topic_id NOT IN ({marks})",
                    unwanted,
                )
                while rows := cursor.fetchmany(ROWS):
                    block = _block(rows, sinks, channels, findings)
                    if len(block.sink):
                        yield block
                if len(unwanted) == len(channels):
                    for key, count in _counts(base).items():
                        if key in channels:
                            findings.seen(channels[key], count)
        except sqlite3.Error as error:
            findings.note(f"the database is damaged ({one_line(error)})")
        if progress is not None:
            progress(total)


def _connect(path: Path) -> sqlite3.Connection:
    """Open read-only; unlike `immutable`, this sees what is still in the write-ahead log."""
    try:
        return sqlite3.connect(f"file:{quote(str(path.resolve()))}?mode=ro", uri=True)
    except sqlite3.Error as error:
        raise LogError(f"{path}: cannot be opened as a database ({one_line(error)})") from error


def _channels(base: sqlite3.Connection) -> dict[int, Channel]:
    columns = {row[1] for row in base.execute("PRAGMA table_info(topics)")}
    encoding = "serialization_format" if "serialization_format" in columns else "'cdr'"
    definitions: dict[str, tuple[str, bytes]] = {}
    query = "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
    if base.execute("SELECT 1 FROM sqlite_master WHERE name = 'message_definitions'").fetchone():
        for name, kind, body in base.execute(query):
            definitions[str(name)] = (str(kind), str(body).encode()[:SCHEMA_BYTES])
    out = {}
    for key, name, type_name, form in base.execute(
        f"SELECT id, name, type, {encoding} FROM topics"
    ):
        kind, body = definitions.get(str(type_name), ("", b""))
        names = normal_topic(printable(str(name))), normal_type(printable(str(type_name)))
        out[int(key)] = Channel(*names, printable(str(form)), body, kind)
    return out


def _counts(base: sqlite3.Connection) -> dict[int, int]:
    """Messages per topic."""
    return dict(base.execute("SELECT topic_id, count(*) FROM messages GROUP BY topic_id"))


def _present(base: sqlite3.Connection, keys: list[int]) -> dict[int, int]:
    """Topics that have any message; most show up among the first rows."""
    early = base.execute("SELECT DISTINCT topic_id FROM (SELECT topic_id FROM messages LIMIT 5000)")
    present = {key for (key,) in early}
    for key in keys:
        if key not in present:
            probe = "SELECT 1 FROM messages WHERE topic_id = ? LIMIT 1"
            if base.execute(probe, (key,)).fetchone():
                present.add(key)
    return dict.fromkeys(present, 1)


def _block(
    rows: list[tuple[Any, Any, Any]],
    sinks: dict[int, int],
    channels: dict[int, Channel],
    findings: Findings,
) -> Block:
    """The wanted rows as one buffer; sqlite keeps any type in any column, so they are checked."""
    good = [row for row in rows if type(row[2]) is bytes and type(row[1]) is int]
    findings.unreadable_rows(len(rows) - len(good))
    known = [row for row in good if row[0] in channels]
    findings.unknown += len(good) - len(known)
    keys, times, payloads = zip(*known, strict=True) if known else ((), (), ())
    size = np.fromiter(map(len, payloads), np.int64, len(known))
    key = np.array(keys, np.int64)
    log_time = np.array(times, np.int64)
    sink = np.zeros(len(known), np.int64)
    for number in set(keys):
        chosen = key == number
        sink[chosen] = sinks[number]
        findings.seen(channels[number], int(chosen.sum()))
    if known:
        findings.span(int(log_time.min()), int(log_time.max()))
    data = np.frombuffer(b"".join(payloads), np.uint8)
    return Block(data, sink, log_time, np.cumsum(size) - size, size)
