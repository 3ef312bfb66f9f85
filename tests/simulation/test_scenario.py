"""Simulated runs against the truth that comes with them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from topobatch.simulation import (
    DRIFTS,
    FAULTS,
    MIXED,
    Drift,
    Faults,
    RunSettings,
    Scenario,
    ScenarioSettings,
    SimulatedRun,
    Truth,
    WalkSettings,
    World,
    best_transform,
    joined,
    make_world,
    placement_error,
    read_truth,
    simulate_run,
    simulate_scenario,
    true_vertex_of_nodes,
    true_vertex_of_passes,
    truth_transform,
    write_truth,
)
from topobatch.simulation.chance import Chance, quantised
from topobatch.simulation.truth import truth_from_document
from topobatch.simulation.walk import explore
from topobatch.simulation.world import polyline_heading
from topobatch.topology.errors import DocumentError, UsageError
from topobatch.topology.ragged import Ragged
from topobatch.topology.se2 import apply, between, compose, fit_rigid, inverse, wrap
from topobatch.topology.topomap import TopoMap

KINDS = ("maze", "office", "organic", "city", "rows", "tiles")
PERFECT = RunSettings(drift=DRIFTS["none"], faults=Faults(0.0, 0.0, 0.0))


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return simulate_scenario(
        ScenarioSettings("maze", 3, unrelated_runs=1, junctions_per_run=20, seed=3)
    )


# --- random numbers ----------------------------------------------------------------------------


def test_chance_gives_these_very_numbers_everywhere() -> None:
    chance = Chance("stream", 7)
    assert chance.uniform(0.0, 1.0, 2).tolist() == [0.7755066270170754, 0.9767604405301428]
    assert Chance("stream", 7).normal(1.0, 2).tolist() == pytest.approx(
        [0.7571053551509976, 1.991016084793955], abs=1e-9
    )


def test_chance_has_the_distributions_it_names() -> None:
    chance = Chance(1)
    normal = chance.normal(2.0, 20_000)
    assert abs(normal.mean()) < 0.06
    assert normal.std() == pytest.approx(2.0, rel=0.03)
    assert np.bincount([chance.weighted_index(np.array([0, 3.0, 1])) for _ in range(400)])[0] == 0
    assert sorted(chance.order(9).tolist()) == list(range(9))


def test_quantised_sums_are_exact() -> None:
    values = quantised(Chance(2).uniform(-1.0, 1.0, 1000), 20)
    assert np.sum(values[::-1]) == np.sum(values) == sum(values.tolist())


# --- worlds ------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("junctions", [15, 120])
def test_worlds_are_connected_and_of_the_size_asked(kind: str, junctions: int) -> None:
    world = make_world(kind, junctions, seed=4, aspect=2.0)
    assert abs(len(world) - junctions) <= max(0.15 * junctions, 25 if kind == "office" else 8)
    legs, _ = explore(world, set(range(len(world))), WalkSettings(1.0), Faults(), Chance(1))
    assert {leg.target for leg in legs} | {legs[0].source} == set(range(len(world)))
    assert np.all(world.length > 2.0)
    np.testing.assert_array_equal(world.branches.counts > 0, True)


@pytest.mark.parametrize("kind", ["maze", "office"])
def test_mazes_and_offices_turn_at_right_angles(kind: str) -> None:
    headings = make_world(kind, 80, seed=1).branches.values
    assert np.max(np.abs(wrap(4 * headings))) < 1e-6


def test_streets_leave_a_junction_apart_and_bend_without_one() -> None:
    world = make_world("organic", 150, seed=2)
    rows = [np.sort(world.branches[v]) for v in range(len(world))]
    gaps = [np.min(np.diff(np.append(r, r[0] + 2 * np.pi))) for r in rows if len(r) > 1]
    assert min(gaps) > np.radians(35)
    assert np.count_nonzero(world.branches.counts == 2) < 4
    assert any(len(path) > 2 for path in world.paths)


def test_city_blocks_are_square_at_every_crossing_and_not_as_a_whole() -> None:
    world = make_world("city", 120, seed=2)
    rows = [world.branches[v] for v in range(len(world))]
    square = [np.abs(wrap(4 * np.diff(r))) / 4 for r in rows if len(r) > 1]
    assert np.quantile(np.concatenate(square), 0.9) < np.radians(15)
    whole = np.abs(np.exp(4j * world.branches.values).mean())
    alone = np.mean([np.abs(np.exp(4j * r).mean()) for r in rows])
    assert alone > 0.9
    assert whole < 0.8


def test_wings_of_an_office_repeat_one_plan() -> None:
    world = make_world("office", 200, seed=5)
    degree = world.branches.counts
    assert np.count_nonzero(degree == 1) > 40
    assert np.std(world.length[np.abs(world.length - 4.2) < 0.5]) < 0.15


def test_worlds_of_tiles_repeat_each_other() -> None:
    worlds = [make_world("tiles", 100, seed) for seed in (1, 2)]
    assert worlds[0].xy.shape != worlds[1].xy.shape
    lengths = [set(np.round(world.length, 6)) for world in worlds]
    assert len(lengths[0] & lengths[1]) > 0.7 * min(map(len, lengths))
    for world in worlds:
        np.testing.assert_array_equal(world.xy % 5.0, 0.0)
        assert np.mean(world.branches.counts >= 3) > 0.5


def test_rows_are_equal() -> None:
    world = make_world("rows", 80, seed=3)
    along = np.isclose(np.abs(np.sin([polyline_heading(p) for p in world.paths])), 1.0)
    assert np.count_nonzero(along) > 20
    np.testing.assert_allclose(world.length[along] / 30.0, np.rint(world.length[along] / 30.0))
    step = world.length[~along] / 3.0
    assert np.abs(step - np.rint(step)).max() < 0.15


# --- scenarios ---------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("overlap", [0.0, 0.3, 0.7])
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


def test_scattered_runs_lie_in_one_world() -> None:
    s = ScenarioSettings("organic", 6, layout="scatter", junctions_per_run=20, seed=2)
    truth = simulate_scenario(s).truth
    assert len(truth.worlds) == 1
    assert all(12 <= len(run.detected) <= 26 for run in truth.runs.values())


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


def test_scenarios_join_unless_names_collide(scenario: Scenario) -> None:
    streets = simulate_scenario(ScenarioSettings("organic", runs=1, prefix="streets-", seed=3))
    both = joined(scenario, streets)
    assert list(both.runs) == ["run1", "run2", "run3", "run4", "streets-1"]
    assert len(both.truth.linked()) == 3
    with pytest.raises(UsageError, match="same name"):
        joined(scenario, scenario)


@pytest.mark.parametrize(
    "wrong",
    [
        {"world": "castle"},
        {"runs": 0},
        {"overlap": 1.0},
        {"overlap": -0.1},
        {"drift": "huge"},
        {"faults": "some"},
        {"layout": "ring"},
        {"junctions_per_run": 2},
        {"odometry_hz": 0.0},
        {"detector_hz": 1e9},
        {"prefix": "a/b"},
        {"prefix": ""},
        {"seed": -1},
    ],
)
def test_nonsense_is_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(UsageError):
        ScenarioSettings(**wrong)  # type: ignore[arg-type]


def test_too_small_a_world_is_refused() -> None:
    with pytest.raises(UsageError, match="no room"):
        simulate_scenario(ScenarioSettings("maze", 5, 0.1, 40, world_junctions=50))


@pytest.mark.parametrize("wrong", [{"scale_sigma": -1.0}, {"heading_jump_deg": float("nan")}])
def test_nonsensical_drift_is_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(UsageError, match="drift"):
        Drift(**wrong)


@pytest.mark.parametrize("wrong", [{"centre_m": -1.0}, {"phantom_rate": 1.5}])
def test_nonsensical_faults_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(UsageError, match="faults"):
        Faults(**wrong)


# --- runs --------------------------------------------------------------------------------------


def _truth_of(simulated: SimulatedRun, world: World) -> Truth:
    return Truth({simulated.truth.world: world}, {simulated.truth.name: simulated.truth})


def _unmatched(seen: np.ndarray, want: np.ndarray) -> float:
    """Largest angle from a heading seen to the nearest one wanted; infinite if counts differ."""
    if len(seen) != len(want):
        return np.inf
    return float(np.max(np.min(np.abs(wrap(seen[:, None] - want[None, :])), axis=1)))


@pytest.mark.parametrize("kind", KINDS)
def test_without_noise_everything_is_where_the_world_says(kind: str) -> None:
    world = make_world(kind, 40, seed=6)
    simulated = simulate_run(world, settings=PERFECT, seed=6)
    run, truth = simulated.run, _truth_of(simulated, world)
    T_world_base = compose(simulated.truth.T_world_odom, run.odometry.at(run.detections.time_ns))
    centre = apply(T_world_base, run.detections.centre)
    vertex = true_vertex_of_passes(truth, "run", run.detections.time_ns)
    assert np.max(np.hypot(*(centre - world.xy[vertex]).T)) < 0.02
    for row in range(0, len(run.detections), 7):
        turned = run.detections.branches[row] + T_world_base[row, 2]
        assert _unmatched(turned, world.branches[int(vertex[row])]) < 0.02


def test_without_drift_odometry_is_the_true_path() -> None:
    simulated = simulate_run(make_world("organic", 40, 1), settings=PERFECT, seed=1)
    poses = compose(
        simulated.truth.T_world_odom, simulated.run.odometry.at(simulated.truth.path_ns)
    )
    off = poses - simulated.truth.path
    assert np.max(np.hypot(off[:, 0], off[:, 1])) < 0.01
    assert np.max(np.abs(wrap(off[:, 2]))) < 1e-3


def test_speeds_are_those_of_the_poses() -> None:
    simulated = simulate_run(make_world("maze", 30, 2), settings=PERFECT, seed=1)
    odometry = simulated.run.odometry
    period = np.diff(odometry.time_ns) * 1e-9
    turning = wrap(np.diff(odometry.pose[:, 2])) / period
    np.testing.assert_allclose(turning, simulated.twist[:-1, 1], atol=2e-3)
    assert np.max(np.abs(simulated.twist[:, 0])) < 1.5


def _drifted(**drift: float) -> SimulatedRun:
    return simulate_run(make_world("maze", 40, 3), settings=replace(PERFECT, drift=Drift(**drift)))


def _turned_deg(simulated: SimulatedRun) -> float:
    return float(np.degrees(np.sum(simulated.run.odometry.turn_rad)))


def test_a_heading_bias_grows_with_the_way() -> None:
    way = _drifted().run.odometry.step_m.sum()
    lost = _turned_deg(_drifted()) - _turned_deg(_drifted(heading_bias_deg_per_m=3.0))
    assert lost == pytest.approx(3.0 * way, rel=0.01)


def test_heading_jumps_are_where_the_truth_says() -> None:
    plain, struck = _drifted(), _drifted(heading_jumps_per_100_m=2.0, heading_jump_deg=20.0)
    difference = struck.run.odometry.turn_rad - plain.run.odometry.turn_rad
    rows = np.flatnonzero(np.abs(difference) > np.radians(1.0))
    jump_ns = struck.run.odometry.time_ns[rows].tolist()
    assert len(jump_ns) >= 2
    assert set(jump_ns) <= set(struck.truth.jump_ns)


def test_a_reset_starts_again_from_zero_and_breaks_the_track() -> None:
    broken = _drifted(resets_per_100_m=1.0)
    odometry = broken.run.odometry
    assert len(odometry.breaks) >= 1
    np.testing.assert_array_equal(odometry.pose[odometry.breaks], 0.0)
    assert odometry.time_ns[odometry.breaks].tolist() == list(broken.truth.break_ns)
    assert odometry.step_m.sum() == pytest.approx(_drifted().run.odometry.step_m.sum(), rel=1e-3)


def test_sideways_slip_moves_the_robot_in_turns_only() -> None:
    plain, slipped = (
        simulate_run(make_world("organic", 30, 3), settings=replace(PERFECT, drift=Drift(**d)))
        for d in ({}, {"sideways_slip_m_per_rad": 0.3})
    )
    off = np.diff(slipped.run.odometry.pose[:, :2] - plain.run.odometry.pose[:, :2], axis=0)
    moved = np.hypot(*off.T)
    assert moved[np.abs(plain.run.odometry.turn_rad[1:]) < 1e-4].max(initial=0.0) < 1e-4
    assert moved.sum() > 1.0


def test_drift_levels_differ() -> None:
    def error(level: str) -> float:
        settings = RunSettings(drift=DRIFTS[level], faults=FAULTS["none"])
        simulated = simulate_run(make_world("maze", 60, 9), settings=settings, seed=3)
        raw = simulated.run.odometry.at(simulated.truth.path_ns)[:, :2]
        true = simulated.truth.path[:, :2]
        off = true - apply(fit_rigid(true, raw), raw)
        return float(np.sqrt(np.mean(np.sum(off**2, axis=1))))

    assert error("none") < 0.01 < error("low") < error("mid") < error("high")


def test_lag_shifts_the_stamps_of_detections() -> None:
    plain, late = (
        simulate_run(make_world("maze", 30, 1), settings=replace(PERFECT, faults=faults))
        for faults in (PERFECT.faults, replace(PERFECT.faults, lag_s=0.25))
    )
    shift = late.run.detections.time_ns - plain.run.detections.time_ns
    np.testing.assert_array_equal(shift, 250_000_000)
    np.testing.assert_array_equal(late.run.detections.centre, plain.run.detections.centre)
    np.testing.assert_array_equal(late.truth.start_ns - plain.truth.start_ns, 250_000_000)


def test_closed_doors_are_neither_seen_nor_driven() -> None:
    world = make_world("office", 80, 2)
    shut = simulate_run(
        world, settings=replace(PERFECT, faults=Faults(0.0, 0.0, 0.0, closed_share=0.2)), seed=5
    )
    truth = shut.truth
    assert len(truth.closed_edges) > 3
    assert not set(truth.closed_edges) & set(truth.drive_edge.tolist())
    counts = shut.run.detections.branches.counts
    vertex = true_vertex_of_passes(_truth_of(shut, world), "run", shut.run.detections.time_ns)
    missing = np.bincount(
        np.concatenate([world.source, world.target])[
            np.tile(np.isin(np.arange(len(world.source)), truth.closed_edges), 2)
        ],
        minlength=len(world),
    )
    np.testing.assert_array_equal(counts, (world.branches.counts - missing)[vertex])


def test_faults_come_at_their_rates() -> None:
    faults = Faults(
        missed_pass_rate=0.2, wrong_pass_rate=0.1, phantom_rate=0.2, wrong_message_rate=0.1
    )
    world = make_world("maze", 150, 4)
    simulated = simulate_run(world, settings=replace(PERFECT, faults=faults), seed=2)
    truth = simulated.truth
    visits = np.count_nonzero(truth.vertex >= 0)
    assert truth.fault.count("missed") / visits == pytest.approx(0.2, abs=0.06)
    assert truth.fault.count("wrong pass") / visits == pytest.approx(0.08, abs=0.05)
    assert truth.fault.count("phantom") > 10
    assert all(
        (m == 0) == (f == "missed") for m, f in zip(truth.messages, truth.fault, strict=True)
    )
    vertex = true_vertex_of_passes(_truth_of(simulated, world), "run", truth.start_ns)
    right = [f == "" for f in truth.fault]
    np.testing.assert_array_equal(vertex[right], truth.vertex[right])


def test_turning_back_is_driven_but_no_corridor() -> None:
    world = make_world("maze", 60, 4)
    faults = replace(PERFECT.faults, turn_back_rate=0.5)
    back = simulate_run(world, settings=replace(PERFECT, faults=faults), seed=2)
    straight = simulate_run(world, settings=PERFECT, seed=2)
    assert back.run.odometry.step_m.sum() > 1.1 * straight.run.odometry.step_m.sum()
    np.testing.assert_array_equal(back.truth.drive_edge, straight.truth.drive_edge)
    off = compose(back.truth.T_world_odom, back.run.odometry.at(back.truth.path_ns))
    assert np.max(np.hypot(*(off - back.truth.path)[:, :2].T)) < 0.01


def test_passes_do_not_overlap_and_drives_join_passes() -> None:
    simulated = simulate_run(make_world("organic", 40, 4), settings=PERFECT, seed=2)
    truth = simulated.truth
    assert np.all(truth.start_ns < truth.end_ns)
    assert np.all(truth.start_ns[1:] >= truth.end_ns[:-1])
    assert np.all(truth.drive_start_ns < truth.drive_end_ns)
    assert np.all(truth.drive_start_ns[1:] >= truth.drive_end_ns[:-1])


def test_a_region_without_corridors_is_refused() -> None:
    with pytest.raises(UsageError, match="no corridor"):
        simulate_run(make_world("maze", 20, 1), {0})


@settings(max_examples=12)
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


# --- the truth ---------------------------------------------------------------------------------


def test_truth_survives_its_document(scenario: Scenario, tmp_path: Path) -> None:
    write_truth(tmp_path / "truth.json", scenario.truth)
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
    write_truth(tmp_path / "again.json", again)
    assert (tmp_path / "again.json").read_bytes() == (tmp_path / "truth.json").read_bytes()


@pytest.mark.parametrize("doc", [[], {"schema": "x"}, {"schema": "topobatch.truth/1", "runs": {}}])
def test_what_is_no_truth_is_refused(doc: object) -> None:
    with pytest.raises(DocumentError):
        truth_from_document(doc)


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
    none = np.zeros(0, np.int64)
    return TopoMap(
        run=name,
        frame="odom",
        xy=xy,
        branches=Ragged.from_rows([[0.0]] * len(xy)),
        kind=("junction",) * len(xy),
        source=none,
        target=none,
        source_branch=none,
        target_branch=none,
        length=none.astype(float),
        length_sigma=none.astype(float),
        traversals=none,
        paths=(),
        observation_vertex=np.array(nodes),
        observation_time_ns=times_ns,
    )


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


def test_the_frame_jumps_where_the_truth_says_and_as_far() -> None:
    plain, struck = _drifted(), _drifted(jumps=2, jump_m=0.7, jump_deg=40.0)
    seen, true = struck.run.odometry, plain.run.odometry
    rows = np.searchsorted(seen.time_ns, struck.truth.jump_ns)
    assert len(rows) == 2
    step = between(seen.pose[rows - 1], seen.pose[rows])
    off = step - between(true.pose[rows - 1], true.pose[rows])
    np.testing.assert_allclose(np.hypot(off[:, 0], off[:, 1]), 0.7, atol=1e-3)
    np.testing.assert_allclose(np.abs(np.degrees(off[:, 2])), 40.0, atol=1e-2)
    others = np.delete(np.arange(1, len(seen)), rows - 1)
    turned = wrap(seen.turn_rad - true.turn_rad)[others]
    np.testing.assert_allclose(turned, 0.0, atol=1e-3)
    assert struck.truth.vertex.tolist() == plain.truth.vertex.tolist()
