"""Batches of small chunks of a bag: some recorders close one after every message."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from .bag_heads import COMPRESSIONS
from .bag_wire import CHUNK, INDEX, INDEX_ENTRY, U32, IndexTemplate, fields_of
from .chunk_reader import SMALL_BYTES
from .inflate import inflate
from .messages import Bytes, DamageError

LONGEST_HEADER = 256
"""Headers of chunks and indexes take 50 bytes; longer ones are left to those who read any."""


class Batch(NamedTuple):
    """Consecutive small chunks.

    stop: bytes of the file that they take; data: the records of each; repaired: number of chunks
    with a wrong declared size.
    """

    stop: int
    data: Sequence[bytes]
    repaired: int


class _Likes:
    """The headers that a recorder repeats: of chunks except for the size, and of indexes."""

    def __init__(self) -> None:
        self._chunk: tuple[int, bytes, bytes] | None = None
        self._index: IndexTemplate | None = None
        self._compression = b"none"

    def chunk_size(self, head: bytes) -> int | None:
        """The size in the header of a chunk, None if it is not one."""
        if self._chunk is None:
            fields = _fields(head)
            if fields.get(b"op") != bytes([CHUNK]) or len(fields.get(b"size", b"")) != 4:
                return None
            if fields.get(b"compression") not in COMPRESSIONS:
                return None
            at = head.index(b"size=") + 5
            self._chunk = (len(head), head[:at], head[at + 4 :])
            self._compression = fields[b"compression"]
        length, before, after = self._chunk
        if len(head) != length or not head.startswith(before) or not head.endswith(after):
            return None
        return int(U32(head, len(before))[0])

    @property
    def plain(self) -> bool:
        """Whether the chunks are not compressed."""
        return self._compression == b"none"

    def inflated(self, packed: memoryview, size: int) -> bytes:
        """The records of a compressed chunk; raises DamageError."""
        return inflate(self._compression.decode("latin-1"), packed, size)

    def is_index(self, head: bytes, data_size: int) -> bool:
        """Whether a header is that of an index record with so many bytes of data."""
        front = head + data_size.to_bytes(4, "little")
        if self._index is not None and self._index.read(front) is not None:
            return True
        fields = _fields(head)
        if fields.get(b"op") != bytes([INDEX]) or len(fields.get(b"count", b"")) != 4:
            return False
        if len(fields.get(b"conn", b"")) == 4:
            self._index = IndexTemplate.of(head)
        return bool(U32(fields[b"count"])[0] * INDEX_ENTRY == data_size)


def _fields(head: bytes) -> dict[bytes, bytes]:
    try:
        return fields_of(head[4:])
    except DamageError:
        return {}


def small_chunks(raw: Bytes) -> Batch:
    """The small chunks at the front of `raw` and their indexes, up to anything else.

    A chunk counts only if another chunk or an index follows: nothing else confirms its length.
    """
    view, at, size = raw.data, 0, len(raw)
    data: list[bytes] = []
    likes = _Likes()
    stop = repaired = 0
    records, wrong = None, False
    while at + 8 <= size:
        header = U32(view, at)[0]
        body = at + 4 + header
        if header > LONGEST_HEADER or body + 4 > size:
            break
        head = bytes(view[at:body])
        end = body + 4 + U32(view, body)[0]
        declared = likes.chunk_size(head)
        if declared is None and not likes.is_index(head, end - body - 4):
            break
        if records is not None:
            data.append(records)
            repaired += wrong
            records = None
        stop = at
        if end > size:
            break
        if declared is None:
            stop = end
        else:
            if max(declared, end - at) > SMALL_BYTES:
                break
            packed = view[body + 4 : end]
            # Of data that are not compressed the record tells the size as well.
            wrong = likes.plain and declared != len(packed)
            try:
                records = bytes(packed) if likes.plain else likes.inflated(packed, declared)
            except DamageError:
                break
        at = end
    return Batch(stop, data, repaired)
