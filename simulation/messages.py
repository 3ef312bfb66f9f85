"""Runs as ROS messages: nav_msgs/Odometry on /odom, geometry_msgs/PoseArray on /junctions.

A detection is one PoseArray in the robot's frame: a pose per branch, each at the junction's centre
and looking along its branch.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .chance import Chance, quantised
from .scenario import SimulatedRun
from .world import FloatArray, IntArray

ODOMETRY_TYPE = "nav_msgs/msg/Odometry"
POSES_TYPE = "geometry_msgs/msg/PoseArray"

COVARIANCE = np.diag([1e-3, 1e-3, 1e6, 1e6, 1e6, 1e-2]).ravel()

_STAMP = {
    "ros1": "uint32 seq\ntime stamp\nstring frame_id\n",
    "ros2": "builtin_interfaces/Time stamp\nstring frame_id\n",
}
_PARTS = {
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec\n",
    "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z\n",
    "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w\n",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z\n",
    "geometry_msgs/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation\n",
    "geometry_msgs/Twist": "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular\n",
    "geometry_msgs/PoseWithCovariance": "geometry_msgs/Pose pose\nfloat64[36] covariance\n",
    "geometry_msgs/TwistWithCovariance": "geometry_msgs/Twist twist\nfloat64[36] covariance\n",
    ODOMETRY_TYPE: (
        "std_msgs/Header header\nstring child_frame_id\n"
        "geometry_msgs/PoseWithCovariance pose\ngeometry_msgs/TwistWithCovariance twist\n"
    ),
    POSES_TYPE: "std_msgs/Header header\ngeometry_msgs/Pose[] poses\n",
}
_NEEDS = {
    ODOMETRY_TYPE: (
        *("geometry_msgs/PoseWithCovariance", "geometry_msgs/Pose", "geometry_msgs/Point"),
        *("geometry_msgs/Quaternion", "geometry_msgs/TwistWithCovariance"),
        *("geometry_msgs/Twist", "geometry_msgs/Vector3"),
    ),
    POSES_TYPE: ("geometry_msgs/Pose", "geometry_msgs/Point", "geometry_msgs/Quaternion"),
}
DIGESTS = {
    ("ros1", ODOMETRY_TYPE): "cd5e73d190d741a2f92e81eda573aca7",
    ("ros1", POSES_TYPE): "916c28c5764443f268b296bb671b9d97",
    ("ros2", ODOMETRY_TYPE): (
        "RIHS01_3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0"
    ),
    ("ros2", POSES_TYPE): "RIHS01_af0cc36d190e104d546d168d6b39df04fa4b4ccecf59cb4c9ed328d3d5004aa0",
}
"""Hashes of the definitions: MD5 for ROS 1, RIHS01 for ROS 2."""


def definition(type_name: str, ros: str) -> str:
    """The text that describes a message type and all types it is made of; ros: "ros1", "ros2"."""
    parts = [("std_msgs/Header", _STAMP[ros])]
    if ros == "ros2":
        parts.append(("builtin_interfaces/Time", _PARTS["builtin_interfaces/Time"]))
    parts += [(name, _PARTS[name]) for name in _NEEDS[type_name]]
    rule = "=" * 80
    return _PARTS[type_name] + "".join(f"{rule}\nMSG: {name}\n{text}" for name, text in parts)


@dataclass(frozen=True, slots=True, eq=False)
class Topic:
    """All messages of one topic: log_ns, stamp_ns: (n,) int64; payloads: n serialized messages."""

    name: str
    type_name: str
    log_ns: IntArray
    stamp_ns: IntArray
    payloads: list[bytes]


def topics_of(simulated: SimulatedRun, ros: str) -> tuple[Topic, Topic]:
    """The two topics of a run, serialized for ROS 1 or as the CDR of ROS 2. O(n), vectorised.

    Messages reach the log some milliseconds after their stamp, like those of a real recorder.
    """
    run = simulated.run
    chance = Chance("latency", len(run.odometry), len(run.detections))
    odometry_ns, seen_ns = run.odometry.time_ns, run.detections.time_ns
    late = chance.uniform(1_000, 8_000, len(odometry_ns)).astype(np.int64) * 1000
    seen_late = chance.uniform(20_000, 70_000, len(seen_ns)).astype(np.int64) * 1000
    return (
        Topic("/odom", ODOMETRY_TYPE, odometry_ns + late, odometry_ns, _odometry(simulated, ros)),
        Topic("/junctions", POSES_TYPE, seen_ns + seen_late, seen_ns, _detections(simulated, ros)),
    )


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
