"""Loop closure round by round, on walks with known truth."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from topobatch.ingest.mapping import build_map
from topobatch.simulation import ScenarioSettings, simulate_scenario, true_vertex_of_passes
from topobatch.topology.closure.answers import Identification
from topobatch.topology.closure.candidates import Candidates, candidates
from topobatch.topology.closure.dead_reckoning import SystematicErrors, dead_reckoning
from topobatch.topology.closure.estimate import optimise
from topobatch.topology.closure.incremental import (
    RoundSettings,
    _certain,
    closure_without_grid,
    full_closure,
    weakest_cut,
)
from topobatch.topology.closure.joint_compatibility import RIVALS, STEP_OFF
from topobatch.topology.closure.manhattan import RectilinearSettings
from topobatch.topology.closure.places import NOWHERE, tabulate
from topobatch.topology.matching.likelihood import LIKELIHOOD
from topobatch.topology.se2 import apply, fit_rigid

from .walks import NOISE, aisles, grid_world, no_ground, partition, record, scene_of, wander


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


def test_every_identification_keeps_its_evidence():
    rng = np.random.default_rng(10)
    world = grid_world(4, 4, rng)
    odometry, passes, truth = record(world, wander(world[1], 50, rng), rng)
    closed = full_closure(dead_reckoning(odometry, passes, NOISE))
    made = [q for q in closed.identifications if q.accepted]
    # A tree of links joins the passes of every place.
    assert len(made) >= len(truth) - (closed.place.max() + 1)
    assert all(truth[q.first] == truth[q.second] and q.first < q.second for q in made)
    assert all(q.bits > 4 and q.reason for q in made)


def test_a_second_lap_closes_that_position_alone_speaks_against():
    rng = np.random.default_rng(21)
    world = grid_world(5, 5, rng)
    lap = [(0, c) for c in range(5)] + [(r, 4) for r in range(1, 5)]
    lap += [(4, c) for c in range(3, -1, -1)] + [(r, 0) for r in range(3, 0, -1)]
    odometry, passes, truth = record(world, lap + lap[:9], rng, bias=0.02)
    reckoning = dead_reckoning(odometry, passes, NOISE, SystematicErrors(turn_rad_per_m=0.04))
    start = optimise(reckoning, np.arange(len(reckoning)))
    state = scene_of(reckoning, start)
    plain = candidates(state, np.arange(len(reckoning)), start, exact=False)
    assert len(plain) == 0  # nothing is plain by position
    closed = full_closure(reckoning)
    assert closed.place.tolist() == partition(truth).tolist()


def revisions(closed):
    """Standing and revised answers, after checking what must hold of any."""
    made = [q for q in closed.identifications if q.accepted]
    refused = [q for q in closed.identifications if not q.accepted]
    assert all(q.round >= 1 for q in closed.identifications + closed.revised)
    assert all(q.accepted_round is None for q in made)
    assert not any(q.accepted for q in closed.revised)
    place = closed.place

    def apart(q):
        return tuple(sorted((place[q.first], place[q.second])))

    # One entry per question and reason: pairs of places, or of passes now by one place.
    both = [(apart(q), q.reason, q.accepted_round) for q in refused + closed.revised]
    between = [entry for entry in both if entry[0][0] != entry[0][1]]
    assert len(set(between)) == len(between)
    within = [q for q in closed.revised if place[q.first] == place[q.second]]
    entries = {(q.first, q.second, q.reason, q.accepted_round) for q in within}
    assert len(entries) == len(within)
    return made, refused, closed.revised


def test_what_is_taken_back_is_kept_with_both_rounds(monkeypatch):
    """With hardly any strain allowed, passes are torn away from places that are right."""
    rng = np.random.default_rng(10)
    world = grid_world(4, 4, rng)
    odometry, passes, _ = record(world, wander(world[1], 50, rng), rng)
    tight = replace(LIKELIHOOD, gate_sigmas=0.67)
    monkeypatch.setattr("topobatch.topology.closure.incremental.LIKELIHOOD", tight)
    closed = full_closure(dead_reckoning(odometry, passes, NOISE))
    _, refused, revised = revisions(closed)
    back = [q for q in refused + revised if q.accepted_round is not None]
    assert back
    assert all(q.reason.startswith("taken back") for q in back)
    assert all(1 <= q.accepted_round <= q.round for q in back)


def test_a_place_is_split_where_it_hangs_together_least():
    def link(i, j, bits):
        return Identification(i, j, True, bits, "")

    # {0, 1, 2} and {3, 4} by strong links, two weak ones between them.
    strong = [link(0, 1, 30), link(1, 2, 25), link(0, 2, 9), link(3, 4, 28)]
    weak = [link(2, 3, 12), link(0, 4, 11)]
    assert weakest_cut(strong + weak) == weak
    alone = link(5, 6, 3)
    assert weakest_cut([alone]) == [alone]
    assert weakest_cut([]) == []


@pytest.mark.parametrize(
    ("heading_noise", "seed", "found_again"),
    [(0.001, 0, 100), (0.008, 2, 0)],
)
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


def test_equal_rows_close_without_a_wrong_identification():
    settings = ScenarioSettings(
        world="rows", runs=1, junctions_per_run=60, drift="mid", faults="harsh", seed=602
    )
    scenario = simulate_scenario(settings)
    ((name, run),) = scenario.runs.items()
    built = build_map(run)
    true = true_vertex_of_passes(scenario.truth, name, built.observation_time_ns)
    vertex = built.observation_vertex
    real = (true >= 0) & (vertex >= 0)
    homes = {(int(t), int(v)) for t, v in zip(true[real], vertex[real], strict=True)}
    assert len({v for _, v in homes}) == len(homes)
    assert len(homes) <= 1.1 * len(np.unique(true[real]))


def test_doubts_are_kept_with_what_became_of_them():
    rng = np.random.default_rng(17)
    world = grid_world(7, 7)  # regular: much looks alike
    loud = replace(NOISE, heading_rad_per_sqrt_m=0.08)
    odometry, passes, _ = record(world, wander(world[1], 40, rng), rng, noise=loud)
    closed = closure_without_grid(dead_reckoning(odometry, passes, loud))
    doubts = [q for q in closed.identifications if not q.accepted]
    assert doubts
    pairs = [tuple(sorted((closed.place[q.first], closed.place[q.second]))) for q in doubts]
    assert all(a != b for a, b in pairs)  # what was joined after all is no doubt
    assert len(set(pairs)) == len(pairs)
    assert {q.reason for q in doubts} <= {
        "not sure enough",
        "corridors disagree",
        "places that are certainly two look as much alike",
        "too far apart once the run was laid out anew",
        "taken back: a pass was torn away",
        RIVALS,
        STEP_OFF,
    }


@pytest.mark.parametrize(
    "route",
    [[(0, 0)], [(0, 0), (0, 1)], [(0, 0), (0, 1), (0, 0)], [(0, 0), (0, 1), (0, 0), (0, 1)]],
)
def test_tiny_walks(route):
    odometry, passes, truth = record(grid_world(2, 2), route)
    closed = full_closure(dead_reckoning(odometry, passes, NOISE))
    assert closed.place.tolist() == partition(truth).tolist()


def test_a_loop_of_one_junction_to_itself():
    xy = {
        "a": np.zeros(2),
        "p": np.array([6.0, 0]),
        "q": np.array([6.0, 6.0]),
        "r": np.array([0, 6.0]),
    }
    beside = {"a": ["p", "r"], "p": ["a", "q"], "q": ["p", "r"], "r": ["q", "a"]}
    odometry, passes, truth = record((xy, beside), ["a", "p", "q", "r", "a"], unseen=(1, 2, 3))
    reckoning = dead_reckoning(odometry, passes, NOISE)
    closed = full_closure(reckoning)
    assert truth == ["a", "a"]
    assert closed.place.tolist() == [0, 0]
    places = tabulate(reckoning, closed.place, closed.estimate.pose[:, 2])
    assert places.next_place[0][:2].tolist() == [0, 0]


def test_settings_are_the_gate_keeper():
    rng = np.random.default_rng(14)
    world = grid_world(4, 4, rng)
    odometry, passes, truth = record(world, wander(world[1], 40, rng), rng)
    reckoning = dead_reckoning(odometry, passes, NOISE)
    strict = RoundSettings(wrong_share=1e-300)
    closed = full_closure(reckoning, strict)
    assert closed.place.tolist() == list(range(len(truth)))
    assert any(not q.accepted and q.bits > 0 for q in closed.identifications)


def test_a_grid_that_bends_on_its_way_is_found_out():
    """Streets that meet at right angles and bend between: the run closes, held by no grid."""
    rng = np.random.default_rng(31)
    xy, beside = grid_world(6, 6, rng)
    flat = {v: complex(*p) - complex(*xy[3, 3]) for v, p in xy.items()}
    size = max(abs(z) for z in flat.values())
    bent = {
        v: np.array([w.real, w.imag]) for v, z in flat.items() for w in [z + 0.3 * z * z / size]
    }
    route = wander(beside, 130, rng)
    lax = RectilinearSettings(least_share=0.5)
    for world, found in (((xy, beside), True), ((bent, beside), False)):
        odometry, passes, truth = record(world, route, np.random.default_rng(31))
        closed = full_closure(dead_reckoning(odometry, passes, NOISE), RoundSettings(grid=lax))
        assert (closed.grid is not None) == found
        assert len(closed.estimate.xy) == len(set(truth))


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
    found = Candidates(
        a, b, zero, alike, zero, zero, zero, zero, no_ground(len(pairs)), within
    )  # fmt: skip
    places = SimpleNamespace(first=np.arange(3), next_place=np.full((3, 1), NOWHERE))
    certain = _certain(places, found, least=9.0)
    assert [(q.first, q.second) for q in certain] == accepted
    # A rival as unlikely as not takes little away.
    found = replace(found, branches=alike - [0.0, 10.5, 0.0][: len(pairs)])
    assert [(q.first, q.second) for q in _certain(places, found, least=9.0)] == [(0, 1)]


@pytest.mark.parametrize(("driven", "accepted"), [(False, [(0, 5)]), (True, [])])
def test_the_end_of_a_stretch_is_no_more_certain_than_the_stretch(driven, accepted):
    """Corridors lead from 0 to 1 to 2 and from 3 to 4 to 5, along the first ones (1 is 3, 2 is 4)
    or a junction further (1 is 4, 0 is 5). The latter shares no place with the former."""
    a, b = np.array([(0, 5), (1, 4), (1, 3), (2, 4)]).T
    zero, alike = np.zeros(4), np.array([12.0, 11.0, 13.0, 13.0])
    found = Candidates(
        a, b, zero, alike, zero, zero, zero, zero, no_ground(4), np.ones(4, bool)
    )  # fmt: skip
    beside = np.array([[1, -1], [0, 2], [1, -1], [4, -1], [3, 5], [4, -1]])
    next_place = beside if driven else np.full((6, 2), NOWHERE)
    places = SimpleNamespace(first=np.arange(6), next_place=next_place)
    certain = _certain(places, found, least=9.0)
    assert [(q.first, q.second) for q in certain] == accepted
