"""ROS 2 bags in sqlite3: messages still in a write-ahead log are read, damage ends a read early."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
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
)

MAGIC = b"SQLite format 3\x00"
ROWS = 2048


class SqliteFile:
    """One `.db3` file."""

    format = "sqlite3"

    def __init__(self, path: Path) -> None:
        self.path = path

    def survey(self) -> Survey | None:
        """Channels with their counts; None where the tables cannot be read to the end."""
        try:
            with closing(_connect(self.path)) as base:
                channels = _channels(base)
                counts = dict.fromkeys(channels.values(), 0)
                query = "SELECT topic_id, count(*) FROM messages GROUP BY topic_id"
                for key, count in base.execute(query):
                    if key in channels:
                        counts[channels[key]] += count
                span = base.execute(
                    "SELECT min(timestamp), max(timestamp) FROM messages"
                ).fetchone()
        except (sqlite3.Error, ValueError):
            return None
        return Survey(counts, span[0] or 0, span[1] or 0)

    def blocks(
        self, want: Want, findings: Findings, progress: Progress | None = None
    ) -> Iterator[Block]:
        """All wanted messages in the order of their rows."""
        total = self.path.stat().st_size
        try:
            with closing(_connect(self.path)) as base:
                channels = _channels(base)
                sinks = {key: want(channel) for key, channel in channels.items()}
                wanted = [key for key, sink in sinks.items() if sink >= 0]
                marks = ",".join("?" * len(wanted))
                cursor = base.execute(
                    f"SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN ({marks})",
                    wanted,
                )
                while rows := cursor.fetchmany(ROWS):
                    yield _block(rows, sinks, channels, findings)
        except sqlite3.Error as error:
            findings.note(f"the database is damaged ({error})")
        if progress is not None:
            progress(total)


def _connect(path: Path) -> sqlite3.Connection:
    """Open read-only; unlike `immutable`, this sees what is still in the write-ahead log."""
    try:
        return sqlite3.connect(f"file:{quote(str(path.resolve()))}?mode=ro", uri=True)
    except sqlite3.Error as error:
        raise LogError(f"{path}: cannot be opened as a database ({error})") from error


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
        out[int(key)] = Channel(
            normal_topic(str(name)), normal_type(str(type_name)), str(form), body, kind
        )
    return out


def _block(
    rows: list[tuple[int, int, bytes]],
    sinks: dict[int, int],
    channels: dict[int, Channel],
    findings: Findings,
) -> Block:
    keys, times, payloads = zip(*rows, strict=True)
    size = np.fromiter(map(len, payloads), np.int64, len(rows))
    start = np.concatenate([[0], np.cumsum(size)[:-1]]).astype(np.int64)
    data = np.frombuffer(b"".join(payloads), np.uint8)
    key = np.array(keys, np.int64)
    log_time = np.array(times, np.int64)
    sink = np.zeros(len(rows), np.int64)
    for number in np.unique(key).tolist():
        chosen = key == number
        sink[chosen] = sinks[number]
        findings.seen(channels[number], int(chosen.sum()))
    findings.span(int(log_time.min()), int(log_time.max()))
    return Block(data, sink, log_time, start, size)
