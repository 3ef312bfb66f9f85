"""Reading a bag chunk without its large unwanted messages, such as images."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ...topology.arrays import IntArray
from .bag_wire import MESSAGE, U32, fields_of, number, op_of
from .chunk_reader import ChunkHead
from .messages import Bytes, DamageError
from .windows import Window

LARGE_BYTES = 1 << 16
"""Smaller messages are read rather than skipped; images are much larger, most other messages
smaller."""

HEAD_BYTES = 512
"""Bytes read of a large message: its header and the size of its data."""


def without_large(
    window: Window, chunk: ChunkHead, listed: IntArray, unwanted: Callable[[int], bool]
) -> Bytes | None:
    """The records of an uncompressed chunk, with undefined bytes in place of the data of large
    unwanted messages.

    listed: positions of messages by an index; unwanted: by connection number. None if there is
    nothing to leave out, or if the index is wrong. Every record's own sizes are read, so that the
    index can be proven right.
    """
    where = np.sort(listed)
    if len(where) == 0 or where[0] < 0 or where[-1] >= chunk.data_size:
        return None
    reach = np.diff(where, append=chunk.data_size)
    large = (reach > LARGE_BYTES).nonzero()[0]
    if len(large) == 0:
        return None
    data, done = np.empty(chunk.data_size, np.uint8), 0
    for begin, most in zip(where[large].tolist(), reach[large].tolist(), strict=True):
        window.fill(data[done : begin + HEAD_BYTES], chunk.data_at + done)
        done = begin + HEAD_BYTES
        size = _unwanted_size(data[begin:done], unwanted)
        if size > most:
            return None
        done = max(done, begin + size)
    window.fill(data[done:], chunk.data_at + done)
    return data


def _unwanted_size(head: Bytes, unwanted: Callable[[int], bool]) -> int:
    """Bytes of the message record that begins with `head`, 0 if it is wanted or unclear."""
    header = U32(head.data)[0]
    if header > HEAD_BYTES - 8:
        return 0
    try:
        fields = fields_of(head[4 : 4 + header].tobytes())
        left_out = op_of(fields) == MESSAGE and unwanted(number(fields, b"conn"))
    except DamageError:
        return 0
    return int(8 + header + U32(head.data, 4 + header)[0]) if left_out else 0
