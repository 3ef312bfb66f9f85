"""Maps to export, and what tests of several formats share."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from topobatch.ingest.mapping import build_map
from topobatch.simulation.scenario import simulate_scenario
from topobatch.simulation.settings import ScenarioSettings
from topobatch.topology.document import map_from_document, map_to_document
from topobatch.topology.polyline import way_of
from topobatch.topology.ragged import Ragged
from topobatch.topology.topomap import TopoMap


@pytest.fixture(scope="session")
def driven():
    """A simulated run among organic, winding ways, and its map as a document gives it."""
    settings = ScenarioSettings("organic", runs=1, junctions_per_run=14, odometry_hz=10, seed=3)
    (run,) = simulate_scenario(settings).runs.values()
    return run, map_from_document(map_to_document(build_map(run)))


@pytest.fixture
def odd_map() -> TopoMap:
    """A loop, two corridors between the same junctions, and a corridor that nobody timed."""
    bow = np.array([(0.0, 0.0), (2.0, 2.0), (4.0, 0.0)])
    loop = np.array([(4.0, 0.0), (6.0, 0.0), (6.0, 2.0), (4.0, 0.0)])
    paths = (bow[[0, 2]], bow, loop)
    none = np.full(3, -1)
    return TopoMap(
        run='no: "1e3"',
        frame="odom",
        xy=np.array([(0.0, 0.0), (4.0, 0.0)]),
        branches=Ragged.from_rows([[0.0, 0.8], [-3.0, 0.0, 0.8, 2.4]]),
        kind=("bend", "junction"),
        source=np.array([0, 0, 1]),
        target=np.array([1, 1, 1]),
        source_branch=none,
        target_branch=none,
        length=np.array([way_of(p)[-1] for p in paths]),
        length_sigma=np.full(3, 0.1),
        traversals=np.array([2, 1, 0]),
        paths=paths,
        observation_vertex=np.array([0, 1, 0]),
        observation_time_ns=np.array([10, 14, 18]) * 10**9,
        traversal_ns=(
            np.array([(10, 14), (22, 16)]) * 10**9,
            np.array([(18, 14)]) * 10**9,
            np.zeros((0, 2), np.int64),
        ),
    )


@pytest.fixture
def bare_map(odd_map) -> TopoMap:
    """Junctions without a corridor."""
    none = np.zeros(0, np.int64)
    return replace(
        odd_map, source=none, target=none, source_branch=none, target_branch=none,
        length=np.zeros(0), length_sigma=np.zeros(0), traversals=none, paths=(), traversal_ns=(),
    )  # fmt: skip
