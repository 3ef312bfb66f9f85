"""Damaged logs: what is there is read, what is lost is counted, nothing else is raised."""

from __future__ import annotations

import re
import sqlite3
import struct
from dataclasses import replace
from datetime import datetime
from pathlib import Path

import pytest

from topobatch.ingest.logs import intake, pose_wire
from topobatch.ingest.logs.messages import several_that
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
    for percent in range(1, 100):
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


def test_one_thing_that_is_told_of_and_several() -> None:
    told = [several_that(n, "message", "are of another type") for n in (1, 2)]
    assert told == ["1 message is of another type", "2 messages are of another type"]
    assert several_that(1, "pose", "have no frame") == "1 pose has no frame"
    assert several_that(1, "message", "could not be decoded") == "1 message could not be decoded"


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


def test_declared_sizes_allocate_nothing(logs, tmp_path):
    """A chunk that claims to hold a terabyte is skipped, and so is a record of such a size."""
    path = logs.mcap(tmp_path / "run.mcap", logs.drive())
    raw = path.read_bytes()
    at = raw.index(b"\x04\x00\x00\x00zstd", len(raw) // 2)
    size_at = at - 12
    path.write_bytes(raw[:size_at] + struct.pack("<Q", 1 << 40) + raw[size_at + 8 :])
    run = read_run(path)
    assert 250 < said(run) < 330
    assert any("damaged chunk" in text for text in run.warnings)
    path.write_bytes(raw[: at - 36] + struct.pack("<Q", 1 << 62) + raw[at - 28 :])
    assert said(read_run(path)) > 250


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


def test_pages_give_what_the_library_gives(logs, tmp_path):
    path = big_database(logs, tmp_path)
    run = read_run(path)
    assert run.warnings == ()
    assert (len(run.odometry), len(run.detections)) == (300, 30)
    counts = {topic.topic: topic.messages for topic in inspect_log(path).topics}
    assert counts == {"/camera": 14, "/junctions": 30, "/odom": 300}


def test_rows_too_large_for_a_page_are_read(logs, tmp_path, monkeypatch):
    messages = logs.drive()
    many = tuple(logs.yaw_pose(0.5, 0.125, 0.05 * k) for k in range(100))
    messages = [
        replace(m, poses=many) if m.topic == "/junctions" and k < 100 else m
        for k, m in enumerate(messages)
    ]
    monkeypatch.setattr("topobatch.ingest.sightings.MAX_BRANCHES", 200)
    run = read_run(logs.ros2_folder(tmp_path / "run", messages))
    assert run.detections.branches.counts.tolist()[:9] == [100] * 9
    assert len(run.detections) == 30


def test_a_database_cut_anywhere_gives_all_that_is_left(logs, tmp_path):
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
    for percent in range(1, 100):
        cut = len(raw) * percent // 100
        cut_path.write_bytes(raw[:cut])
        run = read_part(cut_path)
        if run is not None:
            read += 1
            count = len(run.odometry) + len(run.detections)
            assert count == sum(end <= cut for end in ends)
            assert any("cut short" in text or "damaged" in text for text in run.warnings)
    assert read > 60


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


def test_the_checksum_of_unchunked_data_is_checked(logs, tmp_path):
    options = {"use_chunking": False, "enable_data_crcs": True}
    path = logs.mcap(tmp_path / "run.mcap", logs.drive(), **options)
    assert read_run(path).warnings == ()
    raw = bytearray(path.read_bytes())
    payload = logs.payload(logs.drive()[100], "cdr", logs.store_of(False))
    raw[raw.index(payload) + len(payload) - 20] ^= 1
    path.write_bytes(raw)
    run = read_run(path)
    assert any("checksum (CRC) of the data section" in text for text in run.warnings)


def test_chunks_of_images_alone_are_not_read(logs, tmp_path):
    """The index says what a chunk holds; one without anything wanted is stepped over."""
    from mcap.writer import Writer

    from topobatch.ingest.logs import chunks

    path = tmp_path / "run.mcap"
    store = logs.store_of(False)
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=100_000)
        writer.start("ros2", "test")
        channels = {}
        for message in logs.drive():
            if message.topic not in channels:
                text, _ = store.generate_msgdef(message.type_name, ros_version=2)
                schema = writer.register_schema(message.type_name, "ros2msg", text.encode())
                channels[message.topic] = writer.register_channel(message.topic, "cdr", schema)
            raw = logs.payload(message, "cdr", store)
            writer.add_message(channels[message.topic], message.log_ns, raw, message.log_ns)
        schema = writer.register_schema("sensor_msgs/msg/Image", "ros2msg", b"")
        camera = writer.register_channel("/camera", "cdr", schema)
        for number in range(9):
            writer.add_message(camera, logs.START_NS + number, bytes(120_000), logs.START_NS)
        writer.finish()
    inflated = []
    original = chunks._inflated
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            chunks,
            "_inflated",
            lambda head, raw: inflated.append(head) or original(head, raw),
        )
        run = read_run(path)
    assert (len(run.odometry), len(run.detections), run.warnings) == (300, 30, ())
    assert len(inflated) <= 4
    assert {t.topic: t.messages for t in inspect_log(path).topics}["/camera"] == 9


def test_a_count_below_that_of_the_metadata_is_reported(logs, tmp_path):
    folder = logs.ros2_folder(tmp_path / "run", logs.drive())
    base = sqlite3.connect(folder / "run.db3")
    base.execute("DELETE FROM messages WHERE id > 320")
    base.commit()
    base.close()
    run = read_run(folder)
    assert "metadata.yaml counts 330 messages, 320 were found" in run.warnings


def test_rows_that_are_missing_in_the_middle_are_reported(logs, tmp_path):
    path = logs.ros2_folder(tmp_path / "run", logs.drive()) / "run.db3"
    base = sqlite3.connect(path)
    base.execute("DELETE FROM messages WHERE id BETWEEN 100 AND 120")
    base.commit()
    base.close()
    run = read_run(path)
    assert "the numbers of the rows have gaps: 21 rows missing" in run.warnings
    assert len(run.odometry) + len(run.detections) == 309


def test_a_length_beyond_any_file_is_damage(logs, tmp_path):
    """No file has an offset of 2^63, and asking for it is an error of its own kind."""
    path = logs.mcap(tmp_path / "x.mcap", logs.drive(), compression="NONE", use_chunking=False)
    raw = path.read_bytes()
    for length in (2**63 - 1, 2**63, 2**64 - 1):
        path.write_bytes(raw[:8] + b"\x05" + struct.pack("<Q", length) + raw[8:])
        assert len(read_run(path).odometry) == 300
        path.write_bytes(raw[:8] + b"\x05" + struct.pack("<Q", length) + bytes(range(100)))
        with pytest.raises(LogError, match="nothing can be read"):
            read_run(path)


def killed_database(logs, tmp_path) -> Path:
    """A database whose recorder died: a third of its messages are in the write-ahead log."""
    live = logs.ros2_folder(tmp_path / "live", logs.drive()) / "live.db3"
    base = sqlite3.connect(live)
    base.execute("PRAGMA journal_mode=WAL")
    rows = base.execute("SELECT * FROM messages WHERE id > 200").fetchall()
    base.execute("DELETE FROM messages WHERE id > 200")
    base.commit()
    base.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    for first in range(0, len(rows), 10):
        base.executemany("INSERT INTO messages VALUES (?, ?, ?, ?)", rows[first : first + 10])
        base.commit()
    folder = tmp_path / "run"
    folder.mkdir()
    for suffix in ("", "-wal"):
        (folder / f"run.db3{suffix}").write_bytes(Path(f"{live}{suffix}").read_bytes())
    base.close()
    return folder / "run.db3"


@pytest.mark.parametrize("hurt", ["byte", "page", "head", "header"])
def test_what_holds_of_a_damaged_write_ahead_log_is_used_and_the_rest_told(logs, tmp_path, hurt):
    """The library stops at the first wrong frame without a word."""
    path = killed_database(logs, tmp_path)
    assert len(read_run(path, ReadSettings(strict=True)).odometry) == 300
    log = path.with_name("run.db3-wal")
    raw = bytearray(log.read_bytes())
    frame = 32 + 4120 * (len(raw) // 4120 // 3)
    place = {"byte": (frame + 2000, 1), "page": (frame, 4120), "head": (frame + 8, 4)}
    at, length = place.get(hurt, (12, 4))
    raw[at : at + length] = bytes(byte ^ 0xFF for byte in raw[at : at + length])
    log.write_bytes(raw)
    run = read_run(path)
    assert said(run) == len(run.odometry) + len(run.detections) > 310
    assert any("the database's write-ahead log" in text for text in run.warnings)
    with pytest.raises(LogError, match="write-ahead log"):
        read_run(path, ReadSettings(strict=True))


def test_a_write_ahead_log_that_is_cut_is_told(logs, tmp_path):
    path = killed_database(logs, tmp_path)
    log = path.with_name("run.db3-wal")
    raw = log.read_bytes()
    log.write_bytes(raw[: len(raw) * 6 // 10])
    run = read_run(path)
    assert 200 < said(run) < 330
    assert any("bytes of the database's write-ahead log" in text for text in run.warnings)
    assert "the log is cut short" in run.warnings


@pytest.mark.parametrize("storage", ["MCAP", "SQLITE3"])
@pytest.mark.parametrize("length", [0, 8, 20, 36, 60])
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


def test_more_poses_than_a_junction_has_are_left_out_by_a_limit(logs, tmp_path, monkeypatch):
    """They compress well: 100 KB can hold millions."""
    drive = logs.drive()
    many = tuple(logs.yaw_pose(0.5, 0.0, 0.0) for _ in range(pose_wire.MOST_POSES + 1))
    last = [replace(m, poses=many) if m.topic == "/junctions" else m for m in drive[220:]]
    run = read_run(logs.mcap(tmp_path / "run.mcap", [*drive[:220], *last]))
    assert len(run.detections) == 20
    assert any("10 messages could not be decoded (more than 1024" in w for w in run.warnings)
    monkeypatch.setattr(intake, "MOST_KEPT", 30)
    monkeypatch.setattr(intake, "BYTES_PER_POSE", 1 << 40)
    monkeypatch.setattr(intake, "PENDING_BYTES", 1)
    run = read_run(logs.mcap(tmp_path / "run.mcap", drive, chunk_size=40_000))
    assert 0 < len(run.detections) < 30
    assert any("more than 30 poses, which is the limit" in text for text in run.warnings)
