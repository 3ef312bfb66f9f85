"""Logs that claim, or inflate to, far more than they are; and floods of things that cost work.

Every log also holds a small sound run (SOUND messages of the wanted topics) where its format lets
it, so that reading it to the end shows: what is sound is used in spite of the rest. The size of a
flood is drawn between 1/20 and all of what its name says.
"""

from __future__ import annotations

import bz2
import random
import sqlite3
import struct
from collections.abc import Callable
from functools import partial
from pathlib import Path

from case import Case, Generator, without_index, writers

ODOMETRY = 300
SOUND = 330
MIB = 1 << 20


# MCAP


def _record(op: int, body: bytes) -> bytes:
    return struct.pack("<BQ", op, len(body)) + body


def _text(text: bytes) -> bytes:
    return struct.pack("<I", len(text)) + text


def _chunk(
    records: bytes, compression: bytes = b"", size: int | None = None, crc: int = 0
) -> bytes:
    """A chunk record around data that are already compressed."""
    size = len(records) if size is None else size
    head = struct.pack("<QQQI", 0, 1, size, crc) + _text(compression)
    return _record(6, head + struct.pack("<Q", len(records)) + records)


def _message(channel: int, payload: bytes, time_ns: int = 1) -> bytes:
    return _record(5, struct.pack("<HIQQ", channel, 0, time_ns, time_ns) + payload)


def _channel(number: int, topic: bytes, schema: int = 0) -> bytes:
    return _record(
        4, struct.pack("<HH", number, schema) + _text(topic) + _text(b"cdr") + _text(b"")
    )


def _front(folder: Path, chunked: bool = True) -> bytes:
    """A sound MCAP file up to the end of its data, without any index."""
    from mcap.writer import IndexType

    logs = writers()
    path = logs.mcap(
        folder / "sound.mcap",
        logs.drive(ODOMETRY),
        use_chunking=chunked,
        index_types=IndexType.NONE,
        use_statistics=False,
        use_summary_offsets=False,
        repeat_channels=False,
    )
    raw: bytes = path.read_bytes()
    path.unlink()
    return raw[: raw.rindex(b"\x0f\x04\x00\x00\x00\x00\x00\x00\x00")]


_TAIL = _record(15, bytes(4)) + _record(2, bytes(20)) + b"\x89MCAP0\r\n"


def _mcap(
    make: Callable[[random.Random], bytes],
    note: str,
    *,
    chunked: bool = True,
    lost: int | Callable[[bytes], int] | None = None,
) -> Generator:
    """lost: messages of the wanted topics that cannot be used; None where what a bomb holds is no
    message that anybody wrote, but may be taken for one that is lost."""

    def write(rng: random.Random, folder: Path) -> Case:
        path = folder / "run.mcap"
        made = make(rng)
        path.write_bytes(_front(folder, chunked) + made + _TAIL)
        return Case(path, SOUND, lost(made) if callable(lost) else lost, note)

    return write


def _share(rng: random.Random, most: int) -> int:
    return int(most * rng.choice((0.05, 0.3, 1.0)))


def _zeros(compression: bytes, size: int) -> bytes:
    """So many zero bytes, compressed piece by piece."""
    if compression == b"zstd":
        import zstandard

        packer = zstandard.ZstdCompressor().compressobj()
        parts = [packer.compress(bytes(MIB)) for _ in range(size // MIB)]
        return b"".join(parts) + packer.flush()
    if compression == b"bz2":
        packer = bz2.BZ2Compressor()
        parts = [packer.compress(bytes(MIB)) for _ in range(size // MIB)]
        return b"".join(parts) + packer.flush()
    import lz4.frame

    with_size = lz4.frame.LZ4FrameCompressor()
    parts = [with_size.begin()] + [with_size.compress(bytes(MIB)) for _ in range(size // MIB)]
    return b"".join(parts) + with_size.flush()


def _chunk_of_messages(rng: random.Random) -> bytes:
    """Chunks of 511 MiB of messages that nobody wants."""
    import zstandard

    one = _message(7, bytes(rng.choice((0, 100, 5000))))
    many = one * (MIB // len(one))
    packer, count = zstandard.ZstdCompressor().compressobj(), 511 * MIB // len(many)
    packed = b"".join(packer.compress(many) for _ in range(count)) + packer.flush()
    head = _chunk(_channel(7, b"/noise"))
    return head + _chunk(packed, b"zstd", count * len(many)) * rng.randint(1, 3)


def _declared(rng: random.Random) -> bytes:
    import zstandard

    sizes = (0, 1, 511 * MIB, 1 << 40, (1 << 63) - 1)
    return b"".join(
        _chunk(zstandard.compress(bytes(1000)), b"zstd", rng.choice(sizes))
        + _chunk(bz2.compress(bytes(1000)), b"bz2", rng.choice(sizes))
        for _ in range(20)
    )


def _one_large_message(rng: random.Random) -> bytes:
    import zstandard

    size = _share(rng, 448 * MIB)
    # Odometry: its channel is the first one that the sound part registers.
    head = struct.pack("<BQ", 5, size + 22) + struct.pack("<HIQQ", 1, 0, 1, 1)
    packer = zstandard.ZstdCompressor().compressobj()
    parts = [packer.compress(head), *(packer.compress(bytes(MIB)) for _ in range(size // MIB))]
    parts += [packer.compress(bytes(size % MIB)), packer.flush()]
    return _chunk(b"".join(parts), b"zstd", size + len(head))


def _channels(rng: random.Random) -> bytes:
    count = _share(rng, 10**6)
    name = rng.choice((b"/t%d", b"/always"))
    records = b"".join(
        _channel(k % 65536, name % k if b"%" in name else name) for k in range(count)
    )
    return b"".join(_chunk(records[k : k + MIB]) for k in range(0, len(records), MIB))


def _small_chunks(rng: random.Random) -> bytes:
    import zstandard

    count = _share(rng, 10**6)
    one = _message(7, bytes(8))
    compression = rng.choice((b"", b"zstd"))
    data = one if not compression else zstandard.compress(one)
    index = _record(7, struct.pack("<HI", 7, 16) + bytes(16))
    chunk = _chunk(data, compression, len(one)) + index
    return _chunk(_channel(7, b"/noise")) + chunk * count


_BROKEN = _chunk(_message(1, bytes(8)), b"", crc=3)
"""A chunk of one odometry message whose checksum is wrong."""


def _broken_small_chunks(rng: random.Random) -> bytes:
    return _BROKEN * _share(rng, 10**5)


def _false_heads(rng: random.Random) -> bytes:
    size = _share(rng, 8 * MIB)
    heads = (
        b"\x05" + struct.pack("<Q", 60),
        b"\x06" + struct.pack("<Q", 70),
        b"\x05" + struct.pack("<QH", 40, 1),
        b"\x06" + struct.pack("<Q", 10**6),
        b"\x07" + struct.pack("<Q", 22),
        b"\x06" + struct.pack("<Q", 40) + bytes(40),
        b"\x04\x00\x00\x00zstd",
    )
    head = rng.choice(heads)
    return head * (size // len(head))


def _nested(rng: random.Random) -> bytes:
    """Definitions that inflate when they are followed."""
    line = "=" * 80
    kind = rng.randrange(5)
    if kind == 0:
        parts = [f"MSG: p/T{k}\np/T{k + 1} a\np/T{k + 1} b" for k in range(30)] + ["MSG: p/T30"]
    elif kind == 1:
        parts = [f"MSG: p/T{k}\np/T{k + 1}[1000] a" for k in range(8)] + ["MSG: p/T8\nuint8 a"]
    elif kind == 2:
        parts = ["MSG: p/T0\nstring[2147483647] a"]
    elif kind == 3:
        parts = ["MSG: p/T0\np/T1[] a\np/T1[2000000000] b", "MSG: p/T1"]
    else:
        parts = ["MSG: p/T0\np/T0[] a"]
    text = f"\n{line}\n".join(["p/T0 header", *parts]).encode()
    schema = _record(
        3, struct.pack("<H", 9) + _text(b"nav_msgs/msg/Odometry") + _text(b"ros2msg") + _text(text)
    )
    payload = b"\x00\x01\x00\x00" + b"\xff\xff\xff\x7f" * 300
    return _chunk(schema + _channel(9, b"/odd", 9) + _message(9, payload) * 50)


def _nested_alone(rng: random.Random, folder: Path) -> Case:
    """The same for a topic that is named as the junctions' source by its only name."""
    path = folder / "run.mcap"
    path.write_bytes(_front(folder) + _nested(rng) + _TAIL)
    return Case(path, None, None, "definitions that inflate when followed")


# Bags


def _field(name: bytes, value: bytes) -> bytes:
    return struct.pack("<I", len(name) + 1 + len(value)) + name + b"=" + value


def _bag_record(fields: dict[bytes, bytes], data: bytes) -> bytes:
    header = b"".join(_field(name, value) for name, value in fields.items())
    return struct.pack("<I", len(header)) + header + struct.pack("<I", len(data)) + data


def _bag_chunk(data: bytes, compression: bytes, size: int) -> bytes:
    fields = {b"op": b"\x05", b"compression": compression, b"size": struct.pack("<I", size)}
    return _bag_record(fields, data)


def _bag_message(conn: int, payload: bytes) -> bytes:
    fields = {b"op": b"\x02", b"conn": struct.pack("<I", conn), b"time": bytes(8)}
    return _bag_record(fields, payload)


def _bag(make: Callable[[random.Random], bytes], note: str, lost: int | None = None) -> Generator:
    def write(rng: random.Random, folder: Path) -> Case:
        logs = writers()
        path = logs.bag(folder / "run.bag", logs.drive(ODOMETRY))
        path.write_bytes(without_index(path.read_bytes()) + make(rng))
        return Case(path, SOUND, lost, note)

    return write


def _bag_large(rng: random.Random) -> bytes:
    size = 511 * MIB
    compression = rng.choice((b"bz2", b"lz4"))
    return _bag_chunk(_zeros(compression, size), compression, size) * rng.randint(2, 4)


def _bag_declared(rng: random.Random) -> bytes:
    sizes = (1, 511 * MIB, (1 << 32) - 1)
    return b"".join(
        _bag_chunk(bz2.compress(bytes(1000)), b"bz2", rng.choice(sizes)) for _ in range(40)
    )


def _bag_small(rng: random.Random) -> bytes:
    count = _share(rng, 10**6)
    data = _bag_message(77, bytes(8))
    fields = {b"op": b"\x04", b"ver": struct.pack("<I", 1), b"conn": struct.pack("<I", 77)}
    index = _bag_record({**fields, b"count": struct.pack("<I", 1)}, bytes(12))
    return (_bag_chunk(data, b"none", len(data)) + index) * count


def _bag_marks(rng: random.Random) -> bytes:
    mark = rng.choice(
        (
            b"\x04\x00\x00\x00op=\x05",
            struct.pack("<I", 40) + b"\x04\x00\x00\x00op=\x05",
            _bag_chunk(b"", b"none", 5),
            struct.pack("<I", 8) + b"\x04\x00\x00\x00op=\x02" + b"\xff\xff\x00\x00",
            struct.pack("<I", 60_000) + b"\x04\x00\x00\x00op=\x02",
            struct.pack("<I", 8000) + b"\x04\0\0\0op=\x07" + struct.pack("<I", 7989) + b"topic=",
            _bag_chunk(rng.choice((b"", b"x")), rng.choice((b"lz4", b"bz2", b"none")), 5),
        )
    )
    return mark * (_share(rng, 8 * MIB) // len(mark))


# sqlite


def _db3(folder: Path) -> Path:
    logs = writers()
    return Path(logs.ros2_folder(folder / "run", logs.drive(ODOMETRY)) / "run.db3")


def _died(folder: Path, write: Callable[[sqlite3.Connection], object]) -> tuple[Path, Path]:
    """A database and the log beside it, which holds what was written: the recorder died."""
    path = _db3(folder)
    base = sqlite3.connect(path)
    base.execute("PRAGMA journal_mode=WAL")
    base.execute("PRAGMA wal_autocheckpoint=0")
    write(base)
    base.commit()
    copies = [folder / "died" / (path.name + suffix) for suffix in ("", "-wal")]
    copies[0].parent.mkdir()
    for copy in copies:
        copy.write_bytes(path.with_name(copy.name).read_bytes())
    base.close()
    return copies[0], copies[1]


_SCHEMAS = {
    "a view of endless rows": (
        "ALTER TABLE messages RENAME TO kept; CREATE VIEW messages AS WITH RECURSIVE n(i) AS "
        "(SELECT 1 UNION ALL SELECT i + 1 FROM n) SELECT i AS id, 1 AS topic_id, i AS timestamp, "
        "zeroblob(1000000) AS data FROM n;"
    ),
    "topics out of a view": (
        "ALTER TABLE topics RENAME TO kept; CREATE VIEW topics AS WITH RECURSIVE n(i) AS "
        "(SELECT 1 UNION ALL SELECT i + 1 FROM n) SELECT i AS id, '/t' || i AS name, "
        "'nav_msgs/msg/Odometry' AS type, 'cdr' AS serialization_format, '' AS "
        "offered_qos_profiles, '' AS type_description_hash FROM n;"
    ),
    "a generated column": (
        "CREATE TABLE kept AS SELECT * FROM messages; DROP TABLE messages; CREATE TABLE messages "
        "(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, "
        "data BLOB GENERATED ALWAYS AS (zeroblob(500000000)) VIRTUAL); "
        "INSERT INTO messages (topic_id, timestamp) SELECT topic_id, timestamp FROM kept;"
    ),
    "a virtual table": (
        "DROP TABLE messages; CREATE VIRTUAL TABLE messages USING fts5(id, topic_id, timestamp, "
        "data);"
    ),
}


def _schema(name: str, rng: random.Random, folder: Path) -> Case:
    path = _db3(folder)
    base = sqlite3.connect(path)
    try:
        base.executescript(_SCHEMAS[name])
    except sqlite3.OperationalError:
        # This library knows no such tables.
        return Case(path.parent, SOUND, 0, name)
    finally:
        base.close()
    return Case(path.parent, None, None, name)


def _large_rows(rng: random.Random, folder: Path) -> Case:
    path = _db3(folder)
    base = sqlite3.connect(path)
    size, topic = _share(rng, 448 * MIB), rng.choice((1, 2))
    base.execute("INSERT INTO messages VALUES (9999, ?, 1, zeroblob(?))", (topic, size))
    base.commit()
    base.close()
    return Case(path.parent, None, None, f"a row of {size >> 20} MiB")


YAML = {
    "billion laughs": "a: &a [x, x, x, x, x, x, x, x, x]\n"
    + "".join(
        f"{chr(98 + k)}: &{chr(98 + k)} [{', '.join(['*' + chr(97 + k)] * 9)}]\n" for k in range(20)
    ),
    "merge keys": "a: &a {x: 1}\n"
    + "".join(f"b{k}: &b{k}\n  <<: [{', '.join(['*a'] * 200)}]\n" for k in range(300)),
    "brackets": "[" * (4 * MIB - 200),
    "braces": "{a: " * MIB,
    "dashes": "- " * (2 * MIB - 100),
    "JSON": '{"a":' * (4 * MIB // 5 - 50),
}


def _yaml(name: str, rng: random.Random, folder: Path) -> Case:
    path = _db3(folder).parent / "metadata.yaml"
    front = "" if rng.random() < 0.5 else path.read_text()
    if name == "JSON":
        front = ""
    marked = f"{front}{YAML[name]}\n#rosbag2_bagfile_information:\n"
    path.write_text(marked[: 4 * MIB])
    return Case(path.parent, SOUND, 0, f"metadata.yaml: {name}")


CASES: dict[str, Generator] = {
    "mcap-511-mib-of-messages": _mcap(_chunk_of_messages, "chunks of 511 MiB of messages"),
    "mcap-declared-sizes": _mcap(_declared, "sizes that the data do not reach"),
    "mcap-large-message": _mcap(
        _one_large_message, "one odometry message of up to 448 MiB", lost=1
    ),
    "mcap-channels": _mcap(_channels, "up to 10^6 channel records", lost=0),
    "mcap-small-chunks": _mcap(_small_chunks, "up to 10^6 chunks of one message", lost=0),
    "mcap-broken-chunks": _mcap(
        _broken_small_chunks,
        "up to 10^5 chunks with wrong checksums",
        lost=lambda made: len(made) // len(_BROKEN),
    ),
    "mcap-false-heads": _mcap(_false_heads, "megabytes of false heads"),
    "mcap-nested-types": _nested_alone,
    "bag-511-mib-chunks": _bag(_bag_large, "chunks of 511 MiB of zeros"),
    "bag-declared-sizes": _bag(_bag_declared, "sizes that the data do not reach"),
    "bag-small-chunks": _bag(_bag_small, "up to 10^6 chunks of one message", lost=0),
    "bag-false-marks": _bag(_bag_marks, "megabytes of chunk marks"),
    "db3-large-rows": _large_rows,
    **{f"db3-{name.replace(' ', '-')}": partial(_schema, name) for name in _SCHEMAS},
    **{f"yaml-{name.replace(' ', '-')}": partial(_yaml, name) for name in YAML},
}
