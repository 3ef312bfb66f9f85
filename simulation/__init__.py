"""Simulated runs: worlds, robots that explore them, their logs, and the ground truth.

`simulate_scenario` makes runs in memory, `write_scenario` writes their logs in any container. The
same settings give the same runs, and logs with the same messages, on any machine.
"""

from .scenario import Scenario, SimulatedRun, joined, simulate_run, simulate_scenario
from .settings import (
    DRIFTS,
    FAULTS,
    LASERS,
    Drift,
    Faults,
    LaserSettings,
    MotionSettings,
    RunSettings,
    ScenarioSettings,
    WalkSettings,
)
from .truth import (
    MIXED,
    RunTruth,
    Truth,
    best_transform,
    placement_error,
    read_truth,
    true_vertex_of_nodes,
    true_vertex_of_passes,
    truth_transform,
    write_truth,
)
from .world import World
from .worlds import make_world
from .writing import FORMATS, write_run, write_scenario

__all__ = [
    "DRIFTS",
    "FAULTS",
    "FORMATS",
    "LASERS",
    "MIXED",
    "Drift",
    "Faults",
    "LaserSettings",
    "MotionSettings",
    "RunSettings",
    "RunTruth",
    "Scenario",
    "ScenarioSettings",
    "SimulatedRun",
    "Truth",
    "WalkSettings",
    "World",
    "best_transform",
    "joined",
    "make_world",
    "placement_error",
    "read_truth",
    "simulate_run",
    "simulate_scenario",
    "true_vertex_of_nodes",
    "true_vertex_of_passes",
    "truth_transform",
    "write_run",
    "write_scenario",
    "write_truth",
]
