"""Runs driven without noise, or with one kind of it."""

from __future__ import annotations

from dataclasses import replace

from topobatch.simulation import (
    DRIFTS,
    Drift,
    Faults,
    RunSettings,
    SimulatedRun,
    Truth,
    World,
    make_world,
    simulate_run,
)

KINDS = ("maze", "office", "organic", "city", "rows", "tiles")
PERFECT = RunSettings(drift=DRIFTS["none"], faults=Faults(0.0, 0.0, 0.0))


def truth_of(simulated: SimulatedRun, world: World) -> Truth:
    return Truth({simulated.truth.world: world}, {simulated.truth.name: simulated.truth})


def drifted(**drift: float) -> SimulatedRun:
    return simulate_run(make_world("maze", 40, 3), settings=replace(PERFECT, drift=Drift(**drift)))
