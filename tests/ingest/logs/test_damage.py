"""Damaged logs: what is there is read, what is lost is counted, nothing else is raised."""

from __future__ import annotations

import re
import sqlite3
import struct
from datetime import datetime
from pathlib import Path

import pytest

from topobatch.ingest.reading import ReadSettings, inspect_log, read_run
from topobatch.topology.errors import LogError

WRITERS = {
    "mcap-none": lambda logs, path: logs.mcap(path, logs.drive(), compression="NONE"),
    "mcap-unchunked": lambda logs, path: logs.mcap(path, logs.drive(), use_chunking=False),
    "mcap-zstd": lambda logs, path: logs.mcap(path, logs.drive()),
    "mcap-lz4": lambda logs, path: logs.mcap(path, logs.drive(), compression="LZ4"),
    "bag-none": lambda logs, path: logs.bag(path, logs.drive()),
    "bag-bz2": lambda logs, path: logs.bag(path, logs.drive(), "bz2"),
    "bag-lz4": lambda logs, path: logs.bag(path, logs.drive(), "lz4"),
}
COUNT = re.compile(
    r"(\d+) messages could be read, ([\d.]+) s by log time, from ([^,]+) to ([^,]+) UTC$"
)


def said(run) -> int:
    """The number of messages that the report names."""
    found = [match for text in run.warnings if (match := COUNT.search(text))]
    assert len(found) == 1, run.warnings
    first, last = (datetime.fromisoformat(found[0][k]) for k in (3, 4))  # to the second
    assert float(found[0][2]) == pytest.approx((last - first).total_seconds(), abs=1.0)
    return int(found[0][1])


def ends_of_payloads(logs, raw: bytes, ros1: bool) -> list[int]:
    """Where every message of an uncompressed log ends."""
    store, position, ends = logs.store_of(ros1), 0, []
    for message in logs.drive():
        payload = logs.payload(message, "ros1" if ros1 else "cdr", store)
        position = raw.index(payload, position) + len(payload)
        ends.append(position)
    return ends


def read_part(path: Path):
    """The run, or None where too little is left for one."""
    try:
        return read_run(path)
    except LogError as error:
        problem = str(error)
    assert str(path) in problem
    assert "\n" not in problem
    return None


@pytest.mark.parametrize("name", WRITERS)
def test_a_log_cut_anywhere_gives_all_that_is_left(logs, tmp_path, name):
    path = WRITERS[name](logs, tmp_path / "whole")
    raw = path.read_bytes()
    cut_path = tmp_path / "cut"
    whole, before = len(logs.drive()), 0
    plain = name in ("mcap-none", "mcap-unchunked", "bag-none")
    ends = ends_of_payloads(logs, raw, name.startswith("bag")) if plain else []
    for percent in range(1, 100, 7):
        cut = len(raw) * percent // 100
        cut_path.write_bytes(raw[:cut])
        run = read_part(cut_path)
        if run is None:
            continue
        count = len(run.odometry) + len(run.detections)
        if plain:
            assert count == sum(end <= cut for end in ends)
        assert count >= before, "a longer log gives no less"
        assert said(run) == count
        assert count < whole or any("cut short" in text for text in run.warnings)
        before = count
    assert before >= whole * 0.9


@pytest.mark.parametrize("name", ["mcap-zstd", "mcap-lz4", "mcap-none"])
def test_a_flipped_byte_costs_its_chunk_and_is_counted(logs, tmp_path, name):
    path = WRITERS[name](logs, tmp_path / "run.mcap")
    raw = bytearray(path.read_bytes())
    raw[len(raw) // 3] ^= 0x10
    path.write_bytes(raw)
    run = read_run(path)
    count = len(run.odometry) + len(run.detections)
    assert 250 < count < 330
    assert said(run) == count
    assert any("1 damaged chunk skipped" in text for text in run.warnings)
    lost = [re.match(r"(\d+) messages? of (\S+) (?:is|are) lost", text) for text in run.warnings]
    assert sum(int(match[1]) for match in lost if match) == 330 - count
    with pytest.raises(LogError, match="damaged: 1 damaged chunk"):
        read_run(path, ReadSettings(strict=True))


def test_a_chunk_of_unknown_compression_is_reported(logs, tmp_path):
    path = logs.mcap(tmp_path / "run.mcap", logs.drive())
    raw = path.read_bytes()
    at = raw.index(b"\x04\x00\x00\x00zstd", len(raw) // 2)
    path.write_bytes(raw[:at] + b"\x04\x00\x00\x00zst9" + raw[at + 8 :])
    run = read_run(path)
    assert any("compression 'zst9' is not known" in text for text in run.warnings)
    assert said(run) == len(run.odometry) + len(run.detections) < 330


@pytest.mark.parametrize("name", ["mcap-zstd", "mcap-none", "bag-none", "bag-lz4"])
@pytest.mark.parametrize("summary", [True, False])
def test_reading_goes_on_behind_a_destroyed_stretch(logs, tmp_path, name, summary):
    path = WRITERS[name](logs, tmp_path / "run")
    raw = bytearray(path.read_bytes())
    middle = len(raw) // 3
    raw[middle : middle + 400] = bytes(400)
    path.write_bytes(raw if summary else raw[: -len(raw) // 20])
    run = read_run(path)
    last = int(run.odometry.time_ns[-1])
    assert last > logs.START_NS + 0.85 * 300 * 20_000_000
    count = len(run.odometry) + len(run.detections)
    assert 150 < count < 330
    assert run.warnings


def test_an_unindexed_bag_is_read(logs, tmp_path):
    path = logs.bag(tmp_path / "run.bag", logs.drive())
    raw = path.read_bytes()
    index = struct.unpack_from("<Q", raw, raw.index(b"index_pos=") + 10)[0]
    active = tmp_path / "run.bag.active"
    zeroed = raw[:index].replace(struct.pack("<Q", index), bytes(8), 1)
    active.write_bytes(zeroed)
    run = read_run(active)
    assert run.name == "run"
    assert (len(run.odometry), len(run.detections)) == (300, 30)
    assert inspect_log(active).topics == inspect_log(path).topics


@pytest.mark.parametrize("compression", ["none", "lz4", "bz2"])
def test_the_open_chunk_of_an_active_bag_is_read(logs, tmp_path, compression):
    """A recorder that is killed leaves a last chunk whose head still says that it is empty."""
    path = logs.bag(tmp_path / "run.bag", logs.drive(), compression)
    raw = path.read_bytes()
    marks = [m.start() for m in re.finditer(rb"\x0d\x00\x00\x00compression|op=\x05", raw)]
    start = max(m for m in marks if raw[m : m + 4] == b"op=\x05")
    size_at = raw.index(b"size=", start - 60) + 5
    head_at = next(p for p in range(start - 60, start) if _is_chunk_head(raw, p))
    length = struct.unpack_from("<I", raw, head_at)[0]
    data_at = head_at + 4 + length
    data_size = struct.unpack_from("<I", raw, data_at)[0]
    open_chunk = bytearray(raw[: data_at + 4 + data_size])
    open_chunk[size_at : size_at + 4] = bytes(4)
    open_chunk[data_at : data_at + 4] = bytes(4)
    active = tmp_path / "open.bag.active"
    active.write_bytes(open_chunk)
    run = read_run(active)
    assert (len(run.odometry), len(run.detections)) == (300, 30)
    assert any("cut short" in text for text in run.warnings)


def _is_chunk_head(raw: bytes, position: int) -> bool:
    length = struct.unpack_from("<I", raw, position)[0]
    header = raw[position + 4 : position + 4 + length]
    return (
        20 < length < 80
        and b"op=\x05" in header
        and b"compression=" in header
        and (struct.unpack_from("<I", header)[0] < 40)
    )


def test_one_line_says_why_nothing_can_be_read(logs, tmp_path):
    folder, empty, foreign = tmp_path / "folder", tmp_path / "empty.mcap", tmp_path / "a.bag"
    folder.mkdir()
    empty.touch()
    foreign.write_text("#ROSBAG V1.1\n")
    whole = logs.mcap(tmp_path / "whole.mcap", logs.drive(), compression="NONE")
    stub = tmp_path / "stub.mcap"
    stub.write_bytes(whole.read_bytes()[:60])
    for path, words in (
        (tmp_path / "missing.mcap", "no such file"),
        (folder, "holds no log files"),
        (empty, "is empty"),
        (foreign, "is no log"),
        (stub, "nothing can be read"),
    ):
        with pytest.raises(LogError, match=words) as caught:
            read_run(path)
        assert str(path) in str(caught.value)
        assert "\n" not in str(caught.value)


def test_a_file_that_metadata_names_but_is_missing_is_reported(logs, tmp_path):
    folder = logs.ros2_folder(tmp_path / "run", logs.drive())
    text = (folder / "metadata.yaml").read_text()
    (folder / "metadata.yaml").write_text(text.replace("- run.db3", "- run.db3\n  - run_1.db3"))
    run = read_run(folder)
    assert len(run.odometry) == 300
    assert any("names run_1.db3, which is missing" in text for text in run.warnings)
    (folder / "metadata.yaml").write_text("{ broken: [")
    run = read_run(folder)
    assert len(run.odometry) == 300
    assert any("metadata.yaml cannot be read" in text for text in run.warnings)


def big_database(logs, tmp_path) -> Path:
    """A folder's database with large rows between the others, so that pages follow no pattern."""
    folder = logs.ros2_folder(tmp_path / "run", logs.drive())
    path = folder / "run.db3"
    base = sqlite3.connect(path)
    base.execute("INSERT INTO topics SELECT 9, '/camera', 'sensor_msgs/msg/Image', 'cdr', '', ''")
    rows = base.execute("SELECT topic_id, timestamp, data FROM messages ORDER BY id").fetchall()
    base.execute("DELETE FROM messages")
    base.commit()
    base.execute("VACUUM")
    for number, row in enumerate(rows):
        base.execute("INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)", row)
        if number % 25 == 0:
            image = (9, row[1], bytes(range(256)) * 40)
            base.execute("INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)", image)
    base.commit()
    base.close()
    return path


def test_a_database_cut_anywhere_gives_what_is_left(logs, tmp_path):
    path = big_database(logs, tmp_path)
    raw = path.read_bytes()
    store = logs.store_of(False)
    ends = []
    for message in logs.drive():
        payload = logs.payload(message, "cdr", store)
        # A row is there when the page that it ends in is.
        ends.append((raw.index(payload) // 4096 + 1) * 4096)
    cut_path = tmp_path / "cut.db3"
    read = 0
    for percent in range(1, 100, 7):
        cut = len(raw) * percent // 100
        cut_path.write_bytes(raw[:cut])
        run = read_part(cut_path)
        if run is not None:
            read += 1
            count = len(run.odometry) + len(run.detections)
            assert 0 <= sum(end <= cut for end in ends) - count <= 1  # the last one is lost
            assert any("cut short" in text or "damaged" in text for text in run.warnings)
    assert read > 8


def test_a_destroyed_page_costs_its_rows_alone(logs, tmp_path):
    path = big_database(logs, tmp_path)
    raw = bytearray(path.read_bytes())
    payload = logs.payload(logs.drive()[200], "cdr", logs.store_of(False))
    page = raw.index(payload) // 4096 * 4096
    raw[page : page + 4096] = bytes(4096)
    path.write_bytes(raw)
    run = read_run(path)
    assert any("the database is damaged" in text for text in run.warnings)
    assert any("rows missing" in text for text in run.warnings)
    assert 320 <= len(run.odometry) + len(run.detections) < 330


def test_a_count_below_that_of_the_metadata_is_reported(logs, tmp_path):
    folder = logs.ros2_folder(tmp_path / "run", logs.drive())
    base = sqlite3.connect(folder / "run.db3")
    base.execute("DELETE FROM messages WHERE id > 320")
    base.commit()
    base.close()
    run = read_run(folder)
    assert "metadata.yaml counts 330 messages, 320 were found" in run.warnings


@pytest.mark.parametrize("storage", ["MCAP", "SQLITE3"])
@pytest.mark.parametrize("length", [0, 20])
def test_a_short_last_part_does_not_cost_the_others(logs, tmp_path, storage, length):
    folder = logs.ros2_folder(tmp_path / "run", logs.drive(), storage)
    (whole,) = (path for path in folder.iterdir() if path.suffix != ".yaml")
    part = folder / f"run_1{whole.suffix}"
    part.write_bytes(whole.read_bytes()[:length])
    text = (folder / "metadata.yaml").read_text()
    named = text.replace(f"- {whole.name}", f"- {whole.name}\n  - {part.name}", 1)
    (folder / "metadata.yaml").write_text(named)
    run = read_run(folder)
    assert (len(run.odometry), len(run.detections)) == (300, 30)
    assert run.warnings
