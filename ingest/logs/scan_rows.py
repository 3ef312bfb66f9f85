"""Planar scans as they come out of messages, whatever the message's type and encoding."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np

from ...topology.arrays import Float32Array, IntArray
from .messages import Bytes, DamageError

MOST_BEAMS = 1 << 16
"""Longest scan that is believed: laser scanners have some hundreds or thousands of beams."""


class Geometry(NamedTuple):
    """What scans of one laser have in common.

    frame: name, without a leading slash; angle_min, angle_increment [rad]; time_increment: between
    two beams [s]; range_min, range_max [m]; angle_max: of the last beam, as told; pose: x, y, yaw
    of the scan in its frame; level: angles are already seen from above in the robot's orientation,
    so that of the frame only its place counts.
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

    message: (n,) number of the message within its batch; stamp_ns: (n,) header time; ranges_m: (n,
    m) float32, whatever the message holds; blind: beams without a range tell nothing, as in a slice
    of a cloud.
    """

    message: IntArray
    stamp_ns: IntArray
    ranges_m: Float32Array
    geometry: Geometry
    blind: bool = False


class ScanDecoder(Protocol):
    """Turns payloads into scans; what cannot be decoded is left out and counted in `failed`.

    reason: why the first of them could not be decoded.
    """

    failed: int
    reason: str

    def decode(self, data: Bytes, start: IntArray, size: IntArray) -> list[RawScans]:
        """The scans of the messages at `start` with `size` in `data`, by geometry."""


def checked_beams(count: int) -> int:
    """A number of beams; raises DamageError if no scan has so many."""
    if count > MOST_BEAMS:
        raise DamageError(f"a scan of {count} beams is implausible")
    return count


def in_order(parts: Sequence[RawScans]) -> list[RawScans]:
    """The same scans in the order of their messages: each part covers messages that follow on."""
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
