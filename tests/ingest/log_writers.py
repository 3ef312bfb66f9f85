"""Writes small logs of every kind, with the libraries and by hand, for the tests of reading."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

START_NS = 1_700_000_000_123_456_789
ODOMETRY = "nav_msgs/msg/Odometry"
POSE_ARRAY = "geometry_msgs/msg/PoseArray"
POSE_STAMPED = "geometry_msgs/msg/PoseStamped"
POSE_COVARIANCE = "geometry_msgs/msg/PoseWithCovarianceStamped"
TF = "tf2_msgs/msg/TFMessage"

Pose = tuple[float, float, float, float, float, float, float]


@dataclass(frozen=True)
class Message:
    """One message in the abstract: `poses` of a transform message share `stamp_ns`; sigma_m: 1
    sigma of the position, where a type can state it."""

    topic: str
    type_name: str
    log_ns: int
    stamp_ns: int
    frame: str
    child: str
    poses: tuple[Pose, ...]
    sigma_m: float = 0.1


def yaw_pose(x: float, y: float, yaw: float, z: float = 0.25) -> Pose:
    return (x, y, z, 0.0, 0.0, float(np.sin(yaw / 2)), float(np.cos(yaw / 2)))


def drive(odometry: int = 300, every: int = 10) -> list[Message]:
    """A curved drive with a junction sighting after every `every` odometry messages."""
    out = []
    for k in range(odometry):
        stamp = START_NS + 20_000_000 * k
        yaw = 0.01 * k
        pose = yaw_pose(0.02 * k + 0.1, 0.001 * k * k / 100, yaw)
        out.append(
            Message("/odom", ODOMETRY, stamp + 3_000_001, stamp, "odom", "base_link", (pose,))
        )
        if k % every == every - 1:
            branches = range(1 + k // every % 4)
            poses = tuple(yaw_pose(0.5, 0.125, 1.5 * b - 2.0, 0.0) for b in branches)
            seen = Message(
                "/junctions", POSE_ARRAY, stamp + 5_000_002, stamp, "base_link", "", poses
            )
            out.append(seen)
    return out


# Payloads


def new_store(ros1: bool) -> Any:
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    if ros1 and TF not in store.types:
        store.register(
            get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/TFMessage")
        )
    return store


store_of = cache(new_store)
"""Shared by tests that add no types to it: what packs a type is compiled once for each store."""


def ros_object(message: Message, store: Any, ros1: bool) -> Any:
    t = store.types

    def make(name: str, **members: Any) -> Any:
        return t[name](**members)

    def xyz(name: str, values: Any) -> Any:
        return make(f"geometry_msgs/msg/{name}", x=values[0], y=values[1], z=values[2])

    def turn(p: Pose) -> Any:
        return make("geometry_msgs/msg/Quaternion", x=p[3], y=p[4], z=p[5], w=p[6])

    def pose(p: Pose) -> Any:
        return make("geometry_msgs/msg/Pose", position=xyz("Point", p), orientation=turn(p))

    header = make(
        "std_msgs/msg/Header",
        stamp=make(
            "builtin_interfaces/msg/Time",
            sec=message.stamp_ns // 10**9,
            nanosec=message.stamp_ns % 10**9,
        ),
        frame_id=message.frame,
        **({"seq": 7} if ros1 else {}),
    )
    if message.type_name == ODOMETRY:
        twist = make(
            "geometry_msgs/msg/Twist",
            linear=xyz("Vector3", (0.5, 0.0, 0.0)),
            angular=xyz("Vector3", (0.0, 0.0, 0.1)),
        )
        return make(
            ODOMETRY,
            header=header,
            child_frame_id=message.child,
            pose=make(
                "geometry_msgs/msg/PoseWithCovariance",
                pose=pose(message.poses[0]),
                covariance=np.eye(6).ravel(),
            ),
            twist=make(
                "geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=np.eye(6).ravel()
            ),
        )
    if message.type_name == POSE_ARRAY:
        return make(POSE_ARRAY, header=header, poses=[pose(p) for p in message.poses])
    if message.type_name == POSE_STAMPED:
        return make(POSE_STAMPED, header=header, pose=pose(message.poses[0]))
    if message.type_name == POSE_COVARIANCE:
        covariance = np.zeros(36)
        covariance[[0, 7]] = message.sigma_m * abs(message.sigma_m)
        stated = make(
            "geometry_msgs/msg/PoseWithCovariance",
            pose=pose(message.poses[0]),
            covariance=covariance,
        )
        return make(POSE_COVARIANCE, header=header, pose=stated)
    if message.type_name == TF:
        transforms = [
            make(
                "geometry_msgs/msg/TransformStamped",
                header=header,
                child_frame_id=message.child,
                transform=make(
                    "geometry_msgs/msg/Transform", translation=xyz("Vector3", p), rotation=turn(p)
                ),
            )
            for p in message.poses
        ]
        return make(TF, transforms=transforms)
    raise ValueError(message.type_name)


def payload(message: Message, encoding: str, store: Any) -> bytes:
    if encoding == "protobuf":
        return protobuf(message)
    if encoding == "json":
        return foxglove_json(message)
    ros1 = encoding == "ros1"
    value = ros_object(message, store, ros1)
    write = store.serialize_ros1 if ros1 else store.serialize_cdr
    return bytes(write(value, message.type_name))


def field(number: int, raw: bytes) -> bytes:
    return varint(number << 3 | 2) + varint(len(raw)) + raw


def varint(value: int) -> bytes:
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes(out) + bytes([value])


def _doubles(values: Any) -> bytes:
    # proto3 leaves zeros out.
    pairs = enumerate(values, 1)
    return b"".join(varint(n << 3 | 1) + struct.pack("<d", v) for n, v in pairs if v)


def protobuf(message: Message) -> bytes:
    stamp = b"\x08" + varint(message.stamp_ns // 10**9) + b"\x10" + varint(message.stamp_ns % 10**9)
    poses = [field(3, field(1, _doubles(p[:3])) + field(2, _doubles(p[3:]))) for p in message.poses]
    return field(1, stamp) + field(2, message.frame.encode()) + b"".join(poses)


def foxglove_json(message: Message) -> bytes:
    def pose(p: Pose) -> dict[str, Any]:
        return {
            "position": dict(zip("xyz", p[:3], strict=True)),
            "orientation": dict(zip("xyzw", p[3:], strict=True)),
        }

    stamp = {"sec": message.stamp_ns // 10**9, "nsec": message.stamp_ns % 10**9}
    value: dict[str, Any] = {"timestamp": stamp, "frame_id": message.frame}
    if message.type_name in (POSE_ARRAY, "foxglove.PosesInFrame"):
        value["poses"] = [pose(p) for p in message.poses]
    else:
        value["pose"] = pose(message.poses[0])
    return json.dumps(value).encode()


FOXGLOVE = {ODOMETRY: "foxglove.PoseInFrame", POSE_ARRAY: "foxglove.PosesInFrame"}


# Containers


def mcap(
    path: Path,
    messages: list[Message],
    encoding: str = "cdr",
    profile: str = "ros2",
    **options: Any,
) -> Path:
    """An MCAP file; options go to mcap's Writer, `compression` by name."""
    from mcap.writer import CompressionType, Writer

    options["compression"] = CompressionType[options.pop("compression", "ZSTD")]
    options.setdefault("chunk_size", 16_384)
    schemas = options.pop("schemas", True)
    store = store_of(encoding == "ros1")
    with path.open("wb") as file:
        writer = Writer(file, **options)
        writer.start(profile=profile, library="test")
        channels: dict[tuple[str, str], int] = {}
        for number, message in enumerate(messages):
            key = message.topic, message.type_name
            if key not in channels:
                channels[key] = writer.register_channel(
                    message.topic, encoding, _schema(writer, message, encoding, store, schemas)
                )
            raw = payload(message, encoding, store)
            writer.add_message(channels[key], message.log_ns, raw, message.log_ns, number)
        writer.finish()
    return path


def _schema(writer: Any, message: Message, encoding: str, store: Any, text: bool) -> int:
    if encoding in ("cdr", "ros1"):
        ros1 = encoding == "ros1"
        definition, _ = store.generate_msgdef(message.type_name, ros_version=1 if ros1 else 2)
        name = message.type_name.replace("/msg/", "/") if ros1 else message.type_name
        kind = "ros1msg" if ros1 else "ros2msg"
        return int(writer.register_schema(name, kind, definition.encode() if text else b""))
    kind = {"json": "jsonschema", "protobuf": "protobuf"}[encoding]
    name = FOXGLOVE.get(message.type_name, message.type_name)
    return int(writer.register_schema(name, kind, b"{}"))


def mcap_topic(
    path: Path,
    topic: str,
    encoding: str,
    schema: tuple[str, str, str],
    payloads: Iterable[tuple[int, bytes]],
    **options: Any,
) -> Path:
    """An MCAP file of one topic, of any type. schema: its name, encoding and text; payloads: each
    with its log time [ns]."""
    from mcap.writer import Writer

    name, kind, text = schema
    with path.open("wb") as file:
        writer = Writer(file, **options)
        writer.start()
        number = writer.register_schema(name, kind, text.encode())
        channel = writer.register_channel(topic, encoding, number)
        for log_ns, raw in payloads:
            writer.add_message(channel, log_ns, raw, log_ns)
        writer.finish()
    return path


def bag(
    path: Path, messages: list[Message], compression: str = "none", chunk: int = 16_384
) -> Path:
    from rosbags.rosbag1 import Writer

    store = store_of(True)
    writer = Writer(path)
    writer.chunk_threshold = chunk
    if compression != "none":
        writer.set_compression(Writer.CompressionFormat[compression.upper()])
    _write(writer, messages, "ros1", store)
    return path


def ros2_folder(
    path: Path, messages: list[Message], storage: str = "SQLITE3", compression: str = "NONE"
) -> Path:
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

    store = store_of(False)
    writer = Writer(path, version=8, storage_plugin=StoragePlugin[storage])
    if compression != "NONE":
        writer.set_compression(CompressionMode[compression], CompressionFormat.ZSTD)
    _write(writer, messages, "cdr", store)
    return path


def _write(writer: Any, messages: list[Message], encoding: str, store: Any) -> None:
    """All messages, by a writer of rosbags."""
    with writer:
        links: dict[str, Any] = {}
        for message in messages:
            if message.topic not in links:
                links[message.topic] = writer.add_connection(
                    message.topic, message.type_name, typestore=store
                )
            writer.write(links[message.topic], message.log_ns, payload(message, encoding, store))


def relabelled(messages: list[Message], **changes: Any) -> list[Message]:
    """The same messages with some members replaced."""
    return [replace(message, **changes) for message in messages]
