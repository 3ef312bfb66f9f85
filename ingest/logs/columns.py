"""Gathering bytes at many positions of one buffer, and reading them as columns."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...topology.arrays import BoolArray, IntArray
from .messages import Bytes

WORD = 8
"""Bytes copied at once."""


def words(data: Bytes, kind: str, at: IntArray) -> NDArray[Any]:
    """The number of type `kind` at each position, through an unaligned view with stride 1."""
    count = len(data) - np.dtype(kind).itemsize + 1
    return np.ndarray((max(count, 0),), kind, data.data, strides=(1,))[at]


def gather(data: Bytes, start: IntArray, width: int) -> Bytes:
    """(n, w) bytes of `data` from each position on, w: `width` rounded up to whole words.

    Bytes beyond `width` are undefined. Every position must have `width` bytes.
    """
    wide = -(-width // WORD) * WORD
    if len(start) == 0 or width == 0:
        return np.zeros((len(start), wide), np.uint8)
    if int(start.max()) + wide > len(data):
        rows = np.zeros((len(start), wide), np.uint8)
        rows[:, :width] = _items(data, start, width)
        return rows
    return _items(data, start, wide)


def _items(data: Bytes, start: IntArray, width: int) -> Bytes:
    items = np.ndarray((len(data) - width + 1,), f"V{width}", data.data, strides=(1,))[start]
    return items.view(np.uint8).reshape(len(start), width)


def column(rows: Bytes, kind: str, at: int) -> IntArray:
    """The numbers of type `kind` at one offset of every gathered row, as 64-bit ones."""
    if len(rows) == 0:
        return np.zeros(0, np.int64)
    strides = (rows.shape[1],)
    return np.ndarray((len(rows),), kind, rows.data, offset=at, strides=strides).astype(np.int64)


def numbers(rows: Bytes, kind: str, at: int, count: int) -> NDArray[Any]:
    """(n, count) numbers of type `kind` at one offset of every gathered row, in the machine's byte
    order."""
    wide = np.dtype(kind)
    span = np.ascontiguousarray(rows[:, at : at + wide.itemsize * count])
    return span.view(wide).astype(wide.newbyteorder("="), copy=False).reshape(len(rows), count)


ALL = np.uint64(0xFFFF_FFFF_FFFF_FFFF)
"""Every bit of a word."""


class Shape(NamedTuple):
    """The bytes that rows of one kind share.

    words: for each word with fixed bytes its index, its value and its mask.
    """

    words: tuple[tuple[int, np.uint64, np.uint64], ...]

    @classmethod
    def of(cls, head: Bytes, spans: tuple[tuple[int, int], ...]) -> Shape:
        """The shape of rows that share the bytes of `head` in the spans (from, to)."""
        wide = -(-len(head) // WORD) * WORD
        known, mask = np.zeros(wide, np.uint8), np.zeros(wide, np.uint8)
        for begin, end in spans:
            known[begin:end] = head[begin:end]
            mask[begin:end] = 0xFF
        value, bits = known.view(np.uint64), mask.view(np.uint64)
        return cls(tuple((int(k), value[k], bits[k]) for k in np.flatnonzero(bits)))

    def misfits(self, rows: Bytes) -> BoolArray | None:
        """(n,) which of the gathered rows differ, None if none does."""
        # Word by word down the rows: numpy's inner loop runs over the rows, not over few words.
        found = rows.view(np.uint64)
        wrong = np.zeros(len(rows), bool)
        for k, value, bits in self.words:
            wrong |= (found[:, k] if bits == ALL else found[:, k] & bits) != value
        return wrong if wrong.any() else None
