"""Results of earlier merges, in one table of a SQLite database that may be deleted at any time.

Expensive, deterministic results are kept by the content that they follow from. What is damaged, or
made by another version of the program, is computed again.
"""

from __future__ import annotations

import hashlib
import sqlite3
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import fields
from enum import StrEnum
from functools import cache
from pathlib import Path
from typing import Any

from ..topology.topomap import TopoMap
from .codec import to_bytes

Key = tuple[bytes, bytes]
"""Digests of two maps, of a map twice, or of a component twice."""

WRITTEN_TOGETHER = 1000
"""Results per transaction: what a killed process loses, about a second of one core."""

TABLE = (
    "CREATE TABLE IF NOT EXISTS result (kind TEXT, a BLOB, b BLOB, era BLOB, crc INTEGER, "
    "data BLOB, PRIMARY KEY (kind, a, b))"
)


class Kind(StrEnum):
    """What a result is of, in words."""

    PAIR = "pairs of maps"
    ITSELF = "maps with themselves"
    MIRRORED = "pairs to be merged with mirror images"
    """One map matched with the mirror image of the other."""
    COMPONENT = "components"
    """Several maps fused into one."""


class Kept:
    """Results of one era, in a file, or in memory alone.

    era: digest of what they depend on beside their keys (program, settings). say: called with a
    message if they cannot be written. held: entered while the file is written.
    """

    def __init__(
        self,
        path: Path | None = None,
        era: bytes = b"",
        say: Callable[[str], None] = lambda _: None,
        held: Callable[[], AbstractContextManager[object]] = nullcontext,
    ) -> None:
        self.path = path
        self.era = era
        self._say = say
        self._held = held
        self._new: dict[tuple[Kind, Key], bytes] = {}
        self._wanted: set[bytes] = set()
        self._digests: dict[int, tuple[TopoMap, bytes]] = {}
        self._database: sqlite3.Connection | None = None

    def __del__(self) -> None:
        if self._database is not None:
            self._database.close()

    def digest(self, topomap: TopoMap) -> bytes:
        """`digest_of` a map, computed once."""
        if id(topomap) not in self._digests:
            self._digests[id(topomap)] = topomap, digest_of(topomap)
        return self._digests[id(topomap)][1]

    def find(self, kind: Kind, keys: Iterable[Key]) -> Iterator[bytes | None]:
        """The result of each key, None where it is not known."""
        for key in keys:
            self._wanted.update(key)
            yield self._new[kind, key] if (kind, key) in self._new else self._read(kind, key)

    def add(self, kind: Kind, key: Key, data: bytes) -> None:
        """Keep a result; they are written in batches."""
        self._wanted.update(key)
        self._new[kind, key] = data
        if self.path is not None and len(self._new) >= WRITTEN_TOGETHER:
            self.flush()

    def result(self, kind: Kind, key: Key, made: Callable[[], bytes]) -> bytes:
        """The result of a key; made and kept where it is not known."""
        (data,) = self.find(kind, [key])
        if data is None:
            data = made()
            self.add(kind, key, data)
        return data

    def flush(self) -> None:
        """Write what was added; if that fails, it stays in memory."""
        rows = [
            (kind, *key, self.era, zlib.crc32(data), data)
            for (kind, key), data in self._new.items()
        ]
        if rows and self._written("INSERT OR REPLACE INTO result VALUES (?, ?, ?, ?, ?, ?)", rows):
            self._new.clear()

    def settle(self) -> None:
        """Drop results that were not asked for since this was made, and those of other eras."""
        self.flush()
        every = self._rows("SELECT rowid, a, b, era FROM result")
        wanted, era = self._wanted, self.era
        gone = [(row,) for row, a, b, of in every if of != era or not wanted.issuperset((a, b))]
        if gone:
            self._written("DELETE FROM result WHERE rowid = ?", gone)

    def _read(self, kind: Kind, key: Key) -> bytes | None:
        """The result of a key in the database, None where it is not there or damaged."""
        query = (
            "SELECT crc, CAST(data AS BLOB) FROM result "
            "WHERE kind = ? AND a = ? AND b = ? AND era = ?"
        )
        rows = self._rows(query, (kind, *key, self.era))
        return next((data for crc, data in rows if zlib.crc32(data or b"") == crc), None)

    def _rows(self, statement: str, values: tuple[object, ...] = ()) -> list[Any]:
        """The rows that a statement gives; none without a database."""
        if self._database is None and not (self.path and self.path.exists()):
            return []
        try:
            return self._opened().execute(statement, values).fetchall()
        except sqlite3.Error as error:
            self._give_up(error)
            return []

    def _written(self, statement: str, rows: Sequence[tuple[object, ...]]) -> bool:
        """Whether a statement was executed for all rows; else for none."""
        if self.path is None:
            return False
        try:
            with self._held():
                self.path.parent.mkdir(parents=True, exist_ok=True)
                with self._opened() as database:  # a transaction
                    database.executemany(statement, rows)
        except (sqlite3.Error, OSError) as error:
            self._give_up(error)
            return False
        return True

    def _opened(self) -> sqlite3.Connection:
        """The database, opened once."""
        if self._database is None:
            assert self.path is not None
            self._database = sqlite3.connect(self.path)
            self._database.execute("PRAGMA synchronous = OFF")  # a cache: may be lost
            self._database.execute(TABLE)
        return self._database

    def _give_up(self, error: Exception) -> None:
        """Start anew where the database is damaged; else go on without one."""
        if self._database is not None:
            self._database.close()
        self._database = None
        if isinstance(error, OSError | sqlite3.OperationalError):  # locked, read-only, no space
            self._say(f"{self.path}: results are not kept: {error}")
            self.path = None
        elif self.path is not None:
            self.path.unlink(missing_ok=True)


DIGEST = 16
"""Bytes of a digest: a collision is expected after 2⁶⁴ contents."""

NOT_CONTENT = frozenset({"run", "frame", "closures", "info", "turning_points", "views"})
"""Fields of a map that matching does not use; and its views, which are content where there are
any."""


def digested(*parts: bytes) -> bytes:
    """A 16-byte digest of the concatenated parts."""
    return hashlib.blake2b(b"".join(parts), digest_size=DIGEST).digest()


@cache
def program_digest(*folders: str) -> bytes:
    """A 16-byte digest of all code in some folders, because a version number might be forgotten."""
    root = Path(__file__).parents[1]
    paths = [path for folder in folders for path in sorted((root / folder).rglob("*.py"))]
    return digested(*(p.relative_to(root).as_posix().encode() + p.read_bytes() for p in paths))


def digest_of(topomap: TopoMap) -> bytes:
    """A 16-byte digest of a map's content, independent of the name of its run."""
    content = [getattr(topomap, f.name) for f in fields(topomap) if f.name not in NOT_CONTENT]
    views = topomap.views
    return digested(to_bytes([*content, *([views.pose, views.cells] if len(views) else [])]))
