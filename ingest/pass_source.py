"""Where the passes of a run come from: detections that were recorded, or its scans.

All that mapping does otherwise for the one and for the other stands here.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

from ..topology.arrays import FloatArray
from ..topology.odometry import Odometry
from ..topology.passes import Passes
from ..topology.run import Run, Scanned
from ..topology.topomap import RunNoise
from ..topology.wording import counted
from .mapping_settings import MappingSettings
from .odometry.calibration import Calibration, calibrate
from .odometry.noise import NoiseSettings, estimate_noise
from .passes import fuse_passes, scanned_passes


class PassSource(Protocol):
    """What mapping asks.

    shows_bends: a bend without a branch is a junction, too; resolution_m: junctions nearer to each
    other than this look like one [m]; askew_rad: 1 sigma of headings, shared_m: (p,) of centres per
    axis [m], that all passes of a place share.
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
        """Of odometry and passes, as far as it is known before loops are closed."""

    def expected(self) -> NoiseSettings:
        """What rates of faults are expected of such a detector."""


def pass_source(run: Run, settings: MappingSettings) -> PassSource:
    """The source that a run has."""
    if run.scanned is None:
        return _Detected(run, settings)
    return _FromScans(run.scanned, settings)


def why_none(run: Run) -> str:
    """What is said of a run without any pass."""
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
        "odometry; check the clocks of the two topics"
    )


@dataclass(frozen=True, slots=True)
class _Detected:
    run: Run
    settings: MappingSettings
    shows_bends = True
    resolution_m = 0.0
    askew_rad = 0.0
    shared_m = None

    def calibration(self) -> Calibration:
        odometry, detections = self.run.odometry, self.run.detections
        return calibrate(odometry, detections, self.settings.calibration, self.settings.passes)

    def passes(self, odometry: Odometry) -> Passes:
        return fuse_passes(odometry, self.run.detections, self.settings.passes)

    def noise(self, odometry: Odometry, passes: Passes) -> RunNoise:
        return estimate_noise(odometry, self.run.detections, passes, self.settings.noise)

    def expected(self) -> NoiseSettings:
        return self.settings.noise


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
        """Of odometry that scans corrected, nothing is left but what usually is left."""
        usual = self.settings.systematic
        return Calibration(sigma=(usual.turn_rad_per_m, usual.turn_rad_per_rad, 0.0))

    def passes(self, odometry: Odometry) -> Passes:
        return scanned_passes(odometry, self.scanned.passes, self.settings.passes)

    def noise(self, odometry: Odometry, passes: Passes) -> RunNoise:
        return self.scanned.noise

    def expected(self) -> NoiseSettings:
        return replace(self.settings.noise, prior=self.scanned.noise)
