"""Point clouds sliced at a band of heights, as virtual laser scans."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...topology.arrays import FloatArray
from ...topology.errors import UsageError
from ..frames import NOWHERE_ELSE
from ..logs.clouds import Cloud
from ..logs.lasers import Geometry, RawScans, one_scan
from .surfaces import MOST_POINTS, SURFACES

FARTHEST_M = 1000.0
"""Larger ranges are invalid: the longest scanners measure some hundred metres."""

BEAMS = 360
"""Number of directions of a slice, 1 degree each, as for common laser scanners."""

WIDEST = 6
"""Largest width of the directions of a sparse cloud [degrees]: points on a wall 3 m away are then
as far apart as a fitted line is long (`SurfaceSettings.reach_m`)."""

IN_A_ROW = 0.8
"""Least share of directions with a return that have one in the next direction as well: of five in a
row, which make a line (`SurfaceSettings.least_beams`), four do."""


OPTICAL = np.array([0.0, 0.0, 0.0, -0.5, 0.5, -0.5, 0.5])
"""Rotation of a camera's optical frame (z ahead, y down) to one with x ahead and z up."""


@dataclass(frozen=True, slots=True)
class SliceSettings:
    """Which points of a cloud are walls.

    band_m: lowest and highest z in the robot's frame; None: `half_m` below and above the sensor,
    but without the floor: everything below floor_m above the robot's origin, if the sensor is
    higher. nearest_m: nearer points are the robot itself.
    """

    band_m: tuple[float, float] | None = None
    half_m: float = 0.2
    floor_m: float = 0.1
    nearest_m: float = 0.3

    def __post_init__(self) -> None:
        band = self.band_m
        if band is not None and (np.shape(band) != (2,) or not band[0] < band[1]):
            raise UsageError(f"--cloud-band: heights must come lowest first, not {band}")

    def band(self, sensor_z_m: float) -> tuple[float, float]:
        """Lowest and highest z for a sensor at the given height."""
        if self.band_m is not None:
            return self.band_m
        low, high = sensor_z_m - self.half_m, sensor_z_m + self.half_m
        return (max(low, self.floor_m) if sensor_z_m > self.floor_m else low), high


DEFAULT_SLICES = SliceSettings()


def mount_of_camera(frame: str) -> FloatArray:
    """(7,) assumed pose of a sensor of unknown mounting: looking ahead if it is a camera."""
    return OPTICAL if frame.endswith("optical_frame") else NOWHERE_ELSE


def sliced(cloud: Cloud, T_body_sensor: FloatArray, settings: SliceSettings) -> RawScans:
    """The nearest point of the band in each of BEAMS directions, seen from the sensor.

    T_body_sensor: (7,) pose of the cloud's frame. Directions without points are unknown. For sparse
    clouds there are fewer, wider directions. O(points).
    """
    from scipy.spatial.transform import Rotation

    ranges, turns = np.full(BEAMS, np.inf), np.zeros(BEAMS)
    level, place = Rotation.from_quat(T_body_sensor[3:]), T_body_sensor[:3]
    low, high = settings.band(float(place[2]))
    for first in range(0, len(cloud.xyz), MOST_POINTS):
        xyz = cloud.xyz[first : first + MOST_POINTS]
        xyz = level.apply(xyz[(np.abs(xyz) < FARTHEST_M).all(axis=1)])
        height = xyz[:, 2] + place[2]
        x, y = xyz[(height >= low) & (height <= high), :2].T
        way = np.hypot(x, y)
        far = way >= settings.nearest_m
        turn = np.arctan2(y[far], x[far])
        beam = np.floor((turn + np.pi) / (2 * np.pi) * BEAMS).astype(np.int64) % BEAMS
        # Of the points of a direction the last one of this order stays: the nearest.
        order = np.argsort(-way[far], kind="stable")
        beam, turn, way = beam[order], turn[order], way[far][order]
        nearer = way < ranges[beam]
        ranges[beam[nearer]], turns[beam[nearer]] = way[nearer], turn[nearer]
    ranges = _on_centres(*_in_a_row(ranges, turns))
    ranges[np.isinf(ranges)] = np.nan
    step = 2 * np.pi / len(ranges)
    geometry = Geometry(cloud.frame, -np.pi + step / 2, step, level=True)
    one = one_scan(cloud.stamp_ns, ranges.astype(np.float32), geometry)
    return one._replace(blind=True)


def _in_a_row(ranges: FloatArray, turns: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The nearest points, by range and angle, in the narrowest directions that have returns in
    adjacent ones; (BEAMS,) unchanged if no width does. ranges: inf without return."""
    for degrees in range(1, WIDEST + 1):
        nearest = ranges.reshape(-1, degrees).argmin(axis=1)
        nearest += degrees * np.arange(len(nearest))
        seen = np.isfinite(ranges[nearest])
        if (seen & np.roll(seen, -1)).sum() >= IN_A_ROW * seen.sum():
            return ranges[nearest], turns[nearest]
    return ranges, turns


def _on_centres(ranges: FloatArray, turns: FloatArray) -> FloatArray:
    """(m,) ranges in the middle of every direction: where the line from its point to that of the
    direction on the other side of the middle crosses it, if both can be on one surface.

    Wide directions would otherwise put points half a width beside where they were seen.
    """
    count = len(ranges)
    centre = -np.pi + 2 * np.pi / count * (np.arange(count) + 0.5)
    own = turns - centre
    out = ranges
    for side in (1, -1):
        other_range = np.roll(ranges, -side)
        between = (np.roll(turns, -side) - turns + np.pi) % (2 * np.pi) - np.pi
        with np.errstate(invalid="ignore"):
            reach = SURFACES.grazing * np.minimum(ranges, other_range) * np.abs(between)
            one = np.isfinite(ranges) & (np.abs(ranges - other_range) < reach) & (side * own < 0)
        part, rest = np.sin(-own[one]), np.sin(between[one] + own[one])
        crossing = ranges[one] * part + other_range[one] * rest
        out = out.copy()
        out[one] = ranges[one] * other_range[one] * np.sin(between[one]) / crossing
    return out
