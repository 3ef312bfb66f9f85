"""Clouds of points sliced at a band of heights, as if a laser had scanned there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...topology.arrays import FloatArray
from ...topology.errors import UsageError
from ..frames import NOWHERE_ELSE
from ..logs.clouds import Cloud
from ..logs.scan_rows import Geometry, RawScans

FARTHEST_M = 1000.0
"""Ranges beyond that are broken numbers: the longest scanners measure some hundred metres."""

BEAMS = 360
"""Directions of a slice, 1 degree each: as coarse as the beams of the laser scanners in use."""

WIDEST = 6
"""Directions of a sparse cloud are up to so many degrees wide: points of a wall 3 m away are then
as far apart as a line in it is long (`SurfaceSettings.reach_m`)."""

IN_A_ROW = 0.8
"""Share of directions next to which something is seen, too: of five in a row, which make a line
(`SurfaceSettings.least_beams`), four have a next one."""

PIECE = 1 << 18
"""So many points are looked at together: memory for more is not needed."""

OPTICAL = np.array([0.0, 0.0, 0.0, -0.5, 0.5, -0.5, 0.5])
"""A camera looks along z with y downwards: its frame, in one that looks along x with z upwards."""


@dataclass(frozen=True, slots=True)
class SliceSettings:
    """Which points of a cloud are walls.

    band_m: lowest and highest z in the robot's frame; None: `half_m` below and above the sensor,
    but not the floor, for which everything below floor_m above the robot's origin is taken, if the
    sensor is higher. nearest_m: what is nearer is the robot itself.
    """

    band_m: tuple[float, float] | None = None
    half_m: float = 0.2
    floor_m: float = 0.1
    nearest_m: float = 0.3

    def __post_init__(self) -> None:
        if self.band_m is not None and not self.band_m[0] < self.band_m[1]:
            raise UsageError(f"--cloud-band: heights must come lowest first, not {self.band_m}")

    def band(self, sensor_z_m: float) -> tuple[float, float]:
        """Lowest and highest z for a sensor at a height."""
        if self.band_m is not None:
            return self.band_m
        low, high = sensor_z_m - self.half_m, sensor_z_m + self.half_m
        return (max(low, self.floor_m) if sensor_z_m > self.floor_m else low), high


DEFAULT_SLICES = SliceSettings()


def mount_of_camera(frame: str) -> FloatArray:
    """(7,) how a sensor looks whose mounting nobody knows: ahead, if it is a camera's."""
    optical = frame.endswith("optical_frame")
    return OPTICAL.copy() if optical else np.array(NOWHERE_ELSE)


def sliced(cloud: Cloud, T_body_sensor: FloatArray, settings: SliceSettings) -> RawScans:
    """The nearest point of the band in each of BEAMS directions, seen from the sensor.

    T_body_sensor: (7,) pose of the cloud's frame. Directions in which nothing is seen tell nothing.
    Where the points stand farther apart, there are fewer, wider directions. O(points).
    """
    from scipy.spatial.transform import Rotation

    ranges = np.full(BEAMS, np.inf)
    level, place = Rotation.from_quat(T_body_sensor[3:]), T_body_sensor[:3]
    low, high = settings.band(float(place[2]))
    for first in range(0, len(cloud.xyz), PIECE):
        xyz = cloud.xyz[first : first + PIECE]
        xyz = level.apply(xyz[(np.abs(xyz) < FARTHEST_M).all(axis=1)])
        height = xyz[:, 2] + place[2]
        x, y = xyz[(height >= low) & (height <= high), :2].T
        way = np.hypot(x, y)
        far = way >= settings.nearest_m
        turn = np.arctan2(y[far], x[far])
        beam = np.floor((turn + np.pi) / (2 * np.pi) * BEAMS).astype(np.int64) % BEAMS
        np.minimum.at(ranges, beam, way[far])
    ranges = _in_a_row(ranges)
    ranges[np.isinf(ranges)] = np.nan
    step = 2 * np.pi / len(ranges)
    geometry = Geometry(cloud.frame, -np.pi + step / 2, step, level=True)
    return RawScans(
        np.zeros(1, np.int64),
        np.array([cloud.stamp_ns], np.int64),
        ranges[None].astype(np.float32),
        geometry,
        blind=True,
    )


def _in_a_row(ranges: FloatArray) -> FloatArray:
    """The nearest ranges of directions as wide as it takes for neighbours to see something, too;
    (BEAMS,) as they are where no width does that. ranges: inf where nothing is seen."""
    for degrees in range(1, WIDEST + 1):
        wider = ranges.reshape(-1, degrees).min(axis=1)
        seen = np.isfinite(wider)
        if (seen & np.roll(seen, -1)).sum() >= IN_A_ROW * seen.sum():
            return np.asarray(wider)
    return ranges
