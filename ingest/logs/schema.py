"""Message definitions in logs, as rosbags reads them: layouts, and decoding of any type."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from functools import lru_cache
from typing import Any, NamedTuple

from .messages import Channel, DamageError

LINES = 4000
"""Longest definition that is parsed; the largest in use have about a thousand lines."""

_BESIDE_IDL = re.compile(r"^(=+|IDL:.*|[ \t]*#.*)$", re.MULTILINE)
"""Separators between the IDL files of a definition, and their includes."""

DEPTH = 32
"""Deepest nesting of types; those in use nest less than ten deep."""

PARTS = 10_000
"""Most fields of a type including nested ones, with sequences counted once. The largest in use have
some hundreds; types that double at each level have 2^32."""

REMEMBERED_BYTES = 1 << 14
"""Definitions up to this size are cached in the process: 64 of them take 1 MiB. Includes all
message types used here."""


_HEADER = ["int32", "uint32", "string"]
_POSE = ["float64"] * 7

EXPECTED = {
    "odometry": [*_HEADER, "string", *_POSE],
    "pose": [*_HEADER, *_POSE],
    "pose_covariance": [*_HEADER, *_POSE, "[", "float64", "]"],
    "pose_array": [*_HEADER, "[", *_POSE, "]"],
    "transforms": ["[", *_HEADER, "string", *_POSE, "]"],
    "laser_scan": [*_HEADER, *["float32"] * 7, "[", "float32", "]"],
}
"""Leading primitive fields of each kind of message with a columnar decoder."""


def as_expected(channel: Channel, kind: str) -> bool:
    """Whether the definition begins with the fields expected of the kind.

    True also for a log without definitions, or with one that cannot be read: the type's name is
    trusted then.
    """
    if not channel.schema:
        return True
    try:
        fielddefs = _checked_store(channel).fielddefs
    except DamageError:
        return True
    expected = list(EXPECTED[kind])
    if channel.encoding == "ros1":
        expected.insert(expected.index("int32"), "uint32")
    found = _primitives(fielddefs, channel.type_name)
    return all(next(found, None) == want for want in expected)


def _primitives(fielddefs: Any, type_name: str) -> Iterator[str]:
    """The primitive fields of a type in order, sequences in brackets."""
    waiting = [described for _, described in reversed(fielddefs[type_name][1])]
    while waiting:
        described = waiting.pop()
        if isinstance(described, str):
            yield described
        elif described[0].name == "NAME":
            waiting += [inner for _, inner in reversed(fielddefs[described[1]][1])]
        elif described[0].name == "BASE":
            yield described[1][0]
        else:
            waiting += ["]", described[1][0], "["]


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


class _Extent(NamedTuple):
    """parts: number of fields including nested ones; least: bytes of the shortest value."""

    parts: int
    least: int


def _check_extent(fielddefs: Any, type_name: str) -> None:
    """Reject a type that is incomplete, or of which few bytes could make many objects."""
    known: dict[str, _Extent | None] = {}

    def of_type(name: str, depth: int) -> _Extent:
        found = known.get(name)
        if found is not None:
            return found
        if name not in fielddefs:
            raise DamageError(f"the definition of {type_name} lacks {name[:100]}")
        if name in known or depth > DEPTH:
            raise DamageError(f"{type_name} is nested too deeply")
        known[name] = None
        parts = [of_field(described, depth) for _, described in fielddefs[name][1]]
        total = _Extent(1 + sum(p.parts for p in parts), sum(p.least for p in parts))
        if total.parts > PARTS:
            raise DamageError(f"{type_name} has more than {PARTS} fields")
        known[name] = total
        return total

    def of_field(described: Any, depth: int) -> _Extent:
        kind, content = described[0].name, described[1]
        if kind == "NAME":
            return of_type(content, depth + 1)
        if kind == "BASE":
            return _Extent(1, 4 if "string" in content[0] else 1)
        inner, count = content
        each = of_field(inner, depth)
        if each.least == 0:
            raise DamageError(f"{type_name} has an array of empty items")
        if kind == "SEQUENCE":
            return _Extent(1 + each.parts, 4)
        # A sequence of numbers is read as one array.
        numbers = inner[0].name == "BASE" and "string" not in inner[1][0]
        return _Extent(1 if numbers else 1 + count * each.parts, count * each.least)

    of_type(type_name, 0)
