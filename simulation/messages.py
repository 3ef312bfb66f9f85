"""Runs as ROS messages: nav_msgs/Odometry on /odom, geometry_msgs/PoseArray on /junctions.

A detection is one PoseArray in the robot's frame: a pose per branch, each at the junction's centre
and looking along its branch. A laser's scans are sensor_msgs/LaserScan on /scan, stamped with the
time of their first beam, its place on the robot one message on /tf_static.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .chance import Chance, quantised
from .laser import Scans
from .scenario import SimulatedRun
from .world import FloatArray, IntArray

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

ODOMETRY_TYPE = "nav_msgs/msg/Odometry"
POSES_TYPE = "geometry_msgs/msg/PoseArray"
SCAN_TYPE = "sensor_msgs/msg/LaserScan"
TRANSFORMS_TYPE = "tf2_msgs/msg/TFMessage"

LASER_FRAME = "laser"

COVARIANCE = np.diag([1e-3, 1e-3, 1e6, 1e6, 1e6, 1e-2]).ravel()


@cache
def typestore(ros: str) -> Typestore:
    """What rosbags knows of the message types; ros: "ros1", "ros2"."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if ros == "ros1" else Stores.ROS2_JAZZY)
    if TRANSFORMS_TYPE not in store.types:  # of ROS 1
        text = "geometry_msgs/TransformStamped[] transforms"
        store.register(get_types_from_msg(text, TRANSFORMS_TYPE))
    return store


@dataclass(frozen=True, slots=True, eq=False)
class Topic:
    """All messages of one topic: log_ns, stamp_ns: (n,) int64; payloads: n serialized messages."""

    name: str
    type_name: str
    log_ns: IntArray
    stamp_ns: IntArray
    payloads: list[bytes]


def topics_of(simulated: SimulatedRun, ros: str) -> tuple[Topic, ...]:
    """The topics of a run, serialized for ROS 1 or as the CDR of ROS 2. O(n), vectorised.

    Messages reach the log some milliseconds after their stamp, like those of a real recorder.
    """
    run = simulated.run
    chance = Chance("latency", len(run.odometry), len(run.detections))
    odometry_ns, seen_ns = run.odometry.time_ns, run.detections.time_ns
    late = chance.uniform(1_000, 8_000, len(odometry_ns)).astype(np.int64) * 1000
    seen_late = chance.uniform(20_000, 70_000, len(seen_ns)).astype(np.int64) * 1000
    topics = [
        Topic("/odom", ODOMETRY_TYPE, odometry_ns + late, odometry_ns, _odometry(simulated, ros))
    ]
    if simulated.tells_junctions:
        seen = _detections(simulated, ros)
        topics.append(Topic("/junctions", POSES_TYPE, seen_ns + seen_late, seen_ns, seen))
    if simulated.scans is not None:
        topics += _laser(simulated, simulated.scans, ros)
    return tuple(topics)


def in_log_order(topics: tuple[Topic, ...]) -> list[tuple[int, int, int, bytes]]:
    """Every message as (topic number, log_ns, stamp_ns, payload), by log time."""
    number = np.repeat(np.arange(len(topics)), [len(t.payloads) for t in topics])
    log_ns = np.concatenate([t.log_ns for t in topics])
    stamp_ns = np.concatenate([t.stamp_ns for t in topics])
    payloads = [payload for t in topics for payload in t.payloads]
    order = np.argsort(log_ns, kind="stable")
    columns = (values[order].tolist() for values in (number, log_ns, stamp_ns))
    rows = zip(*columns, order.tolist(), strict=True)
    return [(n, log, stamp, payloads[i]) for n, log, stamp, i in rows]


def _quaternion(yaw: FloatArray) -> FloatArray:
    """(n, 4) x, y, z, w; rounded, so that processors agree and logs compress."""
    zero = np.zeros_like(yaw)
    return np.column_stack(
        [zero, zero, quantised(np.sin(yaw / 2), 22), quantised(np.cos(yaw / 2), 22)]
    )


class _Layout:
    """Builds the numpy dtype of a message, with the alignment of CDR or packed as in ROS 1."""

    def __init__(self, ros: str) -> None:
        self.cdr = ros == "ros2"
        self.fields: list[tuple[str, Any, int]] = []
        # CDR payloads begin with four bytes that say "little endian"; alignment counts from there.
        self.origin = self.end = 4 if self.cdr else 0

    def add(self, name: str, kind: str, count: int = 1) -> None:
        """Append `count` values of a numpy kind."""
        size = np.dtype(kind).itemsize
        if self.cdr and not kind.startswith("S"):
            self.end += -(self.end - self.origin) % size
        self.fields.append((name, (kind, count) if count > 1 else kind, self.end))
        self.end += size * count

    def add_text(self, name: str, text: str) -> None:
        """Append a string: its length, then the bytes (in CDR with a zero at the end)."""
        self.add(f"{name}_size", "<u4")
        self.add(name, f"S{len(text) + (1 if self.cdr else 0)}")

    def add_header(self, frame: str) -> None:
        """Append std_msgs/Header."""
        if not self.cdr:
            self.add("seq", "<u4")
        self.add("sec", "<u4")
        self.add("nanosec", "<u4")
        self.add_text("frame", frame)

    def rows(self, count: int) -> NDArray[Any]:
        """`count` messages, all zero but for the encapsulation of CDR."""
        names, formats, offsets = zip(*self.fields, strict=True)
        spec: Any = {"names": names, "formats": formats, "offsets": offsets, "itemsize": self.end}
        raw = np.zeros((count, self.end), np.uint8)
        if self.cdr:
            raw[:, 1] = 1
        rows: NDArray[Any] = raw.view(np.dtype(spec))[:, 0]
        return rows


def _fill_header(rows: NDArray[Any], time_ns: IntArray, seq: IntArray, frame: str) -> None:
    if "seq" in (rows.dtype.names or ()):
        rows["seq"] = seq
    rows["sec"], rows["nanosec"] = time_ns // 10**9, time_ns % 10**9
    _fill_text(rows, "frame", frame)


def _fill_text(rows: NDArray[Any], name: str, text: str) -> None:
    rows[f"{name}_size"] = rows.dtype[name].itemsize
    rows[name] = text.encode()


def _payloads(rows: NDArray[Any]) -> list[bytes]:
    raw, size = rows.tobytes(), rows.dtype.itemsize
    return [raw[i : i + size] for i in range(0, len(raw), size)]


def _odometry(simulated: SimulatedRun, ros: str) -> list[bytes]:
    odometry = simulated.run.odometry
    layout = _Layout(ros)
    layout.add_header(odometry.frame)
    layout.add_text("child", odometry.child_frame)
    for name, count in (("position", 3), ("quaternion", 4), ("pose_covariance", 36)):
        layout.add(name, "<f8", count)
    for name, count in (("linear", 3), ("angular", 3), ("twist_covariance", 36)):
        layout.add(name, "<f8", count)
    rows = layout.rows(len(odometry))
    _fill_header(rows, odometry.time_ns, np.arange(len(odometry)), odometry.frame)
    _fill_text(rows, "child", odometry.child_frame)
    rows["position"][:, :2] = odometry.pose[:, :2]
    rows["quaternion"] = _quaternion(odometry.pose[:, 2])
    twist = quantised(simulated.twist, 12)
    rows["linear"][:, 0], rows["angular"][:, 2] = twist[:, 0], twist[:, 1]
    rows["pose_covariance"] = rows["twist_covariance"] = COVARIANCE
    return _payloads(rows)


def _detections(simulated: SimulatedRun, ros: str) -> list[bytes]:
    """One structured array per number of branches, put back in order."""
    run = simulated.run
    seen, frame = run.detections, run.odometry.child_frame
    counts = seen.branches.counts
    out = [b""] * len(seen)
    for count in np.unique(counts).tolist():
        which = np.flatnonzero(counts == count)
        layout = _Layout(ros)
        layout.add_header(frame)
        layout.add("count", "<u4")
        for k in range(count):
            layout.add(f"position{k}", "<f8", 3)
            layout.add(f"quaternion{k}", "<f8", 4)
        rows = layout.rows(len(which))
        _fill_header(rows, seen.time_ns[which], which, frame)
        rows["count"] = count
        yaw = seen.branches.take(which).values.reshape(len(which), count)
        for k in range(count):
            rows[f"position{k}"][:, :2] = seen.centre[which]
            rows[f"quaternion{k}"] = _quaternion(yaw[:, k])
        for i, payload in zip(which.tolist(), _payloads(rows), strict=True):
            out[i] = payload
    return out


def _laser(simulated: SimulatedRun, scans: Scans, ros: str) -> tuple[Topic, Topic]:
    """The scans, each in the log when its sweep is done, and where the laser is mounted."""
    first_ns = simulated.run.odometry.time_ns[:1]
    stamp_ns = simulated.scans_ns
    chance = Chance("laser latency", len(scans))
    late = chance.uniform(1_000, 9_000, len(scans)).astype(np.int64) * 1000
    done_ns = stamp_ns + round(scans.settings.sweep_s * 1e9) + late
    mount = _mount(simulated, scans, int(first_ns[0]), ros)
    return (
        Topic("/scan", SCAN_TYPE, done_ns, stamp_ns, _scans(scans, stamp_ns, ros)),
        Topic("/tf_static", TRANSFORMS_TYPE, first_ns, first_ns, [mount]),
    )


def _scans(scans: Scans, stamp_ns: IntArray, ros: str) -> list[bytes]:
    settings, angles = scans.settings, scans.angles_rad
    layout = _Layout(ros)
    layout.add_header(LASER_FRAME)
    about = {
        "angle_min": angles[0],
        "angle_max": angles[-1],
        "angle_increment": (angles[-1] - angles[0]) / (len(angles) - 1),
        "time_increment": settings.sweep_s / (len(angles) - 1),
        "scan_time": 1 / settings.rate_hz,
        "range_min": settings.range_min_m,
        "range_max": settings.range_max_m,
    }
    for name in about:
        layout.add(name, "<f4")
    layout.add("count", "<u4")
    layout.add("ranges", "<f4", len(angles))
    layout.add("no_intensities", "<u4")
    rows = layout.rows(len(scans))
    _fill_header(rows, stamp_ns, np.arange(len(scans)), LASER_FRAME)
    for name, value in about.items():
        rows[name] = value
    rows["count"], rows["ranges"] = len(angles), scans.ranges_m
    return _payloads(rows)


def _mount(simulated: SimulatedRun, scans: Scans, time_ns: int, ros: str) -> bytes:
    x, y, yaw = scans.settings.mount
    layout = _Layout(ros)
    layout.add("transforms", "<u4")
    layout.add_header(simulated.run.odometry.child_frame)
    layout.add_text("child", LASER_FRAME)
    layout.add("translation", "<f8", 3)
    layout.add("rotation", "<f8", 4)
    rows = layout.rows(1)
    _fill_header(
        rows, np.array([time_ns]), np.zeros(1, np.int64), simulated.run.odometry.child_frame
    )
    _fill_text(rows, "child", LASER_FRAME)
    rows["transforms"] = 1
    rows["translation"] = x, y, 0.2
    turn = _quaternion(np.array([yaw]))[0]
    # Half a turn about the x axis after the yaw: (z, w) becomes (y, x).
    rows["rotation"] = [turn[3], turn[2], 0.0, 0.0] if scans.settings.upside_down else turn
    return _payloads(rows)[0]
