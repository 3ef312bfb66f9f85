"""Simulated errors other than the odometry's: detector noise and faults, closed doors, turning
back."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from types import MappingProxyType

import numpy as np

from ..topology.errors import UsageError


@dataclass(frozen=True, slots=True)
class Faults:
    """Noise (standard deviations) and rates (0 to 1) of everything but the odometry."""

    centre_m: float = 0.05
    """Junction centre, per axis; half of the variance is common to all messages of a pass."""
    branch_deg: float = 2.0
    """Branch heading; half of the variance is common to all messages of a pass."""
    lost_message_rate: float = 0.04
    missed_pass_rate: float = 0.0
    """Passes without any message."""
    wrong_message_rate: float = 0.0
    """Messages with one branch too many or too few."""
    wrong_pass_rate: float = 0.0
    """Passes with one branch too many or too few in all messages."""
    wrong_vertex_rate: float = 0.0
    """Junctions with one branch too many or too few in the whole run."""
    phantom_rate: float = 0.0
    """Invented junctions per corridor driven (corridors above 4.5 m)."""
    turn_back_rate: float = 0.0
    """Corridors in which the robot turns round on the way (above 5 m)."""
    closed_share: float = 0.0
    """Corridors closed in the run (doors): their branches are not seen and not driven."""
    lag_s: float = 0.0
    """Delay of the detector's stamps against the odometry's."""

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            is_share = field.name.endswith(("_rate", "_share"))
            if not np.isfinite(value) or value < 0 or (is_share and value > 1):
                raise UsageError(f"faults: {field.name} cannot be {value}")


FAULTS: Mapping[str, Faults] = MappingProxyType(
    {
        "none": Faults(),
        "mild": Faults(
            centre_m=0.07,
            branch_deg=3.0,
            missed_pass_rate=0.02,
            wrong_message_rate=0.05,
            wrong_pass_rate=0.02,
            wrong_vertex_rate=0.01,
            phantom_rate=0.005,
            turn_back_rate=0.005,
        ),
        "harsh": Faults(
            centre_m=0.10,
            branch_deg=5.0,
            missed_pass_rate=0.08,
            wrong_message_rate=0.15,
            wrong_pass_rate=0.08,
            wrong_vertex_rate=0.04,
            phantom_rate=0.02,
            turn_back_rate=0.02,
            closed_share=0.02,
            lag_s=0.05,
        ),
    }
)
"""Levels by name."""
