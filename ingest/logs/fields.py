"""Junctions out of any message, by a mapping that names its fields.

    center=pose.position,branches=frontiers[].angle
    each=detections[],center=bbox.center.position,branches=results[].hypothesis.angle
    center=data.at,branches=data.headings          (std_msgs/String that holds JSON)

`center` is a point; `branches` are angles [rad], quaternions, poses, or points (whose direction is
seen from the centre). `each` names a list of which every item is one junction; the other paths
then begin at the item. `stamp` and `frame` name a time and a frame, the header's by default.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...topology.errors import UsageError
from ...topology.se2 import yaw_from_quaternion
from .foxglove import (
    POSES,
    RowDecoder,
    as_text,
    get,
    load_json,
    real,
    sequence,
    stamp_of,
)
from .messages import Channel, DamageError
from .poses import Frames, Row
from .schema import object_decoder

Path = tuple[tuple[str, bool], ...]
"""Names of members from outside in, each with whether it is a list to go through."""

_KEYS = ("center", "branches", "each", "stamp", "frame")


@dataclass(frozen=True, slots=True)
class JunctionFields:
    """Where in a message a junction is; see the module's text."""

    center: Path
    branches: Path
    each: Path = ()
    stamp: Path = ()
    frame: Path = ()

    @classmethod
    def parse(cls, mapping: str) -> JunctionFields:
        """Read a mapping as typed by a user; raises UsageError."""
        found: dict[str, Path] = {}
        for part in mapping.split(","):
            key, equals, value = (piece.strip() for piece in part.partition("="))
            key = "center" if key == "centre" else key
            if not equals or key not in _KEYS or key in found:
                raise UsageError(
                    f"--junction-fields: {part.strip()!r} is not one of "
                    f"{', '.join(f'{k}=PATH' for k in _KEYS)}, each once"
                )
            found[key] = _path(value)
        for key in ("center", "branches"):
            if key not in found:
                raise UsageError(f"--junction-fields {mapping!r} lacks {key}=PATH")
        return cls(**found)

    def rows(self, message: Any, frames: Frames) -> list[Row]:
        """One row per junction in a decoded message; raises DamageError."""
        items = _values(message, self.each) if self.each else [message]
        if self.each and not self.each[-1][1]:
            items = [item for listed in items for item in sequence(listed)]
        return [self._row(item, message, frames) for item in items]

    def _row(self, item: Any, message: Any, frames: Frames) -> Row:
        centers = [_point(value) for value in _values(item, self.center)]
        if not centers:
            raise DamageError("a junction has no centre")
        x, y = (float(sum(axis)) / len(centers) for axis in zip(*centers, strict=True))
        yaws = [_heading(value, x, y) for value in _values(item, self.branches)]
        header = get(item, "header") or get(message, "header") or message
        stamp_source = _one(item, self.stamp) if self.stamp else None
        stamp = stamp_of({"stamp": stamp_source} if self.stamp else header)
        frame = _one(item, self.frame) if self.frame else get(header, "frame_id")
        poses: list[tuple[float, ...]] = [
            (x, y, 0.0, 0.0, 0.0, float(np.sin(yaw / 2)), float(np.cos(yaw / 2))) for yaw in yaws
        ]
        return stamp, frames.number(as_text(frame)), poses


def fields_decoder(channel: Channel, fields: JunctionFields) -> RowDecoder:
    """The decoder of a channel by such a mapping; raises DamageError if there is none."""
    decode: Callable[[bytes], Any]
    if channel.encoding == "json":
        decode = load_json
    elif channel.encoding in ("cdr", "ros1"):
        decode = object_decoder(channel)
    else:
        raise DamageError(f"fields of {channel.encoding[:40]!r} messages cannot be named")
    return RowDecoder(lambda raw, frames: fields.rows(decode(raw), frames))


def _path(value: str) -> Path:
    names = []
    for name in value.split("."):
        bare = name.removesuffix("[]")
        if not bare.isidentifier() or bare.startswith("_"):
            raise UsageError(f"--junction-fields: {value!r} is no path like pose.position or a[].b")
        names.append((bare, bare != name))
    return tuple(names)


def _values(message: Any, path: Path) -> list[Any]:
    """The values that a path leads to: one, or as many as its lists hold; raises DamageError."""
    values = [message]
    for name, listed in path:
        values = [_member(value, name) for value in values]
        if listed:
            values = [item for value in values for item in sequence(value)]
        if len(values) > POSES:
            raise DamageError("implausibly many values")
    # A path that ends at a list means its items.
    last = [sequence(v) if isinstance(v, list | tuple | np.ndarray) else [v] for v in values]
    return [item for items in last for item in items]


def _member(value: Any, name: str) -> Any:
    """A member of a message, of a JSON object, or of JSON in a string; raises DamageError."""
    if isinstance(value, str):
        value = load_json(value)
    member = get(value, name)
    if member is None:
        raise DamageError(f"a message lacks the field {name!r}")
    return load_json(member) if isinstance(member, str) and member[:1] in ("{", "[") else member


def _one(message: Any, path: Path) -> Any:
    values = _values(message, path)
    if len(values) != 1:
        raise DamageError("a time or frame is not a single value")
    return values[0]


def _point(value: Any) -> tuple[float, float]:
    """x, y of a point, of a pose, or of anything else with a position; raises DamageError."""
    inner = get(value, "position")
    value = value if inner is None else inner
    return real(get(value, "x")), real(get(value, "y"))


def _heading(value: Any, x: float, y: float) -> float:
    """Heading [rad] of a branch; raises DamageError."""
    turn = get(value, "orientation")
    turn = value if turn is None else turn
    if get(turn, "w") is not None:
        q = [real(get(turn, name)) for name in "xyzw"]
        return float(yaw_from_quaternion(*q))
    if get(turn, "x") is not None:
        px, py = _point(turn)
        return float(np.arctan2(py - y, px - x))
    return real(value)
