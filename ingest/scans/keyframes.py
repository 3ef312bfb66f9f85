"""Keyframes: scans selected by distance or rotation, resampled to an even raster of beams."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from ...topology.arrays import BoolArray, Float32Array, FloatArray, IntArray
from ...topology.columns import joined, take
from ...topology.se2 import compose, inverse, wrap
from .scan import ScanBatch


@dataclass(frozen=True, slots=True)
class KeyframeSettings:
    """Which scans are matched, and their resolution."""

    step_m: float = 0.25
    turn_rad: float = 0.15
    """Distance or rotation after which the next scan is a keyframe: neighbours still see nearly the
    same."""
    raster_rad: float = 0.0175
    """Beams are thinned out to this spacing: a degree is 9 cm at 5 m."""


KEYFRAMES = KeyframeSettings()


@dataclass(frozen=True, slots=True, eq=False)
class Keyframes:
    """`k` scans by time.

    odometry: (k, 3) pose of the *laser* in the odometry frame; mount: (k, 3) T_body_laser; xy: (k,
    m, 2) points in the laser's frame [m], NaN without return; start, increment: (k,) bearing of the
    first beam and between beams [rad]; beams: (k,) their number, beyond which rows are padded;
    free: (k,) free distance along beams without return [m]; rate: (k,) turning rate [rad/s]; piece:
    (k,) unbroken piece of odometry; laser: (k,) its number.
    """

    time_ns: IntArray
    odometry: FloatArray
    mount: FloatArray
    xy: Float32Array
    start: FloatArray
    increment: FloatArray
    beams: IntArray
    free: FloatArray
    rate: FloatArray
    piece: IntArray
    laser: IntArray

    def __len__(self) -> int:
        return len(self.time_ns)


Frames = TypeVar("Frames", bound=Keyframes)


def join(parts: list[Frames]) -> Frames:
    """Keyframes concatenated; narrower rasters are padded with NaN."""
    width = max(part.xy.shape[1] for part in parts)
    return joined([replace(part, xy=_widened(part.xy, width)) for part in parts])


def _widened(xy: Float32Array, width: int) -> Float32Array:
    """(k, width, 2) points, padded with NaN columns."""
    return np.pad(xy, ((0, 0), (0, width - xy.shape[1]), (0, 0)), constant_values=np.nan)


@dataclass(frozen=True, slots=True, eq=False)
class Posed:
    """A batch of scans with the robot's pose (n, 3) in the odometry frame at each, its motion (n,
    3) during the sweep in its own frame, and its turning rate (n,) [rad/s]. usable: (n,) whether
    the pose is known; piece: (n,) unbroken piece of odometry."""

    batch: ScanBatch
    pose: FloatArray
    motion: FloatArray
    rate: FloatArray
    usable: BoolArray
    piece: IntArray


def keyframes(posed: Iterable[Posed]) -> Iterator[Keyframes]:
    """The keyframes of every batch. The first scan of each laser is one."""
    last: dict[int, FloatArray] = {}
    for part in posed:
        rows = _chosen(part, last)
        if rows:
            yield prepared(part, np.array(rows))


def in_order(parts: Iterable[Keyframes], size: int, late_s: float = 10.0) -> Iterator[Keyframes]:
    """The same keyframes sorted by time, `size` at once (the last ones fewer).

    Batches of several lasers may overlap: a keyframe is held back until every laser heard in the
    last `late_s` has moved on beyond it.
    """
    waiting: list[Keyframes] = []
    heard: dict[int, int] = {}
    for part in parts:
        waiting.append(part)
        heard[int(part.laser[-1])] = int(part.time_ns[-1])
        newest = max(heard.values())
        settled = min(t for t in heard.values() if t >= newest - late_s * 1e9)
        held = _by_time(waiting)
        ready = int(np.searchsorted(held.time_ns, settled, side="right"))
        whole = ready - ready % size
        for begin in range(0, whole, size):
            yield take(held, slice(begin, begin + size))
        waiting = [take(held, slice(whole, None))]
    if waiting:
        rest = _by_time(waiting)
        for begin in range(0, len(rest), size):
            yield take(rest, slice(begin, begin + size))


def _by_time(parts: list[Keyframes]) -> Keyframes:
    """Keyframes of several lasers sorted by time, at equal times by their views of the robot's
    surroundings, in whatever order they were recorded."""
    joint = join(parts)
    x, y, theta = joint.mount.T
    return take(joint, np.lexsort((joint.laser, joint.start, theta, y, x, joint.time_ns)))


def _chosen(part: Posed, last: dict[int, FloatArray]) -> list[int]:
    """Rows of a batch that are keyframes; last: the robot's pose at each laser's last one."""
    rows: list[int] = []
    laser = part.batch.laser
    poses = part.pose.tolist()
    seen = np.isfinite(part.batch.ranges_m).any(axis=1) & part.usable
    for row in np.flatnonzero(seen).tolist():
        x, y, theta = poses[row]
        if laser in last:
            x0, y0, theta0 = last[laser]
            still = (x - x0) ** 2 + (y - y0) ** 2 < KEYFRAMES.step_m**2
            if still and abs(wrap(theta - theta0)) < KEYFRAMES.turn_rad:
                continue
        last[laser] = np.array(poses[row])
        rows.append(row)
    return rows


def prepared(part: Posed, rows: IntArray) -> Keyframes:
    """Scans `rows` of a batch as keyframes."""
    batch, n = part.batch, len(rows)
    columns, start, step = raster(batch.angles_rad, KEYFRAMES.raster_rad)
    angles = np.asarray(batch.angles_rad[columns])
    ranges = batch.ranges_m[rows][:, columns].astype(np.float64)
    xy = np.stack([ranges * np.cos(angles), ranges * np.sin(angles)], axis=-1)
    if batch.sweep_s != 0:
        share = columns / max(len(batch.angles_rad) - 1, 1) - 0.5
        xy = _at_mid_sweep(xy, part.motion[rows], share, batch.T_body_laser)
        xy = _rastered(xy, start, step)
    mount = np.tile(batch.T_body_laser, (n, 1))
    return Keyframes(
        batch.times_ns[rows],
        compose(part.pose[rows], mount),
        mount,
        xy.astype(np.float32),
        np.full(n, start),
        np.full(n, step),
        np.full(n, len(columns)),
        np.asarray(batch.free_m)[rows],
        part.rate[rows],
        part.piece[rows],
        np.full(n, batch.laser),
    )


def raster(angles_rad: FloatArray, finest_rad: float) -> tuple[IntArray, float, float]:
    """Columns of a scan of even spacing, at most `finest_rad` apart or its own spacing; its first
    bearing and their step [rad]."""
    order = np.argsort(angles_rad, kind="stable").astype(np.int64)
    first, last = angles_rad[order[[0, -1]]].tolist()
    if last <= first:  # beams that all look one way
        return order[:1], first, finest_rad
    spacing = (last - first) / (len(order) - 1)
    stride = max(1, int(finest_rad / spacing + 0.01))
    return order[::stride], first, stride * spacing


def _at_mid_sweep(
    xy: FloatArray, motion: FloatArray, share: FloatArray, mount: FloatArray
) -> FloatArray:
    """Points (n, m, 2) of sweeps, moved to the laser's frame at mid-sweep. motion: (n, 3) of the
    robot in a sweep; share: (m,) of it at each beam, -1/2 to 1/2; mount: (3,) T_body_laser."""
    moved = compose(compose(inverse(mount), motion), mount)[:, None, :] * share[:, None]
    c, s = np.cos(moved[..., 2]), np.sin(moved[..., 2])
    x = c * xy[..., 0] - s * xy[..., 1] + moved[..., 0]
    y = s * xy[..., 0] + c * xy[..., 1] + moved[..., 1]
    return np.stack([x, y], axis=-1)


def _rastered(xy: FloatArray, start: float, step: float) -> FloatArray:
    """The points sorted into the raster by their present bearings."""
    m = xy.shape[1]
    middle = start + 0.5 * step * (m - 1)
    bearing = wrap(np.arctan2(xy[..., 1], xy[..., 0]) - middle) + 0.5 * step * (m - 1)
    beam = np.rint(np.where(np.isfinite(bearing), bearing / step, -1)).astype(np.int64)
    row, column = np.nonzero((beam >= 0) & (beam < m))
    out = np.full_like(xy, np.nan)
    out[row, beam[row, column]] = xy[row, column]
    return out
