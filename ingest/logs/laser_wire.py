"""Columnar decoding of sensor_msgs/LaserScan and MultiEchoLaserScan.

The layout of a LaserScan depends on its frame's name and its number of beams. Echoes have a
different one in every message: they are scanned beam by beam, for all messages together.
"""

from __future__ import annotations

from functools import partial
from typing import Literal, NamedTuple

import numpy as np

from ...topology.arrays import Float32Array, IntArray
from .columns import Shape
from .messages import Bytes
from .scan_rows import Geometry, RawScans, checked_beams, in_order
from .wire import TemplateDecoder, WireParser, stamps_ns

LaserKind = Literal["laser_scan", "multi_echo"]

ABOUT = ("angle_min", "angle_max", "angle_increment", "time_increment", "scan_time")
ABOUT_BYTES = 4 * (len(ABOUT) + 2)
"""The numbers about a scan: those, and range_min and range_max."""


class _Template(NamedTuple):
    """The layout of messages of one shape and size; see `wire.Template`.

    echoes: whether ranges are lists, the first of which begins at ranges_at.
    """

    width: int
    shape: Shape
    order: str
    ros1: bool
    frame: str
    stamp_at: int
    about_at: int
    ranges_at: int
    beams: int
    echoes: bool

    def scans(self, rows: Bytes, message: IntArray) -> list[RawScans]:
        """The scans of messages (rows) of this shape, but those whose echoes do not fit."""
        stamp_ns = stamps_ns(rows, self.stamp_at, self.order, self.ros1)
        about = _numbers(rows, self.about_at, ABOUT_BYTES // 4, f"{self.order}f4")
        if self.echoes:
            ranges, whole = _first_or_strongest(rows, self)
            message, stamp_ns = message[whole], stamp_ns[whole]
            about, ranges = about[whole], ranges[whole]
        else:
            ranges = _numbers(rows, self.ranges_at, self.beams, f"{self.order}f4")
        return [
            RawScans(message[which], stamp_ns[which], ranges[which], _geometry(self.frame, stated))
            for which, stated in _alike(about)
        ]


def _parsed(kind: LaserKind, ros1: bool, raw: bytes) -> _Template:
    """The template of one message; raises DamageError if it cannot be a message of this kind."""
    parser = WireParser(raw, ros1)
    stamp_at, frame = parser.header()
    parser.align(4)
    about_at = parser.advance(ABOUT_BYTES)
    beams = checked_beams(parser.count())
    ranges_at, shape = parser.position, parser.shape
    echoes = kind == "multi_echo"
    parser.advance(4 * (beams + echoes))
    return _Template(
        width=len(raw) if echoes else parser.position,
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


class LaserDecoder(TemplateDecoder[_Template, RawScans]):
    """Decodes laser scans in CDR or in ROS 1's encoding."""

    def __init__(self, kind: LaserKind, ros1: bool) -> None:
        super().__init__(partial(_parsed, kind, ros1), _Template.scans)

    def decode(self, data: Bytes, start: IntArray, size: IntArray) -> list[RawScans]:
        """The scans of a batch of messages."""
        before = self.failed
        parts = self.parts(data, start, size)
        parsed = len(start) - (self.failed - before)
        unfit = parsed - sum(len(part.message) for part in parts)
        if unfit:
            self.failed += unfit
            self.reason = self.reason or "its echoes do not fit into the message"
        return in_order(parts)


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
    rows: Bytes, t: _Template
) -> tuple[Float32Array, np.ndarray[tuple[int], np.dtype[np.bool_]]]:
    """(n, beams) one range per beam, NaN without echo; (n,) which messages are intact.

    The strongest echo if intensities are recorded (dust, rain and glass return little), else the
    first. Strategy: everything from the first echo on is 4 bytes wide, so a message is a row of
    words; a pointer per message advances from list to list, beam by beam.
    """
    count = (t.width - t.ranges_at) // 4
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
