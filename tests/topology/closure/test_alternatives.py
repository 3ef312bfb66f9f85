"""Closures of one run that compete."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from topobatch.ingest.mapping import build_map
from topobatch.simulation import ScenarioSettings, simulate_scenario, true_vertex_of_passes
from topobatch.topology.closure import alternatives
from topobatch.topology.closure.alternatives import crossing_share, most_likely_closure
from topobatch.topology.closure.dead_reckoning import dead_reckoning, scale_noise
from topobatch.topology.closure.estimate import optimise
from topobatch.topology.closure.incremental import Closed, RoundSettings, full_closure

from .walks import NOISE, aisles, grid_world, partition, record, to_and_fro, wander

ROUNDS = RoundSettings()
LOUD = replace(NOISE, heading_rad_per_sqrt_m=0.03)


def unclosed(odometry, passes, noise):
    """Dead reckoning of a walk, and its closure with no pass identified."""
    reckoning = dead_reckoning(odometry, passes, noise)
    place = np.arange(len(passes))
    return reckoning, Closed(reckoning, place, optimise(reckoning, place), [], None)


def walk(seed):
    """A drifting walk through crooked streets."""
    rng = np.random.default_rng(seed)
    xy, beside = grid_world(5, 5, rng)
    xy = {v: at + rng.normal(0, 1.0, 2) for v, at in xy.items()}
    return record((xy, beside), wander(beside, 90, rng), rng, noise=LOUD)


@pytest.mark.parametrize("seed", range(3))
def test_a_map_that_lies_over_itself_gives_way_to_the_closure_that_explains_the_run(seed):
    odometry, passes, truth = walk(seed)
    reckoning, first = unclosed(odometry, passes, LOUD)
    assert crossing_share(first) > ROUNDS.most_crossing
    closed = most_likely_closure(reckoning, first, reckoning, ROUNDS)
    assert closed.place.tolist() == partition(truth).tolist()
    assert closed.reckoning.noise == scale_noise(reckoning, ROUNDS.caution).noise


@pytest.mark.parametrize("seed", range(3))
def test_a_right_closure_stands(seed, monkeypatch):
    monkeypatch.setattr(alternatives, "crossing_share", lambda _: 1.0)  # as bridges do
    odometry, passes, truth = walk(seed)
    reckoning = dead_reckoning(odometry, passes, LOUD)
    right = partition(truth)
    first = Closed(reckoning, right, optimise(reckoning, right), [], None)
    assert most_likely_closure(reckoning, first, reckoning, ROUNDS) is first


def test_a_map_that_repeats_itself_is_not_closed_anew():
    # One row off explains the run as well.
    odometry, passes, _ = record(aisles(8), to_and_fro(8), np.random.default_rng(1))
    reckoning, first = unclosed(odometry, passes, NOISE)
    assert crossing_share(first) > ROUNDS.most_crossing
    assert len(np.unique(full_closure(reckoning).place)) < len(first.place)
    assert most_likely_closure(reckoning, first, reckoning, ROUNDS) is first


@pytest.mark.parametrize("route", [[(0, 0), (0, 1), (1, 1), (1, 0), (0, 0)], [(0, 0), (0, 1)]])
def test_corridors_that_meet_do_not_cross(route):
    odometry, passes, truth = record(grid_world(2, 2), route)
    reckoning = dead_reckoning(odometry, passes, NOISE)
    place = partition(truth)
    closed = Closed(reckoning, place, optimise(reckoning, place), [], None)
    assert crossing_share(closed) == 0
    # Two passes taken for each other: the loop becomes a bow tie.
    if len(route) > 4:
        xy = closed.estimate.xy[[0, 2, 1, 3]]
        assert crossing_share(replace(closed, estimate=replace(closed.estimate, xy=xy))) == 0.25


def test_crossings_are_found_anywhere_in_a_long_run():
    # A row of 300 places, and one corridor back across the last.
    count = 300
    way = [(0, c) for c in range(count)]
    world = {v: np.array([5.0 * v[1], 0.0]) for v in way}
    odometry, passes, _ = record((world, {v: way[max(v[1] - 1, 0) : v[1] + 2] for v in way}), way)
    reckoning = dead_reckoning(odometry, passes, NOISE)
    closed = Closed(reckoning, np.arange(count), optimise(reckoning, np.arange(count)), [], None)
    assert crossing_share(closed) == 0
    xy = closed.estimate.xy.copy()
    xy[-2:] = xy[5] + [[2.5, 1.0], [2.5, -1.0]]
    crossed = replace(closed, estimate=replace(closed.estimate, xy=xy))
    assert crossing_share(crossed) == pytest.approx(1 / (count - 1))


@pytest.mark.parametrize("seed", [3097295113, 2584209121])
def test_streets_with_a_false_grid_do_not_stand_twice(seed):
    # Harsh faults and high drift: streets that bend pass for a grid that they do not keep to.
    settings = ScenarioSettings("city", 1, 0.4, 40, drift="high", faults="harsh", seed=seed)
    scenario = simulate_scenario(settings)
    ((name, run),) = scenario.runs.items()
    built = build_map(run)
    true = true_vertex_of_passes(scenario.truth, name, built.observation_time_ns)
    known = (true >= 0) & (built.observation_vertex >= 0)
    pairs = {*zip(true[known].tolist(), built.observation_vertex[known].tolist(), strict=True)}
    assert len(pairs) == len(np.unique(true[known])) == len({vertex for _, vertex in pairs})
