"""Planar scans decoded from messages, independent of type and encoding."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np

from ...topology.arrays import Float32Array, IntArray
from .messages import Bytes, DamageError

MOST_BEAMS = 1 << 16
"""Largest number of beams; laser scanners have hundreds or thousands."""


class Geometry(NamedTuple):
    """Common parameters of a laser's scans.

    frame: name without a leading slash; angle_min, angle_increment [rad]; time_increment: between
    two beams [s]; range_min, range_max [m]; angle_max: of the last beam, as stated; pose: x, y, yaw
    of the scan in its frame; level: angles are in the robot's orientation, seen from above, so that
    only the frame's position is used.
    """

    frame: str
    angle_min: float
    angle_increment: float
    time_increment: float = 0.0
    range_min: float = 0.0
    range_max: float = float("inf")
    angle_max: float = float("nan")
    pose: tuple[float, float, float] = (0.0, 0.0, 0.0)
    level: bool = False


class RawScans(NamedTuple):
    """Scans of one geometry and number of beams, as recorded.

    message: (n,) index of the message in its batch; stamp_ns: (n,) header time; ranges_m: (n, m)
    float32 as in the message; blind: beams without a range give no information, as in a slice of a
    cloud.
    """

    message: IntArray
    stamp_ns: IntArray
    ranges_m: Float32Array
    geometry: Geometry
    blind: bool = False


def one_scan(stamp_ns: int, ranges_m: Float32Array, geometry: Geometry) -> RawScans:
    """One scan of ranges (m,)."""
    return RawScans(np.zeros(1, np.int64), np.array([stamp_ns], np.int64), ranges_m[None], geometry)


class ScanDecoder(Protocol):
    """Turns payloads into scans; failures are left out and counted in `failed`.

    reason: why the first of them failed.
    """

    failed: int
    reason: str

    def decode(self, data: Bytes, start: IntArray, size: IntArray) -> list[RawScans]:
        """The scans of the messages at `start` with `size` in `data`, by geometry."""


def checked_beams(count: int) -> int:
    """The number of beams; raises DamageError if it is not plausible."""
    if count > MOST_BEAMS:
        raise DamageError(f"a scan of {count} beams is implausible")
    return count


def in_order(parts: Sequence[RawScans]) -> list[RawScans]:
    """The scans in the order of their messages, in parts of consecutive messages."""
    whole = [part for part in parts if len(part.message)]
    if len(whole) < 2:
        return whole
    message = np.concatenate([part.message for part in whole])
    owner = np.repeat(np.arange(len(whole)), [len(part.message) for part in whole])
    row = np.concatenate([np.arange(len(part.message)) for part in whole])
    order = np.argsort(message, kind="stable")
    cuts = np.flatnonzero(np.diff(owner[order])) + 1
    pieces = np.split(order, cuts)
    return [_rows(whole[int(owner[piece[0]])], row[piece]) for piece in pieces]


def _rows(scans: RawScans, which: IntArray) -> RawScans:
    return scans._replace(
        message=scans.message[which],
        stamp_ns=scans.stamp_ns[which],
        ranges_m=scans.ranges_m[which],
    )
