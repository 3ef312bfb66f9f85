"""Fields of view: directions that lasers look in, by which two in one frame are told apart."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ...topology.arrays import BoolArray
from ..logs.scan_rows import Geometry, RawScans

SECTORS = 36
"""Number of directions, 10 degrees each: wider than the spacing of any scanner's beams."""

SAME_SHARE = 0.75
"""Least share of directions that two scans of one laser have in common: drivers add and drop some
beams at the ends of a sweep; two lasers of 270 degrees that look opposite ways share half."""

FURTHER = 3
"""Directions that a laser must add to what another one in its frame sees: filters of scans cut off
directions and add none; two are left for the rounding of both ends."""

MOST_LASERS = 64
"""Lasers of a topic that are told apart, to bound memory: further ones count as the last one."""


def directions(scans: RawScans) -> BoolArray:
    """(SECTORS,) directions of the frame that scans look in: of all beams or, in slices of a cloud,
    which have beams all around, of those with a return."""
    geometry, beams = scans.geometry, scans.ranges_m.shape[1]
    with np.errstate(invalid="ignore", over="ignore"):  # a message may hold any numbers
        angles = geometry.angle_min + geometry.angle_increment * np.arange(beams) + geometry.pose[2]
    if scans.blind:
        angles = angles[np.isfinite(scans.ranges_m).any(axis=0)]
    out = np.zeros(SECTORS, np.bool_)
    angles = angles[np.abs(angles) < 1e6]  # others are no angles
    out[np.floor(angles / (2 * np.pi) * SECTORS).astype(np.int64) % SECTORS] = True
    return out


def adds(view: BoolArray, other: BoolArray | None) -> bool:
    """Whether a view shows directions that another one in its frame (None: there is none) does
    not."""
    return other is None or int((view & ~other).sum()) >= FURTHER


@dataclass(slots=True)
class LaserNumbers:
    """Numbers of the lasers in one topic: by frame and, if several share a frame, by view."""

    _views: dict[str, list[tuple[int, BoolArray]]] = field(default_factory=dict)
    _last: tuple[Geometry, int] | None = None
    _next: int = 0

    def of(self, scans: RawScans) -> int:
        """The number of the laser of these scans, from 0 on in order of appearance."""
        if self._last is not None and self._last[0] == scans.geometry:
            return self._last[1]
        own = self._views.setdefault(scans.geometry.frame, [])
        view = directions(scans)
        number = next((n for n, other in own if scans.blind or _same(view, other)), None)
        if number is None:
            number = self._next
            self._next = min(self._next + 1, MOST_LASERS - 1)
            own.append((number, view))
        self._last = scans.geometry, number
        return number


def _same(view: BoolArray, other: BoolArray) -> bool:
    return int((view & other).sum()) >= SAME_SHARE * int((view | other).sum())
