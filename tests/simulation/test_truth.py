"""The truth that comes with simulated runs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from topobatch.simulation.scenario import Scenario
from topobatch.simulation.truth import (
    MIXED,
    WorldChange,
    read_truth,
    true_vertex_of_nodes,
    write_truth,
)
from topobatch.topology.topomap import TopoMap

from ..maps import straight_map


def test_truth_survives_its_document(scenario: Scenario, tmp_path: Path) -> None:
    changes = (WorldChange("run-world", 3, 5, open=True),)
    write_truth(tmp_path / "truth.json", replace(scenario.truth, changes=changes))
    again = read_truth(tmp_path / "truth.json")
    for name, run in scenario.truth.runs.items():
        other = again.runs[name]
        np.testing.assert_array_equal(run.start_ns, other.start_ns)
        np.testing.assert_array_equal(run.vertex, other.vertex)
        np.testing.assert_allclose(run.path, other.path, atol=6e-4)
        assert run.fault == other.fault
        assert run.settings == other.settings
    for name, world in scenario.truth.worlds.items():
        np.testing.assert_array_equal(world.xy, again.worlds[name].xy)
        np.testing.assert_allclose(world.branches.values, again.worlds[name].branches.values)
    assert again.changes == changes
    write_truth(tmp_path / "again.json", again)
    assert (tmp_path / "again.json").read_bytes() == (tmp_path / "truth.json").read_bytes()


def _map_of(name: str, xy: np.ndarray, nodes: list[int], times_ns: np.ndarray) -> TopoMap:
    """A map without corridors: just its vertices and who was seen where."""
    alone = straight_map(name, xy, [], [(v, 0.0) for v in range(len(xy))])
    return replace(alone, observation_vertex=np.array(nodes), observation_time_ns=times_ns)


def test_nodes_of_a_map_stand_for_vertices(scenario: Scenario) -> None:
    run = scenario.truth.runs["run1"]
    seen = np.flatnonzero(run.messages > 0)[:4]
    vertex, times = run.vertex[seen], run.start_ns[seen]
    assert len(set(vertex.tolist())) > 2
    apart = _map_of("run1", np.eye(4, 2), [0, 1, 2, 3], times)
    assert true_vertex_of_nodes(scenario.truth, apart).tolist() == vertex.tolist()
    fused = _map_of("run1", np.eye(2), [0, 0, 0, 1], times)
    assert true_vertex_of_nodes(scenario.truth, fused).tolist() == [MIXED, vertex[3]]
