"""Runs driven without noise, or with one kind of it."""

from __future__ import annotations

from dataclasses import replace

from topobatch.simulation.scenario import SimulatedRun, simulate_run
from topobatch.simulation.settings import DRIFTS, Drift, Faults, RunSettings
from topobatch.simulation.truth import Truth
from topobatch.simulation.world import World
from topobatch.simulation.worlds import make_world

KINDS = ("maze", "office", "organic", "city", "rows", "tiles")
PERFECT = RunSettings(drift=DRIFTS["none"], faults=Faults(0.0, 0.0, 0.0))


def truth_of(simulated: SimulatedRun, world: World) -> Truth:
    return Truth({simulated.truth.world: world}, {simulated.truth.name: simulated.truth})


def drifted(**drift: float) -> SimulatedRun:
    return simulate_run(make_world("maze", 40, 3), settings=replace(PERFECT, drift=Drift(**drift)))
