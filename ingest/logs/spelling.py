"""Correction of names with one flipped bit, if only one known name is that close."""

from __future__ import annotations

from collections.abc import Collection
from functools import lru_cache
from typing import TypeVar

from .messages import Channel
from .topics import JUNCTION_KINDS, ODOMETRY_KINDS

TYPES = frozenset({*ODOMETRY_KINDS, *JUNCTION_KINDS})
ENCODINGS = frozenset({"cdr", "ros1", "json", "protobuf"})
SCHEMA_ENCODINGS = frozenset({"ros2msg", "ros2idl", "ros1msg", "protobuf", "jsonschema"})

Name = TypeVar("Name", str, bytes, int)


def one_bit_apart(name: Name, other: Name) -> bool:
    """Whether two names of the same length, or two numbers, differ in exactly one bit."""
    if isinstance(name, int) or isinstance(other, int):
        return isinstance(name, int) and isinstance(other, int) and (name ^ other).bit_count() == 1
    if len(name) != len(other):
        return False
    # A damaged byte of text is another character, or one that cannot be decoded.
    a, b = (n.encode("latin-1", "replace") if isinstance(n, str) else n for n in (name, other))
    wrong = [(x, y) for x, y in zip(a, b, strict=True) if x != y]
    if len(wrong) != 1:
        return False
    x, y = wrong[0]
    return (x ^ y).bit_count() == 1 or (isinstance(name, str) and x == ord("?"))


def nearest(name: Name, known: Collection[Name]) -> Name:
    """The only known name that is one bit away, or the name itself."""
    if name in known:
        return name
    found = [other for other in known if one_bit_apart(name, other)]
    return found[0] if len(found) == 1 else name


def spelled(channel: Channel) -> Channel:
    """The channel with its type and encodings corrected."""
    if channel.type_name in TYPES and channel.encoding in ENCODINGS:
        return channel
    names = _spelled(channel.type_name, channel.encoding, channel.schema_encoding)
    return channel._replace(type_name=names[0], encoding=names[1], schema_encoding=names[2])


@lru_cache(256)
def _spelled(type_name: str, encoding: str, schema_encoding: str) -> tuple[str, str, str]:
    return (
        nearest(type_name, TYPES),
        nearest(encoding, ENCODINGS),
        nearest(schema_encoding, SCHEMA_ENCODINGS),
    )
