"""SQLite's write-ahead log, where it is damaged: which of its frames hold, and merging them.

The library stops at the first frame whose checksum is wrong, without a word. Checksums are chained:
each frame's starts from the one before, as stored, so that the frames behind a wrong one can be
checked all the same (https://www.sqlite.org/fileformat2.html, section 4).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...topology.arrays import BoolArray, IntArray
from .messages import CUT, Bytes, Findings, several

HEAD_BYTES, FRAME_HEAD = 32, 24
FRAMES_AT_ONCE = 1024
"""Frames that are checked together: 4 MiB of usual ones."""

LITTLE, BIG = 0x377F0682, 0x377F0683
"""Magic numbers: the byte order in which checksums are added up. All else is big-endian."""


class WriteAhead(NamedTuple):
    """The frames of a database's write-ahead log, up to the last that belongs to it.

    page: (n,) the page that each holds; pages: (n,) pages of the database after a commit, else 0;
    holds: (n,) whether its checksum does; size: bytes of a page; head_holds: whether the log's own
    header does; rest: bytes behind the last whole frame.
    """

    path: Path
    log: Path
    page: IntArray
    pages: IntArray
    holds: BoolArray
    size: int
    head_holds: bool
    rest: int

    @property
    def committed(self) -> int:
        """Number of frames up to the last commit that holds."""
        found = np.flatnonzero(self.holds & (self.pages > 0))
        return int(found[-1]) + 1 if len(found) else 0

    @property
    def damaged(self) -> bool:
        """Whether the library would leave out anything of it."""
        broken = not (self.head_holds and self.holds.all())
        return broken or self.committed < len(self.page) or self.rest > 0

    def merge(self, copy: Path, findings: Findings) -> None:
        """Write all frames that hold, up to the last commit, into a copy of the database, and tell
        what is left out, in bytes."""
        wrong = int((~self.holds[: self.committed]).sum())
        frame = FRAME_HEAD + self.size
        if not self.head_holds:
            findings.note("the header of the database's write-ahead log is damaged")
        if wrong:
            findings.note(
                f"{several(wrong, 'page')} ({wrong * frame} bytes) of the database's write-ahead "
                "log damaged; what follows is used"
            )
        left = (len(self.page) - self.committed) * frame + self.rest
        if left:
            findings.note(f"the last {left} bytes of the database's write-ahead log are no whole")
            findings.faults[CUT] = 1
        log = self.log
        most = (self.path.stat().st_size + log.stat().st_size) // self.size
        with log.open("rb") as source, copy.open("r+b") as target:
            for k in np.flatnonzero(self.holds[: self.committed]).tolist():
                if 0 < self.page[k] <= most:
                    source.seek(HEAD_BYTES + k * (FRAME_HEAD + self.size) + FRAME_HEAD)
                    target.seek((int(self.page[k]) - 1) * self.size)
                    target.write(source.read(self.size))


def log_of(path: Path) -> Path | None:
    """The write-ahead log beside a database, if there is one that holds any change."""
    log = path.with_name(path.name + "-wal")
    return log if log.is_file() and log.stat().st_size > HEAD_BYTES else None


def page_bytes(path: Path) -> int:
    """The size of a database's pages by its header."""
    with path.open("rb") as file:
        return _page(int.from_bytes(file.read(18)[16:], "big"))


def _page(size: int) -> int:
    """A size that a page may have; where none is known, the largest."""
    return size if 512 <= size < 1 << 16 and size & (size - 1) == 0 else 1 << 16


def read_write_ahead(path: Path) -> WriteAhead | None:
    """The write-ahead log beside a database, None if there is none or it has no whole frame.

    What a log held before it was begun anew stands behind its frames, under another salt.
    """
    log = log_of(path)
    if log is None:
        return None
    with log.open("rb") as file:
        head = np.frombuffer(file.read(HEAD_BYTES), np.uint8)
        magic, _, size, *_ = words = head.view(">u4").tolist()
        head_holds = (
            magic in (LITTLE, BIG)
            and words[6:] == _sums(head[None, :24], magic, (0, 0))[0].tolist()
        )
        size = _page(size) if head_holds else page_bytes(path)
        frames = _frames(file, head, size, head_holds)
        rest = (log.stat().st_size - HEAD_BYTES) % (FRAME_HEAD + size)
    own = frames.own.nonzero()[0]
    count = int(own[-1]) + 1 if len(own) else 0
    rest = rest if count == len(frames.own) else 0
    if count == rest == 0:
        return None
    page, pages, holds = frames.page[:count], frames.pages[:count], frames.holds[:count]
    return WriteAhead(path, log, page, pages, holds, size, bool(head_holds), rest)


class _Frames(NamedTuple):
    """Columns of frames; own: whether they have the salt of this log."""

    page: IntArray
    pages: IntArray
    holds: BoolArray
    own: BoolArray


def _frames(file: BinaryIO, head: Bytes, size: int, head_holds: bool) -> _Frames:
    """All whole frames of a log, whose header was read already."""
    magic, frame = int(head.view(">u4")[0]), FRAME_HEAD + size
    salt, before = head[16:24], head[24:32]
    parts = [_Frames(*np.zeros((2, 0), np.int64), *np.zeros((2, 0), bool))]
    while raw := file.read(FRAMES_AT_ONCE * frame):
        rows = np.frombuffer(raw, np.uint8)[: len(raw) // frame * frame].reshape(-1, frame)
        if len(rows) == 0:
            break
        if len(parts) == 1 and not head_holds:
            salt = rows[0, 8:16]
        stored = rows[:, 16:24]
        start = np.vstack([before, stored[:-1]]).view(">u4")
        data = np.hstack([rows[:, :8], rows[:, FRAME_HEAD:]])
        own = np.asarray((rows[:, 8:16] == salt).all(axis=1))
        sums = _sums(data, magic, start)
        holds = own & (sums == np.ascontiguousarray(stored).view(">u4")).all(axis=1)
        page, pages = np.ascontiguousarray(rows[:, :8]).view(">u4").astype(np.int64).T
        parts.append(_Frames(page, pages, holds, own))
        before = stored[-1]
    return _Frames(*map(np.concatenate, zip(*parts, strict=True)))


def _sums(data: Bytes, magic: int, start: Any) -> NDArray[np.uint32]:
    """(n, 2) checksums of rows of bytes, each begun with two numbers (n, 2).

    Strategy: word by word, for all rows at once.
    """
    words = np.ascontiguousarray(data).view(">u4" if magic == BIG else "<u4")
    a, b = np.broadcast_to(np.asarray(start).astype(np.uint32), (len(words), 2)).T.copy()
    for k in range(0, words.shape[1], 2):
        a += words[:, k] + b
        b += words[:, k + 1] + a
    return np.stack([a, b], axis=1)
