"""The source of a run's passes: recorded detections, or its scans.

All differences between the two in mapping are kept here.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from ..topology.arrays import FloatArray
from ..topology.odometry import Odometry
from ..topology.passes import Passes
from ..topology.run import Run, Scanned
from ..topology.topomap import RunNoise
from ..topology.wording import counted
from .mapping_settings import MappingSettings
from .odometry.calibration import Calibration, calibrate
from .odometry.noise import NOISE, estimate_noise
from .passes import fuse_passes, scanned_passes


class PassSource(Protocol):
    """What mapping needs of a source of passes.

    shows_bends: whether bends without a branch are reported; resolution_m: junctions nearer to each
    other than this show as one [m]; askew_rad: 1 sigma of headings, shared_m: (p,) of centres per
    axis [m], of errors that all passes by a place share.
    """

    @property
    def shows_bends(self) -> bool: ...  # noqa: D102

    @property
    def resolution_m(self) -> float: ...  # noqa: D102

    @property
    def askew_rad(self) -> float: ...  # noqa: D102

    @property
    def shared_m(self) -> FloatArray | None: ...  # noqa: D102

    def calibration(self) -> Calibration:
        """The constant errors of the odometry as recorded."""

    def passes(self, odometry: Odometry) -> Passes:
        """The passes in the frame of the odometry as corrected so far."""

    def noise(self, odometry: Odometry, passes: Passes) -> RunNoise:
        """Noise of odometry and passes, as far as it is known before loop closure."""

    def expected(self) -> RunNoise:
        """Priors of the detector's error rates."""


def pass_source(run: Run, settings: MappingSettings) -> PassSource:
    """The source of a run."""
    if run.scanned is None:
        return _Detected(run)
    return _FromScans(run.scanned, settings)


def why_none(run: Run) -> str:
    """The reason why a run has no pass."""
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


@dataclass(frozen=True, slots=True)
class _Detected:
    run: Run
    shows_bends = True
    resolution_m = 0.0
    askew_rad = 0.0
    shared_m = None

    def calibration(self) -> Calibration:
        return calibrate(self.run.odometry, self.run.detections)

    def passes(self, odometry: Odometry) -> Passes:
        return fuse_passes(odometry, self.run.detections)

    def noise(self, odometry: Odometry, passes: Passes) -> RunNoise:
        return estimate_noise(odometry, self.run.detections, passes)

    def expected(self) -> RunNoise:
        return NOISE.prior


@dataclass(frozen=True, slots=True)
class _FromScans:
    scanned: Scanned
    settings: MappingSettings
    shows_bends = False

    @property
    def resolution_m(self) -> float:
        return self.scanned.passes.resolution_m

    @property
    def askew_rad(self) -> float:
        return self.scanned.passes.askew_rad

    @property
    def shared_m(self) -> FloatArray:
        return self.scanned.passes.shared_m

    def calibration(self) -> Calibration:
        """Odometry corrected by scans has only the usual remaining errors."""
        usual = self.settings.systematic
        return Calibration(sigma=(usual.turn_rad_per_m, usual.turn_rad_per_rad, 0.0))

    def passes(self, odometry: Odometry) -> Passes:
        return scanned_passes(odometry, self.scanned.passes)

    def noise(self, odometry: Odometry, passes: Passes) -> RunNoise:
        return self.scanned.noise

    def expected(self) -> RunNoise:
        return self.scanned.noise
