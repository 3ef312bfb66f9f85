"""The noise of simulated runs, estimated and true."""

from __future__ import annotations

import numpy as np
import pytest

from topobatch.ingest.odometry.noise import estimate_noise, refine_noise
from topobatch.ingest.passes import fuse_passes
from topobatch.simulation.scenario import Scenario, simulate_scenario
from topobatch.simulation.settings import DRIFTS, FAULTS, ScenarioSettings
from topobatch.simulation.truth import true_vertex_of_passes
from topobatch.topology.passes import Passes
from topobatch.topology.topomap import RunNoise


def simulated(world: str, drift: str, faults: str, seed: int) -> Scenario:
    return simulate_scenario(
        ScenarioSettings(world, 1, junctions_per_run=60, drift=drift, faults=faults, seed=seed)
    )


def estimated(scenario: Scenario) -> RunNoise:
    odometry, detections = scenario.runs["run1"].odometry, scenario.runs["run1"].detections
    return estimate_noise(odometry, detections, fuse_passes(odometry, detections))


@pytest.mark.parametrize("world", ["maze", "organic"])
@pytest.mark.parametrize(("drift", "faults"), [("low", "none"), ("high", "harsh")])
def test_noise_is_found_within_a_factor(world: str, drift: str, faults: str) -> None:
    found = [estimated(simulated(world, drift, faults, seed)) for seed in range(2)]
    real, detector = DRIFTS[drift], FAULTS[faults]
    # Half of the detector's variance is common to a pass, the rest averages out.
    half = np.sqrt(0.5)
    for name, truth, factor in (
        ("centre_m", detector.centre_m * half, 1.2),
        ("branch_rad", np.radians(detector.branch_deg) * half, 1.2),
        ("heading_rad_per_sqrt_m", np.radians(real.heading_deg_per_sqrt_m), 2.5),
        ("heading_rad_per_sqrt_rad", np.radians(real.heading_deg_per_sqrt_rad), 2.0),
        ("along_m_per_sqrt_m", real.along_m_per_sqrt_m, 2.5),
    ):
        typical = np.exp(np.mean([np.log(getattr(noise, name)) for noise in found]))
        assert truth / factor < typical < truth * factor, (name, typical, truth)


def passes_and_truth(world: str, faults: str, seed: int) -> tuple[Passes, np.ndarray, list[str]]:
    scenario = simulated(world, "none", faults, seed)
    run = scenario.runs["run1"]
    passes = fuse_passes(run.odometry, run.detections)
    vertex = true_vertex_of_passes(scenario.truth, "run1", passes.time_ns)
    return passes, vertex, list(scenario.truth.runs["run1"].fault)


@pytest.mark.parametrize("faults", ["none", "harsh"])
def test_rates_come_from_repeated_passes(faults: str) -> None:
    passes, vertex, fault = passes_and_truth("maze", faults, 1)
    turn = np.zeros(len(passes))
    missed = fault.count("missed")
    before = RunNoise(branch_rad=0.03)
    found = refine_noise(passes, vertex, turn, before, drive_bys=missed)
    wrong = fault.count("wrong pass")
    assert found.branch_fault_rate == pytest.approx(wrong / len(passes), abs=0.035)
    assert found.miss_rate == pytest.approx(missed / len(fault), abs=0.02)
    half = np.sqrt(0.5)
    assert found.branch_rad == pytest.approx(np.radians(FAULTS[faults].branch_deg) * half, rel=0.3)
    assert found.centre_m == before.centre_m
