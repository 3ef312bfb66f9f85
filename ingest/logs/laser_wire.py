"""Columnar decoding of sensor_msgs/LaserScan and MultiEchoLaserScan, in CDR and ROS 1's encoding.

The layout of a LaserScan depends only on its frame's name and its number of beams: one message is
parsed, and all messages of the same size with the same bytes there are decoded at once. Echoes have
a different layout in every message: they are scanned beam by beam, for all messages together.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np

from ...topology.arrays import Float32Array, IntArray
from .columns import Shape, column, gather
from .messages import Bytes, DamageError
from .scan_rows import Geometry, RawScans, checked_beams, in_order
from .wire import TEMPLATES, WireParser

LaserKind = Literal["laser_scan", "multi_echo"]

ABOUT = ("angle_min", "angle_max", "angle_increment", "time_increment", "scan_time")
ABOUT_BYTES = 4 * (len(ABOUT) + 2)
"""The numbers about a scan: those, and range_min and range_max."""


class _Template(NamedTuple):
    """The layout of messages of one shape; see `wire.Template`.

    echoes: whether ranges are lists, the first of which begins at ranges_at.
    """

    size: int
    shape: Shape
    order: str
    ros1: bool
    frame: str
    stamp_at: int
    about_at: int
    ranges_at: int
    beams: int
    echoes: bool


def _parse(kind: LaserKind, raw: bytes, ros1: bool) -> _Template:
    """The template of one message; raises DamageError if it cannot be a message of this kind."""
    parser = WireParser(raw, ros1)
    stamp_at, frame = parser.header()
    parser.align(4)
    about_at = parser.advance(ABOUT_BYTES)
    beams = checked_beams(parser.count())
    ranges_at = parser.position
    echoes = kind == "multi_echo"
    if not echoes:
        parser.advance(4 * beams)
    elif parser.position + 4 * (beams + 1) > len(raw):
        raise DamageError("a message ends too early")
    shape = Shape.of(np.frombuffer(raw, np.uint8, parser.position), tuple(parser.fixed))
    return _Template(
        size=parser.position,
        shape=shape,
        order=parser.order,
        ros1=ros1,
        frame=frame.lstrip("/"),
        stamp_at=stamp_at,
        about_at=about_at,
        ranges_at=ranges_at,
        beams=beams,
        echoes=echoes,
    )


class LaserDecoder:
    """Decodes laser scans in CDR or in ROS 1's encoding."""

    def __init__(self, kind: LaserKind, ros1: bool) -> None:
        self._kind: LaserKind = kind
        self._ros1 = ros1
        self.failed = 0
        self.reason = ""
        self._templates: dict[int, list[_Template]] = {}

    def decode(self, data: Bytes, start: IntArray, size: IntArray) -> list[RawScans]:
        """The scans of a batch of messages. O(bytes) when shapes are few."""
        message = np.arange(len(start))
        order = np.argsort(size, kind="stable")
        cuts = np.flatnonzero(np.diff(size[order])) + 1
        parts: list[RawScans] = []
        for group in np.split(order, cuts) if len(order) else []:
            parts += self._same_size(data, start[group], int(size[group[0]]), message[group])
        return in_order(parts)

    def _same_size(
        self, data: Bytes, start: IntArray, size: int, message: IntArray
    ) -> list[RawScans]:
        known = self._templates.setdefault(size, [])
        parts: list[RawScans] = []
        for template in known:
            start, message, found = self._fitting(data, start, size, message, template)
            parts += found
        while len(start):
            raw = data[start[0] : start[0] + size].tobytes()
            try:
                template = _parse(self._kind, raw, self._ros1)
            except DamageError as damage:
                self._refuse(1, str(damage))
                start, message = start[1:], message[1:]
                continue
            if len(known) < TEMPLATES:
                known.append(template)
                start, message, found = self._fitting(data, start, size, message, template)
            else:
                _, _, found = self._fitting(data, start[:1], size, message[:1], template)
                start, message = start[1:], message[1:]
            parts += found
        if len(self._templates) > TEMPLATES * TEMPLATES:
            self._templates.clear()
        return parts

    def _fitting(
        self, data: Bytes, start: IntArray, size: int, message: IntArray, template: _Template
    ) -> tuple[IntArray, IntArray, list[RawScans]]:
        """The messages of another shape than the template's, and the scans of the others."""
        if len(start) == 0:
            return start, message, []
        rows = gather(data, start, size if template.echoes else template.size)
        other = template.shape.misfits(rows)
        fits = np.ones(len(start), bool) if other is None else ~other
        if not fits.any():
            return start, message, []
        return start[~fits], message[~fits], self._scans(rows[fits], size, message[fits], template)

    def _scans(self, rows: Bytes, size: int, message: IntArray, t: _Template) -> list[RawScans]:
        seconds = column(rows, f"{t.order}{'u4' if t.ros1 else 'i4'}", t.stamp_at)
        stamp_ns = seconds * 10**9 + column(rows, f"{t.order}u4", t.stamp_at + 4)
        about = _numbers(rows, t.about_at, ABOUT_BYTES // 4, f"{t.order}f4")
        if t.echoes:
            ranges, whole = _first_or_strongest(rows, size, t)
            self._refuse(int((~whole).sum()), "its echoes do not fit into the message")
            message, stamp_ns = message[whole], stamp_ns[whole]
            about, ranges = about[whole], ranges[whole]
        else:
            ranges = _numbers(rows, t.ranges_at, t.beams, f"{t.order}f4")
        return [
            RawScans(message[which], stamp_ns[which], ranges[which], _geometry(t.frame, told))
            for which, told in _alike(about)
        ]

    def _refuse(self, count: int, reason: str) -> None:
        self.failed += count
        if count and not self.reason:
            self.reason = reason


def _numbers(rows: Bytes, at: int, count: int, kind: str) -> Float32Array:
    """(n, count) numbers of 4 bytes from one place of every row on."""
    span = np.ascontiguousarray(rows[:, at : at + 4 * count])
    return span.view(kind).astype(kind[1:], copy=False).reshape(len(rows), count)


def _alike(about: Float32Array) -> list[tuple[IntArray, list[float]]]:
    """Rows grouped by equal values, with these: in nearly every log all of them."""
    bits = np.ascontiguousarray(about).view(np.uint32)
    if (bits == bits[:1]).all():
        return [(np.arange(len(about)), about[0].tolist())] if len(about) else []
    _, first, group = np.unique(bits, axis=0, return_index=True, return_inverse=True)
    return [
        (np.flatnonzero(group.ravel() == k), about[row].tolist())
        for k, row in enumerate(first.tolist())
    ]


def _geometry(frame: str, about: list[float]) -> Geometry:
    angle_min, angle_max, angle_increment, time_increment, _, range_min, range_max = about
    return Geometry(
        frame, angle_min, angle_increment, time_increment, range_min, range_max, angle_max
    )


def _first_or_strongest(
    rows: Bytes, size: int, t: _Template
) -> tuple[Float32Array, np.ndarray[tuple[int], np.dtype[np.bool_]]]:
    """(n, beams) one range per beam, NaN without echo; (n,) which messages are intact.

    The strongest echo if intensities are recorded (dust, rain and glass return little), else the
    first. Strategy: everything from the first echo on is 4 bytes wide, so a message is a row of
    words; a pointer per message advances from list to list, beam by beam.
    """
    count = (size - t.ranges_at) // 4
    words = _numbers(rows, t.ranges_at, count, f"{t.order}u4").astype(np.int64)
    values = _numbers(rows, t.ranges_at, count, f"{t.order}f4")
    begin, length, at, whole = _lists(words, np.zeros(len(rows), np.int64), t.beams)
    row = np.arange(len(rows))
    told = np.where(at < count, words[row, np.minimum(at, count - 1)], 0)
    strong, strength, _, complete = _lists(words, at + 1, t.beams)
    graded = (whole & complete & (told == t.beams))[:, None] & (strength == length)
    ranges = np.full((len(rows), t.beams), np.nan, np.float32)
    best = np.full((len(rows), t.beams), -np.inf, np.float32)
    for echo in range(int(length[whole].max(initial=0))):
        there = whole[:, None] & (length > echo)
        value = values[row[:, None], np.minimum(begin + echo, count - 1)]
        power = values[row[:, None], np.minimum(strong + echo, count - 1)]
        better = there & ((echo == 0) | (graded & (power > best)))
        ranges[better] = value[better]
        best = np.where(better & graded, power, best)
    return ranges, whole


MOST_ECHOES = 16
"""Largest number of echoes of one beam; scanners report at most three."""


def _lists(
    words: IntArray, at: IntArray, count: int
) -> tuple[IntArray, IntArray, IntArray, np.ndarray[tuple[int], np.dtype[np.bool_]]]:
    """Where each of `count` lists begins, how long it is, where they end, whether all fit.

    words: (n, k); at: (n,) word at which the first list's length stands. Begins and lengths: (n,
    count).
    """
    rows, width = np.arange(len(words)), words.shape[1]
    begin, length = np.zeros((2, len(words), count), np.int64)
    whole = np.ones(len(words), bool)
    for beam in range(count):
        whole &= at < width
        echoes = words[rows, np.minimum(at, width - 1)]
        whole &= echoes <= MOST_ECHOES
        begin[:, beam], length[:, beam] = at + 1, np.where(whole, echoes, 0)
        at = at + 1 + length[:, beam]
    return begin, length, at, whole & (at <= width)
