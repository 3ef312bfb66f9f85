"""ROS 1 bags, written so that the bytes depend on the messages alone.

Format: http://wiki.ros.org/Bags/Format/2.0. Chunks compressed with LZ4, indexed.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable

from .lz4_frame import lz4_frame
from .messages import DIGESTS, Topic, definition, in_log_order

MAGIC = b"#ROSBAG V2.0\n"
CHUNK_BYTES = 768 << 10
HEADER_BYTES = 4096

MESSAGE, BAG_HEADER, INDEX, CHUNK, CHUNK_INFO, CONNECTION = 2, 3, 4, 5, 6, 7

Row = tuple[int, int, bytes]
"""Connection, log time, message record."""


def bag_bytes(topics: tuple[Topic, ...]) -> bytes:
    """A ROS 1 bag of these topics."""
    connections = [_connection(number, topic) for number, topic in enumerate(topics)]
    body = bytearray()
    infos: list[bytes] = []
    for number, rows in enumerate(_chunks(topics)):
        head = b"".join(connections) if number == 0 else b""
        at = len(MAGIC) + HEADER_BYTES + len(body)
        infos.append(_add_chunk(body, at, head, rows))
    index_at = len(MAGIC) + HEADER_BYTES + len(body)
    counts = {"conn_count": _u32(len(topics)), "chunk_count": _u32(len(infos))}
    header = _fields(BAG_HEADER, {"index_pos": struct.pack("<Q", index_at), **counts})
    padding = HEADER_BYTES - len(header) - 4
    return b"".join(
        [MAGIC, header, _u32(padding), b" " * padding, bytes(body), *connections, *infos]
    )


def _u32(value: int) -> bytes:
    return struct.pack("<I", value)


def _time(time_ns: int) -> bytes:
    return struct.pack("<II", time_ns // 10**9, time_ns % 10**9)


def _fields(op: int | None, fields: dict[str, bytes]) -> bytes:
    """A record header with its length; `op` None gives the data of a connection record."""
    named = {} if op is None else {"op": bytes([op])}
    parts = [f"{name}=".encode() + value for name, value in (named | fields).items()]
    content = b"".join(_u32(len(part)) + part for part in parts)
    return _u32(len(content)) + content


def _connection(number: int, topic: Topic) -> bytes:
    about = {
        "topic": topic.name.encode(),
        "type": topic.type_name.replace("/msg/", "/").encode(),
        "md5sum": DIGESTS["ros1", topic.type_name].encode(),
        "message_definition": definition(topic.type_name, "ros1").encode(),
    }
    head = {"conn": _u32(number), "topic": topic.name.encode()}
    return _fields(CONNECTION, head) + _fields(None, about)


def _chunks(topics: tuple[Topic, ...]) -> Iterable[list[Row]]:
    """The message records in groups of about CHUNK_BYTES."""
    rows: list[Row] = []
    size = 0
    for number, log, _, payload in in_log_order(topics):
        head = _fields(MESSAGE, {"conn": _u32(number), "time": _time(log)})
        rows.append((number, log, head + _u32(len(payload)) + payload))
        size += len(rows[-1][2])
        if size >= CHUNK_BYTES:
            yield rows
            rows, size = [], 0
    if rows:
        yield rows


def _add_chunk(body: bytearray, at: int, head: bytes, rows: list[Row]) -> bytes:
    """Append a chunk and its indexes; the chunk info record that tells of them."""
    entries: dict[int, list[bytes]] = {}
    position = len(head)
    for number, log, record in rows:
        entries.setdefault(number, []).append(_time(log) + _u32(position))
        position += len(record)
    records = [head, *(record for _, _, record in rows)]
    plain, packed = b"".join(records), lz4_frame(records)
    body += _fields(CHUNK, {"compression": b"lz4", "size": _u32(len(plain))})
    body += _u32(len(packed)) + packed
    for number in sorted(entries):
        index = b"".join(entries[number])
        about = {"ver": _u32(1), "conn": _u32(number), "count": _u32(len(entries[number]))}
        body += _fields(INDEX, about) + _u32(len(index)) + index
    counts = b"".join(_u32(number) + _u32(len(entries[number])) for number in sorted(entries))
    about = {
        "ver": _u32(1),
        "chunk_pos": struct.pack("<Q", at),
        "start_time": _time(rows[0][1]),
        "end_time": _time(rows[-1][1]),
        "count": _u32(len(entries)),
    }
    return _fields(CHUNK_INFO, about) + _u32(len(counts)) + counts
