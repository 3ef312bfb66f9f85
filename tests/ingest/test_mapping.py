"""The whole chain from a run to its map, on simulated runs with their truth."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from topobatch.ingest.mapping import build_map
from topobatch.ingest.mapping_settings import MappingSettings
from topobatch.simulation.scenario import simulate_scenario
from topobatch.simulation.settings import ScenarioSettings
from topobatch.simulation.truth import MIXED, true_vertex_of_nodes
from topobatch.topology.document import map_from_document, map_to_document
from topobatch.topology.errors import DataError
from topobatch.topology.odometry import Odometry
from topobatch.topology.ragged import Ragged
from topobatch.topology.run import Detections, Run
from topobatch.topology.se2 import compose


@pytest.fixture(scope="module")
def scenario():
    return simulate_scenario(
        ScenarioSettings("maze", runs=1, junctions_per_run=25, drift="mid", faults="mild", seed=3)
    )


@pytest.fixture(scope="module")
def run(scenario):
    (name,) = scenario.runs
    return scenario.runs[name]


@pytest.fixture(scope="module")
def topomap(run):
    return build_map(run)


@pytest.mark.parametrize("world", ["office", "organic"])
def test_maps_of_other_worlds_are_consistent(world):
    scenario = simulate_scenario(
        ScenarioSettings(world, runs=1, junctions_per_run=25, drift="high", faults="mild", seed=5)
    )
    (name,) = scenario.runs
    topomap = build_map(scenario.runs[name])
    label = true_vertex_of_nodes(scenario.truth, topomap)
    real = label[label >= 0]
    assert MIXED not in label
    assert len(set(real.tolist())) == len(real)


@pytest.mark.parametrize("world", ["maze", "city"])
def test_corridors_are_as_long_as_those_of_the_world(world):
    """A centre is seen to 0.04 m, so a length to 0.05 m; what a robot drives misses by 0.15 m."""
    scenario = simulate_scenario(
        ScenarioSettings(world, runs=1, junctions_per_run=25, drift="none", faults="none", seed=2)
    )
    ((name, run),) = scenario.runs.items()
    topomap, truth = build_map(run), scenario.truth
    there = truth.worlds[truth.runs[name].world]
    label = true_vertex_of_nodes(truth, topomap)
    ends = [
        tuple(sorted(p)) for p in zip(there.source.tolist(), there.target.tolist(), strict=True)
    ]
    mine = np.sort(label[np.column_stack([topomap.source, topomap.target])], axis=1)
    known = [k for k, pair in enumerate(mine.tolist()) if ends.count(tuple(pair)) == 1]
    true = there.length[[ends.index(tuple(mine[k].tolist())) for k in known]]
    off = topomap.length[known] - true
    assert len(known) >= 20
    assert np.sqrt(np.mean(off**2)) < 0.075
    assert np.mean(np.abs(off) < topomap.length_sigma[known]) > 0.5
    assert np.mean(np.abs(off) < 3 * topomap.length_sigma[known]) > 0.95


def test_the_document_tells_how_the_map_was_made(run, topomap):
    document = map_to_document(topomap)
    graph = json.loads(json.dumps(document, allow_nan=False))["graph"]
    assert graph["settings"]["closure"] == "full"
    assert set(graph["calibration"]) == {
        "bias_rad_per_m", "turn_scale", "lag_s", "length_scale", "lever_x_m", "lever_y_m",
    }  # fmt: skip
    assert graph["warnings"] == list(run.warnings)
    assert graph["noise"]["centre_m"] > 0
    assert any(c["accepted"] for c in graph["closures"])
    assert all(c["reason"] and np.isfinite(c["bits"]) for c in graph["closures"])
    assert map_to_document(map_from_document(document)) == document


@pytest.mark.parametrize(
    ("factor", "told"), [(1.04, None), (1.12, " % too long"), (0.9, " % too short")]
)
def test_lengths_that_are_corrected_by_much_are_warned_of(run, topomap, factor, told):
    wrong = replace(run.odometry, pose=run.odometry.pose * [factor, factor, 1.0])
    corrected = build_map(replace(run, odometry=wrong))
    warnings = corrected.info["warnings"][len(run.warnings) :]
    assert [told in warning for warning in warnings] == ([] if told is None else [True])
    here, there = (np.hypot(*(m.xy - m.xy.mean(axis=0)).T).mean() for m in (topomap, corrected))
    assert there == pytest.approx(here, rel=0.02)


def test_without_closure_every_pass_is_a_vertex(run, topomap):
    open_map = build_map(run, MappingSettings(closure="none"))
    assert len(open_map) > len(topomap)
    assert not open_map.closures
    assert np.bincount(open_map.observation_vertex).max() == 1


def test_a_run_without_passes_is_named():
    nothing = Detections(np.zeros(0, np.int64), np.zeros((0, 2)), Ragged.from_rows([]))
    none = Odometry(np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros(0, np.int64))
    track = Odometry(np.arange(5) * 10**9, np.zeros((5, 3)), np.zeros(0, np.int64))
    late = Detections(np.array([10**12]), np.zeros((1, 2)), Ragged.from_rows([[0.0]]))
    for odometry, detections, word in (
        (none, late, "odometry"),
        (track, nothing, "no junction"),
        (track, late, "clocks"),
    ):
        with pytest.raises(DataError, match=f"run lost: .*{word}"):
            build_map(Run("lost", odometry, detections))


def test_a_broken_odometry_gives_pieces(run):
    middle = len(run.odometry) // 2
    pose = run.odometry.pose.copy()
    pose[middle:] = compose(np.array([5.0, 5.0, 1.0]), pose[middle:])
    broken = replace(run, odometry=replace(run.odometry, pose=pose, breaks=np.array([middle])))
    topomap = build_map(broken)
    assert topomap.info["pieces"] == 2
    early = topomap.observation_time_ns < run.odometry.time_ns[middle]
    vertex = topomap.observation_vertex
    assert set(vertex[early].tolist()).isdisjoint(vertex[~early].tolist())
    assert not np.any(
        np.isin(topomap.source, vertex[early]) != np.isin(topomap.target, vertex[early])
    )


def test_a_parked_robot_is_told_that_it_does_not_move():
    rng = np.random.default_rng(0)
    pose = rng.normal(0, 0.01, (100, 3))
    still = Odometry(np.arange(100) * 10**8, pose, np.zeros(0, np.int64))
    seen = Detections(
        np.arange(20) * 10**8 + 10**9,
        np.where(np.arange(20) % 2, 5.0, -5.0)[:, None] * [1.0, 0.0],
        Ragged.from_rows([[0.0, 2.0]] * 20),
    )
    with pytest.raises(DataError, match="run parked: the odometry does not move"):
        build_map(Run("parked", still, seen))
