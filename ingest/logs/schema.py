"""Message definitions in logs, as rosbags reads them: layouts, and decoding of any type."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import lru_cache
from typing import Any

from .messages import Channel, DamageError

LINES = 4000
"""Longest definition that is parsed; the largest in use have about a thousand lines."""

_BESIDE_IDL = re.compile(r"^(=+|IDL:.*|[ \t]*#.*)$", re.MULTILINE)
"""Separators between the IDL files of a definition, and their includes."""

PARTS = 10_000
"""Most fields of a type including nested ones, with sequences counted once. The largest in use have
some hundreds; types that double at each level have 2^32."""

REMEMBERED_BYTES = 1 << 14
"""Definitions up to this size are cached in the process: 64 of them take 1 MiB. Includes all
message types used here."""


_TRANSFORMS = "e41d186dfe5cb02c6b00c4ad42748258", "94810edda583a504dfda3829e70d7eec"

LAYOUTS = {
    "nav_msgs/msg/Odometry": (
        "8defd31b6677fc3797c37aa6ac09af3e",
        "cd5e73d190d741a2f92e81eda573aca7",
    ),
    "geometry_msgs/msg/PoseStamped": (
        "64362206a284db490664e6fd9c66f4b4",
        "d3812c3cbc69362b77dc0b19b345f8f5",
    ),
    "geometry_msgs/msg/PoseWithCovarianceStamped": (
        "fec9797245e326f251407c760ee3fd92",
        "953b798c0f514ff060a53a3498ce6246",
    ),
    "geometry_msgs/msg/PoseArray": (
        "2d8fa74bf1752840cc028b9baa3d9b94",
        "916c28c5764443f268b296bb671b9d97",
    ),
    "tf2_msgs/msg/TFMessage": _TRANSFORMS,
    "tf/msg/tfMessage": _TRANSFORMS,
    "sensor_msgs/msg/LaserScan": (
        "27099baaa2e12d02bb113dcaacd7f1db",
        "90c7ef2dc6895d81024acba2ac42f369",
    ),
}
"""MD5 sums of ROS's own definitions in ROS 2 and in ROS 1, as `rosmsg md5` makes them. To compare
with the definitions of rosbags would load all its types: a tenth of a second."""


def is_usual(channel: Channel) -> bool:
    """Whether the definition of a type of LAYOUTS is ROS's own, so that its layout is known.

    True also for a log without definitions, or with one that cannot be read: the type's name is
    trusted then. Times count as ROS's own, as in ROS 1 they are no type of their own.
    """
    if not channel.schema:
        return True
    try:
        store = _checked_store(channel)
    except DamageError:
        return True
    _, digest = store.generate_msgdef(channel.type_name, ros_version=1)
    return bool(digest == LAYOUTS[channel.type_name][channel.encoding == "ros1"])


def object_decoder(channel: Channel) -> Callable[[bytes], Any]:
    """A function from payload to message object, by the embedded definition.

    Without a usable definition those bundled with rosbags are used. Raises DamageError if there is
    none; the function raises DamageError for a payload that cannot be decoded.
    """
    store = _checked_store(channel)
    read = store.deserialize_ros1 if channel.encoding == "ros1" else store.deserialize_cdr

    def decode(raw: bytes) -> Any:
        try:
            return read(raw, channel.type_name)
        # The generated code raises numpy's and struct's exceptions on invalid data.
        except Exception as error:
            raise DamageError(f"a message does not decode ({type(error).__name__})") from error

    return decode


def _checked_store(channel: Channel) -> Any:
    """rosbags' typestore with the embedded definition, or with ROS's own without one; raises
    DamageError if the type is not in it, or is implausible."""
    short = len(channel.schema) <= REMEMBERED_BYTES
    store = (_store if short else _store.__wrapped__)(*channel[1:])
    if channel.type_name not in store.types:
        raise DamageError(f"no definition of {channel.type_name} is known")
    _check_extent(store.fielddefs, channel.type_name)
    return store


@lru_cache(64)
def _store(type_name: str, encoding: str, schema: bytes, schema_encoding: str) -> Any:
    from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

    if not schema:
        return get_typestore(Stores.ROS1_NOETIC if encoding == "ros1" else Stores.ROS2_JAZZY)
    definition = schema.decode("utf-8", "replace")
    if definition.count("\n") > LINES:
        raise DamageError("a message definition is implausibly long")
    store = get_typestore(Stores.EMPTY)
    try:
        if schema_encoding == "ros2idl":
            store.register(get_types_from_idl(_BESIDE_IDL.sub("", definition)))
        else:
            store.register(get_types_from_msg(definition, type_name))
    # The parser raises its own and Python's exceptions on invalid text.
    except (Exception, RecursionError) as error:
        raise DamageError(f"the definition of {type_name} cannot be read") from error
    return store


def _check_extent(fielddefs: Any, type_name: str) -> None:
    """Reject a type that is incomplete, or of which few bytes could make many objects."""
    waiting, parts = [type_name], 0
    while waiting:
        name = waiting.pop()
        if name not in fielddefs:
            raise DamageError(f"the definition of {type_name} lacks {name[:100]}")
        for _, described in fielddefs[name][1]:
            kind, content = described[0].name, described[1]
            inner, count = content if kind in ("ARRAY", "SEQUENCE") else (described, 1)
            nested = inner[0].name == "NAME"
            if kind == "ARRAY" and count == 0:
                raise DamageError(f"{type_name} has an array of no items")
            # Items of sequences, and numbers of arrays, are read by one piece of code.
            count = count if kind == "ARRAY" and (nested or "string" in inner[1]) else 1
            parts += count
            if parts > PARTS:
                raise DamageError(f"{type_name} has more than {PARTS} fields")
            if nested:
                waiting += [inner[1]] * count
