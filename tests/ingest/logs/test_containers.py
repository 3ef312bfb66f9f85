"""One run out of every container."""

from __future__ import annotations

import shutil
import sqlite3
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
import zstandard

from topobatch.ingest.logs.inflate import inflate
from topobatch.ingest.reading import inspect_log, log_size, read_run

MCAPS = {
    "zstd": {},
    "lz4": {"compression": "LZ4"},
    "none": {"compression": "NONE"},
    "unchunked": {"use_chunking": False},
    "no-index": {"index_types": 0},
    "no-summary": {
        "index_types": 0,
        "repeat_channels": False,
        "repeat_schemas": False,
        "use_statistics": False,
        "use_summary_offsets": False,
    },
    "no-crc": {"enable_crcs": False},
    "data-crc": {"enable_data_crcs": True},
    "one-chunk": {"chunk_size": 1 << 30},
    "empty-profile": {"profile": ""},
    "no-schema-text": {"schemas": False},
    "ros1": {"encoding": "ros1", "profile": "ros1"},
    "protobuf": {"encoding": "protobuf", "profile": ""},
    "json": {"encoding": "json", "profile": ""},
}


def _options(options):
    from mcap.writer import IndexType

    if "index_types" in options:
        return {**options, "index_types": IndexType.NONE}
    return options


def _write(logs, folder: Path, container: str) -> Path:
    messages = logs.drive()
    if container in MCAPS:
        return logs.mcap(folder / "run.mcap", messages, **_options(MCAPS[container]))
    if container.startswith("bag-"):
        return logs.bag(folder / "run.bag", messages, container[4:])
    storage, compression = container.split("-")
    return logs.ros2_folder(folder / "run", messages, storage, compression)


CONTAINERS = [
    *MCAPS,
    "bag-none",
    "bag-bz2",
    "bag-lz4",
    "SQLITE3-NONE",
    "SQLITE3-MESSAGE",
    "SQLITE3-FILE",
    "MCAP-NONE",
    "MCAP-MESSAGE",
    "MCAP-FILE",
    "MCAP-STORAGE",
]


def expected(logs):
    messages = logs.drive()
    odometry = [m for m in messages if m.topic == "/odom"]
    seen = [m for m in messages if m.topic == "/junctions"]
    return odometry, seen


def assert_whole(logs, run, clock="stamp_ns") -> None:
    odometry, seen = expected(logs)
    assert run.odometry.time_ns.tolist() == [getattr(m, clock) for m in odometry]
    assert run.odometry.pose[:, :2].tolist() == [list(m.poses[0][:2]) for m in odometry]
    yaw = [2 * np.arctan2(m.poses[0][5], m.poses[0][6]) for m in odometry]
    np.testing.assert_allclose(run.odometry.pose[:, 2], yaw, atol=1e-12)
    assert run.detections.time_ns.tolist() == [getattr(m, clock) for m in seen]
    assert run.detections.centre.tolist() == [list(m.poses[0][:2]) for m in seen]
    assert run.detections.branches.counts.tolist() == [len(m.poses) for m in seen]
    ways = [2 * np.arctan2(p[5], p[6]) for m in seen for p in m.poses]
    np.testing.assert_allclose(run.detections.branches.values, ways, atol=1e-12)


@pytest.mark.parametrize("container", CONTAINERS)
def test_every_container_gives_the_whole_run(logs, tmp_path, container):
    path = _write(logs, tmp_path, container)
    told = []
    run = read_run(path, on_bytes=told.append)
    assert_whole(logs, run)
    assert run.name == "run"
    assert run.warnings == ()
    assert sum(told) == log_size(path)
    assert run.odometry.frame == "odom"
    info = inspect_log(path)
    assert sorted((t.topic, t.messages, t.use) for t in info.topics) == [
        ("/junctions", 30, "junctions"),
        ("/odom", 300, "odometry"),
    ]
    assert info.problems == ()


def test_log_time_is_used_on_request(logs, tmp_path):
    from topobatch.ingest.reading import ReadSettings

    for path in (
        logs.mcap(tmp_path / "run.mcap", logs.drive()),
        logs.bag(tmp_path / "run.bag", logs.drive()),
        logs.ros2_folder(tmp_path / "run", logs.drive()),
    ):
        assert_whole(logs, read_run(path, ReadSettings(time="log")), "log_ns")


def test_messages_left_in_a_write_ahead_log_are_read(logs, tmp_path, monkeypatch):
    folder = logs.ros2_folder(tmp_path / "run", logs.drive())
    live, copy = folder / "run.db3", tmp_path / "copy"
    base = sqlite3.connect(live)
    base.execute("PRAGMA journal_mode=WAL")
    rows = base.execute("SELECT * FROM messages WHERE id > 200").fetchall()
    base.execute("DELETE FROM messages WHERE id > 200")
    base.commit()
    base.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    base.executemany("INSERT INTO messages VALUES (?, ?, ?, ?)", rows)
    base.commit()
    copy.mkdir()
    for name in ("run.db3", "run.db3-wal", "metadata.yaml"):
        shutil.copy(folder / name, copy)
    base.close()
    assert (copy / "run.db3-wal").stat().st_size > 0
    before = {file.name: file.read_bytes() for file in copy.iterdir()}
    assert_whole(logs, read_run(copy))
    assert {file.name: file.read_bytes() for file in copy.iterdir()} == before
    connect, opened = sqlite3.connect, []
    with monkeypatch.context() as patch:  # a copy is read: nothing may be written beside it
        patch.setattr(sqlite3, "connect", lambda at, **o: opened.append(at) or connect(at, **o))
        assert_whole(logs, read_run(copy))
    assert opened
    assert not any(str(copy) in at for at in opened)
    log = bytearray(before["run.db3-wal"])
    log[len(log) // 2] ^= 4
    (copy / "run.db3-wal").write_bytes(log)
    run = read_run(copy)
    assert len(run.odometry) + len(run.detections) > 200
    assert any("write-ahead log damaged; what follows is used" in text for text in run.warnings)


def test_a_transaction_that_was_never_finished_is_taken_back(logs, tmp_path):
    folder, copy = logs.ros2_folder(tmp_path / "run", logs.drive()), tmp_path / "copy"
    base = sqlite3.connect(folder / "run.db3")
    base.execute("PRAGMA cache_size = 1")
    base.execute("PRAGMA cache_spill = 1")
    base.execute("DELETE FROM messages WHERE id % 2")
    shutil.copytree(folder, copy)
    base.close()
    assert (copy / "run.db3-journal").stat().st_size > 0
    before = {file.name: file.read_bytes() for file in copy.iterdir()}
    assert_whole(logs, read_run(copy))
    assert {file.name: file.read_bytes() for file in copy.iterdir()} == before


def test_a_folder_of_parts_is_one_run(logs, tmp_path):
    messages = logs.drive()
    folder = tmp_path / "run"
    folder.mkdir()
    # Names in an order that the alphabet gets wrong.
    for number in range(11):
        part = messages[number * 30 : (number + 1) * 30]
        if number % 2:
            logs.bag(folder / f"part_{number}.bag", part)
        else:
            logs.mcap(folder / f"part_{number}.mcap", part)
    run = read_run(folder)
    assert_whole(logs, run)
    assert run.warnings == ()


def test_files_are_known_by_their_content(logs, tmp_path):
    path = logs.mcap(tmp_path / "run.mcap", logs.drive())
    path.rename(tmp_path / "run.bag")
    assert_whole(logs, read_run(tmp_path / "run.bag"))


def test_a_bare_database_is_a_log(logs, tmp_path):
    folder = logs.ros2_folder(tmp_path / "bag", logs.drive())
    (folder / "metadata.yaml").unlink()
    assert_whole(logs, read_run(folder / "bag.db3"))
    assert_whole(logs, read_run(folder))


def test_threads_decompress_at_one_time():
    """Of zstd each has a decompressor of its own: shared, one gave wrong bytes."""
    plain = [bytes([k]) * 50_000 + bytes(range(256)) * k for k in range(200)]
    packed = [zstandard.compress(raw) for raw in plain]
    with ThreadPoolExecutor(4) as pool:
        assert [*pool.map(inflate, ["zstd"] * 200, packed, map(len, plain))] == plain
