"""Columnar reading of SQLite pages (https://www.sqlite.org/fileformat2.html).

The library returns rows one by one, in three times the time of reading the file. A row of a bag's
`messages` table lies in one leaf page unless it is large, so that batches of pages are parsed at
once and payloads are used in place. Pages of truncated or damaged files, which the library refuses,
can be read as well.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...topology.arrays import BoolArray, IntArray
from .messages import Bytes, DamageError, FileWindow

LEAF, INTERIOR = 0x0D, 0x05
BATCH = 512
"""Pages parsed at once."""

PAGE_BYTES = 4096
"""Default page size."""

NEAR = 8
"""Gaps of up to this many unneeded pages are read along."""

DEPTH = 16
"""Limit on the depth of a B-tree; SQLite's own is 20 (BTCURSOR_MAX_DEPTH)."""

_PAD = 32
"""Zeros after the pages, so that a cell's head can be read at any offset."""

_REAL = 8
"""Bytes of a timestamp (serial type 6)."""


class Spilled(NamedTuple):
    """Rows that go on in overflow pages: topic (k,), -1 if unknown; time_ns; start, size of the
    payload, of which `data` holds that before `end`, where the first of these pages is named."""

    topic: IntArray
    time_ns: IntArray
    start: IntArray
    end: IntArray
    size: IntArray


class Rows(NamedTuple):
    """Rows of the messages table in one batch of pages.

    data: the pages; topic, time_ns (m,); start, size (m,): the payload in `data`. elsewhere: ids of
    rows that do not lie in one page; spilled: these rows. number: ids of all rows in page order.
    broken: number of pages that are no leaf; short: number of pages that list fewer rows than they
    hold.
    """

    data: Bytes
    topic: IntArray
    time_ns: IntArray
    start: IntArray
    size: IntArray
    elsewhere: IntArray
    spilled: Spilled
    number: IntArray
    broken: int
    short: int

    def only(self, which: BoolArray) -> Rows:
        """The selected ones of the rows that lie in pages."""
        columns = (self.topic, self.time_ns, self.start, self.size)
        topic, time_ns, start, size = (column[which] for column in columns)
        return self._replace(topic=topic, time_ns=time_ns, start=start, size=size)


class Pages:
    """The pages of one database file; anyhow: even if its header is damaged."""

    def __init__(self, window: FileWindow, anyhow: bool = False) -> None:
        head = window.view(0, 100).tobytes()
        size = int.from_bytes(head[16:18], "big")
        self.size = 65536 if size == 1 else size
        unused = head[20:21]
        if len(head) < 100 or self.size < 512 or self.size & (self.size - 1):
            if not anyhow:
                raise DamageError("the database has no page size")
            # What recorders use, as none of them chooses another one.
            self.size = PAGE_BYTES
        self.usable = self.size - (0 if anyhow else unused[0])
        self.count = window.size // self.size
        self._window = window
        self._taken = np.zeros(self.count + 1, bool)

    def page(self, number: int) -> Bytes:
        """Page `number`, from 1 on; raises DamageError if it does not exist."""
        if not 1 <= number <= self.count:
            raise DamageError("a page is missing")
        return self._window.view((number - 1) * self.size, self.size)

    def overflowing(self, data: Bytes, start: int, end: int, size: int) -> Bytes:
        """A payload that goes on in overflow pages, each of which belongs to one row only. Raises
        DamageError."""
        held = end - start
        if not 0 <= held <= size <= held + self.count * (self.usable - 4):
            raise DamageError("a row is larger than the database")
        payload = np.empty(size, np.uint8)
        payload[:held] = data[start:end]
        following = int(_big(data, np.array([end]), 4)[0])
        while held < size:
            page = self.page(following)
            if self._taken[following]:
                raise DamageError("a page belongs to two rows")
            self._taken[following] = True
            part = page[4 : self.usable][: size - held]
            payload[held : held + len(part)] = part
            held += len(part)
            following = int(_big(page, np.array([0]), 4)[0])
        if following:
            raise DamageError("a row goes on behind its end")
        return payload

    def leaves(self, root: int) -> IntArray:
        """The leaf pages of a table in row order; raises DamageError."""
        level = np.array([root], np.int64)
        for _ in range(DEPTH):
            kind = int(self.page(int(level[0]))[0])
            if kind == LEAF:
                return level
            if kind != INTERIOR or len(level) > self.count:
                raise DamageError("the database's index of pages is damaged")
            level = np.concatenate([self._children(number) for number in level.tolist()])
            # Each page belongs to one other only.
            if len(level) > self.count or (np.diff(np.sort(level)) == 0).any():
                raise DamageError("the database's index of pages is damaged")
        raise DamageError("the database's index of pages is nested too deeply")

    def _children(self, number: int) -> IntArray:
        page = self.page(number)
        count = int(page[3]) << 8 | int(page[4])
        if page[0] != INTERIOR or 12 + 2 * count > self.usable:
            raise DamageError("the database's index of pages is damaged")
        at = _big(page, 12 + 2 * np.arange(count), 2)
        if count and int(at.max()) + 4 > self.usable:
            raise DamageError("the database's index of pages is damaged")
        right = _big(page, np.array([8]), 4)
        return np.concatenate([_big(page, at, 4), right])

    def batches(self, numbers: IntArray) -> Iterator[Bytes]:
        """The given pages concatenated, BATCH at a time; each batch is valid until the next one.

        Raises DamageError if a page does not exist.
        """
        if len(numbers) and not (numbers.min() >= 1 and numbers.max() <= self.count):
            raise DamageError("a page is missing")
        buffer = np.zeros(BATCH * self.size + _PAD, np.uint8)
        for first in range(0, len(numbers), BATCH):
            batch = numbers[first : first + BATCH]
            self._read(batch, buffer)
            self._window.passed(int(batch[-1]) * self.size)
            yield buffer[: len(batch) * self.size + _PAD]

    def _read(self, batch: IntArray, buffer: Bytes) -> None:
        """Read runs of neighbouring pages, including small gaps between them."""
        cuts = np.flatnonzero((np.diff(batch) < 1) | (np.diff(batch) > NEAR)) + 1
        done = 0
        for run in np.split(batch, cuts):
            first, last = int(run[0]), int(run[-1])
            target = buffer[done : done + len(run) * self.size]
            if last - first + 1 == len(run):
                self._window.fill(target, (first - 1) * self.size)
            else:
                pages = np.empty((last - first + 1, self.size), np.uint8)
                self._window.fill(pages.reshape(-1), (first - 1) * self.size)
                target.reshape(-1, self.size)[:] = pages[run - first]
            done += len(run) * self.size

    def rows(self, data: Bytes) -> Rows:
        """The rows of a batch of leaf pages. O(rows), vectorised.

        All cells of all pages form one column of offsets; varints are read byte by byte for the
        whole column.
        """
        count = (len(data) - _PAD) // self.size
        base = self.size * np.arange(count)
        cells = _big(data, base + 3, 2)
        # A row takes four bytes at least, and two for its place.
        leaf = (data[base] == LEAF) & (8 + 6 * cells <= self.usable)
        cells = np.where(leaf, cells, 0)
        page = np.repeat(base, cells)
        number = np.arange(len(page)) - np.repeat(np.cumsum(cells) - cells, cells)
        pointer = _big(data, page + 8 + 2 * number, 2)
        short = self._short(data, base, cells, pointer)
        at = page + np.minimum(pointer, self.size - 4)
        if not ((at[1:] < at[:-1]) | (page[1:] > page[:-1])).all():
            # Rows fill a page from its end. A wrong bit in its list may name a place twice.
            once = np.sort(np.unique(at, return_index=True)[1])
            page, at = page[once], at[once]
        payload, at = _varint(data, at)
        row, at = _varint(data, at)
        head = at
        topic_kind, time_kind = data[head + 2], data[head + 3]
        blob, body = _varint(data, head + 4)
        regular = (data[head + 1] == 0) & (time_kind == 6) & (data[head] == body - head)
        topic, width = _small_integer(data, body, topic_kind)
        regular &= (width >= 0) & (blob >= 12) & (blob % 2 == 0)
        size = (blob - 12) // 2
        start = body + np.maximum(width, 0) + _REAL
        regular &= payload == start + size - head
        whole = regular & (start + size <= page + self.usable) & (payload <= self.usable - 35)
        time_ns = _big(data, np.minimum(start, len(data)) - _REAL, 8)
        other = ~whole
        if other.any():
            # The same row twice, once by a place that is none: the library would give it again.
            other[other] = ~np.isin(row[other], row[whole])
        return Rows(
            data,
            topic[whole],
            time_ns[whole],
            start[whole],
            size[whole],
            row[other],
            Spilled(
                np.where(regular, topic, -1)[other],
                time_ns[other],
                start[other],
                (head + self._kept(payload))[other],
                size[other],
            ),
            row[whole | other],
            int((~leaf).sum()),
            short,
        )

    def _kept(self, payload: IntArray) -> IntArray:
        """How much of rows of that length their leaf page holds, if they have overflow pages."""
        least = (self.usable - 12) * 32 // 255 - 23
        kept = least + (payload - least) % (self.usable - 4)
        return np.where(kept <= self.usable - 35, kept, least)

    def _short(self, data: Bytes, base: IntArray, cells: IntArray, pointer: IntArray) -> int:
        """Number of pages that list fewer rows than they hold.

        A page stores where its cell content begins; unless rows were deleted, a listed row begins
        there.
        """
        filled = np.flatnonzero(cells)
        if len(filled) == 0:
            return 0
        lowest = np.minimum.reduceat(pointer, (np.cumsum(cells) - cells)[filled])
        begin = _big(data, base[filled] + 5, 2)
        deleted = _big(data, base[filled] + 1, 2) != 0
        return int(((begin != lowest % 65536) & ~deleted).sum())


def _big(data: Bytes, at: IntArray, width: int) -> IntArray:
    """Big-endian unsigned numbers (signed for 8 bytes) at the offsets."""
    items = np.ndarray(
        (len(data) - width + 1,), f">{'i' if width == 8 else 'u'}{width}", data.data, strides=(1,)
    )
    return items[at].astype(np.int64)


def _varint(data: Bytes, at: IntArray) -> tuple[IntArray, IntArray]:
    """SQLite's varints of 1 to 9 bytes at the offsets, and the offsets after them."""
    value = np.zeros(len(at), np.int64)
    at = np.minimum(at, len(data) - _PAD // 2)
    going = np.ones(len(at), bool)
    for k in range(9):
        byte = data[at].astype(np.int64)
        more = value << 7 | byte & 0x7F if k < 8 else value << 8 | byte
        value = np.where(going, more, value)
        at = at + going
        going &= byte >= 0x80
        if not going.any():
            break
    return value, at


def _small_integer(data: Bytes, at: IntArray, kind: NDArray[np.uint8]) -> tuple[IntArray, IntArray]:
    """Integers of at most two bytes by their serial type, and their widths; -1 for other types."""
    one = data[at].view(np.int8).astype(np.int64)
    two = one << 8 | data[at + 1]
    value = np.select([kind == 1, kind == 2, kind == 9], [one, two, np.ones_like(one)], 0)
    width = np.select([kind == 1, kind == 2, (kind == 8) | (kind == 9)], [1, 2, 0], -1)
    return value, width.astype(np.int64)
