"""A scenario that several tests look at."""

from __future__ import annotations

import pytest

from topobatch.simulation import Scenario, ScenarioSettings, simulate_scenario


@pytest.fixture(scope="session")
def scenario() -> Scenario:
    return simulate_scenario(
        ScenarioSettings("maze", 3, unrelated_runs=1, junctions_per_run=20, seed=3)
    )
