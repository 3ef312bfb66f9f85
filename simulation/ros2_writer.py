"""ROS 2 bag folders with sqlite3 or MCAP storage, written so that the bytes depend on the messages.

Layout as ROS 2 Jazzy writes it: metadata version 9, database schema 4.
"""

from __future__ import annotations

import sqlite3
import struct
from pathlib import Path

from ..topology.document import write_atomically
from .mcap_writer import mcap_bytes
from .messages import DIGESTS, Topic, definition, in_log_order

METADATA_VERSION = 9
DISTRIBUTION = "jazzy"

SQLITE_VERSION_AT = 96
"""Byte at which a database notes the version of the library that wrote it."""

SQLITE_VERSION = 3_040_000

PAGE_BYTES = 4096

TREE_PAGES = {2: 12, 5: 12, 10: 8, 13: 8}
"""Bytes of header by the kind of a page that holds cells."""

PRAGMAS = f"""
PRAGMA page_size = {PAGE_BYTES};
PRAGMA auto_vacuum = NONE;
PRAGMA encoding = 'UTF-8';
PRAGMA journal_mode = OFF;
PRAGMA secure_delete = ON;
"""

TABLES = """
CREATE TABLE schema(schema_version INTEGER PRIMARY KEY, ros_distro TEXT NOT NULL);
CREATE TABLE metadata(
  id INTEGER PRIMARY KEY, metadata_version INTEGER NOT NULL, metadata TEXT NOT NULL);
CREATE TABLE topics(
  id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL,
  serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL,
  type_description_hash TEXT NOT NULL);
CREATE TABLE message_definitions(
  id INTEGER PRIMARY KEY, topic_type TEXT NOT NULL, encoding TEXT NOT NULL,
  encoded_message_definition TEXT NOT NULL, type_description_hash TEXT NOT NULL);
CREATE TABLE messages(
  id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL,
  data BLOB NOT NULL);
CREATE INDEX timestamp_idx ON messages (timestamp ASC);
"""


def write_ros2_folder(folder: Path, topics: tuple[Topic, ...], storage: str) -> None:
    """Write `folder`/metadata.yaml and the storage file beside it; storage: "sqlite3" or "mcap"."""
    folder.mkdir(parents=True, exist_ok=True)
    file = f"{folder.name}_0.{'db3' if storage == 'sqlite3' else 'mcap'}"
    metadata = _metadata(topics, storage, file)
    if storage == "sqlite3":
        write_atomically(folder / file, lambda path: _write_sqlite(path, topics, metadata))
    else:
        raw = mcap_bytes(topics)
        write_atomically(folder / file, lambda path: path.write_bytes(raw))
    text = "rosbag2_bagfile_information:\n" + "".join(f"  {line}\n" for line in metadata)
    write_atomically(folder / "metadata.yaml", lambda path: path.write_bytes(text.encode()))


def _metadata(topics: tuple[Topic, ...], storage: str, file: str) -> list[str]:
    """The lines of metadata.yaml below its first."""
    times = [int(t) for topic in topics for t in topic.log_ns]
    start, duration = min(times), max(times) - min(times)
    lines = [
        f"version: {METADATA_VERSION}",
        f"storage_identifier: {storage}",
        "duration:",
        f"  nanoseconds: {duration}",
        "starting_time:",
        f"  nanoseconds_since_epoch: {start}",
        f"message_count: {len(times)}",
        "topics_with_message_count:",
    ]
    for topic in topics:
        lines += [
            "  - topic_metadata:",
            f"      name: {topic.name}",
            f"      type: {topic.type_name}",
            "      serialization_format: cdr",
            "      offered_qos_profiles: []",
            f"      type_description_hash: {DIGESTS['ros2', topic.type_name]}",
            f"    message_count: {len(topic.payloads)}",
        ]
    return [
        *lines,
        'compression_format: ""',
        'compression_mode: ""',
        "relative_file_paths:",
        f"  - {file}",
        "files:",
        f"  - path: {file}",
        "    starting_time:",
        f"      nanoseconds_since_epoch: {start}",
        "    duration:",
        f"      nanoseconds: {duration}",
        f"    message_count: {len(times)}",
        "custom_data: ~",
        f"ros_distro: {DISTRIBUTION}",
    ]


def _write_sqlite(path: Path, topics: tuple[Topic, ...], metadata: list[str]) -> None:
    """One transaction into an empty file, then the traces of the library removed."""
    hashes = [DIGESTS["ros2", t.type_name] for t in topics]
    database = sqlite3.connect(path, isolation_level=None)
    try:
        database.executescript(f"{PRAGMAS} BEGIN; {TABLES}")
        database.execute("INSERT INTO schema VALUES (4, ?)", (DISTRIBUTION,))
        text = "".join(f"{line}\n" for line in metadata)
        database.execute("INSERT INTO metadata VALUES (1, ?, ?)", (METADATA_VERSION, text))
        for i, (topic, digest) in enumerate(zip(topics, hashes, strict=True), 1):
            row = (i, topic.name, topic.type_name, "cdr", "[]", digest)
            database.execute("INSERT INTO topics VALUES (?, ?, ?, ?, ?, ?)", row)
            about = (i, topic.type_name, "ros2msg", definition(topic.type_name, "ros2"), digest)
            database.execute("INSERT INTO message_definitions VALUES (?, ?, ?, ?, ?)", about)
        database.executemany(
            "INSERT INTO messages VALUES (?, ?, ?, ?)",
            (
                (i, number + 1, log, payload)
                for i, (number, log, _, payload) in enumerate(in_log_order(topics), 1)
            ),
        )
        database.execute("COMMIT")
    finally:
        database.close()
    path.write_bytes(_settled(path.read_bytes()))


def _settled(raw: bytes) -> bytes:
    """A database without what depends on the library: its version, and scraps in unused space.

    A page holds a header of 8 bytes (12 if it has children below), two bytes per cell, unused
    space, and the cells; the format says nothing about the bytes of the unused space.
    """
    out = bytearray(raw)
    out[SQLITE_VERSION_AT : SQLITE_VERSION_AT + 4] = struct.pack(">I", SQLITE_VERSION)
    for page in range(0, len(out), PAGE_BYTES):
        head = page + (100 if page == 0 else 0)
        kind, _, cells, content = struct.unpack_from(">BHHH", out, head)
        if kind in TREE_PAGES:
            unused = head + TREE_PAGES[kind] + 2 * cells
            out[unused : page + content] = bytes(page + content - unused)
    return bytes(out)
