"""Jumps of unknown size, told by the places seen before and after."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from topobatch.ingest.mapping import build_map, dead_reckoned
from topobatch.ingest.odometry.bridging import confirmed
from topobatch.ingest.odometry.track import sane_track
from topobatch.simulation.scenario import simulate_scenario
from topobatch.simulation.settings import DRIFTS, ScenarioSettings
from topobatch.simulation.truth import true_vertex_of_passes
from topobatch.topology.se2 import between, compose


def simulated(seed=5, **jump):
    """Truth and run as read from its log."""
    drift = replace(DRIFTS["low"], **jump)
    scenario = simulate_scenario(
        ScenarioSettings("organic", runs=1, junctions_per_run=16, drift=drift, seed=seed)
    )
    (run,) = scenario.runs.values()
    return scenario.truth, as_read(run, run.odometry.pose)


def as_read(run, pose):
    track = sane_track(run.odometry.time_ns, pose, "odom", "base_link")
    return replace(run, odometry=track.odometry, warnings=track.warnings)


def split_and_mixed(truth, run, topomap):
    """Junctions that stand twice in the map, and vertices that hold two."""
    true = true_vertex_of_passes(truth, run.name, topomap.observation_time_ns)
    pairs = {(v, n) for v, n in zip(true, topomap.observation_vertex, strict=True) if v >= 0}
    vertices, nodes = {v for v, _ in pairs}, {n for _, n in pairs}
    return len(pairs) - len(nodes), len(pairs) - len(vertices)


@pytest.mark.parametrize(("metres", "degrees"), [(0.2, 8.0), (2.0, 90.0)])
def test_a_jump_costs_no_revisit(metres, degrees):
    truth, run = simulated(jumps=1, jump_m=metres, jump_deg=degrees)
    assert len(run.odometry.jumps) == 1
    topomap = build_map(run)
    assert topomap.pieces == 1
    assert split_and_mixed(truth, run, topomap) == (0, 0)
    (told,) = topomap.info["jumps"]
    assert told["time_ns"] == truth.runs[run.name].jump_ns[0]
    assert told["shift_m"] == pytest.approx(metres, abs=0.05)
    assert np.degrees(told["turn_rad"]) == pytest.approx(degrees, abs=3.0)
    assert told["split"] is False


def unrevisited(truth, run):
    """The run up to the first revisit of a junction, and a row about the middle of it."""
    of_run = truth.runs[run.name]
    vertex = of_run.vertex[of_run.messages > 0].tolist()
    again = next(k for k, v in enumerate(vertex) if v in vertex[:k])
    assert again >= 4
    start_ns = of_run.start_ns[of_run.messages > 0]
    ends = np.searchsorted(run.odometry.time_ns, start_ns[[again // 2, again]])
    return int(ends[0]) - 20, int(ends[1])


def jumped(truth, run, jump):
    """The run before any revisit, with one jump [m, m, rad]."""
    row, end = unrevisited(truth, run)
    time_ns, pose = run.odometry.time_ns[:end], run.odometry.pose[:end].copy()
    pose[row:] = compose(compose(pose[row], jump), between(pose[row], pose[row:]))
    track = sane_track(time_ns, pose, "odom", "base_link")
    assert track.odometry.jumps.tolist() == [row]
    return replace(run, odometry=track.odometry)


def test_a_large_jump_that_no_place_tells_splits_the_chain():
    truth, run = simulated()
    topomap = build_map(jumped(truth, run, [1.0, 1.0, 1.2]))
    assert topomap.pieces == 2
    (told,) = topomap.info["jumps"]
    assert told["split"] is True
    assert "the chain is split there" in topomap.info["warnings"][-1]


def test_a_step_that_its_places_do_not_confirm_is_broken_up():
    _, run = simulated(jumps=1, jump_m=0.47, jump_deg=50.0)
    run, odometry, reckoning, _ = dead_reckoned(run)
    past = np.searchsorted(reckoning.passes.time_ns, odometry.time_ns[odometry.jumps[0]])
    for shared, breaks in ((0, odometry.jumps.tolist()), (1, odometry.jumps.tolist()), (2, [])):
        place = np.arange(len(reckoning))
        place[past : past + shared] = place[:shared]
        assert confirmed(odometry, odometry, reckoning, place).breaks.tolist() == breaks
    small = replace(odometry, jump_sigma=odometry.jump_sigma / 10)
    assert confirmed(small, small, reckoning, np.arange(len(reckoning))).breaks.tolist() == []


def test_a_small_jump_that_no_place_tells_makes_its_corridor_uncertain():
    truth, run = simulated()
    topomap = build_map(jumped(truth, run, [0.5, 0.5, 0.1]))
    assert topomap.pieces == 1
    assert topomap.info["jumps"][0]["split"] is False
    assert topomap.length_sigma.max() == pytest.approx(np.hypot(0.5, 0.5), abs=0.1)
    assert np.sort(topomap.length_sigma)[-2] < 0.5
