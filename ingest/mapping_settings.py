"""Settings of the conversion of a run to a map."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, get_args

from ..topology.closure.dead_reckoning import SystematicErrors
from ..topology.closure.incremental import RoundSettings
from ..topology.closure.missed_detections import DrivenBySettings
from ..topology.errors import check_choice
from ..topology.mapbuilding import MapBuildingSettings
from .odometry.calibration import CalibrationSettings
from .odometry.noise import NoiseSettings
from .passes import PassSettings

ClosureMode = Literal["none", "gated", "full"]


@dataclass(frozen=True, slots=True)
class MappingSettings:
    """Settings of the conversion of a run to a map; part of the document, for reproducibility."""

    closure: ClosureMode = "full"
    calibration: CalibrationSettings = field(default_factory=CalibrationSettings)
    calibration_doubt: float = 1.5
    """Factor on the calibration's own sigma, which assumes straight corridors."""
    systematic: SystematicErrors = field(default_factory=SystematicErrors)
    """Constant errors of an odometry that could not be calibrated."""
    passes: PassSettings = field(default_factory=PassSettings)
    noise: NoiseSettings = field(default_factory=NoiseSettings)
    rounds: RoundSettings = field(default_factory=RoundSettings)
    driven_by: DrivenBySettings = field(default_factory=DrivenBySettings)
    drawing: MapBuildingSettings = field(default_factory=MapBuildingSettings)

    def __post_init__(self) -> None:
        check_choice("--closure", self.closure, get_args(ClosureMode))


DEFAULT_MAPPING = MappingSettings()
