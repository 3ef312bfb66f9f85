"""The truth that comes with simulated runs."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np

from topobatch.simulation.scenario import Scenario
from topobatch.simulation.truth import MIXED, WorldChange, true_vertex_of_nodes, write_truth
from topobatch.topology.topomap import TopoMap

from ..maps import straight_map


def test_the_document_says_what_happened(scenario: Scenario, tmp_path: Path) -> None:
    changes = (WorldChange("run-world", 3, 5, open=True),)
    write_truth(tmp_path / "truth.json", replace(scenario.truth, changes=changes))
    told = json.loads((tmp_path / "truth.json").read_text())
    for name, run in scenario.truth.runs.items():
        other = told["runs"][name]
        assert other["passes"]["start_ns"] == run.start_ns.tolist()
        assert other["passes"]["vertex"] == run.vertex.tolist()
        assert other["drives"]["edge"] == run.drive_edge.tolist()
        np.testing.assert_allclose(run.path, np.array(other["path"])[:, 1:], atol=6e-4)
        assert run.settings == other["settings"]
    for name, world in scenario.truth.worlds.items():
        assert told["worlds"][name]["vertices"] == world.xy.tolist()
    assert told["changes"] == [{"world": "run-world", "edge": 3, "time_ns": 5, "open": True}]
    assert {frozenset((pair["a"], pair["b"])) for pair in told["pairs"]} == {
        frozenset(pair)
        for pair in combinations(scenario.runs, 2)
        if len({scenario.truth.runs[run].world for run in pair}) == 1
    }


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
