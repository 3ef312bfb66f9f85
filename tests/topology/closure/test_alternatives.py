"""Closures of one run that compete."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from topobatch.ingest.mapping import build_map
from topobatch.simulation.scenario import simulate_scenario
from topobatch.simulation.settings import ScenarioSettings
from topobatch.simulation.truth import true_vertex_of_passes
from topobatch.topology.closure.alternatives import crossing_share, most_likely_closure
from topobatch.topology.closure.dead_reckoning import dead_reckoning, scale_noise
from topobatch.topology.closure.incremental import ROUNDS, unclosed

from .walks import NOISE, grid_world, partition, record, wander

LOUD = replace(NOISE, heading_rad_per_sqrt_m=0.03)


def walk(seed):
    """A drifting walk through crooked streets."""
    rng = np.random.default_rng(seed)
    xy, beside = grid_world(5, 5, rng)
    xy = {v: at + rng.normal(0, 1.0, 2) for v, at in xy.items()}
    return record((xy, beside), wander(beside, 90, rng), rng, noise=LOUD)


@pytest.mark.parametrize("seed", range(2))
def test_a_map_that_lies_over_itself_gives_way_to_the_closure_that_explains_the_run(seed):
    odometry, passes, truth = walk(seed)
    reckoning = dead_reckoning(odometry, passes, LOUD)
    first = unclosed(reckoning)
    assert crossing_share(first) > ROUNDS.most_crossing
    closed = most_likely_closure(reckoning, first, reckoning)
    assert closed.place.tolist() == partition(truth).tolist()
    assert closed.reckoning.noise == scale_noise(reckoning, ROUNDS.caution).noise


def test_streets_with_a_false_grid_do_not_stand_twice():
    # Harsh faults and high drift: streets that bend pass for a grid that they do not keep to.
    settings = ScenarioSettings("city", 1, 0.4, 40, drift="high", faults="harsh", seed=2584209121)
    scenario = simulate_scenario(settings)
    ((name, run),) = scenario.runs.items()
    built = build_map(run)
    true = true_vertex_of_passes(scenario.truth, name, built.observation_time_ns)
    known = (true >= 0) & (built.observation_vertex >= 0)
    pairs = {*zip(true[known].tolist(), built.observation_vertex[known].tolist(), strict=True)}
    assert len(pairs) == len(np.unique(true[known])) == len({vertex for _, vertex in pairs})
