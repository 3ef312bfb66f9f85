"""What is simulated: the settings of each part of a run, and their levels by name."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from types import MappingProxyType
from typing import Any


@dataclass(frozen=True, slots=True)
class Drift:
    """The odometry's errors. Those named `_sigma` are drawn once per run."""

    along_m_per_sqrt_m: float = 0.0
    """Random walk of the position along the path; half as much across it."""
    heading_deg_per_sqrt_m: float = 0.0
    """Random walk of the heading with distance."""
    heading_deg_per_sqrt_rad: float = 0.0
    """Random walk of the heading with the angle turned."""
    scale_sigma: float = 0.0
    """Relative error of lengths."""
    turn_scale_sigma: float = 0.0
    """Relative error of turns."""
    gyro_bias_deg_per_s_sigma: float = 0.0
    """Constant rate error of the heading."""
    heading_bias_deg_per_m: float = 0.0
    """Systematic heading error with distance, in every run: 3 means 3° too little per metre."""
    sideways_slip_m_per_rad: float = 0.0
    """Unmeasured sideways motion, outwards in turns while driving."""
    heading_jumps_per_100_m: float = 0.0
    """Rate of sudden heading errors that the odometry does not report."""
    heading_jump_deg: float = 20.0
    """Standard deviation of such an error."""
    resets_per_100_m: float = 0.0
    """Rate of resets to zero, which break the track."""
    jumps: int = 0
    """Number of jumps of the odometry's frame, spread evenly over the path."""
    jump_m: float = 0.5
    jump_deg: float = 30.0
    """Size of every such jump, in a random direction."""


_MID_DRIFT = Drift(
    along_m_per_sqrt_m=0.01,
    heading_deg_per_sqrt_m=0.5,
    heading_deg_per_sqrt_rad=0.8,
    scale_sigma=0.005,
    turn_scale_sigma=0.004,
    gyro_bias_deg_per_s_sigma=0.003,
)
_HIGH_DRIFT = Drift(
    along_m_per_sqrt_m=0.02,
    heading_deg_per_sqrt_m=1.0,
    heading_deg_per_sqrt_rad=1.5,
    scale_sigma=0.01,
    turn_scale_sigma=0.008,
    gyro_bias_deg_per_s_sigma=0.015,
)
DRIFTS: Mapping[str, Drift] = MappingProxyType(
    {
        "none": Drift(),
        "low": Drift(
            along_m_per_sqrt_m=0.005,
            heading_deg_per_sqrt_m=0.2,
            heading_deg_per_sqrt_rad=0.3,
            scale_sigma=0.002,
            turn_scale_sigma=0.001,
        ),
        "mid": _MID_DRIFT,
        "high": _HIGH_DRIFT,
        "real": replace(
            _HIGH_DRIFT,
            turn_scale_sigma=0.01,
            gyro_bias_deg_per_s_sigma=0.0,
            heading_bias_deg_per_m=1.5,
            sideways_slip_m_per_rad=0.02,
            heading_jumps_per_100_m=0.3,
            heading_jump_deg=8.0,
        ),
    }
)
"""Levels by name; "real" resembles the robots of public data sets."""


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


@dataclass(frozen=True, slots=True)
class WalkSettings:
    """How thoroughly a robot explores its region."""

    coverage: float = 0.97
    """Stop when this share of the region's corridors was driven."""
    revisit_share: float = 0.15
    """After exploring, drive to known places for this share of the distance so far, which closes
    more loops."""
    detour_rate: float = 0.03
    """Probability before each step of going to a random known place."""


@dataclass(frozen=True, slots=True)
class MotionSettings:
    """The robot's speeds, and its deviation from the corridors' centre lines."""

    slowest_m_per_s: float = 0.6
    fastest_m_per_s: float = 1.0
    """The cruising speed is drawn once per run between slowest and fastest."""
    turn_rate_rad_per_s: float = 1.0
    wobble_m: float = 0.05
    """Deviation from the centre line, standard deviation per axis."""
    corner_m: float = 0.2
    """Corner cutting: standard deviation of the Gaussian smoothing along the path."""
    stop_rate: float = 0.03
    """Probability of standing still for 2 to 8 s at a junction."""


@dataclass(frozen=True, slots=True)
class LaserSettings:
    """The laser, its mount, and doors, glass and people around it."""

    beams: int = 180
    view_deg: float = 270.0
    """Angle between the first and the last beam, symmetric about the x axis."""
    rate_hz: float = 5.0
    sweep_s: float = 0.1
    """Time between the first and the last beam of a scan, in which the robot moves on."""
    range_min_m: float = 0.1
    range_max_m: float = 12.0
    noise_m: float = 0.015
    """Standard deviation of ranges."""
    lost_rate: float = 0.002
    """Share of beams without an echo."""
    mount: tuple[float, float, float] = (0.15, 0.0, 0.0)
    """Pose of the laser on the robot: x, y [m], yaw [rad]."""
    upside_down: bool = False
    corridor_m: float = 1.4
    """Width of all corridors; those of most worlds lie at least 2.5 m apart."""
    door_share: float = 0.06
    """Share of corridor ends with a door that opens and closes."""
    glass_share: float = 0.02
    """Share of walls of glass, which reflect only near the normal."""
    people_per_100_m: float = 0.7
    """Number of people walking, by the total corridor length."""


LASERS: Mapping[str, LaserSettings] = MappingProxyType(
    {
        "none": LaserSettings(door_share=0.0, glass_share=0.0, people_per_100_m=0.0, lost_rate=0.0),
        "mild": LaserSettings(),
        "harsh": LaserSettings(
            noise_m=0.03, door_share=0.15, glass_share=0.06, people_per_100_m=2.0, lost_rate=0.01
        ),
    }
)
"""Levels by name, as those of faults."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RunSettings:
    """How a run is driven and recorded. A level's name stands for its values."""

    drift: str | Drift = "mid"
    """A level (none, low, mid, high, real) or a Drift."""
    faults: str | Faults = "mild"
    """A level (none, mild, harsh) or a Faults."""
    walk: WalkSettings = field(default_factory=WalkSettings)
    motion: MotionSettings = field(default_factory=MotionSettings)
    odometry_hz: float = 20.0
    detector_hz: float = 7.0
    laser: str | LaserSettings | None = None
    """A level (none, mild, harsh) or a LaserSettings; None for no laser."""
    tells_junctions: bool = True
    """Whether the log holds the detector's messages."""

    def values(self) -> tuple[Drift, Faults, LaserSettings | None]:
        """The drift, the faults and the laser, with levels replaced by their values."""
        drift = DRIFTS[self.drift] if isinstance(self.drift, str) else self.drift
        faults = FAULTS[self.faults] if isinstance(self.faults, str) else self.faults
        laser = LASERS[self.laser] if isinstance(self.laser, str) else self.laser
        return drift, faults, laser

    def recorded(self) -> dict[str, Any]:
        """The settings as they stand in the truth, with levels replaced by their values."""
        drift, faults, laser = self.values()
        return asdict(replace(self, drift=drift, faults=faults, laser=laser))


@dataclass(frozen=True, slots=True)
class ScenarioSettings(RunSettings):
    """What to simulate: a world, and runs with common settings."""

    world: str = "maze"
    """Kind of world: maze, office, organic, city, rows or tiles."""
    runs: int = 3
    overlap: float = 0.4
    """Share of a run's junctions that the run before it also visits, 0 … 0.9."""
    junctions_per_run: int = 50
    unrelated_runs: int = 0
    """Further runs, each in a world of its own."""
    changes: int = 0
    """Corridors that close or open between the runs of the one world."""
    days: float | None = None
    """Time from the first run to the last one; by default two hours from each to the next."""
    prefix: str = "run"
    """Prefix of the runs' names, before a number."""
    seed: int = 0
    """Seed of the world, the paths and the errors."""
