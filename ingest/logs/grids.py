"""Grids of logs: nav_msgs/OccupancyGrid, the last one of a topic."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...topology.errors import LogError
from ...topology.run import Grid
from ...topology.se2 import yaw_from_quaternion
from .foxglove import as_text, get, integer, object_reader, pose_of, real, unit_quaternion
from .inflate import ZSTD_MAGIC, inflate_message
from .messages import Channel, DamageError
from .recording import Recording
from .saved_map import checked_grid

FREE = 20
"""Occupancy below which a cell is free: map_server's threshold of 0.196, in percent."""


@dataclass(frozen=True, slots=True)
class GridLog:
    """A grid as it was saved or recorded, in place of a run; name, source, warnings: see `Run`."""

    name: str
    grid: Grid
    source: Mapping[str, Any]
    warnings: tuple[str, ...] = ()


def last_grid(recording: Recording, topic: str) -> tuple[Grid, int]:
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
    for block in recording.blocks(want):
        payloads += [(channels[block.sink], payload) for payload in block.payloads()]
        del payloads[:-3]  # some are kept in case that the last ones are broken
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
    return _of_object(object_reader(channel)(payload))


def _of_object(message: object) -> Grid:
    about = get(message, "info")
    x, y, _, *turn = pose_of(get(about, "origin"))
    data = get(message, "data")
    if data is None or isinstance(data, str) or not hasattr(data, "__len__"):
        raise DamageError("a grid without cells")
    width, height = integer(get(about, "width")), integer(get(about, "height"))
    cells = np.asarray(data)
    if cells.dtype.kind not in "iu":
        raise DamageError("the cells of a grid are no whole numbers")
    if cells.ndim != 1 or min(height, width) < 0 or len(cells) != width * height:
        raise DamageError(f"a grid of {width} x {height} cells holds {cells.size} numbers")
    yaw = float(yaw_from_quaternion(*unit_quaternion(tuple(turn))))
    cells = cells.reshape(height, width)
    free, unknown = (cells >= 0) & (cells < FREE), cells < 0
    place = x, y, yaw
    frame = as_text(get(get(message, "header"), "frame_id")).lstrip("/") or "map"
    return checked_grid(Grid(free, unknown, real(get(about, "resolution")), place, frame))
