"""Makes the sample logs: `python -m topobatch.simulation.samples sample_logs`.

Three runs in a maze, each in another container, one in streets elsewhere, and one of a robot with a
laser in an office. Deterministic.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

from .scenario import Scenario, simulate_scenario
from .settings import LaserSettings, MotionSettings, ScenarioSettings, WalkSettings
from .writing import write_scenario

BRISK = MotionSettings(
    slowest_m_per_s=1.3, fastest_m_per_s=1.5, turn_rate_rad_per_s=2.0, stop_rate=0.01
)
"""Fast driving gives short runs and small files."""

CONTAINERS = ("mcap", "bag", "db3", "mcap", "mcap")
"""Containers of the three runs in the maze, of the office and of the streets."""

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
STREETS = replace(MAZE, world="organic", runs=1, junctions_per_run=22, prefix="streets-", seed=26)
OFFICE = replace(
    MAZE,
    world="office",
    runs=1,
    junctions_per_run=20,
    detector_hz=7.0,
    walk=WalkSettings(revisit_share=0.3),
    laser=LaserSettings(beams=120, rate_hz=4.0, range_max_m=10.0),
    tells_junctions=False,
    prefix="office-",
    seed=3,
)


def sample_scenario() -> Scenario:
    """The runs of the sample logs, in memory."""
    parts = [simulate_scenario(s) for s in (MAZE, OFFICE, STREETS)]
    worlds = {name: world for part in parts for name, world in part.worlds.items()}
    return Scenario(tuple(s for part in parts for s in part.simulated), worlds)


if __name__ == "__main__":
    write_scenario(sample_scenario(), Path(sys.argv[1]), CONTAINERS)
