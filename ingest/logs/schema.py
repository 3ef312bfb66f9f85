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


def is_usual(channel: Channel) -> bool:
    """Whether the definition of a type of ROS is ROS's own, so that its layout is known.

    True also for a log without definitions, or with one that cannot be read: the type's name is
    trusted then.
    """
    try:
        own = _checked_store(channel).fielddefs
        usual = _checked_store(channel._replace(schema=b"")).fielddefs
    except DamageError:
        return True
    return all(name not in usual or usual[name][1] == own[name][1] for name in own)


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
