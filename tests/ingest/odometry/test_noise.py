"""The noise of simulated runs, estimated and true."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from topobatch.ingest.odometry.calibration import apply_calibration, calibrate
from topobatch.ingest.odometry.noise import NOISE, estimate_noise, refine_noise
from topobatch.ingest.passes import fuse_passes, no_passes
from topobatch.simulation import (
    DRIFTS,
    FAULTS,
    Scenario,
    ScenarioSettings,
    simulate_scenario,
    true_vertex_of_passes,
)
from topobatch.topology.odometry import Odometry
from topobatch.topology.passes import Passes
from topobatch.topology.ragged import Ragged
from topobatch.topology.run import Detections
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


def test_square_buildings_do_not_make_odometry_look_better_than_it_is() -> None:
    """Estimates of 12 mazes have a spread of a sixth; with the share of square branches held at a
    half their mean was 0.7."""
    found = [estimated(simulated("maze", "mid", "none", seed)) for seed in range(12)]
    truth = np.radians(DRIFTS["mid"].heading_deg_per_sqrt_m)
    ratio = [noise.heading_rad_per_sqrt_m / truth for noise in found]
    assert 0.8 < np.exp(np.mean(np.log(ratio))) < 1.2


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


def test_a_run_without_passes_has_the_usual_noise() -> None:
    run = simulated("maze", "low", "none", 3).runs["run1"]
    none = Detections(np.zeros(0, np.int64), np.zeros((0, 2)), Ragged.from_rows([]))
    assert estimate_noise(run.odometry, none, no_passes()) == NOISE.prior
    nothing = np.zeros(0, np.int64)
    refined = refine_noise(no_passes(), nothing, np.zeros(0), RunNoise())
    assert asdict(refined) == pytest.approx(asdict(RunNoise()))


@settings(max_examples=15)
@given(
    st.integers(1, 12),
    st.lists(
        st.tuples(
            st.integers(0, 12),
            st.floats(-3, 3),
            st.floats(-3, 3),
            st.lists(st.floats(-3.1, 3.1), max_size=3),
        ),
        max_size=25,
    ),
    st.integers(0, 2**16),
)
def test_any_short_run_has_some_noise_and_some_calibration(
    rows: int, sightings: list[tuple[int, float, float, list[float]]], seed: int
) -> None:
    rng = np.random.default_rng(seed)
    pose = np.cumsum(rng.normal(0, 0.5, (rows, 3)), axis=0)
    breaks = np.flatnonzero(rng.random(rows) < 0.1)
    odometry = Odometry(np.arange(rows) * 500_000_000, pose, breaks[breaks > 0])
    sightings.sort(key=lambda sighting: sighting[0])
    detections = Detections(
        np.array([s[0] for s in sightings], np.int64) * 400_000_000,
        np.array([s[1:3] for s in sightings]).reshape(-1, 2),
        Ragged.from_rows([s[3] for s in sightings]),
    )
    calibration = calibrate(odometry, detections)
    assert np.isfinite(calibration.estimate).all()
    track = apply_calibration(odometry, calibration)
    noise = estimate_noise(track, detections, fuse_passes(track, detections))
    told = asdict(noise)
    assert told.pop("shared_centre_m") == 0.0  # of scans alone
    assert all(0 < value < np.inf for value in told.values())
