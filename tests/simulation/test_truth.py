"""The truth that comes with simulated runs."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from topobatch.simulation import (
    MIXED,
    Scenario,
    ScenarioSettings,
    Truth,
    best_transform,
    placement_error,
    read_truth,
    simulate_scenario,
    true_vertex_of_nodes,
    true_vertex_of_passes,
    truth_transform,
    write_truth,
)
from topobatch.simulation.truth import WorldChange
from topobatch.topology.errors import DocumentError
from topobatch.topology.se2 import apply, compose, inverse
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


@pytest.mark.parametrize("doc", [[], {"schema": "x"}, {"schema": "topobatch.truth/1", "runs": {}}])
def test_what_is_no_truth_is_refused(doc: object, tmp_path: Path) -> None:
    (tmp_path / "truth.json").write_text(json.dumps(doc))
    with pytest.raises(DocumentError, match=r"truth\.json: "):
        read_truth(tmp_path / "truth.json")


def test_times_belong_to_the_nearest_detected_pass(scenario: Scenario) -> None:
    run = scenario.truth.runs["run1"]
    seen = np.flatnonzero(run.messages > 0)
    middle = (run.start_ns[seen] + run.end_ns[seen]) // 2
    found = true_vertex_of_passes(scenario.truth, "run1", middle)
    np.testing.assert_array_equal(found, run.vertex[seen])
    before = run.start_ns[0] - np.array([10, 2_000_000_000])
    assert true_vertex_of_passes(scenario.truth, "run1", before).tolist() == [run.vertex[0], -1]


def test_transforms_are_those_of_the_first_poses(scenario: Scenario) -> None:
    truth = scenario.truth
    a, b = next(
        (a, b) for a in truth.runs for b in truth.runs if a < b and len(truth.common(a, b)) > 5
    )
    T = truth_transform(truth, a, b)
    np.testing.assert_allclose(
        compose(truth.runs[a].T_world_odom, T)[:2], truth.runs[b].T_world_odom[:2], atol=1e-9
    )
    (alone,) = min(truth.linked(), key=len)
    with pytest.raises(ValueError, match="different worlds"):
        truth_transform(truth, a, alone)


def _map_of(name: str, xy: np.ndarray, nodes: list[int], times_ns: np.ndarray) -> TopoMap:
    """A map without corridors: just its vertices and who was seen where."""
    alone = straight_map(name, xy, [], [(v, 0.0) for v in range(len(xy))])
    return replace(alone, observation_vertex=np.array(nodes), observation_time_ns=times_ns)


def _perfect_map(truth: Truth, name: str, pose: np.ndarray) -> TopoMap:
    """One vertex per world vertex seen, in a frame T_world_map = pose."""
    run = truth.runs[name]
    seen = np.flatnonzero(run.messages > 0)
    vertices = sorted(set(run.vertex[seen].tolist()))
    nodes = [vertices.index(v) for v in run.vertex[seen].tolist()]
    xy = truth.worlds[run.world].xy[vertices]
    return _map_of(name, apply(inverse(pose), xy), nodes, run.start_ns[seen])


def test_nodes_of_a_map_stand_for_vertices(scenario: Scenario) -> None:
    run = scenario.truth.runs["run1"]
    seen = np.flatnonzero(run.messages > 0)[:4]
    vertex, times = run.vertex[seen], run.start_ns[seen]
    assert len(set(vertex.tolist())) > 2
    apart = _map_of("run1", np.eye(4, 2), [0, 1, 2, 3], times)
    assert true_vertex_of_nodes(scenario.truth, apart).tolist() == vertex.tolist()
    fused = _map_of("run1", np.eye(2), [0, 0, 0, 1], times)
    assert true_vertex_of_nodes(scenario.truth, fused).tolist() == [MIXED, vertex[3]]


def test_the_best_transform_lays_perfect_maps_over_one_another() -> None:
    truth = simulate_scenario(ScenarioSettings("maze", 2, 0.5, 30, faults="none", seed=2)).truth
    pose_a, pose_b = np.array([3.0, -2.0, 1.0]), np.array([-7.0, 4.0, -2.5])
    map_a, map_b = _perfect_map(truth, "run1", pose_a), _perfect_map(truth, "run2", pose_b)
    best = best_transform(truth, map_a, map_b)
    np.testing.assert_allclose(best, compose(inverse(pose_a), pose_b), atol=1e-9)
    assert placement_error(truth, map_a, map_b, best) == pytest.approx((0.0, 0.0), abs=1e-9)
    moved = compose(np.array([0.3, 0.4, 0.0]), best)
    assert placement_error(truth, map_a, map_b, moved) == pytest.approx((0.5, 0.0), abs=1e-9)
    turned = best + np.array([0.0, 0.0, 0.1])
    assert placement_error(truth, map_a, map_b, turned)[1] == pytest.approx(0.1)
