"""Message counts by chunk and channel of an MCAP file, from its summary alone.

A chunk index holds the positions of the chunk's message indexes, one for each channel. These take
15 bytes and 16 for each message, so that their distances give the counts.
"""

from __future__ import annotations

import numpy as np

from ...topology.arrays import IntArray
from .chunk_index import ChunkIndex
from .columns import words
from .mcap_summary import OFFSETS_AT, PLACE_AT, McapSummary
from .mcap_wire import RECORD_HEAD

_FIRST_AT, _LAST_AT, _LENGTH_AT = RECORD_HEAD, RECORD_HEAD + 8, RECORD_HEAD + 24
"""Offsets in a chunk index: first and last log time of the chunk, and its length."""

INDEX_HEAD, INDEX_ENTRY = RECORD_HEAD + 6, 16
"""Bytes of a message index before its entries, and of an entry."""


def chunk_index(summary: McapSummary | None) -> ChunkIndex | str:
    """The chunks of a file with their message counts, or the reason why they are not known.

    They are known if the message indexes fill the gaps between chunks and their counts add up to
    the statistics for every channel: then nothing lies outside of chunks, and errors that no
    checksum covers are noticed.
    """
    if summary is None:
        return "it has no index, or a damaged one"
    data, where = summary.listing
    if len(where) == 0 or not summary.counts:
        return "its index lists no chunks or counts no messages"
    if not summary.describes_all:
        return "its index does not describe all channels"
    begin = words(data, "<i8", where + PLACE_AT)
    end = begin + words(data, "<i8", where + _LENGTH_AT)
    if (end <= begin).any() or end.max() > summary.start or (begin[1:] < end[:-1]).any():
        return "its index contradicts itself"
    listed = np.diff(summary.chunk_first)
    chunk = np.repeat(np.arange(len(begin)), listed)
    count = _counts(summary, end, listed, chunk)
    index = ChunkIndex(
        begin,
        end,
        words(data, "<i8", where + _FIRST_AT),
        words(data, "<i8", where + _LAST_AT),
        chunk,
        summary.chunk_channels,
        count,
    )
    held = index.counts(np.ones(len(begin), bool))
    if held != {number: count for number, count in summary.counts.items() if count}:
        return "its index does not say which chunk holds which messages"
    return index


def _counts(summary: McapSummary, end: IntArray, listed: IntArray, chunk: IntArray) -> IntArray:
    """(k,) messages of a channel in a chunk; meaningless where positions are inconsistent."""
    data, where = summary.listing
    within = np.arange(len(chunk)) - summary.chunk_first[chunk]
    at = words(data, "<i8", where[chunk] + OFFSETS_AT + 10 * within + 2)
    # Behind the list stands how long all message indexes of the chunk are together.
    stop = end + words(data, "<i8", where + OFFSETS_AT + 10 * listed)
    order = np.lexsort((at, chunk))
    behind = np.append(at[order][1:], 0)
    last = np.append(chunk[1:] != chunk[:-1], True)
    behind[last] = stop[chunk[last]]
    length = np.empty_like(at)
    length[order] = behind - at[order]
    whole = (length >= INDEX_HEAD) & ((length - INDEX_HEAD) % INDEX_ENTRY == 0)
    return np.where(whole, (length - INDEX_HEAD) // INDEX_ENTRY, 0)
