"""Logs in a bucket: the same maps as from files, with few requests and few bytes."""

from __future__ import annotations

import struct
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from topobatch.ingest.mapping import build_map
from topobatch.ingest.reading import find_logs, inspect_log, read_run
from topobatch.ingest.remote.path import log_path
from topobatch.topology.document import map_to_document
from topobatch.topology.errors import LogError
from topobatch.topology.run import Run

SAMPLES = Path(__file__).parents[2] / "sample_logs"
IMAGE_BYTES = 1 << 18


def mcap_with_images(path: Path, logs: ModuleType, images: int, **options: Any) -> Path:
    """Odometry and junctions in chunks of their own, as far as the writer lets them: first some
    images, then the drive, then the rest."""
    from mcap.writer import CompressionType, Writer

    random = np.random.default_rng(7)
    store = logs.store_of(False)
    options["compression"] = CompressionType[options.pop("compression", "ZSTD")]
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=100_000, **options)
        writer.start(profile="ros2", library="test")
        camera = writer.register_channel(
            "/camera", "cdr", writer.register_schema("sensor_msgs/msg/Image", "ros2msg", b"")
        )
        channels: dict[str, int] = {}
        messages = logs.drive(3000)

        def image(k: int) -> None:
            raw = random.integers(0, 256, IMAGE_BYTES, np.uint8).tobytes()
            writer.add_message(camera, messages[k].log_ns, raw, messages[k].log_ns)

        for k in range(images // 2):
            image(k)
        for message in messages:
            if message.topic not in channels:
                schema = logs._schema(writer, message, "cdr", store, True)
                channels[message.topic] = writer.register_channel(message.topic, "cdr", schema)
            raw = logs.payload(message, "cdr", store)
            writer.add_message(channels[message.topic], message.log_ns, raw, message.log_ns)
        for k in range(images // 2):
            image(k)
        writer.finish()
    return path


def lower_bound(path: Path, wanted: set[str]) -> int:
    """Bytes of the summary, and of the chunks that hold wanted topics, by mcap's own reader."""
    from mcap.reader import make_reader

    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
        assert summary is not None
        file.seek(-37, 2)
        _, _, start, _, _ = struct.unpack_from("<BQQQI", file.read())
    numbers = {number for number, c in summary.channels.items() if c.topic in wanted}
    chunks = [c for c in summary.chunk_indexes if numbers & set(c.message_index_offsets)]
    return path.stat().st_size - start + sum(chunk.chunk_length for chunk in chunks)


def same_runs(a: Run, b: Run) -> None:
    assert map_to_document(build_map(a)) == map_to_document(build_map(b))


def same_readings(a: Run, b: Run) -> None:
    assert (a.name, a.source, a.warnings) == (b.name, b.source, b.warnings)
    assert (a.odometry.time_ns == b.odometry.time_ns).all()
    assert (a.odometry.pose == b.odometry.pose).all()
    assert (a.detections.time_ns == b.detections.time_ns).all()
    assert (a.detections.centre == b.detections.centre).all()
    assert (a.detections.branches.values == b.detections.branches.values).all()


@pytest.mark.parametrize("name", ["maze-1.mcap", "maze-2.bag", "streets-1.mcap"])
def test_the_map_is_that_of_the_file(bucket: Any, name: str) -> None:
    bucket.put(f"night/{name}", (SAMPLES / name).read_bytes())
    (found,) = find_logs([bucket.path("night/")])
    assert str(found) == f"{bucket.url}/night/{name}"
    same_runs(read_run(found), read_run(SAMPLES / name))


def test_a_bag_folder_is_one_log(bucket: Any, logs: ModuleType, tmp_path: Path) -> None:
    folder = logs.ros2_folder(tmp_path / "drive", logs.drive(), "MCAP")
    for file in folder.iterdir():
        bucket.put(f"runs/drive/{file.name}", file.read_bytes())
        bucket.put(f"runs/again/{file.name}", file.read_bytes())
    bucket.put("runs/notes/metadata.yaml", b"title: not a bag\n")
    bucket.put("runs/notes/alone.mcap", (SAMPLES / "maze-1.mcap").read_bytes())
    found = find_logs([bucket.path("runs")])
    names = ["runs/again", "runs/drive", "runs/notes/alone.mcap"]
    assert [str(f) for f in found] == [f"{bucket.url}/{name}" for name in names]
    same_readings(read_run(found[1]), read_run(folder))


@pytest.mark.parametrize("compression", ["ZSTD", "LZ4", "NONE"])
def test_only_the_chunks_that_hold_wanted_topics_are_read(
    bucket: Any, logs: ModuleType, tmp_path: Path, compression: str
) -> None:
    path = mcap_with_images(tmp_path / "camera.mcap", logs, 120, compression=compression)
    size, bound = path.stat().st_size, lower_bound(path, {"/odom", "/junctions"})
    bucket.put("camera.mcap", path.read_bytes())
    (found,) = find_logs([bucket.path()])
    bucket.proxy.clear()
    assert inspect_log(found).topics == inspect_log(path).topics
    (index,) = bucket.proxy.gets
    assert index.range.startswith("bytes=-")
    same_readings(read_run(found), read_run(path))
    assert bucket.proxy.sent <= 1.2 * bound  # chunks of 100 kB, with indexes between them
    assert bound < 0.15 * size


def without_summary(data: bytes) -> bytes:
    """The same MCAP file, whose footer says that there is no summary."""
    footer = struct.pack("<BQQQI", 2, 20, 0, 0, 0)
    return data[: -(len(footer) + 8)] + footer + data[-8:]


def test_a_log_without_index_is_only_read_whole_when_that_is_allowed(bucket: Any) -> None:
    data = (SAMPLES / "maze-1.mcap").read_bytes()
    bucket.put("maze-1.mcap", without_summary(data))
    with pytest.raises(LogError, match=rf"{bucket.name}/maze-1.mcap: it has no index.*--allow-sc"):
        read_run(bucket.path("maze-1.mcap"))
    assert bucket.proxy.sent < 0.2 * len(data)
    whole = read_run(bucket.path("maze-1.mcap", allow_scan=True))
    same_runs(whole, read_run(SAMPLES / "maze-1.mcap"))


def test_databases_are_refused_with_advice(bucket: Any) -> None:
    for file in (SAMPLES / "maze-3").iterdir():
        bucket.put(f"maze-3/{file.name}", file.read_bytes())
    with pytest.raises(LogError, match=r"maze-3/.*db3: .*copy it here, or convert it to MCAP"):
        read_run(bucket.path("maze-3/", allow_scan=True))


def test_a_file_that_is_no_log(bucket: Any) -> None:
    bucket.put("text.mcap", b"hello" * 1000)
    with pytest.raises(LogError, match=r"/text.mcap: is no log"):
        read_run(bucket.path("text.mcap"))
    with pytest.raises(LogError, match=r"/gone.mcap: no such"):
        read_run(bucket.path("gone.mcap"))
    with pytest.raises(LogError, match=r"/empty: no such file or folder"):
        find_logs([bucket.path("empty/")])


def damaged(data: bytes, random: np.random.Generator) -> bytes:
    """With wrong bits, or cut short."""
    if random.random() < 0.3:
        return data[: int(random.integers(len(data)))]
    out = bytearray(data)
    for _ in range(int(random.integers(1, 4))):
        out[int(random.integers(len(out)))] ^= 1 << int(random.integers(8))
    return bytes(out)


def result(place: Any) -> tuple[Any, ...]:
    try:
        run = read_run(place)
    except LogError as error:
        return (str(error).partition(": ")[2],)
    return run.odometry.pose.tobytes(), run.detections.centre.tobytes(), run.warnings


@pytest.mark.parametrize("name", ["maze-1.mcap", "maze-2.bag"])
@pytest.mark.parametrize("seed", range(3))
def test_a_damaged_log_is_read_as_from_disk_or_refused(
    servers: ModuleType, impatient: None, tmp_path: Path, name: str, seed: int
) -> None:
    data = damaged((SAMPLES / name).read_bytes(), np.random.default_rng(seed))
    (tmp_path / name).write_bytes(data)
    local = result(tmp_path / name)
    with servers.running(servers.Recorder(servers.files({f"/{name}": data}))) as server:
        address = f"http://127.0.0.1:{server.port}/{name}"
        by_index, scanned = (result(log_path(address, allow_scan=scan)) for scan in (False, True))
    assert scanned == local
    assert by_index == local or "--allow-scan" in by_index[0]
