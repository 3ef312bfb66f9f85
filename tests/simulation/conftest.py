"""A scenario that several tests look at."""

from __future__ import annotations

import pytest

from topobatch.simulation.scenario import Scenario, simulate_scenario
from topobatch.simulation.settings import ScenarioSettings


@pytest.fixture(scope="session")
def scenario() -> Scenario:
    return simulate_scenario(
        ScenarioSettings("maze", 3, unrelated_runs=1, junctions_per_run=20, seed=3)
    )
