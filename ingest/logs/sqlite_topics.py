"""Recognising the topics of a bag whose database the library refuses."""

from __future__ import annotations

import numpy as np

from .messages import Channel, DamageError, normal_topic, normal_type, text
from .spelling import ENCODINGS, TYPES, spelled
from .sqlite_pages import LEAF, Pages

_HINTS = tuple(name.encode() for name in sorted(TYPES))
CELLS = 4096
"""Limit on rows examined per page."""

TEXT, BLOB = 13, 12
"""Smallest serial types of text (odd) and of bytes (even), which encode the length."""


def topics_by_looks(pages: Pages) -> dict[int, Channel]:
    """Topics of the wanted types by id, on any page that looks like a leaf.

    A row of `topics` holds name, type and format as consecutive text. O(bytes).
    """
    out: dict[int, Channel] = {}
    for data in pages.batches(np.arange(1, pages.count + 1)):
        raw = data.tobytes()
        for begin in range(0, len(raw) - pages.size + 1, pages.size):
            page = raw[begin : begin + pages.size]
            if page[0] == LEAF and any(hint in page for hint in _HINTS):
                out |= _topics_of(page)
    return out


def _topics_of(page: bytes) -> dict[int, Channel]:
    out = {}
    for k in range(min(int.from_bytes(page[3:5], "big"), CELLS)):
        try:
            key, values = _row(page, int.from_bytes(page[8 + 2 * k : 10 + 2 * k], "big"))
        except DamageError:
            continue
        if len(values) < 4 or not all(isinstance(value, bytes) for value in values[1:4]):
            continue
        name, type_name, form = (text(value) for value in values[1:4])
        channel = spelled(Channel(normal_topic(name), normal_type(type_name), form))
        if channel.type_name in TYPES and channel.encoding in ENCODINGS:
            out[key] = channel
    return out


def _row(page: bytes, at: int) -> tuple[int, list[bytes]]:
    """Id and values of a row, empty for those that are no text; raises DamageError."""
    _, at = _varint(page, at)
    key, at = _varint(page, at)
    size, head = _varint(page, at)
    body, values = at + size, []
    while head < at + size:
        kind, head = _varint(page, head)
        width = (kind - BLOB) // 2 if kind >= BLOB else (0, 1, 2, 3, 4, 6, 8, 8, 0, 0, 0, 0)[kind]
        if body + width > len(page):
            raise DamageError("a row goes beyond its page")
        values.append(page[body : body + width] if kind >= TEXT and kind % 2 else b"")
        body += width
    return key, values


def _varint(page: bytes, at: int) -> tuple[int, int]:
    value = 0
    for k in range(at, min(at + 8, len(page))):
        value = value << 7 | page[k] & 0x7F
        if page[k] < 0x80:
            return value, k + 1
    raise DamageError("a number has no end")
