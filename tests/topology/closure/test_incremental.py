"""Loop closure round by round, on walks with known truth."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from topobatch.topology.closure.candidates import Candidates, Surroundings
from topobatch.topology.closure.dead_reckoning import dead_reckoning
from topobatch.topology.closure.incremental import _certain, full_closure
from topobatch.topology.closure.places import NOWHERE
from topobatch.topology.se2 import apply, fit_rigid

from .walks import NOISE, aisles, grid_world, no_ground, partition, record, wander


def test_a_perfect_walk_is_closed_completely():
    world = grid_world(3, 3)
    route = [(0, 0), (0, 1), (0, 2), (1, 2), (1, 1), (0, 1), (0, 0), (1, 0), (1, 1), (1, 2)]
    odometry, passes, truth = record(world, route)
    closed = full_closure(dead_reckoning(odometry, passes, NOISE))
    assert closed.place.tolist() == partition(truth).tolist()
    xy = np.array([world[0][v] for v in dict.fromkeys(truth)])
    np.testing.assert_allclose(closed.estimate.xy, xy, atol=1e-6)


@pytest.mark.parametrize("seed", range(3))
def test_drifting_walks_are_closed_without_a_false_identification(seed):
    rng = np.random.default_rng(seed)
    world = grid_world(5, 5, rng)
    route = wander(world[1], 90, rng)
    odometry, passes, truth = record(world, route, rng)
    closed = full_closure(dead_reckoning(odometry, passes, NOISE))
    names = list(dict.fromkeys(truth))
    assert closed.place.tolist() == partition(truth).tolist()
    there = np.array([world[0][v] for v in names])
    off = apply(fit_rigid(there, closed.estimate.xy), closed.estimate.xy) - there
    assert np.sqrt((off**2).sum(axis=1).mean()) < 0.25
    # The odometry alone ends far off.
    raw = np.hypot(*(passes.centre[-1] - world[0][truth[-1]]))
    assert np.hypot(*(closed.estimate.pose[-1, :2] - closed.estimate.xy[closed.place[-1]])) < 0.3
    assert raw > 0.3


def test_a_wrong_noise_costs_recall_at_most():
    rng = np.random.default_rng(9)
    world = grid_world(5, 5, rng)
    odometry, passes, truth = record(world, wander(world[1], 80, rng), rng)
    for factor in (0.4, 2.5):
        names = NOISE.__dataclass_fields__
        wrong = replace(NOISE, **{name: getattr(NOISE, name) * factor for name in names})
        closed = full_closure(dead_reckoning(odometry, passes, wrong))
        count = int(closed.place.max()) + 1
        for place in range(count):
            members = {truth[i] for i in np.flatnonzero(closed.place == place)}
            assert len(members) == 1
        assert count < 1.5 * len(set(truth)) < len(truth)


@pytest.mark.parametrize(("heading_noise", "seed", "found_again"), [(0.001, 0, 100), (0.008, 2, 0)])
def test_equal_rows_side_by_side_are_not_taken_for_each_other(heading_noise, seed, found_again):
    rng = np.random.default_rng(40 + seed)
    world = aisles(14)
    noise = replace(NOISE, heading_rad_per_sqrt_m=heading_noise)
    odometry, passes, truth = record(world, wander(world[1], 160, rng), rng, noise=noise)
    place = full_closure(dead_reckoning(odometry, passes, noise)).place
    homes = {}
    for p, v in zip(place.tolist(), truth, strict=True):
        homes.setdefault(p, set()).add(v)
    assert all(len(found) == 1 for found in homes.values())
    assert len(truth) - len(homes) >= found_again


@pytest.mark.parametrize(
    ("third", "fits", "accepted"),
    [
        (False, True, []),
        (True, True, [(0, 1), (0, 2)]),
        (True, False, [(0, 1), (0, 2)]),  # beyond the gate, and nearer than two junctions
    ],
)
def test_a_candidate_is_certain_only_against_all_that_it_excludes(third, fits, accepted):
    """Place 0 cannot be 1 as well as 2, unless these may be one."""
    pairs = [(0, 1), (0, 2), *([(1, 2)] if third else [])]
    a, b = np.array(pairs).T
    zero = np.zeros(len(pairs))
    alike = np.array([12.0, 11.0, 0.5 if fits else 99.0])[: len(pairs)]
    within = np.array([True, True, fits])[: len(pairs)]
    around = Surroundings(alike, zero, zero, zero)
    found = Candidates(a, b, zero, around, zero, no_ground(len(pairs)), within)
    places = SimpleNamespace(first=np.arange(3), next_place=np.full((3, 1), NOWHERE))
    certain = _certain(places, found, least_odds=9.0)
    assert [(q.first, q.second) for q in certain] == accepted
    # A rival as unlikely as not takes little away.
    around = replace(around, branches=alike - [0.0, 10.5, 0.0][: len(pairs)])
    found = replace(found, around=around)
    assert [(q.first, q.second) for q in _certain(places, found, least_odds=9.0)] == [(0, 1)]
