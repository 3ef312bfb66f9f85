"""Makes the sample logs: `python -m topobatch.simulation.samples sample_logs`.

Three runs through one maze, each in another container, and one through streets elsewhere. Running
it again gives the same files byte for byte.
"""

from __future__ import annotations

import sys
from pathlib import Path

from .motion import MotionSettings
from .scenario import Scenario, ScenarioSettings, joined, simulate_scenario
from .walk import WalkSettings
from .writing import write_scenario

BRISK = MotionSettings(
    slowest_m_per_s=1.3, fastest_m_per_s=1.5, turn_rate_rad_per_s=2.0, stop_rate=0.01
)
"""Short runs make small files."""

FORMATS = ("mcap", "bag", "db3", "mcap")

MAZE = ScenarioSettings(
    world="maze",
    runs=3,
    overlap=0.55,
    junctions_per_run=26,
    drift="mid",
    faults="mild",
    walk=WalkSettings(revisit_share=0.05),
    motion=BRISK,
    odometry_hz=10.0,
    detector_hz=5.0,
    prefix="maze-",
    seed=182,
)
STREETS = ScenarioSettings(
    world="organic",
    runs=1,
    junctions_per_run=22,
    drift="mid",
    faults="mild",
    walk=WalkSettings(revisit_share=0.05),
    motion=BRISK,
    odometry_hz=10.0,
    detector_hz=5.0,
    prefix="streets-",
    seed=26,
)


def sample_scenario() -> Scenario:
    """The runs of the sample logs, in memory."""
    return joined(simulate_scenario(MAZE), simulate_scenario(STREETS))


def write_samples(folder: Path) -> list[Path]:
    """Write the sample logs and their truth into a folder; the paths of the logs."""
    return write_scenario(sample_scenario(), folder, FORMATS)


if __name__ == "__main__":
    write_samples(Path(sys.argv[1]))
