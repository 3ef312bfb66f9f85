"""Scenarios: several runs of one world, and others beside them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from topobatch.simulation.scenario import Scenario, simulate_run, simulate_scenario
from topobatch.simulation.settings import DRIFTS, FAULTS, RunSettings, ScenarioSettings
from topobatch.simulation.worlds import make_world
from topobatch.topology.errors import UsageError

from .driven import KINDS


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("overlap", [0.0, 0.5])
def test_runs_of_a_chain_overlap_as_asked(kind: str, overlap: float) -> None:
    s = ScenarioSettings(kind, 3, overlap, junctions_per_run=30, faults="none", seed=8)
    truth = simulate_scenario(s).truth
    shares = sorted(
        len(truth.common(a, b)) / min(len(truth.runs[a].detected), len(truth.runs[b].detected))
        for a, b in (("run1", "run2"), ("run1", "run3"), ("run2", "run3"))
    )
    assert shares[-1] == pytest.approx(overlap, abs=0.12)
    assert shares[-2] == pytest.approx(overlap, abs=0.12 + 0.3 * overlap)
    assert (len(truth.linked()) == 3) == (overlap == 0)


def test_unrelated_runs_share_no_world(scenario: Scenario) -> None:
    groups = scenario.truth.linked()
    assert sorted(len(group) for group in groups) == [1, 3]
    assert len({run.world for run in scenario.truth.runs.values()}) == 2


def test_a_world_changes_between_runs_as_the_truth_says() -> None:
    s = ScenarioSettings(
        "organic", 3, 0.7, 25, unrelated_runs=1, changes=3, days=10, faults="none", seed=4
    )
    truth = simulate_scenario(s).truth
    times = sorted(int(run.path_ns[0]) for run in truth.runs.values())
    assert times[-1] - times[0] == 10 * 86_400 * 10**9
    assert len(truth.changes) == 3
    for run in truth.runs.values():
        shut = {c.edge for c in truth.changes if c.open == (run.path_ns[0] < c.time_ns)}
        assert set(run.closed_edges) == (shut if run.world == "run-world" else set())
        assert not set(run.closed_edges) & set(run.drive_edge.tolist())
    with pytest.raises(UsageError, match="fewer changes, or for more overlap"):
        simulate_scenario(replace(s, changes=50))


def test_the_same_settings_give_the_same_runs(scenario: Scenario) -> None:
    again = simulate_scenario(
        ScenarioSettings("maze", 3, unrelated_runs=1, junctions_per_run=20, seed=3)
    )
    other = simulate_scenario(
        ScenarioSettings("maze", 3, unrelated_runs=1, junctions_per_run=20, seed=4)
    )
    for name, run in scenario.runs.items():
        np.testing.assert_array_equal(run.odometry.pose, again.runs[name].odometry.pose)
        np.testing.assert_array_equal(run.detections.centre, again.runs[name].detections.centre)
        assert not np.array_equal(run.odometry.pose[:9], other.runs[name].odometry.pose[:9])


@settings(max_examples=6)
@given(
    kind=st.sampled_from(KINDS),
    junctions=st.integers(5, 40),
    seed=st.integers(0, 10**6),
    faults=st.sampled_from(sorted(FAULTS)),
    drift=st.sampled_from(sorted(DRIFTS)),
)
def test_any_world_can_be_driven(
    kind: str, junctions: int, seed: int, faults: str, drift: str
) -> None:
    world = make_world(kind, junctions, seed)
    simulated = simulate_run(
        world, settings=RunSettings(drift=DRIFTS[drift], faults=FAULTS[faults]), seed=seed
    )
    run, truth = simulated.run, simulated.truth
    assert len(simulated.twist) == len(run.odometry)
    assert truth.messages.sum() == len(run.detections)
    assert run.detections.branches.counts.min(initial=1) >= 1
    assert np.max(np.hypot(*run.detections.centre.T), initial=0.0) < 3.0
