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
from .messages import UNWANTED, Channel, DamageError
from .recording import Recording
from .saved_map import USUAL_FREE_THRESH, checked_grid


@dataclass(frozen=True, slots=True)
class GridLog:
    """A grid as it was saved or recorded, in place of a run; name, source, warnings: see `Run`."""

    name: str
    grid: Grid
    source: Mapping[str, Any]
    warnings: tuple[str, ...] = ()


def last_grid(recording: Recording, topic: str) -> Grid:
    """The last grid of a topic; raises LogError if there is none, or it cannot be read.

    Memory follows the largest message.
    """
    channels: list[Channel] = []

    def want(channel: Channel) -> int:
        if channel.topic != topic:
            return UNWANTED
        channels.append(channel)
        return len(channels) - 1

    last: tuple[Channel, bytes] | None = None
    for block in recording.blocks(want):
        (payload,) = block.rows(slice(-1, None)).payloads()
        last = channels[block.sink], payload
    try:
        if last is None:
            raise DamageError("there is none")
        return grid_of_message(*last)
    except (DamageError, ValueError) as error:
        raise LogError(f"{recording.path}: no grid can be read from {topic}: {error}") from error


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
    free, unknown = (cells >= 0) & (cells < 100 * USUAL_FREE_THRESH), cells < 0
    place = x, y, yaw
    frame = as_text(get(get(message, "header"), "frame_id")).lstrip("/") or "map"
    return checked_grid(Grid(free, unknown, real(get(about, "resolution")), place, frame))
