"""Message definitions in logs: checking layouts, and decoding messages of any type."""

from __future__ import annotations

import itertools
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

_TIME = ["int32", "uint32"]
_HEADER = [*_TIME, "string"]
_POSE = ["float64"] * 7
_LASER = ["float32"] * 7
_ECHOES = ["[", "[", "float32", "]", "]"]

_SHORT = {"Header": "std_msgs/Header", "time": "time", "duration": "duration"}
_PRIMITIVE = frozenset(
    f"{name}{bits}"
    for name, sizes in (("int", (8, 16, 32, 64)), ("uint", (8, 16, 32, 64)), ("float", (32, 64)))
    for bits in sizes
) | {"bool", "byte", "char", "string", "wstring"}

EXPECTED = {
    "odometry": [*_HEADER, "string", *_POSE],
    "pose": [*_HEADER, *_POSE],
    "pose_covariance": [*_HEADER, *_POSE, "[", "float64", "]"],
    "pose_array": [*_HEADER, "[", *_POSE, "]"],
    "transforms": ["[", *_HEADER, "string", *_POSE, "]"],
    "foxglove_pose": [*_HEADER, *_POSE],
    "foxglove_poses": [*_HEADER, "[", *_POSE, "]"],
    "laser_scan": [*_HEADER, *_LASER, "[", "float32", "]"],
    "multi_echo": [*_HEADER, *_LASER, *_ECHOES, *_ECHOES],
    "cloud": [
        *(*_HEADER, "uint32", "uint32", "[", "string", "uint32", "uint8", "uint32", "]"),
        *("bool", "uint32", "uint32", "[", "uint8", "]"),
    ],
    "grid": [*_HEADER, *_TIME, "float32", "uint32", "uint32", *_POSE, "[", "int8", "]"],
}
"""Leading primitive fields of each kind of message with a columnar decoder."""


class UnreadableError(DamageError):
    """A definition that cannot be parsed."""


def as_expected(channel: Channel, kind: str) -> bool:
    """Whether the definition begins with the fields expected of the kind.

    True also for a log without definitions, or with one that cannot be read: the type's name is
    trusted then. Definitions other than `.msg` text that can be read give False, so that the
    general decoder is used.
    """
    if not channel.schema:
        return True
    if channel.schema_encoding in ("ros2msg", "ros1msg"):
        short = len(channel.schema) <= REMEMBERED_BYTES
        begins = _begins_with if short else _begins_with.__wrapped__
        if begins(channel.schema, kind, channel.encoding == "ros1"):
            return True
    try:
        object_decoder(channel)
    except UnreadableError:
        return True
    except DamageError:
        pass
    return False


@lru_cache(64)
def _begins_with(schema: bytes, kind: str, ros1: bool) -> bool:
    expected = list(EXPECTED[kind])
    if ros1 and not kind.startswith("foxglove"):
        expected.insert(expected.index("int32"), "uint32")
    sections = _sections(schema.decode("utf-8", "replace"))
    found = _primitives(sections, "", 0, itertools.count())
    try:
        return all(next(found, None) == want for want in expected)
    except DamageError:
        return False


def _sections(definition: str) -> dict[str, list[tuple[str, str]]]:
    """Fields (type, name) of the main type, under "", and of every type that it uses."""
    sections: dict[str, list[tuple[str, str]]] = {"": []}
    current = sections[""]
    for line in definition.splitlines():
        words = line.split("#", 1)[0].split()
        if line.startswith("=====") or not words:
            continue
        if words[0] == "MSG:" and len(words) > 1:
            current = sections.setdefault(_short(words[1]), [])
        elif len(words) > 1 and "=" not in words[1] and (len(words) < 3 or words[2][:1] != "="):
            current.append((words[0], words[1]))
    return sections


def _short(name: str) -> str:
    parts = name.split("/")
    return f"{parts[0]}/{parts[-1]}"


def _primitives(
    sections: dict[str, list[tuple[str, str]]], name: str, depth: int, steps: Iterator[int]
) -> Iterator[str]:
    """The primitive fields of a type in order, sequences in brackets; raises DamageError."""
    if depth > DEPTH or name not in sections or next(steps) > PARTS:
        raise DamageError("a definition is missing or nested too deeply")
    for type_name, _ in sections[name]:
        bare, bracket, _ = type_name.partition("[")
        if bracket:
            yield "["
        yield from _primitives_of(sections, bare, name, depth, steps)
        if bracket:
            yield "]"


def _primitives_of(
    sections: dict[str, list[tuple[str, str]]],
    bare: str,
    outer: str,
    depth: int,
    steps: Iterator[int],
) -> Iterator[str]:
    if bare.split("<", maxsplit=1)[0] in _PRIMITIVE:
        yield bare.split("<", maxsplit=1)[0]
    elif bare in ("time", "duration") or _short(bare) in (
        "builtin_interfaces/Time",
        "builtin_interfaces/Duration",
    ):
        yield from _TIME
    else:
        yield from _primitives(sections, _resolve(sections, bare, outer), depth + 1, steps)


def _resolve(sections: dict[str, list[tuple[str, str]]], bare: str, outer: str) -> str:
    """Full name of a type used in `outer`, where the package may be omitted."""
    if "/" in bare:
        return _short(bare)
    if bare in _SHORT:
        return _SHORT[bare]
    package = outer.split("/", maxsplit=1)[0]
    if f"{package}/{bare}" in sections:
        return f"{package}/{bare}"
    named = [name for name in sections if name.endswith(f"/{bare}")]
    return named[0] if len(named) == 1 else bare


def object_decoder(channel: Channel) -> Callable[[bytes], Any]:
    """A function from payload to message object, by the embedded definition.

    Without a usable definition those bundled with rosbags are used. Raises DamageError if there is
    none; the function raises DamageError for a payload that cannot be decoded.
    """
    ros1 = channel.encoding == "ros1"
    store = _store(channel)
    if channel.type_name not in store.types:
        raise DamageError(f"no definition of {channel.type_name} is known")
    _check_extent(store.fielddefs, channel.type_name)
    read = store.deserialize_ros1 if ros1 else store.deserialize_cdr

    def decode(raw: bytes) -> Any:
        try:
            return read(raw, channel.type_name)
        # The generated code raises numpy's and struct's exceptions on invalid data.
        except Exception as error:
            raise DamageError(f"a message does not decode ({type(error).__name__})") from error

    return decode


def _store(channel: Channel) -> Any:
    """rosbags' typestore with the embedded definition, or with ROS's own without one."""
    from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

    if not channel.schema:
        ros1 = channel.encoding == "ros1"
        return get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_JAZZY)
    definition = channel.schema.decode("utf-8", "replace")
    _check_length(definition)
    store = get_typestore(Stores.EMPTY)
    try:
        if channel.schema_encoding == "ros2idl":
            store.register(get_types_from_idl(_BESIDE_IDL.sub("", definition)))
        else:
            store.register(get_types_from_msg(definition, channel.type_name))
    # The parser raises its own and Python's exceptions on invalid text.
    except (Exception, RecursionError) as error:
        raise UnreadableError(f"the definition of {channel.type_name} cannot be read") from error
    return store


def _check_length(definition: str) -> None:
    """Reject definitions that are far larger than real ones before parsing."""
    if definition.count("\n") > LINES:
        raise DamageError("a message definition is implausibly long")


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
            raise UnreadableError(f"the definition of {type_name} lacks {name[:100]}")
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
