"""What the libraries lose without a word, each case once: it is read, or it is reported."""

from __future__ import annotations

import io
import shutil
import sqlite3

import numpy as np
import pytest

from topobatch.ingest.grid_log import GridLog
from topobatch.ingest.logs import log_file, messages, topics
from topobatch.ingest.reading import ReadSettings, inspect_log, read_log, read_run
from topobatch.topology.errors import LogError

MESSAGES = 330


def count(run) -> int:
    return len(run.odometry) + len(run.detections)


def whole_mcap_chunks(raw: bytes) -> list[tuple[int, int]]:
    """Where each chunk ends and how many messages it holds, by the library."""
    from mcap.records import Chunk, Message
    from mcap.stream_reader import StreamReader, breakup_chunk

    file, out = io.BytesIO(raw), []
    for record in StreamReader(file, emit_chunks=True).records:
        if isinstance(record, Chunk):
            held = sum(isinstance(inner, Message) for inner in breakup_chunk(record))
            out.append((file.tell(), held))
    return out


def whole_bag_chunks(path) -> list[tuple[int, int]]:
    from rosbags.rosbag1 import Reader

    with Reader(path) as reader:
        out = []
        raw = path.read_bytes()
        for info in reader.chunk_infos:
            data_at = info.pos + 4 + int.from_bytes(raw[info.pos : info.pos + 4], "little")
            end = data_at + 4 + int.from_bytes(raw[data_at : data_at + 4], "little")
            out.append((end, sum(info.connection_counts.values())))
        return out


@pytest.mark.parametrize("compression", ["ZSTD", "LZ4", "bz2", "lz4"])
def test_no_whole_chunk_is_lost_wherever_a_compressed_log_is_cut(logs, tmp_path, compression):
    if compression.isupper():
        path = logs.mcap(tmp_path / "run", logs.drive(), compression=compression)
        chunks = whole_mcap_chunks(path.read_bytes())
    else:
        path = logs.bag(tmp_path / "run", logs.drive(), compression)
        chunks = whole_bag_chunks(path)
    raw = path.read_bytes()
    assert sum(held for _, held in chunks) == MESSAGES
    cut_path, read = tmp_path / "cut", 0
    for percent in range(1, 100):
        cut = len(raw) * percent // 100
        cut_path.write_bytes(raw[:cut])
        least = sum(held for end, held in chunks if end <= cut)
        try:
            run = read_run(cut_path)
        except LogError:
            # A junction is seen after ten messages of odometry: below that there is no run.
            assert least < 11
            continue
        read += 1
        assert least <= count(run) <= MESSAGES
    assert read > 50 if len(chunks) > 1 else read > 0


@pytest.mark.parametrize("kind", ["mcap", "bag", "db3"])
def test_strict_refuses_what_is_cut_and_takes_what_is_whole(logs, tmp_path, kind):
    if kind == "db3":
        path = logs.ros2_folder(tmp_path / "run", logs.drive()) / "run.db3"
    else:
        path = getattr(logs, kind)(tmp_path / "run", logs.drive())
    strict = ReadSettings(strict=True)
    assert count(read_run(path, strict)) == MESSAGES
    raw = path.read_bytes()
    path.write_bytes(raw[: len(raw) * 7 // 10])
    assert 0 < count(read_run(path)) < MESSAGES
    with pytest.raises(LogError, match="damaged: "):
        read_run(path, strict)


def test_chunk_indexes_without_message_indexes_are_enough(logs, tmp_path):
    from mcap.writer import IndexType

    path = logs.mcap(tmp_path / "run.mcap", logs.drive(), index_types=IndexType.CHUNK)
    run = read_run(path)
    assert (count(run), run.warnings) == (MESSAGES, ())


@pytest.mark.parametrize("compression", ["ZSTD", "NONE"])
def test_a_message_index_that_lies_loses_nothing(logs, tmp_path, compression):
    """The index of a chunk is outside the chunk's checksum: what it says has to be proven."""
    path = logs.mcap(tmp_path / "run.mcap", logs.drive(), compression=compression)
    raw = bytearray(path.read_bytes())
    end = whole_mcap_chunks(bytes(raw))[0][0]
    assert raw[end] == 0x07
    # The third offset that the first index record lists: op, length, channel, bytes, entries.
    at = end + 9 + 6 + 2 * 16 + 8
    raw[at : at + 8] = (int.from_bytes(raw[at : at + 8], "little") + 1).to_bytes(8, "little")
    path.write_bytes(raw)
    run = read_run(path)
    assert (count(run), run.warnings) == (MESSAGES, ())


@pytest.mark.parametrize("compression", ["none", "lz4"])
def test_the_index_of_a_bag_that_lies_loses_nothing(logs, tmp_path, compression):
    path = logs.bag(tmp_path / "run.bag", logs.drive(), compression)
    raw = bytearray(path.read_bytes())
    end = whole_bag_chunks(path)[0][0]
    at = raw.index(b"op=\x04", end)
    data_at = end + 4 + int.from_bytes(raw[end : end + 4], "little") + 4
    assert end < at < data_at
    raw[data_at + 8 : data_at + 12] = b"\xff\xff\xff\x7f"
    path.write_bytes(raw)
    assert count(read_run(path)) == MESSAGES


def test_names_that_are_no_text_are_read(logs, tmp_path):
    """The libraries end in a UnicodeDecodeError."""
    mcap = logs.mcap(tmp_path / "a.mcap", logs.drive(), compression="NONE", enable_crcs=False)
    bag = logs.bag(tmp_path / "a.bag", logs.drive())
    for path in (mcap, bag):
        raw = path.read_bytes()
        path.write_bytes(raw.replace(b"base_link", b"base\xff\xfeink"))
        run = read_run(path)
        assert count(run) == MESSAGES
        assert run.odometry.child_frame.isprintable()
    folder = logs.ros2_folder(tmp_path / "run", logs.drive())
    base = sqlite3.connect(folder / "run.db3")
    base.execute(
        "INSERT INTO topics "
        "SELECT 9, CAST(x'2fff' AS TEXT), type, 'cdr', '', '' FROM topics LIMIT 1"
    )
    base.commit()
    base.close()
    assert count(read_run(folder)) == MESSAGES


def test_messages_of_channels_that_nobody_describes_are_counted(logs, tmp_path):
    """The libraries end in a KeyError."""
    path = logs.mcap(
        tmp_path / "run.mcap",
        logs.drive(),
        compression="NONE",
        enable_crcs=False,
        use_chunking=False,
        repeat_channels=False,
        use_statistics=False,
    )
    raw = bytearray(path.read_bytes())
    at = raw.index(b"\x0a\x00\x00\x00/junctions")
    # The channel's number stands four bytes before its topic.
    raw[at - 4 : at - 2] = (77).to_bytes(2, "little")
    path.write_bytes(raw)
    info = inspect_log(path)
    assert any("30 messages of channels that the log does not" in p for p in info.problems)
    with pytest.raises(LogError, match="no junction detections"):
        read_run(path)


def test_a_file_compressed_as_a_whole_and_cut_is_read_to_the_cut(logs, tmp_path):
    folder = logs.ros2_folder(tmp_path / "run", logs.drive(), "MCAP", "FILE")
    path = next(file for file in folder.iterdir() if file.suffix == ".zstd")
    raw = path.read_bytes()
    read = []
    for percent in (50, 75, 90, 99):
        path.write_bytes(raw[: len(raw) * percent // 100])
        try:
            run = read_run(folder)
        except LogError:
            continue
        assert run.warnings
        read.append(count(run))
    assert read == sorted(read)
    path.write_bytes(raw)
    assert count(read_run(folder)) == MESSAGES


def test_a_file_that_inflates_without_end_is_refused(logs, tmp_path, monkeypatch):
    import zstandard

    path = tmp_path / "run.mcap.zstd"
    path.write_bytes(zstandard.compress(b"\x89MCAP0\r\n" + bytes(1 << 24)))
    monkeypatch.setattr(log_file, "UNPACKED_BYTES", 1 << 20)
    monkeypatch.setattr(log_file, "UNPACKED_RATIO", 10)
    with pytest.raises(LogError, match="inflates to more than"):
        read_run(path)
    assert not [p for p in tmp_path.iterdir() if p != path]


def test_a_database_beside_its_log_stays_untouched_where_nothing_may_be_written(logs, tmp_path):
    """Opening with the library alone would leave a -shm file behind, or fail."""
    folder = logs.ros2_folder(tmp_path / "run", logs.drive())
    base = sqlite3.connect(folder / "run.db3")
    base.execute("PRAGMA journal_mode=WAL")
    base.execute("UPDATE messages SET timestamp = timestamp + 1")
    base.commit()
    copy = tmp_path / "copy"
    copy.mkdir()
    for name in ("run.db3", "run.db3-wal"):
        shutil.copy(folder / name, copy)
    base.close()
    copy.chmod(0o555)
    try:
        run = read_run(copy, ReadSettings(time="log"))
    finally:
        copy.chmod(0o755)
    assert count(run) == MESSAGES
    assert run.odometry.time_ns[0] == logs.drive()[0].log_ns + 1
    assert sorted(p.name for p in copy.iterdir()) == ["run.db3", "run.db3-wal"]


def bag_with_images(logs, path):
    """A bag whose chunks hold large messages that nobody wants among others, at the end as well."""
    from rosbags.rosbag1 import Reader, Writer

    plain = logs.bag(path.with_name("plain.bag"), logs.drive())
    store = logs.store_of(True)
    with Reader(plain) as reader, Writer(path) as writer:
        links = {
            c.id: writer.add_connection(c.topic, c.msgtype, msgdef=c.msgdef.data, md5sum=c.digest)
            for c in reader.connections
        }
        camera = writer.add_connection("/camera", "std_msgs/msg/String", typestore=store)
        for number, (connection, time, raw) in enumerate(reader.messages()):
            writer.write(links[connection.id], time, raw)
            if number % 7 == 0:
                writer.write(camera, time, bytes([0, 0, 2, 0]) + bytes(range(256)) * 512)
    return path


@pytest.mark.parametrize("change", [1, 1 << 14, -(1 << 14)])
def test_an_index_that_lies_about_images_loses_nothing(logs, tmp_path, change):
    path = bag_with_images(logs, tmp_path / "run.bag")
    raw = bytearray(path.read_bytes())
    # The second entry of every index record behind the first chunk.
    at = whole_bag_chunks(path)[0][0]
    while b"op=\x04" in raw[at : at + 64]:
        header = int.from_bytes(raw[at : at + 4], "little")
        size = int.from_bytes(raw[at + 4 + header : at + 8 + header], "little")
        entry = at + 8 + header + 12 + 8
        offset = int.from_bytes(raw[entry : entry + 4], "little")
        raw[entry : entry + 4] = max(offset + change, 0).to_bytes(4, "little")
        at += 8 + header + size
    path.write_bytes(raw)
    assert count(read_run(path)) == MESSAGES


SCANS = 60
STRICT = ReadSettings(strict=True)


def scanned_rows(logs, sensors, encoding="cdr", lasers=(("/scan", "base_link"),)):
    """Odometry, and scans of a room in place of detections; lasers: their topics and frames."""
    store, rows = logs.store_of(encoding == "ros1"), []
    odometry = [message for message in logs.drive() if message.topic == "/odom"]
    for number, message in enumerate(odometry):
        raw = logs.payload(message, encoding, store)
        rows.append(("/odom", message.type_name, message.log_ns, raw))
        for topic, frame in lasers if number % 5 == 0 else ():
            scan = sensors.around(message.poses[0], message.stamp_ns, frame, encoding)
            rows.append((topic, sensors.SCAN, message.log_ns + 1, scan))
    return rows


def by_topic(rows):
    """Sorted so that a chunk holds messages of one topic."""
    return sorted(rows, key=lambda row: (row[0], row[2]))


def chunks_of(path):
    """Place, length and topics of every chunk."""
    from mcap.reader import make_reader

    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    names = {channel.id: channel.topic for channel in summary.channels.values()}
    return [
        (c.chunk_start_offset, c.chunk_length, {names[k] for k in c.message_index_offsets})
        for c in summary.chunk_indexes
    ]


def hurt(path, topics):
    """Break the last chunk that holds just these topics, if any does."""
    found = [(at, length) for at, length, held in chunks_of(path) if held == topics]
    raw = bytearray(path.read_bytes())
    at = found[-1][0] + found[-1][1] // 2
    raw[at : at + 2] = bytes(byte ^ 0xFF for byte in raw[at : at + 2])
    path.write_bytes(raw)
    return path


def told_once(warnings, topic):
    """How many messages of a topic are said to be lost; that there was damage is said once."""
    assert sum("damaged chunk" in text for text in warnings) == 1, warnings
    (lost,) = (text for text in warnings if f" messages of {topic} are lost" in text)
    return int(lost.split()[0])


def refused(path, match):
    """What is damaged is refused by strict mode alone."""
    with pytest.raises(LogError, match=f"damaged: .*{match}"):
        read_log(path, STRICT)


@pytest.mark.parametrize("together", [False, True])
def test_damaged_chunks_of_scans_are_told_once(logs, sensors, tmp_path, together):
    rows = scanned_rows(logs, sensors)
    rows = rows if together else by_topic(rows)
    path = sensors.mcap(tmp_path / "run.mcap", rows, chunk_size=40_000)
    assert read_run(path, STRICT).warnings == ()
    hurt(path, {"/odom", "/scan"} if together else {"/scan"})
    run = read_run(path)
    lost = told_once(run.warnings, "/scan")
    assert run.source["junctions"]["messages"] == SCANS - lost < SCANS
    assert (run.source["odometry"]["messages"] < 300) == together
    refused(path, "damaged chunk")


def test_damaged_chunks_of_scans_in_a_bag_are_told_once(logs, sensors, tmp_path):
    from rosbags.rosbag1 import Writer

    path = tmp_path / "run.bag"
    writer = Writer(path)
    writer.chunk_threshold = 40_000
    writer.set_compression(Writer.CompressionFormat.BZ2)
    with writer:
        links = {}
        for topic, kind, time_ns, raw in by_topic(scanned_rows(logs, sensors, "ros1")):
            if topic not in links:
                links[topic] = writer.add_connection(topic, kind, typestore=logs.store_of(True))
            writer.write(links[topic], time_ns, raw)
    assert read_run(path, STRICT).warnings == ()
    raw, ends = bytearray(path.read_bytes()), whole_bag_chunks(path)
    at = ends[-1][0] - 2000
    raw[at : at + 100] = bytes(100)
    path.write_bytes(raw)
    run = read_run(path)
    assert run.source["junctions"]["messages"] == SCANS - told_once(run.warnings, "/scan") < SCANS
    refused(path, "damaged chunk")


def test_a_second_laser_is_told_of_beside_the_first(logs, sensors, tmp_path):
    lasers = ("/scan", "base_link"), ("/scan_behind", "behind")
    rows = scanned_rows(logs, sensors, lasers=lasers)
    mount = sensors.mount("behind", (0, 0, 0.1, 0, 0, 0, 1))
    rows.append(("/tf_static", sensors.TF, logs.START_NS, mount))
    path = sensors.mcap(tmp_path / "run.mcap", by_topic(rows), chunk_size=40_000)
    assert read_run(path, STRICT).source["junctions"]["lasers"] == ["/scan", "/scan_behind"]
    for topic, _ in lasers:
        hurt(path, {topic})
    lost = [text for text in read_run(path).warnings if "are lost" in text]
    assert sorted(text.split()[3] for text in lost) == ["/scan", "/scan_behind"]


def test_damaged_transforms_are_told(logs, sensors, tmp_path):
    """Transforms are read only where a frame is unknown, apart from the odometry."""
    rows = scanned_rows(logs, sensors, lasers=[("/scan", "laser")])
    mounts = [sensors.mount(name, (0, 0, 0, 0, 0, 0, 1)) for name in ("laser", "x" * 500)]
    rows += [("/tf_static", sensors.TF, logs.START_NS + k, mounts[k > 0]) for k in range(150)]
    path = sensors.mcap(tmp_path / "run.mcap", by_topic(rows), chunk_size=40_000)
    assert read_run(path, STRICT).warnings == ()
    hurt(path, {"/tf_static"})
    with pytest.raises(LogError, match=r"damaged: .* messages of /tf_static are lost"):
        read_log(path, STRICT)


@pytest.mark.parametrize("storage", ["SQLITE3", "MCAP"])
def test_scans_that_are_too_large_are_told(logs, sensors, tmp_path, storage):
    from rosbags.rosbag2 import StoragePlugin, Writer

    path, numbers = tmp_path / "run", iter(range(1000))
    with Writer(path, version=8, storage_plugin=StoragePlugin[storage]) as writer:
        links = {}
        for topic, kind, time_ns, raw in scanned_rows(logs, sensors):
            if topic not in links:
                links[topic] = writer.add_connection(topic, kind, typestore=logs.store_of(False))
            long = topic == "/scan" and next(numbers) in (20, 40)
            writer.write(links[topic], time_ns, raw + bytes((messages.MESSAGE_BYTES + 8192) * long))
    run = read_run(path)
    assert run.warnings == ("2 messages of /scan above 16 MiB left out",)
    assert run.source["junctions"]["messages"] == SCANS - 2
    refused(path, "2 messages of /scan above 16 MiB")


def test_a_log_of_nothing_but_scans_too_large_says_so(logs, sensors, tmp_path):
    rows = [
        (topic, kind, time_ns, raw + bytes((messages.MESSAGE_BYTES + 8192) * (topic == "/scan")))
        for topic, kind, time_ns, raw in scanned_rows(logs, sensors)[:7]
    ]
    path = sensors.mcap(tmp_path / "run.mcap", rows)
    with pytest.raises(LogError, match=r"nothing can be made of /scan: .*/scan above 16 MiB"):
        read_log(path)


def test_a_damaged_chunk_of_grids_is_told(sensors, tmp_path):
    ways = [[100] * 100] * 45 + [[0] * 100] * 10 + [[100] * 100] * 45
    rows = [("/map", sensors.GRID, sensors.START_NS + k, sensors.grid(ways)) for k in range(12)]
    rows += [("/other", sensors.GRID, sensors.START_NS, sensors.grid(ways))] * 5
    path = sensors.mcap(tmp_path / "run.mcap", rows, chunk_size=40_000)
    assert read_log(path, STRICT).warnings == ()
    hurt(path, {"/map"})
    found = read_log(path)
    assert isinstance(found, GridLog)
    assert 0 < told_once(found.warnings, "/map") < 12
    refused(path, "damaged chunk")


LONG = messages.MESSAGE_BYTES + 8192


def clouded(logs, sensors, path, kind, long):
    """Odometry and 10 clouds of a room; long: by the cloud's number, how much is behind it."""
    encoding = "ros1" if kind.startswith("bag") else "cdr"
    rows, ways = [], np.linspace(-np.pi, np.pi, 720, endpoint=False)
    odometry = [message for message in logs.drive() if message.topic == "/odom"]
    for number, message in enumerate(odometry):
        raw = logs.payload(message, encoding, logs.store_of(encoding == "ros1"))
        rows.append(("/odom", message.type_name, message.log_ns, raw))
        if number % 30 == 0:
            x, y, *_, z, w = message.poses[0]
            far = sensors.room(x, y, 2 * np.arctan2(z, w), len(ways))
            xyz = np.stack([far * np.cos(ways), far * np.sin(ways), np.zeros(len(ways))], axis=1)
            cloud = sensors.cloud(
                xyz, encoding=encoding, frame="base_link", stamp_ns=message.stamp_ns
            )
            tail = bytes(long.get(number // 30, 0))
            rows.append(("/points", sensors.CLOUD, message.log_ns + 1, cloud + tail))
    if kind == "mcap":
        return sensors.mcap(path, rows)
    if kind == "mcap-unchunked":
        return sensors.mcap(path, rows, use_chunking=False)
    if kind == "db3":
        from rosbags.rosbag2 import StoragePlugin
        from rosbags.rosbag2 import Writer as FolderWriter

        writer = FolderWriter(path, version=8, storage_plugin=StoragePlugin.SQLITE3)
    else:
        from rosbags.rosbag1 import Writer

        writer = Writer(path)
        if kind == "bag-lz4":
            writer.set_compression(Writer.CompressionFormat.LZ4)
    with writer:
        links = {}
        for topic, type_name, time_ns, raw in rows:
            if topic not in links:
                store = sensors.store(encoding)
                links[topic] = writer.add_connection(topic, type_name, typestore=store)
            writer.write(links[topic], time_ns, raw)
    return path


CLOUD_LOGS = ("mcap", "mcap-unchunked", "db3", "bag", "bag-lz4")


@pytest.mark.parametrize("kind", CLOUD_LOGS)
def test_clouds_above_the_limit_of_other_messages_are_read(logs, sensors, tmp_path, kind):
    short = read_run(clouded(logs, sensors, tmp_path / "short", kind, {}), STRICT)
    run = read_run(clouded(logs, sensors, tmp_path / "run", kind, {3: LONG, 4: LONG}), STRICT)
    assert run.warnings == short.warnings == ()
    assert run.source == short.source
    assert run.source["junctions"]["messages"] == 10
    assert run.odometry.pose.tobytes() == short.odometry.pose.tobytes()


@pytest.mark.parametrize("kind", CLOUD_LOGS)
def test_clouds_above_their_own_limit_are_told(logs, sensors, tmp_path, monkeypatch, kind):
    monkeypatch.setattr(topics, "CLOUD_BYTES", 17 << 20)
    path = clouded(logs, sensors, tmp_path / "run", kind, {3: 18 << 20, 6: LONG})
    run = read_run(path)
    assert run.warnings == ("1 message of /points above 17 MiB left out",)
    assert run.source["junctions"]["messages"] == 9
    refused(path, "1 message of /points above 17 MiB")


def overflow_pages(database):
    """The overflow pages of every large row of a database, in the order of rows."""
    with sqlite3.connect(database) as base:
        ids = [k for (k,) in base.execute("SELECT id FROM messages WHERE length(data) > 4096")]
        payloads = [
            base.execute("SELECT data FROM messages WHERE id = ?", [k]).fetchone()[0] for k in ids
        ]
    raw = database.read_bytes()
    # Its last bytes stand in its last page.
    return [raw.index(data[-2000:]) // 4096 for data in payloads]


def test_a_damaged_page_costs_one_cloud_of_a_database(logs, sensors, tmp_path):
    path = clouded(logs, sensors, tmp_path / "run", "db3", {})
    (database,) = path.glob("*.db3")
    hurt = overflow_pages(database)[4]
    raw = bytearray(database.read_bytes())
    raw[4096 * (hurt - 1) : 4096 * hurt] = bytes(4096)
    database.write_bytes(raw)
    run = read_run(path)
    assert run.source["junctions"]["messages"] == 9
    assert "the numbers of the rows have gaps: 1 row missing" in run.warnings
    refused(path, "1 row missing")


def test_clouds_of_a_database_that_is_cut_short_are_read(logs, sensors, tmp_path):
    path = clouded(logs, sensors, tmp_path / "run", "db3", {})
    (database,) = path.glob("*.db3")
    last = overflow_pages(database)
    database.write_bytes(database.read_bytes()[: 4096 * last[6]])
    run = read_run(path)
    assert run.source["junctions"]["messages"] == 6
    assert "the log is cut short" in run.warnings
    whole = read_run(clouded(logs, sensors, tmp_path / "whole", "db3", {}))
    assert whole.source["junctions"]["messages"] == 10
    refused(path, "the log is cut short")


@pytest.mark.parametrize("storage", ["db3", "mcap"])
def test_the_largest_grid_is_read(logs, sensors, tmp_path, storage):
    from rosbags.rosbag2 import StoragePlugin, Writer

    raw = sensors.grid(np.zeros((4096, 4096)))
    assert len(raw) > messages.MESSAGE_BYTES
    plugin = {"db3": StoragePlugin.SQLITE3, "mcap": StoragePlugin.MCAP}[storage]
    with Writer(tmp_path / "run", version=8, storage_plugin=plugin) as writer:
        link = writer.add_connection("/map", sensors.GRID, typestore=sensors.ROS2)
        writer.write(link, sensors.START_NS, raw)
    found = read_log(tmp_path / "run", STRICT)
    assert isinstance(found, GridLog)
    assert found.grid.free.shape == (4096, 4096)
