"""The passes of a run: from recorded detections, or from its scans.

All differences between the two in mapping are kept here.
"""

from __future__ import annotations

from dataclasses import dataclass

from ..topology.arrays import FloatArray
from ..topology.odometry import Odometry
from ..topology.passes import Passes
from ..topology.run import Run
from ..topology.topomap import RunNoise
from ..topology.wording import counted
from .odometry.calibration import Calibration, calibrate
from .odometry.noise import NOISE, estimate_noise
from .passes import fuse_passes, scanned_passes

USUAL_SIGMA = (0.0005, 0.01, 0.0)
"""1 sigma of the heading errors left in an odometry that scans corrected: per metre [rad], per
radian, and by a wrong clock [s]."""


@dataclass(frozen=True, slots=True)
class PassSource:
    """What mapping needs to know of a run's passes."""

    run: Run

    @property
    def shows_bends(self) -> bool:
        """Whether bends without a branch are reported."""
        return self.run.scanned is None

    @property
    def resolution_m(self) -> float:
        """Junctions nearer to each other than this show as one [m]."""
        return 0.0 if self.run.scanned is None else self.run.scanned.passes.resolution_m

    @property
    def askew_rad(self) -> float:
        """1 sigma of the error of headings that all passes by a place share."""
        return 0.0 if self.run.scanned is None else self.run.scanned.passes.askew_rad

    @property
    def shared_m(self) -> FloatArray | None:
        """(p,) 1 sigma per axis of the error of centres that all passes by a place share [m]."""
        return None if self.run.scanned is None else self.run.scanned.passes.shared_m

    @property
    def prior(self) -> RunNoise:
        """Prior of the detector's error rates."""
        return NOISE.prior if self.run.scanned is None else self.run.scanned.noise

    def calibration(self) -> Calibration:
        """The constant errors of the odometry as recorded; one corrected by scans has only the
        usual remaining errors."""
        if self.run.scanned is None:
            return calibrate(self.run.odometry, self.run.detections)
        return Calibration(sigma=USUAL_SIGMA)

    def passes(self, odometry: Odometry) -> Passes:
        """The passes in the frame of the odometry as corrected so far."""
        if self.run.scanned is None:
            return fuse_passes(odometry, self.run.detections)
        return scanned_passes(odometry, self.run.scanned.passes)

    def noise(self, odometry: Odometry, passes: Passes) -> RunNoise:
        """Noise of odometry and passes, as far as it is known before loop closure."""
        if self.run.scanned is None:
            return estimate_noise(odometry, self.run.detections, passes)
        return self.run.scanned.noise

    def why_none(self) -> str:
        """The reason why a run has no pass."""
        run = self.run
        if len(run.odometry) == 0:
            return "holds no odometry; nothing can be mapped"
        if run.scanned is not None:
            scans = counted(run.source["junctions"]["scans"], "scan")
            way = f"{run.odometry.step_m.sum():,.0f} m of way"
            return f"no junction shows in its {scans} over {way}; nothing can be mapped"
        if len(run.detections) == 0:
            return "holds no junction detection; nothing can be mapped"
        return (
            f"none of its {len(run.detections)} junction detections lies within the time of its "
            "odometry; check the clocks of the two topics; --time log takes the times of recording"
        )
