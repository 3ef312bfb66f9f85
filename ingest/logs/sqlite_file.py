"""Reading ROS 2 bags in SQLite, including messages in a write-ahead log; damage ends a read
early."""

from __future__ import annotations

import shutil
import sqlite3
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from ...topology.arrays import IntArray
from ...topology.errors import LogError
from .described import DEFINITION_BYTES
from .inflate import keep_freed_memory
from .limits import longest_message
from .messages import (
    MESSAGE_BYTES,
    NAME_BYTES,
    SCHEMA_BYTES,
    UNWANTED,
    Block,
    Channel,
    DamageError,
    FileWindow,
    Findings,
    Progress,
    Survey,
    Want,
    normal_topic,
    normal_type,
    one_line,
    printable,
    several,
)
from .spelling import spelled
from .sqlite_pages import Pages, Rows
from .sqlite_topics import topics_by_looks

MAGIC = b"SQLite format 3\x00"
ROWS = 2048
_ERRORS = (sqlite3.Error, ValueError, TypeError, OverflowError, MemoryError)
"""Exceptions of the library on a damaged database: its own, and those of converting values."""

MOST_PAGES = 1 << 31
"""A larger page count in the header counts as damage."""

_TOPICS = 1 << 15
_UNKNOWN = -2
"""Topic ids below _TOPICS are looked up in a table; its value for unknown ones."""


_Row = tuple[Any, ...]
"""Topic, time, payload if wanted, type and length of the payload; its number, if asked for."""

FETCHED = 500
"""Rows asked for by their numbers at a time; a query for each takes 5 times as long."""

HELD_BYTES = 1 << 22
"""Limit on payloads fetched from the database at a time."""

LEAST_STEPS = 1 << 25
STEPS_PER_BYTE = 4
"""Limit on the virtual machine's steps for one connection: LEAST_STEPS (about a second) plus
STEPS_PER_BYTE of the file, since a row takes about ten steps and at least ten bytes."""

MOST_PROBED = 100
"""Limit on topics that are searched for one by one if they are not among the first rows."""

STEPS_AT_ONCE = 10_000
"""Virtual machine steps between two checks of the limit."""


def _columns_of(wanted: str, longest: int) -> str:
    """Columns of a query; wanted: SQL condition for reading the payload, if it is not longer than
    `longest`. Its length is in the row's head."""
    fits = f"{_BLOB} AND length(data) <= {longest}"
    data = f"CASE WHEN {wanted} AND {fits} THEN data END"
    return f"topic_id, timestamp, {data}, typeof(data), CASE WHEN {_BLOB} THEN length(data) END"


_BLOB = "typeof(data) = 'blob'"


class SqliteFile:
    """One `.db3` file."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def survey(self, exact: bool = False) -> Survey | None:
        """Channels with their counts; None if the tables cannot be read.

        exact: count all rows. Else a channel with any message counts as 1: counting reads every
        row's page, which takes as long as reading the run.
        """
        try:
            with _connected(self.path) as base:
                channels = _channels(base)
                present = _counts(base) if exact else _present(base, list(channels))
                counts = dict.fromkeys(channels.values(), 0)
                for key, count in present.items():
                    if key in channels:
                        counts[channels[key]] += count
                first, last = _span(base)
        except (*_ERRORS, DamageError):
            return None
        return Survey(counts, first or 0, last or 0)

    def blocks(
        self, want: Want, findings: Findings, progress: Progress | None = None
    ) -> Iterator[Block]:
        """All messages in the order of their rows. O(bytes of the pages that hold any).

        Parses the pages where possible; reads through the library if some messages are in a
        write-ahead log; scans every page of a database that the library refuses.
        """
        keep_freed_memory()
        with FileWindow(self.path, progress) as window:
            before = findings.messages
            try:
                with _connected(self.path) as base:
                    reader = _Reader(base, _channels(base), want, findings)
                    root = None if _unmerged(self.path) else _root(base)
                    if root is None:
                        yield from reader.by_library()
                    else:
                        yield from reader.by_pages(Pages(window), root)
            except (*_ERRORS, DamageError) as error:
                findings.note(f"the database is damaged ({one_line(error)})")
                # The tree of pages is read before any row: what fails later has given its rows.
                if findings.messages == before:
                    yield from self._salvaged(window, want, findings)
            window.passed(window.size)

    def _salvaged(self, window: FileWindow, want: Want, findings: Findings) -> Iterator[Block]:
        """The rows on every readable page, without the B-tree that orders them."""
        try:
            pages = Pages(window, anyhow=True)
            declared = int.from_bytes(window.view(28, 4).tobytes(), "big")
            findings.truncated |= pages.count < declared < MOST_PAGES
            channels = self._described(pages, findings)
            yield from _Reader(None, channels, want, findings).by_every_page(pages)
        except (*_ERRORS, DamageError) as error:
            findings.note(f"its rows cannot be read ({one_line(error)})")

    def _described(self, pages: Pages, findings: Findings) -> dict[int, Channel]:
        """The topics, by the library if it opens the file, else recognised on the pages."""
        try:
            with _connected(self.path) as base:
                # Lets the library open a file that is shorter than its header says.
                base.execute("PRAGMA writable_schema = ON")
                return _channels(base)
        except (*_ERRORS, DamageError) as error:
            findings.note(f"its topics cannot be read ({one_line(error)})")
        return topics_by_looks(pages)


class _Reader:
    """Returns the rows of one database as blocks, and counts them."""

    def __init__(
        self,
        base: sqlite3.Connection | None,
        channels: dict[int, Channel],
        want: Want,
        findings: Findings,
    ) -> None:
        self._base = base
        self._findings = findings
        self._channels = channels
        self._sink = np.full(_TOPICS, _UNKNOWN, np.int64)
        for key, channel in self._channels.items():
            sink = want(channel)
            if 0 <= key < _TOPICS:
                self._sink[key] = sink
        self._wanted = np.unique(self._sink[self._sink >= 0]).tolist()
        wanted = (c for key, c in channels.items() if self._is_wanted(key))
        self._longest = max(map(longest_message, wanted), default=MESSAGE_BYTES)

    def by_library(self) -> Iterator[Block]:
        """All rows by the library; of unwanted ones only the heads are read."""
        wanted = ",".join(str(k) for k in np.flatnonzero(self._sink >= 0).tolist())
        query = f"SELECT {_columns_of(f'topic_id IN ({wanted})', self._longest)} FROM messages"
        yield from self._in_blocks(self._asked(query))

    def _asked(self, query: str, values: Sequence[int] = ()) -> Iterator[_Row]:
        assert self._base is not None
        return self._base.execute(query, values)

    def _in_blocks(self, found: Iterator[_Row]) -> Iterator[Block]:
        """Rows in blocks of bounded memory."""
        rows: list[_Row] = []
        held = 0
        for row in found:
            rows.append(row)
            held += len(row[2]) if type(row[2]) is bytes else 0
            if len(rows) == ROWS or held > HELD_BYTES:
                yield from self._block(rows)
                rows, held = [], 0
        if rows:
            yield from self._block(rows)

    def by_pages(self, pages: Pages, root: int) -> Iterator[Block]:
        """All rows from the leaf pages of the table; large ones by the library."""
        gaps = missing = short = last = 0
        for data in pages.batches(pages.leaves(root)):
            rows = pages.rows(data)
            self._findings.damaged_pages += rows.broken
            short += rows.short
            if len(rows.number):
                # A recorder numbers its rows from 1 on, one after the other.
                step = np.diff(rows.number, prepend=last)
                odd = int((step != 1).sum())
                gaps += odd
                missing += _missing(rows.number, last) if odd else 0
                last = int(rows.number[-1])
            yield from self._columns(rows)
            yield from self._large(rows)
        if gaps:
            self._findings.note(
                f"the numbers of the rows have {several(gaps, 'gap')}: {several(missing, 'row')} "
                "missing"
            )
        if short:
            self._findings.note(
                f"fewer rows than are there are listed by {several(short, 'page')} of the database"
            )

    def by_every_page(self, pages: Pages) -> Iterator[Block]:
        """All rows of known topics on any page that looks like a leaf."""
        for data in pages.batches(np.arange(1, pages.count + 1)):
            rows = pages.rows(data)
            yield from self._columns(rows.only(self._sinks(rows.topic) != _UNKNOWN))
            yield from self._spilled(pages, rows)

    def _columns(self, rows: Rows) -> Iterator[Block]:
        """The wanted rows of those that lie in pages; all are counted."""
        self._count(rows.topic, rows.time_ns)
        for sink, keep in self._by_sink(rows.topic):
            yield Block(rows.data, sink, rows.time_ns[keep], rows.start[keep], rows.size[keep])

    def _by_sink(self, topic: IntArray) -> Iterator[tuple[int, IntArray]]:
        """The wanted sinks among rows, each with its rows."""
        sink = self._sinks(topic)
        for number in self._wanted:
            rows = (sink == number).nonzero()[0]
            if len(rows):
                yield number, rows

    def _large(self, rows: Rows) -> Iterator[Block]:
        """Rows with overflow pages: unwanted ones are counted, the others fetched."""
        topic = rows.spilled.topic
        unwanted = (topic >= 0) & (self._sinks(topic) == UNWANTED)
        self._count(topic[unwanted], np.zeros(0, np.int64))
        wanted = zip(rows.elsewhere[~unwanted].tolist(), topic[~unwanted].tolist(), strict=True)
        yield from self._in_blocks(self._fetched(dict(wanted)))

    def _fetched(self, topics: dict[int, int]) -> Iterator[_Row]:
        """Rows by their numbers, with the topic of each; a broken one costs no other."""
        numbers = list(topics)
        for first in range(0, len(numbers), FETCHED):
            left = dict.fromkeys(numbers[first : first + FETCHED])
            with suppress(*_ERRORS):  # told where the row that is broken is asked for by itself
                for row in self._numbered(list(left)):
                    left.pop(row[-1], None)
                    yield row
            for number in left:
                found: list[_Row] = []
                try:
                    found += self._numbered([number])
                except _ERRORS as error:
                    self._findings.note(f"large rows cannot be read ({one_line(error)})")
                if not found:
                    self._lost(topics[number])
                yield from found

    def _numbered(self, numbers: Sequence[int]) -> Iterator[_Row]:
        marks = ",".join("?" * len(numbers))
        columns = f"{_columns_of('1', self._longest)}, id"
        return self._asked(f"SELECT {columns} FROM messages WHERE id IN ({marks})", numbers)

    def _spilled(self, pages: Pages, rows: Rows) -> Iterator[Block]:
        """Rows of known topics with overflow pages, without the library."""
        spilled = rows.spilled
        sink = np.where(spilled.topic >= 0, self._sinks(spilled.topic), _UNKNOWN)
        self._count(spilled.topic[sink == UNWANTED], np.zeros(0, np.int64))
        for k in np.flatnonzero(sink >= 0).tolist():
            topic, size = int(spilled.topic[k]), int(spilled.size[k])
            if not self._fits(topic, size):
                continue
            try:
                payload = pages.overflowing(
                    rows.data, int(spilled.start[k]), int(spilled.end[k]), size
                )
            except DamageError:
                self._lost(topic)
                continue
            time_ns = spilled.time_ns[k : k + 1]
            self._count(spilled.topic[k : k + 1], time_ns)
            yield Block(payload, int(sink[k]), time_ns, np.zeros(1, np.int64), np.array([size]))

    def _block(self, rows: list[_Row]) -> Iterator[Block]:
        """The wanted rows of a query as a block; columns may hold any type in SQLite."""
        good = [r for r in rows if type(r[0]) is type(r[1]) is int and r[3] == "blob"]
        self._findings.broken_rows += len(rows) - len(good)
        whole = [row for row in good if self._fits(row[0], row[4])]
        topic = np.array([row[0] for row in whole], np.int64)
        time_ns = np.array([row[1] for row in whole], np.int64)
        self._count(topic, time_ns)
        for sink, kept in self._by_sink(topic):
            payloads = [whole[k][2] for k in kept.tolist()]
            size = np.fromiter(map(len, payloads), np.int64, len(payloads))
            data = np.frombuffer(b"".join(payloads), np.uint8)
            yield Block(data, sink, time_ns[kept], np.cumsum(size) - size, size)

    def _sinks(self, topic: IntArray) -> IntArray:
        """The sink of each topic, UNWANTED or _UNKNOWN."""
        return np.asarray(self._sink[np.clip(topic, 0, _TOPICS - 1)])

    def _is_wanted(self, topic: int) -> bool:
        return 0 <= topic < _TOPICS and self._sink[topic] >= 0

    def _fits(self, topic: int, size: int) -> bool:
        """Whether a message is kept; else it is counted as too large."""
        if size <= MESSAGE_BYTES or not self._is_wanted(topic):
            return True
        channel = self._channels[topic]
        longest = longest_message(channel)
        if size > longest:
            self._findings.lost[channel.topic] += 1
            self._findings.too_large[channel.topic, longest] += 1
        return size <= longest

    def _lost(self, topic: int) -> None:
        channel = self._channels.get(topic)
        if channel is None:
            self._findings.broken_rows += 1
        else:
            self._findings.lost[channel.topic] += 1

    def _count(self, topic: IntArray, time_ns: IntArray) -> None:
        counts = np.bincount(np.clip(topic, 0, _TOPICS - 1))
        for key in np.flatnonzero(counts).tolist():
            channel = self._channels.get(key)
            if channel is None:
                self._findings.unknown += int(counts[key])
            else:
                self._findings.seen(channel, int(counts[key]))
        if len(time_ns):
            self._findings.span(int(time_ns.min()), int(time_ns.max()))


@contextmanager
def _connected(path: Path) -> Iterator[sqlite3.Connection]:
    """Open a database for reading, without leaving files beside it.

    Without unmerged changes only the file is opened (`immutable`); this would ignore a write-ahead
    log, so that with one the library opens both. If it cannot write the index that it needs then, a
    copy is opened.
    """
    name = quote(str(path.resolve()))
    if not _unmerged(path):
        with closing(_opened(f"file:{name}?immutable=1", path)) as base:
            yield base
        return
    index = path.with_name(path.name + "-shm")
    existed = index.exists()
    # An index that is there is the recorder's; what is wrong with it is worked out in memory.
    mode = "mode=ro&readonly_shm=1" if existed else "mode=ro"
    try:
        with closing(_opened(f"file:{name}?{mode}", path)) as base:
            try:
                base.execute("SELECT 1 FROM sqlite_master").fetchone()
            except sqlite3.OperationalError:
                with _copied(path) as copy:
                    yield copy
                return
            yield base
    finally:
        if not existed:
            index.unlink(missing_ok=True)


@contextmanager
def _copied(path: Path) -> Iterator[sqlite3.Connection]:
    with tempfile.TemporaryDirectory(prefix="topobatch-") as folder:
        target = Path(folder) / "copy.db3"
        for suffix in ("", "-wal", "-journal"):
            source = path.with_name(path.name + suffix)
            if source.is_file():
                shutil.copyfile(source, target.with_name(target.name + suffix))
        with closing(_opened(f"file:{quote(str(target))}", path)) as base:
            yield base


def _opened(uri: str, path: Path) -> sqlite3.Connection:
    """A read-only connection that runs no code of the file, with work limited by the file's
    size."""
    try:
        base = sqlite3.connect(uri, uri=True)
    except sqlite3.Error as error:
        raise LogError(f"{path}: cannot be opened as a database ({one_line(error)})") from error
    base.text_factory = lambda raw: raw.decode("utf-8", "replace")
    left = LEAST_STEPS + STEPS_PER_BYTE * _size(path)

    def spent() -> bool:
        nonlocal left
        left -= STEPS_AT_ONCE
        return left < 0

    base.set_progress_handler(spent, STEPS_AT_ONCE)
    with suppress(*_ERRORS):  # what is wrong with the file shows when it is asked for something
        base.execute("PRAGMA trusted_schema = OFF")
    return base


def _size(path: Path) -> int:
    """Bytes of a database and its write-ahead log."""
    beside = (path.with_name(path.name + suffix) for suffix in ("", "-wal"))
    return sum(file.stat().st_size for file in beside if file.is_file())


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
        f"SELECT id, {short} FROM topics LIMIT {_TOPICS}"
    ):
        kind, body = definitions.get(str(type_name), ("", b""))
        names = normal_topic(printable(str(name))), normal_type(printable(str(type_name)))
        # The recorder wrote the first one, whatever else calls itself so.
        out.setdefault(int(key), spelled(Channel(*names, printable(str(form)), body, kind)))
    return out


def _definitions(base: sqlite3.Connection) -> dict[str, tuple[str, bytes]]:
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
    """Topics with any message; most are among the first rows."""
    early = base.execute("SELECT DISTINCT topic_id FROM (SELECT topic_id FROM messages LIMIT 5000)")
    present = {key for (key,) in early}
    left, row = set(keys) - present, -(1 << 63)
    if len(left) > MOST_PROBED:
        present.update(key for (key,) in base.execute("SELECT DISTINCT topic_id FROM messages"))
        left.clear()
    while left:
        # Each search goes on where the one before ended: all topics without messages take one pass.
        marks = ",".join("?" * len(left))
        probe = f"rowid >= ? AND topic_id IN ({marks}) ORDER BY rowid LIMIT 1"
        query = f"SELECT rowid, topic_id FROM messages WHERE {probe}"
        found = base.execute(query, (row, *left)).fetchone()
        if found is None or found[1] not in left:
            break
        row = found[0]
        present.add(found[1])
        left.remove(found[1])
    return dict.fromkeys(present, 1)


def _span(base: sqlite3.Connection) -> tuple[int | None, int | None]:
    """First and last log time [ns], None without messages."""
    query = "SELECT min(timestamp), max(timestamp) FROM messages"
    if base.execute("PRAGMA index_list(messages)").fetchone():
        # Asked for one by one, either is a look at one end of the recorder's index.
        ends = ("(SELECT min(timestamp) FROM messages)", "(SELECT max(timestamp) FROM messages)")
        query = f"SELECT {', '.join(ends)}"
    first, last = base.execute(query).fetchone()
    return first, last


def _unmerged(path: Path) -> bool:
    """Whether a write-ahead log holds changes that the database lacks."""
    beside = (path.with_name(path.name + suffix) for suffix in ("-wal", "-journal"))
    return any(log.is_file() and log.stat().st_size > 0 for log in beside)


def _missing(number: IntArray, last: int) -> int:
    """Number of rows missing between ascending ids; `last`: the id before them.

    An id that fits neither of its neighbours is wrong itself and is ignored.
    """
    before = np.concatenate([[last], number[:-1]])
    after = np.concatenate([number[1:], number[-1:] + 1])
    number = np.where(after == before + 2, before + 1, number)
    step = np.diff(number, prepend=last)
    return int((step[(step > 1) & (step <= MOST_MISSING)] - 1).sum())


MOST_MISSING = 1 << 20
"""A larger step counts as a wrong id."""


def _root(base: sqlite3.Connection) -> int | None:
    """Root page of the messages table, None if the table is not laid out as usual."""
    columns = [row[1:3] for row in base.execute("PRAGMA table_info(messages)")]
    if [name for name, _ in columns] != ["id", "topic_id", "timestamp", "data"]:
        return None
    query = "SELECT rootpage, sql FROM sqlite_master WHERE type = 'table' AND name = 'messages'"
    root, sql = base.execute(query).fetchone()
    # Only this declaration makes the id the row's own number, which is not stored in the row.
    usual = columns[0][1].upper() == "INTEGER" and "PRIMARY KEY" in sql.upper()
    return int(root) if usual and "WITHOUT" not in sql.upper() else None
