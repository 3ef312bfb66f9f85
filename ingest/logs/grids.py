"""nav_msgs/OccupancyGrid, in CDR and ROS 1's encoding: the last one of a topic."""

from __future__ import annotations

import struct

import numpy as np

from ...topology.errors import LogError
from ...topology.run import Grid
from ...topology.se2 import yaw_from_quaternion
from .foxglove import as_text, get, integer, load_json, real, unit_quaternion, vector
from .inflate import ZSTD_MAGIC, inflate_message
from .messages import Channel, DamageError, Findings
from .recording import Recording
from .saved_map import checked_grid
from .schema import as_expected, object_decoder
from .wire import WireParser

FREE = 20
"""Occupancy below which a cell is free: map_server's threshold of 0.196, in percent."""


def last_grid(recording: Recording, topic: str, findings: Findings) -> tuple[Grid, int]:
    """The last readable grid of a topic, and the number of unreadable ones after it.

    Raises LogError if there is none. Memory follows the largest message.
    """
    failed, reason = 0, "there is none"
    channels: list[Channel] = []

    def want(channel: Channel) -> int:
        if channel.topic != topic:
            return -1
        channels.append(channel)
        return len(channels) - 1

    payloads: list[tuple[Channel, bytes]] = []
    for file in recording.files:
        with file.opened() as log:
            for block in log.blocks(want, findings, None):
                for at, size in zip(block.start.tolist(), block.size.tolist(), strict=True):
                    payloads.append((channels[block.sink], block.data[at : at + size].tobytes()))
                    # Some are kept in case that the last ones are broken.
                    del payloads[:-3]
    for channel, payload in reversed(payloads):
        try:
            return grid_of_message(channel, payload), failed
        except (DamageError, ValueError) as error:
            failed, reason = failed + 1, str(error)
    raise LogError(f"{recording.path}: no grid can be read from {topic}: {reason}")


def grid_of_message(channel: Channel, payload: bytes) -> Grid:
    """The grid of one message; raises DamageError or ValueError if it is invalid."""
    if channel.encoding == "cdr" and payload[:4] == ZSTD_MAGIC:
        payload = inflate_message(payload)
    if channel.encoding == "json":
        return _of_object(load_json(payload))
    if channel.encoding not in ("cdr", "ros1"):
        raise DamageError(f"messages are encoded as {channel.encoding[:40]!r}, which is not known")
    if as_expected(channel, "grid"):
        return _of_wire(payload, channel.encoding == "ros1")
    return _of_object(object_decoder(channel)(payload))


def _of_wire(raw: bytes, ros1: bool) -> Grid:
    parser = WireParser(raw, ros1)
    _, frame = parser.header()
    parser.stamp()
    (resolution,) = struct.unpack_from(f"{parser.order}f", raw, parser.advance(4))
    width, height = parser.count(), parser.count()
    pose = struct.unpack_from(f"{parser.order}7d", raw, parser.doubles(7))
    cells = parser.count()
    data = np.frombuffer(raw, np.int8, cells, parser.advance(cells))
    return _checked(data, (height, width), resolution, pose, frame)


def _of_object(message: object) -> Grid:
    about = get(message, "info")
    origin = get(about, "origin")
    pose = vector(get(origin, "position"), "xyz") + vector(get(origin, "orientation"), "xyzw")
    data = get(message, "data")
    if data is None or isinstance(data, str) or not hasattr(data, "__len__"):
        raise DamageError("a grid without cells")
    width, height = integer(get(about, "width")), integer(get(about, "height"))
    frame = as_text(get(get(message, "header"), "frame_id"))
    cells = np.asarray(data)
    if cells.dtype.kind not in "iu":
        raise DamageError("the cells of a grid are no whole numbers")
    return _checked(cells, (height, width), real(get(about, "resolution")), pose, frame)


def _checked(
    data: np.ndarray[tuple[int, ...], np.dtype[np.integer]],
    shape: tuple[int, int],
    resolution: float,
    pose: tuple[float, ...],
    frame: str,
) -> Grid:
    height, width = shape
    if data.ndim != 1 or min(shape) < 0 or len(data) != width * height:
        raise DamageError(f"a grid of {width} x {height} cells holds {data.size} numbers")
    yaw = float(yaw_from_quaternion(*unit_quaternion(pose[3:])))
    cells = data.reshape(height, width)
    free = (cells >= 0) & (cells < FREE)
    known_frame = frame.lstrip("/") or "map"
    origin = pose[0], pose[1], yaw
    return checked_grid(
        Grid(np.asarray(free), np.asarray(cells < 0), float(resolution), origin, known_frame)
    )
