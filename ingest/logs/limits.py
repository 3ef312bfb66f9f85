"""How long the messages of a channel may be."""

from __future__ import annotations

from .messages import MESSAGE_BYTES, Channel
from .topics import GRID_KINDS

CLOUD_BYTES = 1 << 26
"""Longest cloud in CDR or ROS 1's encoding, which is decoded in place: `clouds.MOST_POINTS` of 32
bytes."""

GRID_BYTES = (1 << 24) + (1 << 13)
"""Longest grid in these encodings: `saved_map.MOST_CELLS`, and what is told of them."""

HEAD_BYTES = 1 << 12
"""Bytes of a record beside its message."""


def longest_message(channel: Channel) -> int:
    """Longest message of a channel that is decoded [bytes]."""
    if channel.encoding not in ("cdr", "ros1"):
        return MESSAGE_BYTES
    if channel.type_name == "sensor_msgs/msg/PointCloud2":
        return CLOUD_BYTES
    return GRID_BYTES if channel.type_name in GRID_KINDS else MESSAGE_BYTES
