"""Settings of the conversion of a run to a map."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

from ..topology.errors import UsageError, check_choice

RADII_M = (0.05, 2.0)
"""Least and largest radius of a robot: a cell of a grid, and a large vehicle indoors."""

ClosureMode = Literal["none", "full"]


@dataclass(frozen=True, slots=True)
class MappingSettings:
    """Settings of the conversion of a run to a map; part of the document, for reproducibility."""

    closure: ClosureMode = "full"
    robot_radius_m: float = 0.25
    """Of the robot that drives the corridors of saved grids: a small one's."""

    def __post_init__(self) -> None:
        check_choice("--closure", self.closure, get_args(ClosureMode))
        if not RADII_M[0] <= self.robot_radius_m <= RADII_M[1]:
            raise UsageError(
                f"--robot-radius {self.robot_radius_m:g}: expected {RADII_M[0]:g} to "
                f"{RADII_M[1]:g} m"
            )


DEFAULT_MAPPING = MappingSettings()
