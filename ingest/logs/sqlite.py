"""ROS 2 bags in SQLite (`.db3`), read by the library; of a damaged one, the rows that it still
reaches."""

from __future__ import annotations

import os
import shutil
import sqlite3
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager, suppress
from functools import cached_property
from itertools import compress
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from ...topology.arrays import IntArray
from ...topology.errors import LogError
from ...topology.wording import legible
from .channels import DEFINITION_BYTES
from .inflate import keep_freed_memory
from .messages import (
    CUT,
    NAME_BYTES,
    SCHEMA_BYTES,
    UNKNOWN,
    Block,
    Channel,
    DamageError,
    Findings,
    Passed,
    Progress,
    Survey,
    Want,
    normal_topic,
    normal_type,
    one_line,
    several,
)
from .topics import longest_message
from .write_ahead import PAGES, WriteAhead, beside, read_write_ahead

MAGIC = b"SQLite format 3\x00"

_ERRORS = (sqlite3.Error, ValueError, TypeError, OverflowError, MemoryError)
"""Exceptions of the library on a damaged database: its own, and those of converting values."""

ROWS, LARGE_BYTES = 512, 1 << 14
"""Rows that are fetched at a time; larger payloads are asked for by themselves."""

LEAST_STEPS = 1 << 25
STEPS_PER_BYTE = 4
"""Limit on the virtual machine's steps for one connection: LEAST_STEPS (about a second) plus
STEPS_PER_BYTE of the file, since a row takes about ten steps and at least ten bytes."""

STEPS_AT_ONCE = 10_000
"""Virtual machine steps between two checks of the limit."""

PATIENCE = 1000
"""Damaged places that are stepped over; a file with more is an attack. Each takes about 1 ms."""

TOPICS = 1 << 15
"""Most topics that are read."""

MOST_MISSING = 1 << 20
"""A larger step between the numbers of two rows counts as a wrong number."""

_BROKEN_ROW = ("row", "of the database without a message")

_Row = tuple[int, Any, Any, Any]
"""Number, topic, time, and the payload if it is wanted and not large, else its length."""


class SqliteFile:
    """One `.db3` file."""

    def __init__(self, path: Path) -> None:
        self.path = path

    @cached_property
    def _write_ahead(self) -> WriteAhead | None:
        """The write-ahead log beside the file if it is damaged: the library would leave out what
        follows, without a word."""
        found = read_write_ahead(self.path)
        return found if found is not None and found.damaged else None

    def survey(self, exact: bool = False) -> Survey | None:
        """Channels with their counts; None if the tables cannot be read.

        exact: count all rows. Else a channel with any message counts as 1: counting reads every
        row's page, which takes as long as reading the run.
        """
        if self._write_ahead is not None:
            return None
        try:
            with _connected(self.path) as base:
                channels = _channels(base)
                present = _counts(base) if exact else _present(base, list(channels))
                counts = dict.fromkeys(channels.values(), 0)
                for key, count in present.items():
                    if key in channels:
                        counts[channels[key]] += count
                ends = (
                    "(SELECT min(timestamp) FROM messages), (SELECT max(timestamp) FROM messages)"
                )
                first, last = base.execute(f"SELECT {ends}").fetchone()
        except (*_ERRORS, DamageError):
            return None
        return Survey(counts, first or 0, last or 0, sure=True)

    def blocks(
        self, want: Want, findings: Findings, progress: Progress | None = None
    ) -> Iterator[Block]:
        """All messages by the numbers of their rows. O(bytes of the pages that hold any)."""
        keep_freed_memory()
        passed = Passed(progress)
        with self._sound(findings) as path:
            for anyhow in (False, True):
                try:
                    with _connected(path, anyhow) as base:
                        yield from _Reader(base, want, findings, passed).blocks()
                    break
                except (*_ERRORS, DamageError) as error:
                    findings.note(f"the database is damaged ({one_line(error)})")
        passed.passed(self.path.stat().st_size)

    @contextmanager
    def _sound(self, findings: Findings) -> Iterator[Path]:
        """The database, or a copy without what is known to be damaged.

        What is sound of a damaged write-ahead log is merged, and a page that is cut is left out:
        the library would take what is missing of it for zeros.
        """
        page, declared = _length(self.path)
        size = self.path.stat().st_size
        if size < declared:
            findings.faults[CUT] = 1
        if self._write_ahead is None and size % page == 0:
            yield self.path
            return
        with tempfile.TemporaryDirectory(prefix="topobatch-") as folder:
            copy = Path(folder) / "copy.db3"
            try:
                shutil.copyfile(self.path, copy)
                os.truncate(copy, size // page * page)
                if self._write_ahead is not None:
                    self._write_ahead.merge(copy, findings)
            except OSError as error:
                reason = error.strerror
                raise LogError(f"{self.path}: cannot be copied to be read ({reason})") from error
            yield copy


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
        self._id = "id" if any(row[1] == "id" and row[5] for row in columns) else "rowid"
        self._query = f"SELECT {self._id}, topic_id, timestamp, {data} FROM messages "
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
        """All rows by ascending number; what cannot be read is stepped over."""
        last = -(1 << 63)
        for _ in range(PATIENCE):
            try:
                found = self._base.execute(f"{self._query}{self._from('>')}", (last,))
                while rows := found.fetchmany(ROWS):
                    last = rows[-1][0]
                    yield rows
                return
            except _ERRORS as error:
                self._findings.note(f"the database is damaged ({one_line(error)})")
            rows = self._up_to_damage(last)
            last = max(rows[-1][0] if rows else last, 0)
            behind = self._first_from(last + 1) or self._readable_after(last + 1)
            yield [*rows, behind] if behind is not None else rows
            if behind is None:
                return
            last = behind[0]
        self._findings.note("the database is damaged in too many places: the rest is left out")

    def _up_to_damage(self, last: int) -> list[_Row]:
        """The rows after a number, one by one, up to the one before the first that cannot be read.

        The library's module for Python drops that one, or all rows that were asked for together.
        """
        rows: list[_Row] = []
        with suppress(*_ERRORS):
            for row in self._base.execute(f"{self._query}{self._from('>')}", (last,)):
                rows.append(row)
                if len(rows) == ROWS:
                    break
        return rows

    def _readable_after(self, bad: int) -> _Row | None:
        """The first row that can be read behind the number of one that cannot.

        Doubles the step until a row can be read, then bisects: rows next to each other share their
        page.
        """
        top, step, found = self._largest(), 1, None
        while found is None:
            if bad + step > top:
                return None
            found = self._first_from(bad + step)
            bad, step = (bad, step) if found is not None else (bad + step, 2 * step)
        good = bad + step
        while good - bad > 1:
            middle = (good + bad) // 2
            row = self._first_from(middle)
            found, good, bad = (row, middle, bad) if row is not None else (found, good, middle)
        return found

    def _first_from(self, number: int) -> _Row | None:
        """The first row from a number on, None if it cannot be read."""
        with suppress(*_ERRORS):
            query = f"{self._query}{self._from('>=')} LIMIT 1"
            found: _Row | None = self._base.execute(query, (number,)).fetchone()
            return found
        return None

    def _from(self, compared: str) -> str:
        return f"WHERE {self._id} {compared} ? ORDER BY {self._id}"

    def _largest(self) -> int:
        """The largest number of a row, or a larger one: a row takes 8 bytes and more."""
        with suppress(*_ERRORS):
            (found,) = self._base.execute(f"SELECT max({self._id}) FROM messages").fetchone()
            return int(found or 0)
        (pages,) = self._base.execute("PRAGMA page_count").fetchone()
        return int(pages) * 512

    def _block(self, rows: list[_Row]) -> Iterator[Block]:
        """The wanted ones of some rows; columns may hold any type in SQLite."""
        if not rows:
            return
        numbers, topics, times, payloads = zip(*rows, strict=True)
        topic, time = np.array(topics), np.array(times)
        if not topic.dtype == time.dtype == np.int64:
            good = [row for row in rows if type(row[1]) is type(row[2]) is int]
            self._findings.faults[_BROKEN_ROW] += len(rows) - len(good)
            yield from self._block(good)
            return
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
                for k, data in zip(mine.nonzero()[0], found, strict=True):
                    whole = data if type(data) is bytes else self._large(channel, numbers[k], data)
                    if whole is not None:
                        yield self._block_of(channel, self._sink[key], [whole], time[k : k + 1])

    def _block_of(
        self, channel: Channel, sink: int, payloads: list[bytes], time_ns: IntArray
    ) -> Block:
        block = Block.of(sink, time_ns, payloads)
        self._findings.seen(channel, len(payloads))
        self._read_bytes += len(block.data)
        return block

    def _large(self, channel: Channel, number: int, size: Any) -> bytes | None:
        """A payload that is asked for by itself; None if it is too long or damaged.

        size: its length, or what stands in its place.
        """
        longest = longest_message(channel)
        if isinstance(size, int) and size > longest:
            self._findings.too_large(channel.topic, longest)
            return None
        with suppress(*_ERRORS):
            query = f"SELECT data FROM messages WHERE {self._id} = ?"
            (payload,) = self._base.execute(query, (number,)).fetchone()
            if isinstance(payload, bytes):
                return payload
            self._findings.faults[_BROKEN_ROW] += 1
            return None
        self._findings.lost[channel.topic] += 1
        return None

    def _count_missing(self, number: IntArray) -> None:
        """Count the gaps in ascending numbers: a recorder counts from 1 on."""
        step = np.diff(number, prepend=self._last)
        self._missing += int((step[(step > 1) & (step <= MOST_MISSING)] - 1).sum())
        self._last = int(number[-1])


@contextmanager
def _connected(path: Path, anyhow: bool = False) -> Iterator[sqlite3.Connection]:
    """Open a database for reading, without leaving files beside it.

    Without unmerged changes only the file is opened (`immutable`); this would ignore a write-ahead
    log, so that with one the library opens both. If it cannot write the index that it needs then, a
    copy is opened. anyhow: even if the file is shorter than its header says.
    """
    name = quote(str(path.resolve()))
    if not any(log.stat().st_size for log in beside(path)):
        with closing(_opened(f"file:{name}?immutable=1", path, anyhow)) as base:
            yield base
        return
    index = path.with_name(path.name + "-shm")
    existed = index.exists()
    # An index that is there is the recorder's; what is wrong with it is worked out in memory.
    mode = "mode=ro&readonly_shm=1" if existed else "mode=ro"
    try:
        with closing(_opened(f"file:{name}?{mode}", path, anyhow)) as base:
            try:
                base.execute("SELECT 1 FROM sqlite_master").fetchone()
            except sqlite3.OperationalError:
                with _copied(path, anyhow) as copy:
                    yield copy
                return
            yield base
    finally:
        if not existed:
            index.unlink(missing_ok=True)


@contextmanager
def _copied(path: Path, anyhow: bool) -> Iterator[sqlite3.Connection]:
    with tempfile.TemporaryDirectory(prefix="topobatch-") as folder:
        target = Path(folder) / path.name
        for source in (path, *beside(path)):
            shutil.copyfile(source, target.with_name(source.name))
        with closing(_opened(f"file:{quote(str(target))}", path, anyhow)) as base:
            yield base


def _opened(uri: str, path: Path, anyhow: bool) -> sqlite3.Connection:
    """A read-only connection that runs no code of the file, with work limited by the file's
    size."""
    try:
        base = sqlite3.connect(uri, uri=True)
    except sqlite3.Error as error:
        raise LogError(f"{path}: cannot be opened as a database ({one_line(error)})") from error
    base.text_factory = lambda raw: raw.decode("utf-8", "replace")
    size = sum(file.stat().st_size for file in (path, *beside(path)))
    left = LEAST_STEPS + STEPS_PER_BYTE * size

    def spent() -> bool:
        nonlocal left
        left -= STEPS_AT_ONCE
        return left < 0

    base.set_progress_handler(spent, STEPS_AT_ONCE)
    with suppress(*_ERRORS):  # what is wrong with the file shows when it is asked for something
        base.execute("PRAGMA trusted_schema = OFF")
        if anyhow:
            base.execute("PRAGMA writable_schema = ON")
    return base


def _length(path: Path) -> tuple[int, int]:
    """Size of a page, and of the file by its header, 0 if that is not said [bytes]."""
    with path.open("rb") as file:
        head = file.read(96)
    page = int.from_bytes(head[16:18], "big")
    page = page if page in PAGES else PAGES[-1]
    # The count of pages is right if the one who changed the file last wrote it.
    counted = head[24:28] == head[92:96]
    return page, int.from_bytes(head[28:32], "big") * page if counted else 0


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
        f"SELECT id, {short} FROM topics LIMIT {TOPICS}"
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


def _counts(base: sqlite3.Connection) -> dict[int, int]:
    """Messages per topic."""
    return dict(base.execute("SELECT topic_id, count(*) FROM messages GROUP BY topic_id"))


def _present(base: sqlite3.Connection, keys: list[int]) -> dict[int, int]:
    """Topics with any message; most are among the first rows, those that are not take one pass."""
    early = "SELECT DISTINCT topic_id FROM (SELECT topic_id FROM messages LIMIT 5000)"
    present = {key for (key,) in base.execute(early)}
    if not present.issuperset(keys):
        present = {key for (key,) in base.execute("SELECT DISTINCT topic_id FROM messages")}
    return dict.fromkeys(present, 1)
