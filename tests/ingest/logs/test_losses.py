"""What the libraries lose without a word, each case once: it is read, or it is reported."""

from __future__ import annotations

import pytest

from topobatch.ingest.logs import log_file
from topobatch.ingest.reading import ReadSettings, read_log, read_run
from topobatch.topology.errors import LogError

MESSAGES = 330


def count(run) -> int:
    return len(run.odometry) + len(run.detections)


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


SCANS = 60
STRICT = ReadSettings(strict=True)


def scanned_rows(logs, sensors):
    """Odometry, and scans of a room in place of detections."""
    store, rows = logs.store_of(False), []
    odometry = [message for message in logs.drive() if message.topic == "/odom"]
    for number, message in enumerate(odometry):
        raw = logs.payload(message, "cdr", store)
        rows.append(("/odom", message.type_name, message.log_ns, raw))
        if number % 5 == 0:
            scan = sensors.around(message.poses[0], message.stamp_ns)
            rows.append(("/scan", sensors.SCAN, message.log_ns + 1, scan))
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
