"""Runs as ROS messages: nav_msgs/Odometry on /odom, geometry_msgs/PoseArray on /junctions.

A detection is one PoseArray in the robot's frame, with a pose for each branch: the junction's
centre and the branch's heading. Scans are sensor_msgs/LaserScan on /scan, stamped with the time of
their first beam; the laser's mount is one message on /tf_static.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np

from ..topology.arrays import FloatArray, IntArray
from .chance import Chance, quantised
from .laser import Scans
from .scenario import SimulatedRun

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
    """rosbags' store of message types; ros: "ros1" or "ros2"."""
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
    """The topics of a run, serialized for ROS 1 or as CDR for ROS 2. O(n).

    Messages are logged some milliseconds after their stamp, as by a real recorder.
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


def _detections(simulated: SimulatedRun, ros: str) -> list[bytes]:
    m, run, out = _named(ros), simulated.run, []
    seen = run.detections
    turns, stops = _quaternion(seen.branches.values).tolist(), seen.branches.offsets.tolist()
    for k, time_ns in enumerate(seen.time_ns.tolist()):
        xy = seen.centre[k].tolist()
        poses = [_pose(ros, xy, turn) for turn in turns[stops[k] : stops[k + 1]]]
        header = _header(ros, time_ns, run.odometry.child_frame, k)
        out.append(_payload(ros, m.PoseArray(header, poses)))
    return out


def _laser(simulated: SimulatedRun, scans: Scans, ros: str) -> tuple[Topic, Topic]:
    """The scans, each logged when its sweep is complete, and the laser's mount."""
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


def _mount(simulated: SimulatedRun, scans: Scans, time_ns: int, ros: str) -> bytes:
    (x, y, yaw), m = scans.settings.mount, _named(ros)
    turn = _quaternion(np.array([yaw]))[0].tolist()
    if scans.settings.upside_down:
        # Yaw, then half a turn about x: the quaternion (0, 0, z, w) becomes (w, z, 0, 0).
        turn = [turn[3], turn[2], 0.0, 0.0]
    header = _header(ros, time_ns, simulated.run.odometry.child_frame)
    place = m.Transform(m.Vector3(x, y, 0.2), m.Quaternion(*turn))
    return _payload(ros, m.TFMessage([m.TransformStamped(header, LASER_FRAME, place)]))
