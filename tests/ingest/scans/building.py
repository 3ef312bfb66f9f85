"""A building made of rectangles, a robot that drives through it, and what its laser sees."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from topobatch.ingest.scans.scan import ScanBatch
from topobatch.topology.odometry import Odometry
from topobatch.topology.se2 import compose, wrap

CELL_M = 0.02
FARTHEST_M = 15.0
HALF_TURN = np.linspace(-np.pi / 2, np.pi / 2, 181)
WHOLE_TURN = np.arange(-180, 180) * np.pi / 180


@dataclass(frozen=True)
class Building:
    """Free cells (h, w) of 2 cm, the first one at `corner`."""

    free: NDArray[np.bool_]
    corner: NDArray[np.float64]
    clear: NDArray[np.float32]
    """Distance of every cell from the nearest wall [m]."""

    @classmethod
    def of(cls, *rooms: tuple[float, float, float, float]) -> Building:
        """Free space is what any rectangle (x0, y0, x1, y1) covers."""
        table = np.array(rooms)
        corner = table[:, :2].min(axis=0) - 0.5
        size = np.ceil((table[:, 2:].max(axis=0) + 0.5 - corner) / CELL_M).astype(int)
        free = np.zeros((size[1], size[0]), bool)
        for x0, y0, x1, y1 in rooms:
            a, b = np.rint((np.array([x0, y0]) - corner) / CELL_M).astype(int)
            c, d = np.rint((np.array([x1, y1]) - corner) / CELL_M).astype(int)
            free[b:d, a:c] = True
        return cls._with(free, corner)

    @classmethod
    def _with(cls, free: NDArray[np.bool_], corner: NDArray[np.float64]) -> Building:
        clear = distance_transform_edt(free) * CELL_M
        return cls(free, corner, clear.astype(np.float32))

    def without(self, *boxes: tuple[float, float, float, float]) -> Building:
        """With boxes (x, y, width, height) in it."""
        free = self.free.copy()
        for x, y, width, height in boxes:
            a, b = ((np.array([x, y]) - self.corner) / CELL_M).astype(int)
            free[b : b + int(height / CELL_M), a : a + int(width / CELL_M)] = False
        return self._with(free, self.corner)

    def ranges(self, pose: NDArray[np.float64], angles: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n, m) ranges from poses (n, 3), or (n, m, 3) for one per beam; NaN beyond 15 m."""
        at = pose[:, None, :] if pose.ndim == 2 else pose
        heading = at[..., 2] + angles
        x0, y0 = np.broadcast_arrays(at[..., 0], at[..., 1] + 0 * heading)
        along = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
        out = np.zeros(heading.shape)
        # Every step goes as far as the nearest wall, whatever its direction.
        for _ in range(60):
            i = ((x0 + out * along[..., 0] - self.corner[0]) / CELL_M).astype(int)
            j = ((y0 + out * along[..., 1] - self.corner[1]) / CELL_M).astype(int)
            i, j = i.clip(0, self.free.shape[1] - 1), j.clip(0, self.free.shape[0] - 1)
            out += np.maximum(self.clear[j, i] - CELL_M, 0.25 * CELL_M) * (self.clear[j, i] > 0)
        return np.where(out < FARTHEST_M, out, np.nan)


def drive(*corners: tuple[float, float], speed: float = 0.6, rate_hz: float = 5.0) -> Odometry:
    """True poses of a robot that drives straight from corner to corner and turns on the spot."""
    dt = 1 / rate_hz
    poses: list[tuple[float, float, float]] = []
    theta = 0.0
    for k in range(len(corners) - 1):
        a, b = np.array(corners[k]), np.array(corners[k + 1])
        towards = float(np.arctan2(*(b - a)[::-1]))
        turn = float(wrap(towards - theta))
        if k == 0:
            turn = 0.0
        for share in np.linspace(0, 1, max(2, int(abs(turn) / (0.6 * dt)) + 1))[:-1]:
            poses.append((a[0], a[1], towards - turn + share * turn))
        theta = towards
        count = max(2, int(np.hypot(*(b - a)) / (speed * dt)) + 1)
        poses += [(*(a + s * (b - a)), theta) for s in np.linspace(0, 1, count)[:-1]]
    poses.append((*corners[-1], theta))
    time_ns = (10**9 + np.arange(len(poses)) * dt * 1e9).astype(np.int64)
    pose = np.array(poses)
    pose[:, 2] = wrap(pose[:, 2])
    return Odometry(time_ns, pose, np.zeros(0, np.int64))


def biased(truth: Odometry, rad_per_m: float, scale: float = 1.0) -> Odometry:
    """Odometry that turns too little per metre, steadily, and counts lengths by `scale`."""
    heading = truth.pose[:, 2] - rad_per_m * np.cumsum(truth.step_m)
    step = np.diff(truth.pose[:, 0] + 1j * truth.pose[:, 1])
    lost = 0.5 * ((heading - truth.pose[:, 2])[1:] + (heading - truth.pose[:, 2])[:-1])
    at = np.concatenate([[0], np.cumsum(scale * step * np.exp(1j * lost))])
    start = complex(*truth.pose[0, :2])
    pose = np.column_stack([(start + at).real, (start + at).imag, wrap(heading)])
    return Odometry(truth.time_ns, pose, np.zeros(0, np.int64))


def scans(
    building: Building,
    truth: Odometry,
    angles: NDArray[np.float64] = HALF_TURN,
    *,
    mount: NDArray[np.float64] | None = None,
    sweep_s: float = 0.0,
    noise_m: float = 0.01,
) -> ScanBatch:
    """A scan at every row of the true track."""
    T = np.zeros(3) if mount is None else mount
    share = np.linspace(-0.5, 0.5, len(angles))
    if sweep_s:
        when = truth.time_ns[:, None] + (share * sweep_s * 1e9).astype(np.int64)
        pose = compose(truth.at(when.ravel()), T).reshape(*when.shape, 3)
    else:
        pose = compose(truth.pose, T)
    ranges = building.ranges(pose, angles)
    ranges += np.random.default_rng(5).normal(0, noise_m, ranges.shape)
    return ScanBatch(truth.time_ns, ranges.astype(np.float32), FARTHEST_M, angles, T, sweep_s)


def parts(batch: ScanBatch, size: int) -> list[ScanBatch]:
    """The same scans in batches of `size`."""
    return [
        ScanBatch(
            batch.times_ns[k : k + size],
            batch.ranges_m[k : k + size],
            np.asarray(batch.free_m)[k : k + size],
            batch.angles_rad,
            batch.T_body_laser,
            batch.sweep_s,
        )
        for k in range(0, len(batch), size)
    ]


# Corridors 2 m wide: a square of 20 m, a passage across it, and a dead end to the east.
RING = Building.of(
    (-1, -1, 21, 1), (-1, 19, 21, 21), (-1, -1, 1, 21), (19, -1, 21, 21), (9, -1, 11, 21),
    (19, 7, 27, 9),
    # Niches, so that the corridors are not bare.
    (3, 1, 4, 1.4), (6, -1.5, 7.2, -1), (14, 1, 15.2, 1.5), (17, -1.4, 17.6, -1),
    (21, 3, 21.5, 4.2), (18.5, 13, 19, 14), (15, 21, 16, 21.4), (13, 18.5, 13.6, 19),
    (5, 18.6, 6.3, 19), (2, 21, 3.3, 21.5), (-1.5, 14, -1, 15), (1, 8, 1.4, 9.3),
    (-1.4, 4, -1, 4.6), (8.6, 5, 9, 6), (11, 14, 11.5, 15),
)  # fmt: skip
