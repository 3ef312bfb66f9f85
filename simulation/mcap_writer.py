"""MCAP files, written so that the bytes depend on the messages alone.

Format: https://mcap.dev/spec. Chunks with message indexes, a summary with statistics and chunk
indexes, checksums throughout.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable, Sequence

from .lz4_frame import lz4_frame
from .messages import Topic, definition, in_log_order

MAGIC = b"\x89MCAP0\r\n"
CHUNK_BYTES = 1 << 20
LIBRARY = "topobatch"

HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK = 1, 2, 3, 4, 5, 6
MESSAGE_INDEX, CHUNK_INDEX, STATISTICS, SUMMARY_OFFSET, DATA_END = 7, 8, 11, 14, 15


def mcap_bytes(topics: tuple[Topic, ...]) -> bytes:
    """A ROS 2 MCAP file of these topics (CDR payloads), compressed with LZ4."""
    out = bytearray(MAGIC + _record(HEADER, _text("ros2") + _text(LIBRARY)))
    schemas = [
        _record(SCHEMA, struct.pack("<H", i) + _text(t.type_name) + _text("ros2msg") + _text(text))
        for i, t in enumerate(topics, 1)
        for text in [definition(t.type_name, "ros2")]
    ]
    channels = [
        _record(CHANNEL, struct.pack("<HH", i, i) + _text(t.name) + _text("cdr") + _blob(b""))
        for i, t in enumerate(topics, 1)
    ]
    chunk_indexes = []
    for number, chunk in enumerate(_chunks(topics)):
        head = schemas + channels if number == 0 else []
        chunk_indexes.append(_add_chunk(out, head, chunk))
    out += _record(DATA_END, struct.pack("<I", zlib.crc32(out)))
    summary = [
        (SCHEMA, schemas),
        (CHANNEL, channels),
        (STATISTICS, [_statistics(topics, len(chunk_indexes))]),
        (CHUNK_INDEX, chunk_indexes),
    ]
    out += _summary(len(out), [(op, b"".join(records)) for op, records in summary if records])
    return bytes(out + MAGIC)


def _record(op: int, content: bytes) -> bytes:
    return struct.pack("<BQ", op, len(content)) + content


def _text(text: str) -> bytes:
    return _blob(text.encode())


def _blob(raw: bytes) -> bytes:
    return struct.pack("<I", len(raw)) + raw


Row = tuple[int, int, bytes]
"""Channel, log time, message record."""


def _chunks(topics: tuple[Topic, ...]) -> Iterable[list[Row]]:
    """The message records in groups of about CHUNK_BYTES."""
    head = struct.Struct("<BQHIQQ")
    rows: list[Row] = []
    size = 0
    for sequence, (number, log, stamp, payload) in enumerate(in_log_order(topics)):
        fixed = head.pack(MESSAGE, 22 + len(payload), number + 1, sequence, log, stamp)
        rows.append((number + 1, log, fixed + payload))
        size += len(fixed) + len(payload)
        if size >= CHUNK_BYTES:
            yield rows
            rows, size = [], 0
    if rows:
        yield rows


def _add_chunk(out: bytearray, head: Sequence[bytes], rows: list[Row]) -> bytes:
    """Append a chunk and its message indexes; the chunk index record that tells of them."""
    position = sum(len(record) for record in head)
    entries: dict[int, list[bytes]] = {}
    for channel, log, record in rows:
        entries.setdefault(channel, []).append(struct.pack("<QQ", log, position))
        position += len(record)
    records = [*head, *(record for _, _, record in rows)]
    plain, packed = b"".join(records), lz4_frame(records)
    start, end = rows[0][1], rows[-1][1]
    at = len(out)
    content = struct.pack("<QQQI", start, end, len(plain), zlib.crc32(plain)) + _text("lz4")
    out += _record(CHUNK, content + struct.pack("<Q", len(packed)) + packed)
    chunk_end = len(out)
    offsets = []
    for channel in sorted(entries):
        offsets.append(struct.pack("<HQ", channel, len(out)))
        index = struct.pack("<H", channel) + _blob(b"".join(entries[channel]))
        out += _record(MESSAGE_INDEX, index)
    return _record(
        CHUNK_INDEX,
        struct.pack("<QQQQ", start, end, at, chunk_end - at)
        + _blob(b"".join(offsets))
        + struct.pack("<Q", len(out) - chunk_end)
        + _text("lz4")
        + struct.pack("<QQ", len(packed), len(plain)),
    )


def _statistics(topics: tuple[Topic, ...], chunks: int) -> bytes:
    times = [int(t) for topic in topics for t in topic.log_ns]
    counts = [struct.pack("<HQ", i, len(t.payloads)) for i, t in enumerate(topics, 1)]
    head = struct.pack("<QHIIII", len(times), len(topics), len(topics), 0, 0, chunks)
    span = struct.pack("<QQ", min(times, default=0), max(times, default=0))
    return _record(STATISTICS, head + span + _blob(b"".join(counts)))


def _summary(start: int, groups: list[tuple[int, bytes]]) -> bytes:
    """The summary section from byte `start` of the file on, and the footer."""
    body, offsets = bytearray(), bytearray()
    for op, records in groups:
        place = struct.pack("<BQQ", op, start + len(body), len(records))
        offsets += _record(SUMMARY_OFFSET, place)
        body += records
    footer = struct.pack("<BQQQ", FOOTER, 20, start, start + len(body))
    checksum = zlib.crc32(footer, zlib.crc32(offsets, zlib.crc32(body)))
    return bytes(body + offsets) + footer + struct.pack("<I", checksum)
