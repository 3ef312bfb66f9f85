"""Validation of a field mapping's paths by the definition of the messages."""

from __future__ import annotations

from collections.abc import Mapping

from ...topology.errors import UsageError
from .fields import FieldPath, JunctionFields, listed
from .messages import Channel, DamageError
from .schema import Member, members

Types = Mapping[str, Mapping[str, Member]]

_NUMBER = ("float", "int", "uint", "byte", "char")
_TEXT = ("string", "wstring")
_POINT = {"x", "position"}

_EXPECTED = {
    "center": "a point or a pose",
    "branches": "angles, quaternions, poses or points",
    "stamp": "a time",
    "frame": "the name of a frame",
    "each": "a list of messages",
}


def check_fields(channel: Channel, fields: JunctionFields, log: str) -> bool:
    """Follow every path through the log's definition of a channel's messages.

    Raises UsageError that names the first path that does not exist, and the alternatives. False if
    only the messages themselves can show: there is no definition, or a path leads into JSON in a
    string.
    """
    if channel.encoding not in ("cdr", "ros1"):
        return False
    try:
        types = members(channel)
    except DamageError:
        return False
    try:
        begin: str | None = channel.type_name
        if fields.each is not None:
            begin = _end(types, begin, fields.each)
        if begin is None:
            return False
        ends = [_end(types, begin, path) for path in (fields.center, fields.branches)]
        for path in fields.times_and_frames:
            own = path.steps[0][0] in types.get(begin, ())
            ends.append(_end(types, begin if own else channel.type_name, path))
    except UsageError as error:
        raise UsageError(f"{log}: {channel.topic}: --junction-fields: {error}") from error
    return all(end is not None for end in ends)


def _end(types: Types, begin: str | None, path: FieldPath) -> str | None:
    """The type that a path leads to, None if it is unknown."""
    here, many = begin, False
    for number, (name, through) in enumerate(path.steps):
        if here in _TEXT:
            return None
        fields = types.get(here or "")
        if fields is None or name not in fields:
            has = f"has {listed(list(fields))}" if fields else "has no fields"
            raise UsageError(f"`{path.text}`: {_spoken(here)} {has}")
        here, many = fields[name]
        if through and not many and here not in _TEXT:
            raise UsageError(f"`{path.text}`: {name} is no list; leave out its []")
        if many and not through and number + 1 < len(path.steps):
            raise UsageError(f"`{path.text}`: {name} is a list; write {name}[]")
    if here in _TEXT and path.text.partition("=")[0] != "frame":
        return None  # JSON, perhaps
    _check_end(types, here or "", path)
    return here


def _check_end(types: Types, end: str, path: FieldPath) -> None:
    """Raise UsageError if values of this type cannot serve the purpose of the path."""
    key = path.text.partition("=")[0]
    names = set(types.get(end, ()))
    serves = {
        "center": bool(names & _POINT),
        "branches": bool(names & (_POINT | {"orientation", "w"})) or end.startswith(_NUMBER),
        "stamp": {"sec", "nanosec"} <= names or end.startswith(_NUMBER),
        "frame": end in _TEXT,
        "each": bool(names),
    }[key]
    if not serves:
        has = f" with {listed(sorted(names))}" if names else ""
        raise UsageError(f"`{path.text}`: is {_spoken(end)}{has}; expected {_EXPECTED[key]}")


def _spoken(type_name: str | None) -> str:
    """`geometry_msgs/msg/Pose` as people write it."""
    return (type_name or "").replace("/msg/", "/")
