"""Floods and monsters beside the messages: connections, attachments, names, logs of databases.

As in `logs_bombs`, every log also holds a small sound run, which has to be used in spite of it.
"""

from __future__ import annotations

import random
import struct
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

from case import Case, Generator, writers
from logs_bombs import (
    _TAIL,
    MIB,
    ODOMETRY,
    SOUND,
    _bag,
    _bag_chunk,
    _bag_record,
    _channel,
    _chunk,
    _died,
    _front,
    _mcap,
    _record,
    _share,
    _text,
)

# Bags


def _connection(number: int, topic: bytes, kind: bytes, definition: bytes = b"") -> bytes:
    own = {b"topic": topic, b"type": kind, b"md5sum": b"*", b"message_definition": definition}
    data = b"".join(
        struct.pack("<I", len(name) + 1 + len(value)) + name + b"=" + value
        for name, value in own.items()
    )
    head = {b"op": b"\x07", b"conn": struct.pack("<I", number), b"topic": topic}
    return _bag_record(head, data)


def _in_chunks(rng: random.Random, records: list[bytes]) -> bytes:
    """Records as they are, or in chunks of 1,000."""
    if rng.random() < 0.5:
        return b"".join(records)
    parts = [b"".join(records[k : k + 1000]) for k in range(0, len(records), 1000)]
    return b"".join(_bag_chunk(part, b"none", len(part)) for part in parts)


def _connections(rng: random.Random) -> bytes:
    """Up to 10^6 connections, of one number or of any, of one topic or of as many."""
    count = _share(rng, 10**6)
    kind = rng.choice((b"nav_msgs/Odometry", b"std_msgs/String", b"x/Y"))
    topic = rng.choice((b"/t%d", b"/odom2"))
    first, every = rng.choice(((2, 1), (2, 0), (65_530, 1), ((1 << 32) - 1, 0)))
    records = [
        _connection((first + every * k) & 0xFFFFFFFF, topic % k if b"%" in topic else topic, kind)
        for k in range(count)
    ]
    return _in_chunks(rng, records)


def _chunk_info(place: int, pairs: bytes) -> bytes:
    fields = {b"op": b"\x06", b"ver": struct.pack("<I", 1), b"chunk_pos": struct.pack("<Q", place)}
    fields |= {b"start_time": bytes(8), b"end_time": bytes(8)}
    return _bag_record({**fields, b"count": struct.pack("<I", len(pairs) // 8)}, pairs)


def _index_flood(rng: random.Random, folder: Path) -> Case:
    """An index of hundreds of thousands of connections or chunks, or of millions of counts."""
    count = _share(rng, 300_000)
    kind = rng.choice((b"nav_msgs/Odometry", b"std_msgs/String"))
    pairs = struct.pack("<II", 0, 0)
    connections, infos = {
        "connections": lambda: ([_connection(2 + k, b"/t%d" % k, kind) for k in range(count)], []),
        "chunks": lambda: ([], [_chunk_info(5000 - k % 2, b"") for k in range(count)]),
        "counts": lambda: ([], [_chunk_info(5000, pairs * 1000) for _ in range(count // 100)]),
        "counts of one chunk": lambda: ([], [_chunk_info(5000, pairs * 10 * count)]),
    }[what := rng.choice(("connections", "chunks", "counts", "counts of one chunk"))]()
    path = _with_index(folder, lambda index: index + b"".join(connections + infos))
    raw = bytearray(path.read_bytes())
    for name, more in ((b"conn_count=", connections), (b"chunk_count=", infos)):
        at = raw.index(name) + len(name)
        struct.pack_into("<I", raw, at, struct.unpack_from("<I", raw, at)[0] + len(more))
    path.write_bytes(raw)
    return Case(path, SOUND, None, f"an index with more {what} ({count})")


def _with_index(folder: Path, other: Callable[[bytes], bytes]) -> Path:
    """A sound bag whose index section is another one."""
    logs = writers()
    path = Path(logs.bag(folder / "run.bag", logs.drive(ODOMETRY)))
    raw = path.read_bytes()
    start = struct.unpack_from("<Q", raw, raw.index(b"index_pos=") + 10)[0]
    path.write_bytes(raw[:start] + other(raw[start:]))
    return path


FALSE = ((b"/junctions", b"geometry_msgs/PoseArray"), (b"/odom", b"nav_msgs/Odometry"))
FALSE += ((b"/odom", b"std_msgs/String"), (b"/x", b"nav_msgs/Odometry"), (b"", b""))
"""What an index may say of a connection that is none of this."""


def _false_index(rng: random.Random, folder: Path) -> Case:
    """An index that describes the connections otherwise than the data."""
    false = [_connection(k, *rng.choice(FALSE)) for k in (0, 1)]
    path = _with_index(folder, lambda index: b"".join(false) + index[index.index(b"op=\x06") - 8 :])
    return Case(path, SOUND, 0, "an index that describes other connections")


# MCAP


def _false_summary(rng: random.Random, folder: Path) -> Case:
    """A summary without a checksum that describes the channels otherwise than the data."""
    logs = writers()
    path = logs.mcap(folder / "run.mcap", logs.drive(ODOMETRY))
    raw = path.read_bytes()
    start, at = struct.unpack_from("<Q", raw, len(raw) - 28)[0], 0
    false = b""
    while start + at < len(raw) - 37:
        op, length = struct.unpack_from("<BQ", raw, start + at)
        body = raw[start + at + 9 : start + at + 9 + length]
        topic, kind = rng.choice(FALSE)
        if op == 3 and rng.random() < 0.7:
            body = body[:2] + _text(kind.replace(b"/", b"/msg/")) + _text(b"ros2msg") + _text(b"")
        elif op == 4 and rng.random() < 0.7:
            body = body[:4] + _text(topic) + _text(b"cdr") + _text(b"")
        false += _record(op, body)
        at += 9 + length
    footer = _record(2, struct.pack("<QQI", start, 0, 0)) + raw[-8:]
    path.write_bytes(raw[:start] + false + footer)
    return Case(path, SOUND, 0, "a summary that describes other channels")


def _huge_attachment(rng: random.Random, folder: Path) -> Case:
    """An attachment of up to 1 GB in front of the messages or behind them; it takes no room."""
    path, size = folder / "run.mcap", _share(rng, 1 << 30)
    front = _front(folder)
    op = rng.choice((9, 12, 0x90))
    before = rng.random() < 0.5
    head_end = 8 + 9 + struct.unpack_from("<Q", front, 9)[0]
    with path.open("wb") as file:
        file.write(front[:head_end] if before else front)
        file.write(struct.pack("<BQ", op, size))
        file.seek(size, 1)
        file.write((front[head_end:] if before else b"") + _TAIL)
    return Case(path, SOUND, 0, f"record {op} of {size >> 20} MiB")


def _summary_flood(rng: random.Random, folder: Path) -> Case:
    """A summary of hundreds of thousands of records of any kind."""
    logs = writers()
    path = logs.mcap(folder / "run.mcap", logs.drive(ODOMETRY), repeat_channels=False)
    raw = path.read_bytes()
    start = struct.unpack_from("<Q", raw, len(raw) - 28)[0]
    count = _share(rng, 300_000)
    kind = rng.randrange(5)
    flood = {
        0: lambda: _record(13, struct.pack("<QQ", 8, 9) + _text(b"m")) * count,
        1: lambda: _record(10, bytes(48)) * count,
        2: lambda: b"".join(_channel(k % 65_536, b"/t%d" % k) for k in range(count)),
        3: lambda: b"".join(
            _record(3, struct.pack("<H", 1 + k % 65_535) + _text(b"nav_msgs/msg/Odometry") * 3)
            for k in range(count)
        ),
        4: lambda: _record(8, bytes(36) + _text(bytes(10 * 1000)) + bytes(28)) * (count // 100),
    }[kind]()
    footer = _record(2, struct.pack("<QQI", start, 0, 0)) + raw[-8:]
    path.write_bytes(raw[: len(raw) - 37] + flood + footer)
    return Case(path, SOUND, None, f"a summary with {count} records more ({kind})")


# Descriptions in front of the sound run, and out of a small file


def _described(rng: random.Random, count: int) -> list[bytes]:
    """Channels or schemas, each of another name; or long definitions of a few."""
    kind = rng.randrange(4)
    if kind == 0:
        return [_channel(10 + k % 60_000, b"/t%d" % k) for k in range(count)]
    if kind == 1:
        schema = _record(3, struct.pack("<H", 9) + _text(b"nav_msgs/msg/Odometry") + _text(b"") * 2)
        return [schema, *(_channel(10 + k % 60_000, b"/t%d" % k, 9) for k in range(count))]
    if kind == 2:
        names = (_text(b"x/Y%d" % k) + _text(b"") * 2 for k in range(count))
        return [_record(3, struct.pack("<H", 9 + k % 60_000) + t) for k, t in enumerate(names)]
    long = _text(b"x/Y") + _text(b"ros2msg") + _text(b"uint8 a\n" * (MIB // 8))
    return [_record(3, struct.pack("<H", 9 + k) + long) for k in range(40)]


def _descriptions_in_front(rng: random.Random, folder: Path) -> Case:
    front, records = _front(folder), _described(rng, _share(rng, 300_000))
    head_end = 8 + 9 + struct.unpack_from("<Q", front, 9)[0]
    flood = b"".join(_chunk(b"".join(records[k : k + 1000])) for k in range(0, len(records), 1000))
    path = folder / "run.mcap"
    path.write_bytes(front[:head_end] + flood + front[head_end:] + _TAIL)
    return Case(path, SOUND, 0, f"{len(records)} descriptions in front of the messages")


def _packed_descriptions(rng: random.Random) -> bytes:
    """A chunk of up to a million descriptions, each of another name."""
    import zstandard

    data = b"".join(_described(rng, _share(rng, 10**6)))
    return _chunk(zstandard.compress(data, 3), b"zstd", len(data))


# Databases


def _beside(rng: random.Random, folder: Path) -> Case:
    """A log beside the database that is another's, damaged, random, cut, or no file."""
    later = "UPDATE messages SET timestamp = timestamp + 1 WHERE id < 200"
    path, wal = _died(folder, lambda base: base.execute(later))
    raw = bytearray(wal.read_bytes())
    wal.unlink()
    how = rng.choice(("foreign", "bits", "cut", "noise", "pages", "journal", "link", "fifo", "shm"))
    beside = path.with_name(path.name + ("-journal" if how == "journal" else "-wal"))
    if how == "foreign":
        raw[16:24] = rng.randbytes(8)  # the salts
    elif how == "bits":
        for _ in range(rng.choice((1, 10, 1000))):
            raw[rng.randrange(len(raw))] ^= 1 << rng.randrange(8)
    elif how == "cut":
        del raw[rng.randrange(len(raw)) :]
    elif how == "noise":
        raw[:] = rng.randbytes(rng.choice((1, 31, 32, 5000, 5 * MIB)))
    elif how == "pages":
        # Every frame says that the database has 2^31 pages.
        for at in range(32, len(raw), 24 + 4096):
            raw[at + 4 : at + 8] = b"\x7f\xff\xff\xff"
    elif how == "journal":
        head = b"\xd9\xd5\x05\xf9\x20\xa1\x63\xd7" + struct.pack(">IIIII", 2, 1, 1, 512, 4096)
        raw[:] = head.ljust(512, b"\0") + struct.pack(">I", 2) + rng.randbytes(4100) * 3
    if how == "link":
        beside.symlink_to(rng.choice(("/dev/zero", beside.name, "gone", "/proc/self/mem")))
    elif how == "fifo":
        import os

        os.mkfifo(beside)
    else:
        beside.write_bytes(bytes(raw))
    if how == "shm":
        path.with_name(path.name + "-shm").write_bytes(rng.randbytes(32_768))
    harmless = how in ("foreign", "noise", "link", "fifo", "shm", "pages")
    return Case(path, SOUND if harmless else None, None, f"beside the database: {how}")


# Names


def _long_names(kind: str, rng: random.Random, folder: Path) -> Case:
    """Topics, types and frames of up to 10^6 characters."""
    logs = writers()
    long = rng.choice(("x", "/", "ä", "\u202e", "a/b", " ", "%s{0}")) * 10**6
    long = long[: rng.choice((5000, 70_000, 10**6))]
    messages = logs.drive(ODOMETRY)
    what = rng.choice(("frame", "child", "topic"))
    if what == "topic":
        messages = [*messages, *(replace(m, topic="/" + long) for m in messages[:20])]
    else:
        messages = [
            replace(m, frame="odom" + long) if what == "frame" else replace(m, child="base" + long)
            for m in messages[:40]
        ]
    if kind == "mcap":
        log = logs.mcap(folder / "run.mcap", messages)
    elif kind == "bag":
        log = logs.bag(folder / "run.bag", messages)
    else:
        log = logs.ros2_folder(folder / "run", messages)
    return Case(log, None, None, f"a {what} of {len(long)} characters")


CASES: dict[str, Generator] = {
    "bag-connections": _bag(_connections, "up to 10^6 connections"),
    "bag-index-flood": _index_flood,
    "bag-false-index": _false_index,
    "mcap-descriptions-in-front": _descriptions_in_front,
    "mcap-packed-descriptions": _mcap(_packed_descriptions, "up to 10^6 descriptions in zstd"),
    "mcap-huge-attachment": _huge_attachment,
    "mcap-summary-flood": _summary_flood,
    "mcap-false-summary": _false_summary,
    "db3-log-beside": _beside,
    **{f"names-{kind}": partial(_long_names, kind) for kind in ("mcap", "bag", "db3")},
}
