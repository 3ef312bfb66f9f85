"""Sensor messages for the tests of reading scans, made with rosbags and by hand."""

from __future__ import annotations

import base64
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np

from .log_writers import TF, field, store_of, varint

START_NS = 1_700_000_000_000_000_000
SCAN = "sensor_msgs/msg/LaserScan"
ECHOES = "sensor_msgs/msg/MultiEchoLaserScan"
CLOUD = "sensor_msgs/msg/PointCloud2"
GRID = "nav_msgs/msg/OccupancyGrid"

Row = tuple[str, str, int, bytes]
"""Topic, type, log time and payload of a message."""


ROS2, ROS1 = store_of(False), store_of(True)


def store(encoding: str) -> Any:
    return ROS1 if encoding == "ros1" else ROS2


def packed(message: Any, type_name: str, encoding: str = "cdr") -> bytes:
    s = store(encoding)
    raw = s.serialize_ros1 if encoding == "ros1" else s.serialize_cdr
    return bytes(raw(message, type_name))


def header(stamp_ns: int, frame: str = "laser", encoding: str = "cdr") -> Any:
    types = store(encoding).types
    time = types["builtin_interfaces/msg/Time"](sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
    more = {"seq": 3} if encoding == "ros1" else {}
    return types["std_msgs/msg/Header"](stamp=time, frame_id=frame, **more)


def about(**changes: float) -> dict[str, float]:
    told = {
        "angle_min": -1.0,
        "angle_max": 1.0,
        "angle_increment": 0.5,
        "time_increment": 0.01,
        "scan_time": 0.1,
        "range_min": 0.1,
        "range_max": 10.0,
    }
    return told | changes


def scan(
    ranges: Any,
    stamp_ns: int = START_NS,
    frame: str = "laser",
    encoding: str = "cdr",
    **changes: Any,
) -> bytes:
    message = store(encoding).types[SCAN](
        header=header(stamp_ns, frame, encoding),
        **about(**changes),
        ranges=np.array(ranges, np.float32),
        intensities=np.zeros(0, np.float32),
    )
    return packed(message, SCAN, encoding)


def echoes(
    ranges: list[list[float]], strengths: list[list[float]], encoding: str = "cdr", **changes: Any
) -> bytes:
    types = store(encoding).types
    stamp_ns = changes.pop("stamp_ns", START_NS)

    def lists(rows: list[list[float]]) -> list[Any]:
        return [types["sensor_msgs/msg/LaserEcho"](echoes=np.array(r, np.float32)) for r in rows]

    message = types[ECHOES](
        header=header(stamp_ns, "laser", encoding),
        **about(**changes),
        ranges=lists(ranges),
        intensities=lists(strengths),
    )
    return packed(message, ECHOES, encoding)


def cloud(
    xyz: Any,
    kind: str = "<f4",
    encoding: str = "cdr",
    *,
    lead: int = 0,
    tail: int = 4,
    height: int = 1,
    gap: int = 0,
    frame: str = "laser",
    stamp_ns: int = START_NS,
) -> bytes:
    """A cloud whose points have `lead` bytes before x, y, z and `tail` behind, its rows a gap."""
    types, xyz = store(encoding).types, np.asarray(xyz, np.float64).reshape(-1, 3)
    size = np.dtype(kind).itemsize
    step, width = lead + 3 * size + tail, len(xyz) // height
    row = width * step + gap
    data = np.full((height, row), 0xAB, np.uint8)
    for axis in range(3):
        values = xyz[:, axis].reshape(height, width).astype(kind)
        raw = values.view(np.uint8).reshape(height, width, size)
        for k in range(size):
            at = lead + axis * size + k
            data[:, at : width * step : step] = raw[..., k]
    of_points = types["sensor_msgs/msg/PointField"]
    code = {"f4": 7, "f8": 8, "i2": 3}[kind[1:]]
    fields = [
        of_points(name=n, offset=lead + i * size, datatype=code, count=1)
        for i, n in enumerate("xyz")
    ]
    fields.insert(0, of_points(name="intensity", offset=0, datatype=2, count=1))
    message = types[CLOUD](
        header=header(stamp_ns, frame, encoding),
        height=height,
        width=width,
        fields=fields,
        is_bigendian=kind[0] == ">",
        point_step=step,
        row_step=row,
        data=data.ravel(),
        is_dense=True,
    )
    return packed(message, CLOUD, encoding)


def grid(
    cells: Any,
    resolution: float = 0.1,
    origin: tuple[float, ...] = (0, 0, 0),
    encoding: str = "cdr",
) -> bytes:
    types, cells = store(encoding).types, np.asarray(cells, np.int8)
    x, y, yaw = origin
    pose = types["geometry_msgs/msg/Pose"](
        position=types["geometry_msgs/msg/Point"](x=x, y=y, z=0.0),
        orientation=types["geometry_msgs/msg/Quaternion"](
            x=0.0, y=0.0, z=float(np.sin(yaw / 2)), w=float(np.cos(yaw / 2))
        ),
    )
    info = types["nav_msgs/msg/MapMetaData"](
        map_load_time=header(START_NS, "", encoding).stamp,
        resolution=resolution,
        width=cells.shape[1],
        height=cells.shape[0],
        origin=pose,
    )
    message = types[GRID](header=header(START_NS, "map", encoding), info=info, data=cells.ravel())
    return packed(message, GRID, encoding)


def mount(child: str, pose: tuple[float, ...], parent: str = "base_link") -> bytes:
    """A TFMessage; pose: x, y, z, qx, qy, qz, qw."""
    t = ROS2.types
    transform = t["geometry_msgs/msg/Transform"](
        translation=t["geometry_msgs/msg/Vector3"](x=pose[0], y=pose[1], z=pose[2]),
        rotation=t["geometry_msgs/msg/Quaternion"](x=pose[3], y=pose[4], z=pose[5], w=pose[6]),
    )
    stamped = t["geometry_msgs/msg/TransformStamped"](
        header=header(START_NS, parent), child_frame_id=child, transform=transform
    )
    return packed(t[TF](transforms=[stamped]), TF)


def foxglove_json(ranges: Any) -> bytes:
    zero = {"x": 0, "y": 0, "z": 0}
    return json.dumps(
        {
            "timestamp": {"sec": START_NS // 10**9, "nsec": START_NS % 10**9},
            "frame_id": "laser",
            "pose": {"position": {**zero, "x": 0.5}, "orientation": {**zero, "w": 1}},
            "start_angle": -1.0,
            "end_angle": 1.0,
            "ranges": [None if r != r else r for r in ranges],  # noqa: PLR0124
            "intensities": [],
        }
    ).encode()


def foxglove_protobuf(ranges: Any, whole: bool = True) -> bytes:
    """whole: ranges in one packed field, as every writer does; else one by one."""
    stamp = b"\x08" + varint(START_NS // 10**9) + b"\x10" + varint(START_NS % 10**9)
    position = field(1, _double(1, 0.5))
    out = field(1, stamp) + field(2, b"laser") + field(3, position)
    out += _double(4, -1.0) + _double(5, 1.0)
    if whole:
        return out + field(6, b"".join(struct.pack("<d", r) for r in ranges))
    return out + b"".join(_double(6, r) for r in ranges)


def foxglove_cloud(
    xyz: Any, encoding: str, pose: tuple[float, ...] = (0, 0, 0, 0, 0, 0, 1)
) -> bytes:
    """A foxglove.PointCloud of a byte of intensity, then x, y as float32, z as float64."""
    points = np.zeros(len(xyz), np.dtype("u1, <f4, <f4, <f8"))
    points["f1"], points["f2"], points["f3"] = np.asarray(xyz, np.float64).T
    fields = [("intensity", 0, 1), ("x", 1, 7), ("y", 5, 7), ("z", 9, 8)]
    names = "position", "orientation"
    if encoding == "json":
        parts = dict(zip("xyz", pose[:3], strict=True)), dict(zip("xyzw", pose[3:], strict=True))
        return json.dumps(
            {
                "timestamp": {"sec": START_NS // 10**9, "nsec": START_NS % 10**9},
                "frame_id": "laser",
                "pose": dict(zip(names, parts, strict=True)),
                "point_stride": points.itemsize,
                "fields": [{"name": n, "offset": at, "type": t} for n, at, t in fields],
                "data": base64.b64encode(points.tobytes()).decode(),
            }
        ).encode()
    stamp = b"\x08" + varint(START_NS // 10**9) + b"\x10" + varint(START_NS % 10**9)
    parts = (
        b"".join(_double(k + 1, v) for k, v in enumerate(part)) for part in (pose[:3], pose[3:])
    )
    out = field(1, stamp) + field(2, b"laser")
    out += field(3, b"".join(field(k, part) for k, part in enumerate(parts, 1)))
    out += _fixed32(4, points.itemsize)
    for name, at, kind in fields:
        told = field(1, name.encode()) + _fixed32(2, at) + varint(3 << 3) + varint(kind)
        out += field(5, told)
    return out + field(6, points.tobytes())


def _double(number: int, value: float) -> bytes:
    return varint(number << 3 | 1) + struct.pack("<d", value)


def _fixed32(number: int, value: int) -> bytes:
    return varint(number << 3 | 5) + struct.pack("<I", value)


def room(x: float, y: float, yaw: float, beams: int) -> Any:
    """Ranges all around in a room of 10 m by 10 m."""
    way = yaw + np.linspace(-np.pi, np.pi, beams, endpoint=False)
    c, s = np.cos(way), np.sin(way)
    sides = np.where(c > 0, 8 - x, -2 - x), np.where(s > 0, 6 - y, -4 - y)
    with np.errstate(divide="ignore"):
        return np.minimum(np.abs(sides[0] / c), np.abs(sides[1] / s))


def around(pose: tuple[float, ...], stamp_ns: int) -> bytes:
    """A scan of that room by a laser at the robot's middle; pose: as of `log_writers`."""
    x, y, *_, z, w = pose
    beams = 720
    step = 2 * np.pi / beams
    return scan(
        room(x, y, 2 * np.arctan2(z, w), beams),
        stamp_ns,
        "base_link",
        angle_min=-np.pi,
        angle_max=np.pi - step,
        angle_increment=step,
        time_increment=0.0,
        range_max=30.0,
    )


def mcap(path: Path, rows: list[Row], encoding: str = "cdr", **options: Any) -> Path:
    """An MCAP file of messages that are serialized already; options go to mcap's Writer."""
    from mcap.writer import Writer

    with path.open("wb") as file:
        writer = Writer(file, **{"chunk_size": 4096} | options)
        writer.start(profile="ros2", library="test")
        channels: dict[str, int] = {}
        for number, (topic, type_name, log_ns, raw) in enumerate(rows):
            if topic not in channels:
                kind, text = {"json": ("jsonschema", "{}"), "protobuf": ("protobuf", "")}.get(
                    encoding, ("ros1msg" if encoding == "ros1" else "ros2msg", None)
                )
                if text is None:
                    version = 1 if encoding == "ros1" else 2
                    text, _ = store(encoding).generate_msgdef(type_name, ros_version=version)
                schema = writer.register_schema(type_name, kind, text.encode())
                channels[topic] = writer.register_channel(topic, encoding, schema)
            writer.add_message(channels[topic], log_ns, raw, log_ns, number)
        writer.finish()
    return path
