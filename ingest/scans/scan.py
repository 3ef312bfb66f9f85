"""Input and output of junction detection in scans."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from ...topology.arrays import Float32Array, FloatArray, IntArray
from ...topology.frozen import freeze
from ...topology.odometry import Odometry
from ...topology.run import Scanned


@dataclass(frozen=True, slots=True, eq=False)
class ScanBatch:
    """Consecutive planar scans of one laser with the same geometry, in the order of time.

    times_ns: (n,) int64, time of the middle beam of each sweep; ranges_m: (n, m) float32 [m], NaN
    without return; free_m: (n,) or one number, free distance along a beam without return [m], 0 if
    unknown; angles_rad: (m,) beam directions in the laser's frame, counter-clockwise seen from
    above; T_body_laser: (3,) x, y [m], yaw [rad] of the laser in the odometry's child frame;
    sweep_s: time from the first column's beam to the last one's [s], negative if the last was
    measured first, 0 if unknown; laser: a number, the same for all scans of a laser, which its
    mounting need not tell from another. Raises ValueError on shapes that do not fit or times that
    descend.
    """

    times_ns: IntArray
    ranges_m: Float32Array
    free_m: FloatArray | float
    angles_rad: FloatArray
    T_body_laser: FloatArray = field(default_factory=lambda: np.zeros(3))
    sweep_s: float = 0.0
    laser: int = 0

    def __post_init__(self) -> None:
        freeze(self, np.int64, times_ns=(None,))
        freeze(self, np.float64, angles_rad=(None,), T_body_laser=(3,))
        n, m = len(self.times_ns), len(self.angles_rad)
        ranges = np.asarray(self.ranges_m, np.float32)
        if ranges.shape != (n, m):
            raise ValueError(f"ranges_m has shape {ranges.shape}, expected {(n, m)}")
        if np.isinf(ranges).any() or (ranges <= 0).any():
            raise ValueError("ranges_m holds values that are neither positive nor NaN")
        if np.any(np.diff(self.times_ns) < 0):
            raise ValueError("scans must be in the order of time")
        free = np.broadcast_to(np.asarray(self.free_m, np.float64), (n,))
        if not np.isfinite(free).all() or (free < 0).any() or not np.isfinite(self.sweep_s):
            raise ValueError("free_m and sweep_s must be finite, free_m not negative")
        object.__setattr__(self, "ranges_m", ranges)
        object.__setattr__(self, "free_m", free)

    def __len__(self) -> int:
        return len(self.times_ns)

    def rows(self, which: slice) -> ScanBatch:
        """Some of the scans, in their order."""
        return replace(
            self,
            times_ns=self.times_ns[which],
            ranges_m=self.ranges_m[which],
            free_m=np.asarray(self.free_m)[which],
        )


@dataclass(frozen=True, slots=True)
class ScanStatistics:
    """Statistics of scan matching.

    scans: read; matched: of these, used and found to fit; drift_before_m, drift_after_m: median
    position error after 20 m [m] of the odometry as recorded (relative to the corrected one) and as
    corrected (by its own covariance, over the same parts), NaN if the run is shorter;
    bias_rad_per_m: heading bias of the odometry that was removed; covered: share of the distance
    driven where the scans show enough of the surroundings; searched: number of steps found by
    searching; odometry: whether there was any beside the scans.
    """

    scans: int = 0
    matched: int = 0
    drift_before_m: float = float("nan")
    drift_after_m: float = float("nan")
    bias_rad_per_m: float = 0.0
    covered: float = 0.0
    searched: int = 0
    odometry: bool = True


@dataclass(frozen=True, slots=True, eq=False)
class ScanResult:
    """Corrected odometry, and what was detected in scans.

    scanned: the junctions, the noise of `odometry`, for loop closure, and of the passes (centre,
    branch), views and loops. warnings: one sentence per kind of fault, with a count.
    """

    odometry: Odometry
    scanned: Scanned
    statistics: ScanStatistics
    warnings: tuple[str, ...] = ()
