"""Junctions out of any message, by a mapping that names its fields.

    center=pose.position,branches=frontiers[].angle
    each=detections[],center=bbox.center.position,branches=results[].pose.pose.orientation
    center=data.at,branches=data.headings,unit=deg      (std_msgs/String that holds JSON)

`center` is a point or a pose (`length` m, cm, mm, in or ft); `branches` are angles (`unit` rad or
deg), quaternions, poses, or points (whose direction is seen from the centre). `each` names a list
of which every item is one junction; the other paths then begin at the item. `stamp` and `frame`
name a time and a frame, of the item or of the message, the header's by default. docs/detections.md
has an example of each.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, is_dataclass
from dataclasses import fields as members_of
from typing import Any, Literal, NamedTuple

import numpy as np

from ...topology.errors import UsageError
from .foxglove import LONGEST_LIST, as_text, get, load_json, object_reader, real, sequence, stamp_of
from .messages import Channel, DamageError
from .poses import Frames, Row, RowDecoder

_PATHS = ("center", "branches", "each", "stamp", "frame")

LENGTHS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254, "ft": 0.3048}
"""Units of lengths [m]."""

UNITS: Mapping[str, Mapping[str, Any]] = {"unit": {"rad": "rad", "deg": "deg"}, "length": LENGTHS}
"""What the keys of units may be."""

_WHOLE_TURN = 2 * np.pi * (1 + 1e-6)
"""Limit of headings in radians; in degrees few junctions stay below."""


class FieldPath(NamedTuple):
    """A path into a message, as given ("center=pose.position").

    steps: names of members from outside in, each with whether it is a list to iterate.
    """

    text: str
    steps: tuple[tuple[str, bool], ...]


@dataclass(frozen=True, slots=True)
class JunctionFields:
    """Where in a message a junction is; see the module's docstring.

    unit: of angles; None: taken for radians, and then refused beyond a whole turn; length_m: the
    unit of centres [m].
    """

    center: FieldPath
    branches: FieldPath
    each: FieldPath | None = None
    stamp: FieldPath | None = None
    frame: FieldPath | None = None
    unit: Literal["rad", "deg"] | None = None
    length_m: float = 1.0

    @classmethod
    def parse(cls, mapping: str) -> JunctionFields:
        """Parse a mapping given by a user; raises UsageError."""
        found: dict[str, Any] = {}
        for part in mapping.split(","):
            key, equals, value = (piece.strip() for piece in part.partition("="))
            key = "center" if key == "centre" else key
            name = "length_m" if key == "length" else key
            if not equals or key not in (*_PATHS, "unit", "length") or name in found:
                raise UsageError(
                    f"--junction-fields: {part.strip()!r} is not one of "
                    f"{', '.join(f'{k}=PATH' for k in _PATHS)}, unit=rad or unit=deg, and "
                    f"length={'|'.join(LENGTHS)}, each once"
                )
            found[name] = _one_of(key, value) if key in UNITS else _path(key, value)
        for key in ("center", "branches"):
            if key not in found:
                raise UsageError(f"--junction-fields {mapping!r} lacks {key}=PATH")
        return cls(**found)

    def rows(self, message: Any, frames: Frames) -> list[Row]:
        """One row per junction in a decoded message; raises DamageError, UsageError for units."""
        items = [message]
        if self.each is not None:
            with _naming(self.each):
                items = _values(message, self.each)
        return [self._row(item, message, frames) for item in items]

    def _row(self, item: Any, message: Any, frames: Frames) -> Row:
        with _naming(self.center):
            centers = [_point(value) for value in _values(item, self.center)]
            if not centers:
                raise DamageError("the list is empty")
        center = tuple(float(sum(axis)) / len(centers) for axis in zip(*centers, strict=True))
        with _naming(self.branches):
            ways = _values(item, self.branches)
            self._check_degrees(ways)
            turns = [self._orientation(value, center) for value in ways]
        poses = [(*(self.length_m * axis for axis in center), *turn) for turn in turns]
        headers = [h for h in (get(item, "header"), get(message, "header")) if h is not None]
        headers = headers or [message]
        # Items of a list often have headers that nobody filled in.
        stamp = next((time for time in map(stamp_of, headers) if time), 0)
        frame = next((name for h in headers if (name := as_text(get(h, "frame_id")))), "")
        if self.stamp is not None:
            with _naming(self.stamp):
                stamp = stamp_of({"stamp": _one(_holder(self.stamp, item, message), self.stamp)})
        if self.frame is not None:
            with _naming(self.frame):
                name = _one(_holder(self.frame, item, message), self.frame)
                if not isinstance(name, str):
                    raise DamageError("the name of a frame is no text")
                frame = as_text(name)
        return stamp, frames.number(frame), poses

    def _orientation(self, value: Any, center: tuple[float, ...]) -> tuple[float, ...]:
        """Quaternion (x, y, z, w) whose x axis points along a branch; raises DamageError."""
        turn = get(value, "orientation")
        turn = value if turn is None else turn
        if get(turn, "w") is not None:
            return tuple(real(get(turn, name)) for name in "xyzw")
        if get(turn, "x") is not None or get(turn, "position") is not None:
            return _towards(_point(turn, center[2]), center)
        if isinstance(value, dict) or is_dataclass(value):
            expected = "angles, quaternions, poses or points"
            raise DamageError(f"{_described(value)}; expected {expected}")
        return _about_z(self._angle(value))

    def _check_degrees(self, ways: list[Any]) -> None:
        """Raise UsageError if three branches or more lie within some degrees."""
        numbers = [way for way in ways if isinstance(way, int | float)]
        if self.unit == "deg" and len(numbers) > 2 and max(map(abs, numbers)) <= _WHOLE_TURN:
            raise UsageError(
                f"{self.branches.text}: {len(numbers)} branches within ± 2π degrees are hardly one "
                "junction; leave out unit=deg if these are radians"
            )

    def _angle(self, value: Any) -> float:
        """An angle [rad]; raises DamageError, UsageError if it is implausible."""
        angle = real(value)
        if self.unit == "deg":
            return float(np.deg2rad(angle))
        if self.unit is None and np.isfinite(angle) and abs(angle) > _WHOLE_TURN:
            raise UsageError(
                f"{self.branches.text}: a heading of {angle:g} is beyond ± 2π; add unit=deg to "
                "--junction-fields for degrees, or unit=rad if these are radians all the same"
            )
        return angle


def fields_decoder(channel: Channel, fields: JunctionFields, log: str) -> RowDecoder:
    """The decoder of a channel by such a mapping; raises DamageError if there is none.

    Decoding raises UsageError that names the log where headings are beyond any in radians.
    """
    decode = object_reader(channel)

    def rows(raw: bytes, frames: Frames) -> list[Row]:
        message = decode(raw)
        try:
            return fields.rows(message, frames)
        except UsageError as error:
            raise UsageError(f"{log}: {channel.topic}: {error}") from error

    return RowDecoder(rows)


def _one_of(key: str, value: str) -> Any:
    among = UNITS[key]
    if value not in among:
        known = ", ".join(f"{key}={name}" for name in among)
        raise UsageError(f"--junction-fields: {key}={value} is none of {known}")
    return among[value]


def _path(key: str, value: str) -> FieldPath:
    steps = []
    for name in value.split("."):
        bare = name.removesuffix("[]")
        if not bare.isidentifier() or bare.startswith("_"):
            raise UsageError(f"--junction-fields: {value!r} is no path like pose.position or a[].b")
        steps.append((bare, bare != name))
    return FieldPath(f"{key}={value}", tuple(steps))


@contextmanager
def _naming(path: FieldPath) -> Iterator[None]:
    """Add the path to DamageErrors."""
    try:
        yield
    except DamageError as error:
        raise DamageError(f"{path.text}: {error}") from error


def _values(message: Any, path: FieldPath) -> list[Any]:
    """The values that a path leads to: one, or as many as its lists hold; raises DamageError."""
    values = [message]
    for name, listed in path.steps:
        values = [_member(value, name) for value in values]
        if listed:
            values = [item for value in values for item in sequence(value)]
        if len(values) > LONGEST_LIST:
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
        raise DamageError(_described(value))
    return load_json(member) if isinstance(member, str) and member[:1] in ("{", "[") else member


def _described(value: Any) -> str:
    """What there is instead of what a path asks for."""
    if isinstance(value, list | tuple | np.ndarray):
        return "a list is met where [] does not say so"
    names = list(value) if isinstance(value, dict) else []
    owner = "the message"
    if is_dataclass(value):  # as rosbags makes them of definitions
        names = [member.name for member in members_of(value) if member.name[:1] != "_"]
        owner = str(getattr(value, "__msgtype__", owner)).replace("/msg/", "/")
    if not names:
        return "leads into a value without fields"
    more = f" and {len(names) - 12} more" if len(names) > 12 else ""
    return f"{owner} has {', '.join(as_text(name) for name in names[:12])}{more}"


def _holder(path: FieldPath, item: Any, message: Any) -> Any:
    """Where a time or a frame begins: at the item of a list, or else at the whole message."""
    return message if get(item, path.steps[0][0]) is None else item


def _one(message: Any, path: FieldPath) -> Any:
    """The single value that a path leads to; several that are equal count as one."""
    values = _values(message, path)
    if not values or any(value != values[0] for value in values):
        raise DamageError("is not a single value")
    return values[0]


def _point(value: Any, z: float = 0.0) -> tuple[float, float, float]:
    """x, y, z of a point, of a pose, or of anything else with a position; raises DamageError.

    z: of points in the plane.
    """
    inner = get(value, "position")
    value = value if inner is None else inner
    if get(value, "x") is None:
        raise DamageError(f"{_described(value)}; expected a point or a pose")
    height = get(value, "z")
    return real(get(value, "x")), real(get(value, "y")), z if height is None else real(height)


def _towards(point: tuple[float, ...], center: tuple[float, ...]) -> tuple[float, ...]:
    """Quaternion of the direction from a centre to a point; raises DamageError if there is none."""
    dx, dy, dz = (float(p - c) for p, c in zip(point, center, strict=True))
    level = float(np.hypot(dx, dy))
    if level == 0.0:
        raise DamageError("a branch points to its own centre")
    yaw, pitch = float(np.arctan2(dy, dx)), -float(np.arctan2(dz, level))
    _, _, sz, cz = _about_z(yaw)
    sp, cp = float(np.sin(pitch / 2)), float(np.cos(pitch / 2))
    return -sz * sp, cz * sp, sz * cp, cz * cp


def _about_z(yaw: float) -> tuple[float, ...]:
    """Quaternion of a heading, not a number of one that is infinite."""
    if np.isinf(yaw):
        yaw = np.nan
    return 0.0, 0.0, float(np.sin(yaw / 2)), float(np.cos(yaw / 2))
