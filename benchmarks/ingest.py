"""How fast logs are read, beside rosbags and beside reading and decompressing alone.

    python benchmarks/ingest.py [--full] [--out DIR] [--keep] [--only NAME]

Writes one log per container (odometry, detections, images of one camera), reads each of them in a
process of its own and prints the medians of the wall time, and the same ratios of CPU time, which
a busy machine disturbs less. All use one thread. The limit is reading every byte and
decompressing every chunk, without checksums. What is read must equal rosbags' columns in
every bit: times, poses and detections, all of them, with yaws from the quaternions that rosbags
gives. "peak MB" is memory above what the interpreter and the imports take. `--full`: a million
odometry messages, 20,000 detections and 1 GB of images per log, which needs about 8 GB in DIR.
"""

from __future__ import annotations

import argparse
import json
import shutil
import sqlite3
import statistics
import subprocess
import sys
import tempfile
import time
import zlib
from array import array
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

START_NS = 1_700_000_000 * 10**9
PERIOD_NS = 20_000_000
IMAGE_BYTES = 640 * 480 * 3
CHUNK_BYTES = 1 << 20

ODOMETRY = "nav_msgs/msg/Odometry"
POSES = "geometry_msgs/msg/PoseArray"
IMAGE = "sensor_msgs/msg/Image"


@dataclass(frozen=True)
class Size:
    """How much goes into one log."""

    odometry: int
    detections: int
    images: int

    @property
    def name(self) -> str:
        return f"{self.odometry}-{self.detections}-{self.images}"


@dataclass(frozen=True)
class Message:
    log_ns: int
    topic: str
    type_name: str
    payload: bytes


# Logs. The messages are serialised once by rosbags and then patched by columns: serialising a
# million of them one by one would take longer than everything that is measured.


class Patterns:
    """Payloads of one encoding, made from one message of each type."""

    def __init__(self, ros1: bool, size: Size) -> None:
        self.ros1 = ros1
        self.size = size
        rng = np.random.default_rng(1)
        n = size.odometry
        self.odom_ns = START_NS + PERIOD_NS * np.arange(n)
        theta = np.cumsum(rng.normal(0, 0.01, n))
        self.pose = np.zeros((n, 7))
        self.pose[:, 0] = np.cumsum(0.02 * np.cos(theta))
        self.pose[:, 1] = np.cumsum(0.02 * np.sin(theta))
        self.pose[:, 5], self.pose[:, 6] = np.sin(theta / 2), np.cos(theta / 2)
        span = PERIOD_NS * n
        self.seen_ns = START_NS + np.linspace(0, span, size.detections, False).astype(np.int64)
        self.image_ns = START_NS + np.linspace(0, span, size.images, False).astype(np.int64)
        # Four random bits per byte: zstd halves it, lz4 finds nothing, as with real images.
        self.pixels = rng.integers(0, 16, 4 * IMAGE_BYTES, np.uint8).tobytes()

    def odometry(self) -> np.ndarray:
        """(n, bytes) payloads of all odometry messages."""
        raw = np.frombuffer(serialised(ODOMETRY, self.ros1), np.uint8)
        rows = np.tile(raw, (self.size.odometry, 1))
        put_stamp(rows, 4, self.odom_ns)
        at = raw.tobytes().index(np.float64(11.0).tobytes())
        rows[:, at : at + 56] = self.pose.view(np.uint8)
        return rows

    def messages(self, rows: np.ndarray) -> Iterator[Message]:
        """All messages by log time."""
        poses = [serialised(POSES, self.ros1, count) for count in (1, 3, 4)]
        image = serialised(IMAGE, self.ros1)
        seen = image_number = 0
        for k, log_ns in enumerate(self.odom_ns.tolist()):
            while seen < len(self.seen_ns) and self.seen_ns[seen] <= log_ns:
                payload = np.frombuffer(poses[seen % 3], np.uint8).copy()[None]
                put_stamp(payload, 4, self.seen_ns[seen : seen + 1])
                yield Message(log_ns, "/junctions", POSES, payload.tobytes())
                seen += 1
            while image_number < len(self.image_ns) and self.image_ns[image_number] <= log_ns:
                shift = 4099 * image_number % (3 * IMAGE_BYTES)
                pixels = self.pixels[shift : shift + IMAGE_BYTES]
                yield Message(log_ns, "/camera", IMAGE, image + pixels)
                image_number += 1
            yield Message(log_ns, "/odom", ODOMETRY, rows[k].tobytes())


def put_stamp(rows: np.ndarray, at: int, ns: np.ndarray) -> None:
    words = np.stack([ns // 10**9, ns % 10**9], axis=1).astype("<u4")
    rows[:, at : at + 8] = words.view(np.uint8)


def store_of(ros1: bool):
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)


def serialised(type_name: str, ros1: bool, poses: int = 0) -> bytes:
    """One message; of an image everything but the pixels."""
    store = store_of(ros1)
    t = store.types
    stamp = t["builtin_interfaces/msg/Time"](sec=1, nanosec=2)
    sequence = {"seq": 0} if ros1 else {}

    def header(frame: str):
        return t["std_msgs/msg/Header"](stamp=stamp, frame_id=frame, **sequence)

    def pose(x: float, yaw: float):
        return t["geometry_msgs/msg/Pose"](
            position=t["geometry_msgs/msg/Point"](x=x, y=0.5, z=0.0),
            orientation=t["geometry_msgs/msg/Quaternion"](
                x=0.0, y=0.0, z=float(np.sin(yaw / 2)), w=float(np.cos(yaw / 2))
            ),
        )

    vector = t["geometry_msgs/msg/Vector3"](x=0.0, y=0.0, z=0.0)
    if type_name == ODOMETRY:
        message = t[ODOMETRY](
            header=header("odom"),
            child_frame_id="base_link",
            pose=t["geometry_msgs/msg/PoseWithCovariance"](
                pose=pose(11.0, 0.3), covariance=np.eye(6).ravel()
            ),
            twist=t["geometry_msgs/msg/TwistWithCovariance"](
                twist=t["geometry_msgs/msg/Twist"](linear=vector, angular=vector),
                covariance=np.eye(6).ravel(),
            ),
        )
    elif type_name == POSES:
        yaws = np.linspace(0, 2 * np.pi, poses, False)
        message = t[POSES](header=header("base_link"), poses=[pose(1.0, yaw) for yaw in yaws])
    else:
        message = t[IMAGE](
            header=header("camera"),
            height=480,
            width=640,
            encoding="rgb8",
            is_bigendian=0,
            step=1920,
            data=np.zeros(IMAGE_BYTES, np.uint8),
        )
    raw = (
        store.serialize_ros1(message, type_name)
        if ros1
        else store.serialize_cdr(message, type_name)
    )
    out = bytes(raw)
    if ros1:
        # The sequence number goes first; the stamp is then at 4 in both encodings.
        assert out[4:12] == np.array([1, 2], "<u4").tobytes()
    return out[:-IMAGE_BYTES] if type_name == IMAGE else out


def write_mcap(path: Path, size: Size, compression: str, chunk_bytes: int = CHUNK_BYTES) -> None:
    from mcap.writer import CompressionType, Writer

    patterns, store = Patterns(False, size), store_of(False)
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=chunk_bytes, compression=CompressionType[compression])
        writer.start(profile="ros2", library="benchmark")
        channels: dict[str, int] = {}
        for number, message in enumerate(patterns.messages(patterns.odometry())):
            if message.topic not in channels:
                text, _ = store.generate_msgdef(message.type_name, ros_version=2)
                schema = writer.register_schema(message.type_name, "ros2msg", text.encode())
                channels[message.topic] = writer.register_channel(message.topic, "cdr", schema)
            writer.add_message(
                channels[message.topic], message.log_ns, message.payload, message.log_ns, number
            )
        writer.finish()


def write_bag(path: Path, size: Size, chunk_bytes: int = CHUNK_BYTES) -> None:
    from rosbags.rosbag1 import Writer

    patterns, store = Patterns(True, size), store_of(True)
    writer = Writer(path)
    writer.chunk_threshold = chunk_bytes
    with writer:
        links: dict[str, object] = {}
        for message in patterns.messages(patterns.odometry()):
            if message.topic not in links:
                links[message.topic] = writer.add_connection(
                    message.topic, message.type_name, typestore=store
                )
            writer.write(links[message.topic], message.log_ns, message.payload)


def write_db3(path: Path, size: Size) -> None:
    """A bag folder whose rows are written by sqlite3 itself, many at a time."""
    from rosbags.rosbag2 import Writer

    patterns, store = Patterns(False, size), store_of(False)
    with Writer(path, version=8) as writer:
        topics = {
            topic: writer.add_connection(topic, type_name, typestore=store).id
            for topic, type_name in (("/odom", ODOMETRY), ("/junctions", POSES), ("/camera", IMAGE))
        }
    with sqlite3.connect(path / f"{path.name}.db3") as base:
        base.executemany(
            "INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)",
            (
                (topics[m.topic], m.log_ns, m.payload)
                for m in patterns.messages(patterns.odometry())
            ),
        )
    base.close()


# What is measured; each in a process of its own.


NOTHING = np.zeros(0)


class Found(NamedTuple):
    """What a method made of a log: nanoseconds; x, y [m] and yaw [rad] of every pose.

    counts: how many poses each detection has.
    """

    time_ns: np.ndarray = NOTHING
    pose: np.ndarray = NOTHING
    seen_ns: np.ndarray = NOTHING
    seen_pose: np.ndarray = NOTHING
    counts: np.ndarray = NOTHING

    def checked(self) -> dict[str, int]:
        """Counts, and a checksum over every bit of the columns."""
        crc = 0
        for column, kind in zip(self, ("i8", "f8", "i8", "f8", "i8"), strict=True):
            crc = zlib.crc32(np.ascontiguousarray(column, kind).tobytes(), crc)
        return {"odometry": len(self.time_ns), "detections": len(self.seen_ns), "columns": crc}


def measure_topobatch(path: Path) -> Found:
    from topobatch.ingest.reading import read_run

    run = read_run(path)
    seen, branches = run.detections, run.detections.branches
    seen_pose = np.column_stack([seen.centre[branches.owner], branches.values])
    counts = np.diff(branches.offsets)
    return Found(run.odometry.time_ns, run.odometry.pose, seen.time_ns, seen_pose, counts)


def measure_rosbags(path: Path) -> Found:
    from rosbags.highlevel import AnyReader

    time_ns, poses, seen_ns, seen_poses, counts = (array(kind) for kind in "qdqdq")
    with AnyReader([path]) as reader:
        wanted = [c for c in reader.connections if c.topic != "/camera"]
        for connection, _, raw in reader.messages(wanted):
            message: Any = reader.deserialize(raw, connection.msgtype)
            stamp = message.header.stamp
            if connection.topic == "/odom":
                time_ns.append(stamp.sec * 10**9 + stamp.nanosec)
                keep(message.pose.pose, poses)
            else:
                seen_ns.append(stamp.sec * 10**9 + stamp.nanosec)
                counts.append(len(message.poses))
                for pose in message.poses:
                    keep(pose, seen_poses)
    return Found(time_ns, with_yaw(poses), seen_ns, with_yaw(seen_poses), counts)


def keep(pose, column: array) -> None:
    position, turn = pose.position, pose.orientation
    column.extend((position.x, position.y, turn.x, turn.y, turn.z, turn.w))


def with_yaw(column: array) -> np.ndarray:
    """(n, 3) x, y, yaw of poses as `keep` puts them down."""
    from topobatch.topology.se2 import yaw_from_quaternion

    x, y, *turn = np.frombuffer(column).reshape(-1, 6).T
    return np.stack([x, y, yaw_from_quaternion(*turn)], axis=1)


def measure_limit(path: Path) -> Found:
    """Reading every byte and decompressing every chunk, nothing else."""
    from topobatch.ingest.logs.bag import MAGIC, record_at
    from topobatch.ingest.logs.inflate import inflate, keep_freed_memory
    from topobatch.ingest.logs.source import FileSource

    if path.is_dir():
        path = next(path.glob("*.db3"))
    keep_freed_memory()
    with FileSource(path) as window:
        if path.suffix == ".mcap":
            for start, length, compression, size in mcap_chunks(path):
                data = window.read(start, length)
                if compression:
                    inflate(compression, data, size)
        elif path.suffix == ".bag":
            position = len(MAGIC)
            while position < window.size:
                record = record_at(window.read, position)
                assert record is not None
                window.read(record.data_at, record.data_size)
                position = record.end
        else:
            for position in range(0, window.size, CHUNK_BYTES):
                window.read(position, CHUNK_BYTES)
    return Found()


def mcap_chunks(path: Path) -> list[tuple[int, int, str, int]]:
    from mcap.reader import make_reader

    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
        assert summary is not None
        out = []
        for index in summary.chunk_indexes:
            head = 9 + 8 + 8 + 8 + 4 + 4 + len(index.compression) + 8
            start = index.chunk_start_offset + head
            out.append((start, index.compressed_size, index.compression, index.uncompressed_size))
    return out


METHODS = {"topobatch": measure_topobatch, "rosbags": measure_rosbags, "limit": measure_limit}


def imports_of(method: str) -> None:
    """Import what the method needs, so that neither time nor memory counts it."""
    import topobatch.ingest.reading  # noqa: F401

    if method == "rosbags":
        import rosbags.highlevel  # noqa: F401
    for module in ("zstandard", "lz4.frame", "mcap.reader", "sqlite3"):
        __import__(module)


def peak_kib() -> int:
    """Peak resident memory. Unlike `ru_maxrss`, it does not count the parent's."""
    status = Path("/proc/self/status").read_text()
    return int(next(line for line in status.splitlines() if "VmHWM" in line).split()[1])


def measure_here(method: str, path: Path) -> None:
    imports_of(method)
    before = peak_kib()
    wall, cpu = time.perf_counter(), time.process_time()
    found = METHODS[method](path)
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    peak = peak_kib() - before
    print(json.dumps({"wall": wall, "cpu": cpu, "peak_mb": peak / 1024, **found.checked()}))


def measured(method: str, path: Path, repeats: int) -> dict[str, float]:
    runs = []
    for _ in range(repeats):
        command = [sys.executable, __file__, "--measure", method, str(path)]
        runs.append(json.loads(subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout))
    return {key: statistics.median(run[key] for run in runs) for key in runs[0]}


def warm(path: Path) -> None:
    for file in path.glob("*") if path.is_dir() else [path]:
        with file.open("rb") as stream:
            while stream.read(1 << 22):
                pass


def row(name: str, path: Path, repeats: int) -> None:
    warm(path)
    ours = measured("topobatch", path, repeats)
    limit = measured("limit", path, repeats)
    library = measured("rosbags", path, 1)
    for what in ("odometry", "detections", "columns"):
        assert ours[what] == library[what], f"{what} differ from rosbags'"
    size = sum(f.stat().st_size for f in path.glob("*")) if path.is_dir() else path.stat().st_size
    print(
        f"{name:14s} {size / 1e6:8.0f} {library['wall']:9.2f} {ours['wall']:9.2f} "
        f"{ours['cpu']:6.2f} {limit['wall']:8.2f} {library['wall'] / ours['wall']:9.1f} "
        f"{library['cpu'] / ours['cpu']:6.1f} {ours['wall'] / limit['wall']:8.2f} "
        f"{ours['cpu'] / limit['cpu']:6.2f} "
        f"{ours['peak_mb']:8.0f} {limit['peak_mb']:6.0f}",
        flush=True,
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--full", action="store_true")
    parser.add_argument("--out", type=Path)
    parser.add_argument("--keep", action="store_true", help="leave the logs, and use them again")
    parser.add_argument("--only", default="", help="part of a row's name")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--measure", nargs=2, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.measure:
        measure_here(args.measure[0], Path(args.measure[1]))
        return
    images = 10**9 // IMAGE_BYTES
    size = Size(10**6, 20_000, images) if args.full else Size(10**5, 2_000, images // 10)
    camera = Size(size.odometry // 20, size.detections // 20, size.images)
    out = args.out or Path(tempfile.mkdtemp(prefix="topobatch-benchmark-"))
    out.mkdir(parents=True, exist_ok=True)
    print(
        f"{'log':14s} {'MB':>8s} {'rosbags s':>9s} {'ours s':>9s} {'CPU s':>6s} {'limit s':>8s} "
        f"{'x rosbags':>9s} {'CPU':>6s} {'x limit':>8s} {'CPU':>6s} {'peak MB':>8s} {'l. MB':>6s}"
    )
    try:
        for name, file, write in (
            ("mcap zstd", "zstd.mcap", lambda p: write_mcap(p, size, "ZSTD")),
            ("mcap lz4", "lz4.mcap", lambda p: write_mcap(p, size, "LZ4")),
            ("mcap none", "none.mcap", lambda p: write_mcap(p, size, "NONE")),
            ("bag", "plain.bag", lambda p: write_bag(p, size)),
            ("db3", "db3", lambda p: write_db3(p, size)),
            ("camera zstd", "camera.mcap", lambda p: write_mcap(p, camera, "ZSTD")),
        ):
            path = out / f"{size.name}-{file}"
            if args.only in name:
                if not path.exists():
                    write(path)
                row(name, path, args.repeats)
                if not args.keep:
                    shutil.rmtree(path) if path.is_dir() else path.unlink()
    finally:
        if args.out is None:
            shutil.rmtree(out)


if __name__ == "__main__":
    main()
