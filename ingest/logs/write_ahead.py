"""SQLite's write-ahead log: merging the pages whose checksums hold into a copy of the database.

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


def merge_write_ahead(log: Path, copy: Path, findings: Findings) -> None:
    """Write all pages of a log that hold, up to the last commit, into a copy of its database, and
    tell what is left out, in bytes.

    What a log held before it was begun anew stands behind its frames, under another salt.
    """
    size = log.stat().st_size
    with log.open("rb") as source, copy.open("r+b") as target:
        head = np.frombuffer(source.read(HEAD_BYTES).ljust(HEAD_BYTES, b"\0"), np.uint8)
        magic, _, page, *_ = words = head.view(">u4").tolist()
        own_sums = _sums(head[None, :24], magic, (0, 0))[0].tolist()
        if magic not in (LITTLE, BIG) or words[6:] != own_sums:
            findings.note("the header of the database's write-ahead log is damaged; it is left out")
            return
        page = _page(page)
        frames, frame = _frames(source, head, page), FRAME_HEAD + page
        count = int(frames.own.nonzero()[0].max(initial=-1)) + 1
        committed = frames.holds & (frames.pages > 0)
        used = int(committed.nonzero()[0].max(initial=-1)) + 1
        if wrong := int((~frames.holds[:used]).sum()):
            findings.note(
                f"{several(wrong, 'page')} ({wrong * frame} bytes) of the database's write-ahead "
                "log damaged; what follows is used"
            )
        # Behind frames of another salt nothing is of this log.
        rest = (size - HEAD_BYTES) % frame if count == len(frames.own) else 0
        if left := (count - used) * frame + rest:
            findings.note(f"the last {left} bytes of the database's write-ahead log are no whole")
            findings.faults[CUT] = 1
        most = (copy.stat().st_size + size) // page
        for k in frames.holds[:used].nonzero()[0].tolist():
            if 0 < frames.page[k] <= most:
                source.seek(HEAD_BYTES + k * frame + FRAME_HEAD)
                target.seek((int(frames.page[k]) - 1) * page)
                target.write(source.read(page))


def page_bytes(path: Path) -> int:
    """The size of a database's pages by its header."""
    with path.open("rb") as file:
        return _page(int.from_bytes(file.read(18)[16:], "big"))


def _page(size: int) -> int:
    """A size that a page may have; where none is known, the largest."""
    return size if 512 <= size < 1 << 16 and size & (size - 1) == 0 else 1 << 16


class _Frames(NamedTuple):
    """Columns of frames: the page that each holds; pages of the database after a commit, else 0;
    whether its checksum holds, and whether it has the salt of this log."""

    page: IntArray
    pages: IntArray
    holds: BoolArray
    own: BoolArray


def _frames(file: BinaryIO, head: Bytes, size: int) -> _Frames:
    """All whole frames of a log, whose header was read already."""
    magic, frame = int(head.view(">u4")[0]), FRAME_HEAD + size
    salt, before = head[16:24], head[24:32]
    parts = [_Frames(*np.zeros((2, 0), np.int64), *np.zeros((2, 0), bool))]
    while raw := file.read(FRAMES_AT_ONCE * frame):
        rows = np.frombuffer(raw, np.uint8)[: len(raw) // frame * frame].reshape(-1, frame)
        if len(rows) == 0:
            break
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
