"""The cache of a workspace: packs of results, which may be deleted at any time.

Files are named by their content and never changed, so that several processes may add to one
folder. What is damaged, stale or no pack is passed over: the results are made again.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path

from ..topology.document import read_bytes, write_atomically
from ..topology.errors import DocumentError
from ..topology.topomap import TopoMap
from .packs import DamagedPackError, Pack, digest_of, joined, joined_count
from .robust.pairing import era_of
from .robust.settings import RobustSettings

PACK = re.compile(r"[0-9a-f]{32}\.pack")
"""Names of the files; nothing else in the folder is touched."""

WRITTEN_TOGETHER = 16
"""Tasks whose results are kept in one file: what a killed process loses, some 20 s of one core."""

MOST_FILES = 32
LEAST_LIVE = 0.5
"""More files than this, or a smaller share of records that are of use, and all are made one."""


@dataclass(slots=True, eq=False)
class PairCache:
    """Results of matching the maps of a workspace. say: is told what could not be written; held:
    entered while a file is written, where others may clear away what they take for left over."""

    folder: Path
    say: Callable[[str], None] = lambda _: None
    held: Callable[[], AbstractContextManager[object]] = nullcontext
    _new: list[Pack] = field(default_factory=list)
    _failed: bool = False

    def packs(self, era: bytes, digests: Sequence[bytes]) -> list[Pack]:
        """What is known of an era about maps of such content."""
        wanted = frozenset(digests)
        return [pack for _, pack in self._whole(era) if wanted.intersection(pack.digests)]

    def keep(self, pack: Pack) -> None:
        """Add results; they are written a few at a time."""
        self._new.append(pack)
        if len(self._new) >= WRITTEN_TOGETHER:
            self.flush()

    def flush(self) -> None:
        """Write what was added. Where that cannot be, nothing is lost but time."""
        if self._new and not self._failed:
            self._write(joined(self._new[0].era, self._new))
        self._new.clear()

    def settle(self, maps: Sequence[TopoMap], settings: RobustSettings) -> None:
        """Drop what belongs to none of these maps, or to another era, once that is much."""
        self.flush()
        era, wanted = era_of(settings), frozenset(map(digest_of, maps))
        whole = dict(self._whole(era))
        files = list(self._files())
        packs = list(whole.values())
        useful = joined_count(packs, wanted) >= LEAST_LIVE * sum(map(len, packs))
        if len(files) == len(whole) <= MOST_FILES and useful:
            return
        live = joined(era, packs, wanted)
        kept = self._write(live) if len(live) else None
        if kept is not None or not len(live):
            for path in files:
                if path != kept:
                    path.unlink(missing_ok=True)

    def _files(self) -> Iterator[Path]:
        if self.folder.is_dir():
            for path in sorted(self.folder.iterdir()):
                if PACK.fullmatch(path.name) and (path.is_file() or path.is_symlink()):
                    yield path

    def _whole(self, era: bytes) -> Iterator[tuple[Path, Pack]]:
        """The packs of an era that can be read."""
        for path in self._files():
            try:
                pack = Pack.from_bytes(read_bytes(path))
            except (DamagedPackError, DocumentError, OSError):
                continue  # a cache: its results are made again, and `settle` removes the file
            if pack.era == era:
                yield path, pack

    def _write(self, pack: Pack) -> Path | None:
        data = pack.to_bytes()
        path = self.folder / f"{hashlib.blake2b(data, digest_size=16).hexdigest()}.pack"
        try:
            with self.held():
                write_atomically(path, lambda temporary: temporary.write_bytes(data))
        except OSError as error:
            self._failed = True
            self.say(f"{self.folder}: results are not kept: {error.strerror or error}")
            return None
        return path
