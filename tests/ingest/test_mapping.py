"""The whole chain from a run to its map, on simulated runs with their truth."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from topobatch.ingest.grid_log import GridLog
from topobatch.ingest.mapping import build_map, map_of_log, require_junctions
from topobatch.ingest.mapping_settings import MappingSettings
from topobatch.simulation import (
    MIXED,
    ScenarioSettings,
    simulate_scenario,
    true_vertex_of_nodes,
)
from topobatch.topology.closure import resolution
from topobatch.topology.document import map_from_document, map_to_document
from topobatch.topology.errors import DataError
from topobatch.topology.odometry import Odometry
from topobatch.topology.ragged import Ragged
from topobatch.topology.run import Detections, Grid, Run, Scanned, ScanPasses
from topobatch.topology.se2 import apply, compose
from topobatch.topology.topomap import RunNoise


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


@pytest.mark.parametrize("sign", [1, -1])
def test_detections_that_are_misread_correct_no_lengths(run, sign):
    seen = replace(run.detections, centre=run.detections.centre * [1, sign])
    told = build_map(replace(run, detections=seen)).info
    assert "length_scale" in told["calibration"]
    unknown = build_map(replace(run, detections=seen, misread=True))
    assert "length_scale" not in unknown.info["calibration"]
    assert unknown.info["warnings"] == []
    assert unknown.noise.scale > 0


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


def test_the_frame_of_the_odometry_does_not_matter(run, topomap):
    T = np.array([40.0, -12.0, -2.0])
    odometry = replace(run.odometry, pose=compose(T, run.odometry.pose))
    moved = build_map(replace(run, odometry=odometry))
    assert moved.observation_vertex.tolist() == topomap.observation_vertex.tolist()
    # Outliers are told by medians per axis of the odometry's frame: centres differ a little.
    np.testing.assert_allclose(apply(T, topomap.xy), moved.xy, atol=0.05)
    np.testing.assert_allclose(np.sort(topomap.length), np.sort(moved.length), atol=0.02)


def test_without_closure_every_pass_is_a_vertex(run, topomap):
    open_map = build_map(run, MappingSettings(closure="none"))
    gated = build_map(run, MappingSettings(closure="gated"))
    assert len(open_map) > len(gated) > len(topomap)
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


@pytest.mark.parametrize("mapped", [map_of_log, require_junctions])
def test_what_gives_no_map_tells_the_faults_of_its_log(mapped):
    """They may be the reason."""
    moving = np.linspace(0.0, 9.0, 100)[:, None] * [1.0, 0.0, 0.0]
    odometry = Odometry(np.arange(100) * 10**8, moving, np.zeros(0, np.int64))
    late = Detections(
        np.arange(20) * 10**8 + 10**12, np.zeros((20, 2)), Ragged.from_rows([[0.0, 2.0]] * 20)
    )
    faults = ("half of it is gone",)
    with pytest.raises(DataError, match=r"check the clocks .*; half of it is gone"):
        mapped(Run("late", odometry, late, {}, faults))
    still = replace(odometry, pose=np.zeros((100, 3)))
    seen = replace(late, time_ns=late.time_ns - 10**12)
    with pytest.raises(DataError, match=r"does not move: .*; half of it is gone"):
        mapped(Run("parked", still, seen, {}, faults))
    closed = Grid(np.zeros((9, 9), bool), np.zeros((9, 9), bool), 0.05, (0.0, 0.0, 0.0), "map")
    with pytest.raises(DataError, match=r"shows no junction and no room; .*; half of it is gone"):
        mapped(GridLog("floor", closed, {}, faults))


def test_a_reset_is_no_drive():
    pose = np.repeat([[8.0, 0.0, 1.6], [0.0, 0.0, 0.0]], 50, axis=0)
    seen = Detections(
        np.arange(20) * 10**8 + 10**9, np.zeros((20, 2)), Ragged.from_rows([[0.0, 2.0]] * 20)
    )
    parked = Odometry(np.arange(100) * 10**8, pose, np.array([50]))
    with pytest.raises(DataError, match=r"does not move: .* m between its resets; nothing"):
        build_map(Run("parked", parked, seen))


def test_a_robot_that_stands_most_of_the_time():
    """Most of its legs have no length at all: two junctions come into view in turn."""
    pose = np.zeros((200, 3))
    pose[190:, 0] = np.linspace(0.0, 3.0, 10)
    odometry = Odometry(np.arange(200) * 10**8, pose, np.zeros(0, np.int64))
    seen = Detections(
        np.arange(60) * 3 * 10**8,
        np.where(np.arange(60) // 6 % 2, 5.0, -5.0)[:, None] * [1.0, 0.0],
        Ragged.from_rows([[0.0, 2.0]] * 60),
    )
    topomap = build_map(Run("stands", odometry, seen))
    assert len(topomap) >= 1
    assert np.isfinite(topomap.xy).all()


def test_the_least_of_runs():
    pose = np.tile([1.0, 2.0, 0.3], (100, 1))
    pose[-20:, :2] += np.linspace(0, 1, 20)[:, None] * [1.0, 0.5]
    odometry = Odometry(np.arange(100) * 10**8, pose, np.zeros(0, np.int64))
    seen = Detections(
        np.arange(20) * 10**8 + 10**9, np.zeros((20, 2)), Ragged.from_rows([[0.0, 2.0]] * 20)
    )
    topomap = build_map(Run("still", odometry, seen))
    assert len(topomap) == 1
    assert len(topomap.source) == 0
    assert topomap.kind == ("bend",)
    np.testing.assert_allclose(topomap.xy, [[1.0, 2.0]], atol=1e-9)
    np.testing.assert_allclose(topomap.branches[0], [0.3, 2.3], atol=1e-9)


def scanned_there_and_back(off_m):
    """A run along a corridor with two crossings and back, by scans; on the way back the second
    crossing shows otherwise: with other branches, `off_m` further on."""
    x = np.concatenate([np.arange(0, 20, 0.1), np.arange(20, 0, -0.1)])
    pose = np.column_stack([x, np.zeros(len(x)), np.where(np.arange(len(x)) < 200, 0.0, np.pi)])
    odometry = Odometry(np.arange(len(x)) * 10**8, pose, np.zeros(0, np.int64))
    rows = np.array([50, 150, round(400 - 10 * (15 + off_m)), 350])
    ways = np.radians([[0, 90, 180], [0, 90, 180], [0, 45, 180], [0, 90, 180]])
    branches = Ragged.from_rows(w - t for w, t in zip(ways, pose[rows, 2], strict=True))
    passes = ScanPasses(
        time_ns=odometry.time_ns[rows],
        start_ns=odometry.time_ns[rows],
        end_ns=odometry.time_ns[rows],
        centre=np.zeros((4, 2)),
        branches=branches,
        support=Ragged(branches.offsets, np.ones(len(branches.values))),
        confidence=np.array([1.0, 1.0, 5 / 7, 1.0]),
        windows=np.full(4, 4),
        clearance_m=np.ones(4),
        shared_m=np.zeros(4),
        resolution_m=1.3,
    )
    none = Detections(np.zeros(0, np.int64), np.zeros((0, 2)), Ragged.from_rows([]))
    noise = RunNoise(along_m_per_sqrt_m=0.005, heading_rad_per_sqrt_m=0.002)
    return Run("scans", odometry, none, scanned=Scanned(passes, noise, 6.0))


def test_what_scans_show_otherwise_at_one_place_is_one_place_in_doubt():
    topomap = build_map(scanned_there_and_back(0.6))
    assert topomap.observation_vertex.tolist() == [0, 1, 1, 0]
    assert topomap.confidence.tolist() == [1.0, 0.5]
    np.testing.assert_allclose(topomap.branches[1], np.radians([-180, 0, 90]), atol=0.02)
    assert 10.1 < np.hypot(*(topomap.xy[1] - topomap.xy[0])) < 10.5
    assert topomap.traversals.tolist() == [2]
    (joined,) = (c for c in topomap.closures if c.reason == resolution.REASON)
    assert joined.accepted
    assert not topomap.shows_bends
    assert map_from_document(map_to_document(topomap)).confidence.tolist() == [1.0, 0.5]


def test_places_that_scans_tell_apart_and_maps_without_closure_keep_them():
    assert len(build_map(scanned_there_and_back(2.0))) == 3
    apart = build_map(scanned_there_and_back(0.6), MappingSettings(closure="none"))
    assert len(apart) == 4
    assert apart.closures == ()
