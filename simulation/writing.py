"""Scenarios as files: one log per run in any container, and `truth.json` beside them.

Odometry is nav_msgs/Odometry on /odom. A detection is one geometry_msgs/PoseArray on /junctions, in
the robot's frame, with a pose for each branch: the junction's centre and the branch's heading.
Scans are sensor_msgs/LaserScan on /scan, stamped with the time of their first beam; the laser's
mount is one message on /tf_static.

Logs are written by mcap and rosbags. The same run gives the same bytes with the same versions of
these libraries (and of SQLite, LZ4 and Zstandard), and the same messages with any version.
"""

from __future__ import annotations

import errno
import os
import sqlite3
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import cache, partial
from itertools import cycle
from pathlib import Path
from tempfile import TemporaryDirectory
from types import MappingProxyType, SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np

from ..topology.arrays import FloatArray, IntArray
from ..topology.run import Run
from .chance import Chance, quantised
from .laser import Scans
from .scenario import Scenario, SimulatedRun
from .truth import write_truth

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

TRUTH_FILE = "truth.json"
TOPICS: Mapping[str, str] = {
    "/odom": "nav_msgs/msg/Odometry",
    "/junctions": "geometry_msgs/msg/PoseArray",
    "/scan": "sensor_msgs/msg/LaserScan",
    "/tf_static": "tf2_msgs/msg/TFMessage",
}
"""Types by topic."""

LASER_FRAME = "laser"

COVARIANCE = np.diag([1e-3, 1e-3, 1e6, 1e6, 1e6, 1e-2]).ravel()

Message = tuple[int, str, bytes]
"""Log time [ns], topic, and the serialized message."""


# Messages.


@cache
def typestore(ros: str) -> Typestore:
    """rosbags' store of message types; ros: "ros1" or "ros2"."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if ros == "ros1" else Stores.ROS2_JAZZY)
    if TOPICS["/tf_static"] not in store.types:  # of ROS 1
        text = "geometry_msgs/TransformStamped[] transforms"
        store.register(get_types_from_msg(text, TOPICS["/tf_static"]))
    return store


def topics_of(simulated: SimulatedRun) -> list[str]:
    """The topics of a run's log, some perhaps without a message."""
    left_out = set() if simulated.tells_junctions else {"/junctions"}
    left_out |= set() if simulated.scans is not None else {"/scan", "/tf_static"}
    return [topic for topic in TOPICS if topic not in left_out]


def messages_of(simulated: SimulatedRun, ros: str) -> list[Message]:
    """The messages of a run by log time, serialized for ROS 1 or as CDR for ROS 2. O(n log n).

    They are logged some milliseconds after their stamp, as by a real recorder; scans when their
    sweep is complete.
    """
    run, scans = simulated.run, simulated.scans
    chance = Chance("latency", len(run.odometry), len(run.detections))
    late = chance.uniform(1_000, 8_000, len(run.odometry))
    seen_late = chance.uniform(20_000, 70_000, len(run.detections))
    out = _logged("/odom", run.odometry.time_ns, late, _odometry(simulated, ros))
    if simulated.tells_junctions:
        out += _logged("/junctions", run.detections.time_ns, seen_late, _detections(run, ros))
    if scans is not None:
        late = Chance("laser latency", len(scans)).uniform(1_000, 9_000, len(scans))
        swept_us, stamp_ns = round(scans.settings.sweep_s * 10**6), simulated.scans_ns
        out += _logged("/scan", stamp_ns, swept_us + late, _scans(scans, stamp_ns, ros))
        first_ns = run.odometry.time_ns[:1]
        mount = _mount(run, scans, int(first_ns[0]), ros)
        out += _logged("/tf_static", first_ns, np.zeros(1), [mount])
    return sorted(out, key=lambda message: message[0])


def _logged(
    topic: str, stamp_ns: IntArray, late_us: FloatArray, payloads: list[bytes]
) -> list[Message]:
    log_ns = stamp_ns + late_us.astype(np.int64) * 1000
    return [(log, topic, payload) for log, payload in zip(log_ns.tolist(), payloads, strict=True)]


def _quaternion(yaw: FloatArray) -> FloatArray:
    """(n, 4) x, y, z, w, rounded: the same on every processor, and logs compress better."""
    zero = np.zeros_like(yaw)
    return np.column_stack(
        [zero, zero, quantised(np.sin(yaw / 2), 22), quantised(np.cos(yaw / 2), 22)]
    )


@cache
def _named(ros: str) -> Any:
    """The message classes by their names without packages."""
    packages = ("geometry_msgs/", "nav_msgs/", "sensor_msgs/", "tf2_msgs/", "builtin_interfaces/")
    known = typestore(ros).types
    kinds = {n.rpartition("/")[2]: kind for n, kind in known.items() if n.startswith(packages)}
    return SimpleNamespace(**kinds, Header=known["std_msgs/msg/Header"])


def _header(ros: str, time_ns: int, frame: str, seq: int = 0) -> Any:
    m = _named(ros)
    number = {"seq": seq} if ros == "ros1" else {}
    return m.Header(stamp=m.Time(*divmod(time_ns, 10**9)), frame_id=frame, **number)


def _pose(ros: str, xy: Sequence[float], quaternion: Sequence[float]) -> Any:
    m = _named(ros)
    return m.Pose(m.Point(*xy, 0.0), m.Quaternion(*quaternion))


def _payload(ros: str, message: Any) -> bytes:
    store = typestore(ros)
    serialize = store.serialize_ros1 if ros == "ros1" else store.serialize_cdr
    return bytes(serialize(message, message.__msgtype__))


def _odometry(simulated: SimulatedRun, ros: str) -> list[bytes]:
    m, odometry, out = _named(ros), simulated.run.odometry, []
    rows = zip(
        odometry.time_ns.tolist(),
        odometry.pose[:, :2].tolist(),
        _quaternion(odometry.pose[:, 2]).tolist(),
        quantised(simulated.twist, 12).tolist(),
        strict=True,
    )
    for seq, (time_ns, xy, turn, (forward, turning)) in enumerate(rows):
        header = _header(ros, time_ns, odometry.frame, seq)
        pose = m.PoseWithCovariance(_pose(ros, xy, turn), COVARIANCE)
        twist = m.Twist(m.Vector3(forward, 0.0, 0.0), m.Vector3(0.0, 0.0, turning))
        speed = m.TwistWithCovariance(twist, COVARIANCE)
        out.append(_payload(ros, m.Odometry(header, odometry.child_frame, pose, speed)))
    return out


def _detections(run: Run, ros: str) -> list[bytes]:
    m, seen, out = _named(ros), run.detections, []
    turns, stops = _quaternion(seen.branches.values).tolist(), seen.branches.offsets.tolist()
    for k, time_ns in enumerate(seen.time_ns.tolist()):
        xy = seen.centre[k].tolist()
        poses = [_pose(ros, xy, turn) for turn in turns[stops[k] : stops[k + 1]]]
        header = _header(ros, time_ns, run.odometry.child_frame, k)
        out.append(_payload(ros, m.PoseArray(header, poses)))
    return out


def _scans(scans: Scans, stamp_ns: IntArray, ros: str) -> list[bytes]:
    settings, angles, m = scans.settings, scans.angles_rad, _named(ros)
    about = {
        "angle_min": float(angles[0]),
        "angle_max": float(angles[-1]),
        "angle_increment": float(angles[-1] - angles[0]) / (len(angles) - 1),
        "time_increment": settings.sweep_s / (len(angles) - 1),
        "scan_time": 1 / settings.rate_hz,
        "range_min": settings.range_min_m,
        "range_max": settings.range_max_m,
        "intensities": np.zeros(0, np.float32),
    }
    headers = (_header(ros, t, LASER_FRAME, k) for k, t in enumerate(stamp_ns.tolist()))
    rows = zip(headers, scans.ranges_m, strict=True)
    return [_payload(ros, m.LaserScan(header=h, ranges=r, **about)) for h, r in rows]


def _mount(run: Run, scans: Scans, time_ns: int, ros: str) -> bytes:
    (x, y, yaw), m = scans.settings.mount, _named(ros)
    turn = _quaternion(np.array([yaw]))[0].tolist()
    if scans.settings.upside_down:
        # Yaw, then half a turn about x: the quaternion (0, 0, z, w) becomes (w, z, 0, 0).
        turn = [turn[3], turn[2], 0.0, 0.0]
    header = _header(ros, time_ns, run.odometry.child_frame)
    place = m.Transform(m.Vector3(x, y, 0.2), m.Quaternion(*turn))
    return _payload(ros, m.TFMessage([m.TransformStamped(header, LASER_FRAME, place)]))


# Containers.


def _write_mcap(path: Path, simulated: SimulatedRun) -> None:
    from mcap.writer import CompressionType, Writer

    store = typestore("ros2")
    with path.open("xb") as file:
        writer = Writer(file, compression=CompressionType.ZSTD)
        writer.start(profile="ros2", library="topobatch")
        channels = {}
        for topic in topics_of(simulated):
            text, _ = store.generate_msgdef(TOPICS[topic], ros_version=2)
            schema = writer.register_schema(TOPICS[topic], "ros2msg", text.encode())
            channels[topic] = writer.register_channel(topic, "cdr", schema)
        for log_ns, topic, payload in messages_of(simulated, "ros2"):
            writer.add_message(channels[topic], log_ns, payload, log_ns)
        writer.finish()  # type: ignore[no-untyped-call]


def _write_bag(path: Path, simulated: SimulatedRun, storage: str | None) -> None:
    """A ROS 1 bag, or the folder of a ROS 2 bag of a storage."""
    from rosbags import rosbag1, rosbag2

    writer: Any
    if storage is None:
        writer = rosbag1.Writer(path)
        writer.set_compression(writer.CompressionFormat.LZ4)
    else:
        plugin, latest = rosbag2.StoragePlugin[storage], rosbag2.Writer.VERSION_LATEST
        writer = rosbag2.Writer(path, version=latest, storage_plugin=plugin)
        if storage == "MCAP":
            zstd = rosbag2.CompressionFormat.ZSTD
            writer.set_compression(rosbag2.CompressionMode.STORAGE, zstd)
    ros = "ros1" if storage is None else "ros2"
    with writer:
        links = {
            topic: writer.add_connection(topic, TOPICS[topic], typestore=typestore(ros))
            for topic in topics_of(simulated)
        }
        for log_ns, topic, payload in messages_of(simulated, ros):
            writer.write(links[topic], log_ns, payload)


FORMATS: Mapping[str, tuple[tuple[str, ...], Callable[[Path, SimulatedRun], None]]] = (
    MappingProxyType(
        {
            "mcap": (("{0}.mcap",), _write_mcap),
            "bag": (("{0}.bag",), partial(_write_bag, storage=None)),
            "db3": (("{0}/{0}.db3", "{0}/metadata.yaml"), partial(_write_bag, storage="SQLITE3")),
            "ros2-mcap": (
                ("{0}/{0}.mcap", "{0}/metadata.yaml"),
                partial(_write_bag, storage="MCAP"),
            ),
        }
    )
)
"""Containers by name: the files of a run's log, and the writer of that file or of their folder."""


def write_run(folder: Path, simulated: SimulatedRun, container: str = "mcap") -> Path:
    """Write the log of one run into `folder`, named after the run; returns its path.

    Existing logs of that name in any container are replaced. container: of FORMATS. Raises OSError
    with the log's path if it cannot be written.
    """
    run, (files, write) = simulated.run.name, FORMATS[container]
    path = folder / Path(files[0].format(run)).parts[0]
    folder.mkdir(parents=True, exist_ok=True)
    try:
        with TemporaryDirectory(prefix=".topobatch-", suffix=".tmp", dir=folder) as made:
            write(Path(made, path.name), simulated)
            for file in files:
                target = folder / file.format(run)
                target.parent.mkdir(exist_ok=True)
                os.replace(Path(made, file.format(run)), target)
        for file in {file for others, _ in FORMATS.values() for file in others} - {*files}:
            Path(folder, file.format(run)).unlink(missing_ok=True)
        with suppress(OSError):  # the folder of such a log, now empty
            (folder / run).rmdir()
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from error
    except sqlite3.Error as error:
        raise OSError(errno.EIO, str(error), str(path)) from error
    return path


def write_scenario(
    scenario: Scenario,
    out: Path,
    formats: Sequence[str] = ("mcap",),
    progress: Callable[[Path], object] = lambda path: None,
) -> list[Path]:
    """Write every run's log and `truth.json` into the folder `out`; returns the paths of the logs.

    Several formats are assigned to the runs in turn. `progress` is called with each finished log.
    """
    paths = []
    for simulated, container in zip(scenario.simulated, cycle(formats), strict=False):
        paths.append(write_run(out, simulated, container))
        progress(paths[-1])
    write_truth(out / TRUTH_FILE, scenario.truth)
    return paths
