"""The cache of a workspace: packs of results, which may be deleted at any time.

Files are named by their content and never changed, so that several processes may add to one folder.
Damaged, outdated and foreign files are ignored: the results are computed again.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, nullcontext
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..topology.arrays import IntArray
from ..topology.errors import DocumentError
from ..topology.files import opened, write_atomically
from .digests import digested
from .packs import RECORD, DamagedPackError, Key, Kind, Pack, Rows

PACK = re.compile(r"[0-9a-f]{32}\.pack")
"""Names of the files; nothing else in the folder is touched."""

WRITTEN_TOGETHER = 16_000
"""Records per file: what a killed process loses, about 20 s of one core."""

MOST_FILES = 32
LEAST_LIVE = 0.5
"""With more files than this, or a smaller share of records in use, files are rewritten as one."""


Record = tuple[Pack, int, int, int]
"""A pack, and of a payload in it the offset, the size and the checksum."""


@dataclass(slots=True, eq=False)
class ResultCache:
    """Results of merging the maps of a workspace, of one era.

    say: called with a message if results cannot be written. held: entered while a file is written,
    because others may delete temporary files as leftovers.
    """

    folder: Path
    era: bytes
    say: Callable[[str], None] = lambda _: None
    held: Callable[[], AbstractContextManager[object]] = nullcontext
    _new: list[Pack] = field(default_factory=list)
    _unwritten: int = 0
    _failed: bool = False
    _packs: dict[Path, Pack | None] = field(default_factory=dict)
    _rows: dict[Kind, dict[Key, list[Record]]] = field(default_factory=dict)
    _wanted: set[bytes] = field(default_factory=set)

    def packs(self, digests: Sequence[bytes]) -> list[Pack]:
        """All results known; those about the given digests are marked as wanted."""
        self._wanted.update(digests)
        return [*(pack for _, pack in self._whole()), *self._new]

    def find(self, kind: Kind, key: Key) -> bytes | None:
        """The payload of a record, marked as wanted; None if there is no undamaged one."""
        self._wanted.update(key)
        return next(_undamaged(self._of(kind).get(key, ())), None)

    def every(self, kind: Kind) -> Iterator[bytes]:
        """The payloads of all undamaged records of a kind."""
        return _undamaged(record for known in self._of(kind).values() for record in known)

    def keep(self, pack: Pack) -> None:
        """Add results; they are written in batches."""
        self._new.append(pack)
        for kind in self._rows:
            self._enter(pack, kind)
        self._unwritten += len(pack)
        if self._unwritten >= WRITTEN_TOGETHER:
            self.flush()

    def flush(self) -> None:
        """Write what was added and release it; if that fails, keep it in memory."""
        if self._new and not self._failed and self._write(joined(self.era, self._new)) is not None:
            self._new.clear()
            self._unwritten = 0

    def settle(self) -> None:
        """Drop records that are not wanted or of another era, once they are a large share."""
        self.flush()
        whole, wanted = dict(self._whole()), frozenset(self._wanted)
        packs = list(whole.values())
        small = [path for path, pack in whole.items() if len(pack) < WRITTEN_TOGETHER // 2]
        worn = list(whole)
        if joined_count(packs, wanted) >= LEAST_LIVE * sum(map(len, packs)):
            worn = small if len(small) > MOST_FILES else []
        made = self._made_new([whole[path] for path in worn], wanted)
        if made is None:
            return
        for path in self._files():
            if path not in made and (path in worn or path not in whole):
                whole.pop(path, None)
                self._packs.pop(path, None)  # which closes it
                path.unlink(missing_ok=True)

    def _made_new(self, packs: Sequence[Pack], wanted: frozenset[bytes]) -> list[Path] | None:
        """The wanted records of some packs in new files; None if these cannot be written."""
        made: list[Path] = []
        some: list[Pack] = []
        for k, pack in enumerate(packs):
            some.append(pack)
            if k + 1 < len(packs) and sum(map(len, some)) < 2 * WRITTEN_TOGETHER:
                continue
            live = joined(self.era, some, wanted)
            path = self._write(live) if len(live) else None
            if path is not None:
                made.append(path)
            elif len(live):
                return None
            some = []
        return made

    def _of(self, kind: Kind) -> dict[Key, list[Record]]:
        """The records of a kind, by key."""
        if kind not in self._rows:
            self._rows[kind] = {}
            for pack in self.packs(()):
                self._enter(pack, kind)
        return self._rows[kind]

    def _enter(self, pack: Pack, kind: Kind) -> None:
        """Index the records of a kind by key."""
        chosen = pack.rows[pack.rows["kind"] == kind]
        columns = (chosen[name].tolist() for name in ("a", "b", "start", "size", "check"))
        for a, b, *where in zip(*columns, strict=True):
            key = pack.digests[a], pack.digests[b]
            self._rows[kind].setdefault(key, []).append((pack, *where))

    def _files(self) -> Iterator[Path]:
        if self.folder.is_dir():
            for path in sorted(self.folder.iterdir()):
                if PACK.fullmatch(path.name) and (path.is_file() or path.is_symlink()):
                    yield path

    def _whole(self) -> Iterator[tuple[Path, Pack]]:
        """The readable packs of this era; each is read once."""
        for path in self._files():
            if path not in self._packs:
                self._packs[path] = self._pack(path)
            pack = self._packs[path]
            if pack is not None and pack.era == self.era:
                yield path, pack

    def _pack(self, path: Path) -> Pack | None:
        try:
            with ExitStack() as stack:
                pack = Pack.of_file(stack.enter_context(opened(path)))
                stack.pop_all()  # from now on the pack's
                return pack
        except (DamagedPackError, DocumentError, OSError):
            return None  # a cache: its results are made again, and `settle` removes the file

    def _write(self, pack: Pack) -> Path | None:
        data = pack.to_bytes()
        path = self.folder / f"{digested(data).hex()}.pack"
        try:
            with self.held():
                write_atomically(path, lambda temporary: temporary.write_bytes(data))
        except OSError as error:
            self._failed = True
            self.say(f"{self.folder}: results are not kept: {error.strerror or error}")
            return None
        self._packs[path] = self._pack(path)
        return path


def joined(era: bytes, packs: Sequence[Pack], wanted: frozenset[bytes] | None = None) -> Pack:
    """One pack with the records of several, without damaged ones and those of maps that are not
    wanted. Of two records with the same key the first is kept."""
    number: dict[bytes, int] = {}
    parts, payloads, end = [], [], 0
    for pack in packs:
        chosen, rows = _of_wanted(pack, number, wanted)
        found = [pack.payload(row) for row in chosen.tolist()]
        rows = rows[np.array([payload is not None for payload in found], np.bool_)]
        ends = end + np.cumsum([0, *rows["size"].tolist()])
        rows["start"] = ends[:-1]
        payloads += [payload for payload in found if payload is not None]
        parts.append(rows)
        end = int(ends[-1])
    rows, first = _firsts(parts)
    if len(first) < len(rows):
        payloads = [payloads[k] for k in first.tolist()]
        rows = rows[first]
        rows["start"] = np.cumsum([0, *rows["size"].tolist()])[:-1]
    return Pack(era, tuple(number), rows, b"".join(payloads))


def joined_count(packs: Sequence[Pack], wanted: frozenset[bytes]) -> int:
    """Number of records of `joined` if none is damaged; payloads are not read."""
    number: dict[bytes, int] = {}
    return len(_firsts([_of_wanted(pack, number, wanted)[1] for pack in packs])[1])


def _of_wanted(
    pack: Pack, number: dict[bytes, int], wanted: frozenset[bytes] | None
) -> tuple[IntArray, Rows]:
    """The records of wanted maps: their rows, and the records with the maps renumbered; `number` is
    extended by new maps."""
    new = [
        number.setdefault(d, len(number)) if wanted is None or d in wanted else -1
        for d in pack.digests
    ]
    to = np.array(new or [-1], np.int64)
    a, b = to[pack.rows["a"]], to[pack.rows["b"]]
    chosen = np.flatnonzero((a >= 0) & (b >= 0))
    rows = pack.rows[chosen].copy()
    rows["a"], rows["b"] = a[chosen], b[chosen]
    return chosen, rows


def _firsts(parts: Sequence[Rows]) -> tuple[Rows, IntArray]:
    """All records concatenated, and the rows of the first one per key."""
    rows = np.concatenate(parts) if parts else np.zeros(0, RECORD)
    keys = np.stack([rows["a"], rows["b"], rows["kind"]], axis=1)
    return rows, np.sort(np.unique(keys, axis=0, return_index=True)[1])


def _undamaged(records: Iterable[Record]) -> Iterator[bytes]:
    """The payloads of the undamaged records."""
    for pack, *where in records:
        payload = pack.read(*where)
        if payload is not None:
            yield payload
