"""ROS 2 bags in SQLite (`.db3`), read by the library; of a damaged one, the rows that it still
reaches."""

from __future__ import annotations

import os
import shutil
import sqlite3
import tempfile
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from contextlib import closing, contextmanager, suppress
from itertools import compress
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from ...topology.arrays import IntArray
from ...topology.errors import LogError
from ...topology.wording import legible
from .channels import DEFINITION_BYTES, NUMBERS
from .messages import (
    CUT,
    MESSAGE_BYTES,
    NAME_BYTES,
    NOT_TOLD,
    SCHEMA_BYTES,
    TOO_LARGE,
    UNKNOWN,
    Block,
    Channel,
    DamageError,
    Findings,
    Passed,
    Survey,
    Want,
    normal_topic,
    normal_type,
    one_line,
    several,
)
from .write_ahead import merge_write_ahead, page_bytes

MAGIC = b"SQLite format 3\x00"

_ERRORS = (sqlite3.Error, ValueError, TypeError, OverflowError, MemoryError)
"""Exceptions of the library on a damaged database: its own, and those of converting values."""

ROWS, LARGE_BYTES = 2048, 1 << 14
"""Rows that are fetched at a time; larger payloads are asked for by themselves."""

LEAST_STEPS = 1 << 25
STEPS_PER_BYTE = 4
"""Limit on the virtual machine's steps for one connection: LEAST_STEPS (about a second) plus
STEPS_PER_BYTE of the file, since a row takes about ten steps and at least ten bytes."""

STEPS_AT_ONCE = 10_000
"""Virtual machine steps between two checks of the limit."""

MOST_MISSING = 1 << 20
"""A larger step between the numbers of two rows counts as a wrong number; over a damaged place none
so large is made."""

_BROKEN_ROW = ("row", "of the database without a message")

_Row = tuple[int, Any, Any, Any]
"""Number, topic, time, and the payload if it is wanted and not large, else its length."""


class SqliteFile:
    """One `.db3` file."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def survey(self, exact: bool = False) -> Survey | None:
        """Channels with their counts; None if the tables cannot be read, or not all changes.

        exact: count all rows. Else a channel with any message counts as 1: counting reads every
        row's page, which takes as long as reading the run.
        """
        findings = Findings()
        try:
            with _sound(self.path, findings) as path, _connected(path) as base:
                channels = _channels(base)
                counts = Counter(dict.fromkeys(channels.values(), 0))
                for key, count in _counts(base, channels, exact).items():
                    if key in channels:
                        counts[channels[key]] += count
                ends = "SELECT (SELECT min(timestamp) FROM messages), max(timestamp) FROM messages"
                first, last = (int(end or 0) for end in base.execute(ends).fetchone())
        except (*_ERRORS, DamageError):
            return None
        return None if findings.damage else Survey(counts, first, last, sure=True)

    def blocks(self, want: Want, findings: Findings, passed: Passed = NOT_TOLD) -> Iterator[Block]:
        """All messages by the numbers of their rows. O(bytes of the pages that hold any)."""
        with _sound(self.path, findings) as path:
            try:
                with _connected(path) as base:
                    yield from _Reader(base, want, findings, passed).blocks()
            except (*_ERRORS, DamageError) as error:
                findings.note(f"the database is damaged ({one_line(error)})")


class _Reader:
    """Reads the rows of one database as blocks, and counts them."""

    def __init__(
        self, base: sqlite3.Connection, want: Want, findings: Findings, passed: Passed
    ) -> None:
        self._base = base
        self._findings = findings
        self._passed = passed
        self._channels = _channels(base)
        self._sink = {key: want(channel) for key, channel in self._channels.items()}
        wanted = ",".join(str(key) for key, sink in self._sink.items() if sink >= 0)
        chosen = f"topic_id IN ({wanted}) AND length(data) <= {LARGE_BYTES}"
        data = f"CASE WHEN {chosen} THEN data ELSE length(data) END"
        # The number of a row is its id, but in tables of other writers.
        columns = base.execute("PRAGMA table_info(messages)").fetchall()
        number = "id" if any(row[1] == "id" and row[5] for row in columns) else "rowid"
        self._query = (
            f"SELECT {number}, topic_id, timestamp, {data} FROM messages "
            f"WHERE {number} >= ? ORDER BY {number}"
        )
        self._one = f"SELECT data FROM messages WHERE {number} = ?"
        self._read_bytes = self._last = self._missing = 0

    def blocks(self) -> Iterator[Block]:
        """All rows in blocks of bounded memory."""
        for rows in self._batches():
            yield from self._block(rows)
            self._passed.passed(self._read_bytes)
        if self._missing:
            self._findings.note(
                f"the numbers of the rows have gaps: {several(self._missing, 'row')} missing"
            )

    def _batches(self) -> Iterator[list[_Row]]:
        """All rows by ascending number; damaged places are stepped over, in ever longer steps: rows
        next to each other share their page."""
        first, count, step = -(1 << 63), ROWS, 1
        while step < MOST_MISSING:
            try:
                cursor = self._base.execute(self._query, (first,))
                while rows := cursor.fetchmany(count):
                    yield rows
                    first, step = rows[-1][0] + 1, 1
                return
            except _ERRORS as error:
                self._findings.note(f"the database is damaged ({one_line(error)})")
            if count > 1:
                count = 1  # up to the damage
            else:
                first, count, step = max(first, 0) + step, ROWS, 2 * step

    def _block(self, rows: list[_Row]) -> Iterator[Block]:
        """The wanted ones of some rows; columns may hold any type in SQLite."""
        good = [row for row in rows if type(row[1]) is type(row[2]) is int]
        self._findings.faults[_BROKEN_ROW] += len(rows) - len(good)
        if not good:
            return
        numbers, topics, times, payloads = zip(*good, strict=True)
        topic, time = np.array(topics), np.array(times)
        self._count_missing(np.array(numbers))
        self._findings.span(int(time.min()), int(time.max()))
        for key in sorted(set(topics)):
            mine = topic == key
            channel, count = self._channels.get(key), int(mine.sum())
            if channel is None:
                self._findings.faults[UNKNOWN] += count
            elif self._sink[key] < 0:
                self._findings.seen(channel, count)
            else:
                found = list(compress(payloads, mine.tolist()))
                if set(map(type, found)) == {bytes}:
                    yield self._block_of(channel, self._sink[key], found, time[mine])
                    continue
                for k, data in zip(mine.nonzero()[0].tolist(), found, strict=True):
                    if payload := data if type(data) is bytes else self._large(numbers[k], data):
                        yield self._block_of(channel, self._sink[key], [payload], time[k : k + 1])

    def _large(self, number: int, size: Any) -> bytes | None:
        """A payload that is asked for by itself; None, and counted, if it is none or too long.

        size: its length, or what stands in its place.
        """
        large = isinstance(size, int) and size > MESSAGE_BYTES
        with suppress(*_ERRORS):
            if not large:
                (data,) = self._base.execute(self._one, (number,)).fetchone()
                if isinstance(data, bytes):
                    return data
        self._findings.faults[TOO_LARGE if large else _BROKEN_ROW] += 1
        return None

    def _block_of(
        self, channel: Channel, sink: int, payloads: list[bytes], time_ns: IntArray
    ) -> Block:
        block = Block.of(sink, time_ns, payloads)
        self._findings.seen(channel, len(payloads))
        self._read_bytes += len(block.data)
        return block

    def _count_missing(self, number: IntArray) -> None:
        """Count the gaps in ascending numbers: a recorder counts from 1 on."""
        step = np.diff(number, prepend=self._last)
        self._missing += int((step[(step > 1) & (step <= MOST_MISSING)] - 1).sum())
        self._last = int(number[-1])


@contextmanager
def _sound(path: Path, findings: Findings) -> Iterator[Path]:
    """The database, or a copy with the changes of its write-ahead log, without those that its
    rollback journal takes back, and without a page that is cut: the library would take what is
    missing of it for zeros.

    A copy, so that nothing has to be written beside the database.
    """
    page, size = page_bytes(path), path.stat().st_size
    log, journal = (_beside(path, suffix) for suffix in ("-wal", "-journal"))
    if log is None and journal is None and size % page == 0:
        yield path
        return
    with tempfile.TemporaryDirectory(prefix="topobatch-") as folder:
        copy = Path(folder) / path.name
        try:
            for file in (path, journal) if journal is not None else (path,):
                shutil.copyfile(file, copy.with_name(file.name))
        except OSError as error:
            raise LogError(f"{path}: cannot be copied to be read ({error.strerror})") from error
        if size % page:
            findings.faults[CUT] = 1
            os.truncate(copy, size // page * page)
        if log is not None:
            merge_write_ahead(log, copy, findings)
        if journal is not None:
            with closing(sqlite3.connect(copy)) as base, suppress(*_ERRORS):
                base.execute("SELECT 1 FROM sqlite_master").fetchone()
        yield copy


def _beside(path: Path, suffix: str) -> Path | None:
    """A file that belongs to a database, None if there is none or it is empty."""
    file = path.with_name(path.name + suffix)
    return file if file.is_file() and file.stat().st_size else None


@contextmanager
def _connected(path: Path) -> Iterator[sqlite3.Connection]:
    """A connection that only reads the database itself (`immutable`) and runs no code of it, with
    work limited by the file's size."""
    left = LEAST_STEPS + STEPS_PER_BYTE * path.stat().st_size

    def spent() -> bool:
        nonlocal left
        left -= STEPS_AT_ONCE
        return left < 0

    address = f"file:{quote(str(path.resolve()))}?immutable=1"
    with closing(sqlite3.connect(address, uri=True)) as base:
        base.text_factory = lambda raw: raw.decode("utf-8", "replace")
        base.set_progress_handler(spent, STEPS_AT_ONCE)
        with suppress(*_ERRORS):  # what is wrong with the file shows when something is asked
            base.execute("PRAGMA trusted_schema = OFF")
            base.execute("PRAGMA writable_schema = ON")  # opens one that is shorter than it says
        yield base


def _check_table(base: sqlite3.Connection, name: str) -> None:
    """Raise DamageError unless this is a plain table, not a view or with generated columns."""
    found = base.execute(
        "SELECT type, substr(sql, 1, 100) FROM sqlite_master WHERE name = ? COLLATE NOCASE LIMIT 2",
        (name,),
    ).fetchall()
    if not found:
        raise DamageError(f"it has no table {name}")
    if len(found) > 1 or found[0][0] != "table" or "VIRTUAL" in str(found[0][1]).upper().split():
        raise DamageError(f"{name} is no plain table")
    if any(row[6] for row in base.execute(f"PRAGMA table_xinfo({name})")):
        raise DamageError(f"{name} has generated columns")


def _channels(base: sqlite3.Connection) -> dict[int, Channel]:
    """The topics by id; raises DamageError if the tables are not those of a bag."""
    _check_table(base, "messages")
    _check_table(base, "topics")
    columns = {row[1] for row in base.execute("PRAGMA table_info(topics)")}
    encoding = "serialization_format" if "serialization_format" in columns else "'cdr'"
    definitions = _definitions(base)
    short = ", ".join(f"substr({column}, 1, {NAME_BYTES})" for column in ("name", "type", encoding))
    out: dict[int, Channel] = {}
    for key, name, type_name, form in base.execute(
        f"SELECT id, {short} FROM topics LIMIT {NUMBERS}"
    ):
        kind, body = definitions.get(str(type_name), ("", b""))
        names = normal_topic(legible(str(name))), normal_type(legible(str(type_name)))
        # The recorder wrote the first one, whatever else calls itself so.
        out.setdefault(int(key), Channel(*names, legible(str(form)), body, kind))
    return out


def _definitions(base: sqlite3.Connection) -> Mapping[str, tuple[str, bytes]]:
    """The definitions of types, up to a limit of memory."""
    there = "SELECT 1 FROM sqlite_master WHERE name = 'message_definitions'"
    if not base.execute(there).fetchone():
        return {}
    _check_table(base, "message_definitions")
    query = (
        f"SELECT substr(topic_type, 1, {NAME_BYTES}), substr(encoding, 1, {NAME_BYTES}), "
        f"substr(encoded_message_definition, 1, {SCHEMA_BYTES}) FROM message_definitions"
    )
    out: dict[str, tuple[str, bytes]] = {}
    room = DEFINITION_BYTES
    for name, kind, body in base.execute(query):
        out[str(name)] = (str(kind), str(body).encode("utf-8", "replace"))
        room -= len(str(name)) + len(str(body))
        if room < 0:
            break
    return out


def _counts(base: sqlite3.Connection, keys: Iterable[int], exact: bool) -> dict[int, int]:
    """Messages per topic; if not exact, 1 for any number of them."""
    if exact:
        return dict(base.execute("SELECT topic_id, count(*) FROM messages GROUP BY topic_id"))
    # Most topics are among the first rows; those that are not take one pass.
    early = "SELECT DISTINCT topic_id FROM (SELECT topic_id FROM messages LIMIT 5000)"
    present = {key for (key,) in base.execute(early)}
    if not present.issuperset(keys):
        present = {key for (key,) in base.execute("SELECT DISTINCT topic_id FROM messages")}
    return dict.fromkeys(present, 1)
