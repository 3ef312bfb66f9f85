"""Loop closure on walks through a street grid, drawn by hand or at random, with known truth."""

from __future__ import annotations

import itertools
from dataclasses import astuple, replace

import numpy as np
import pytest

from topobatch.ingest.mapping import build_map
from topobatch.simulation import ScenarioSettings, simulate_scenario, true_vertex_of_passes
from topobatch.topology.closure import resolution
from topobatch.topology.closure.answers import Identification, explained
from topobatch.topology.closure.branches import align, branches_of
from topobatch.topology.closure.candidates import Candidates, candidates, likeness_odds
from topobatch.topology.closure.dead_reckoning import (
    SystematicErrors,
    dead_reckoning_covariance,
    make_walk,
    relative_covariance,
    scale_noise,
)
from topobatch.topology.closure.detector_faults import measured_rates
from topobatch.topology.closure.estimate import lay_out
from topobatch.topology.closure.evidence import EvidenceSettings, background
from topobatch.topology.closure.growth import GrowthSettings, Scene, grow
from topobatch.topology.closure.incremental import (
    RoundSettings,
    closure_without_grid,
    full_closure,
    weakest_cut,
)
from topobatch.topology.closure.joint_compatibility import RIVALS, STEP_OFF, agreeing
from topobatch.topology.closure.lattice import pattern_of
from topobatch.topology.closure.manhattan import RectilinearSettings, grid_corridors, grid_headings
from topobatch.topology.closure.missed_detections import correct_detections, phantoms
from topobatch.topology.closure.nearest_neighbour import gated_closure
from topobatch.topology.closure.pieces import set_apart
from topobatch.topology.closure.places import NOWHERE, tabulate
from topobatch.topology.closure.variance_components import with_shown_spread
from topobatch.topology.matching.likelihood import LIKELIHOOD
from topobatch.topology.odometry import Odometry
from topobatch.topology.passes import NO_BRANCH, Passes
from topobatch.topology.ragged import Ragged
from topobatch.topology.se2 import apply, compose, fit_rigid, wrap
from topobatch.topology.topomap import RunNoise

T0 = 10**18
STEP_M = 0.1
NOISE = RunNoise(
    along_m_per_sqrt_m=0.01,
    heading_rad_per_sqrt_m=0.008,
    heading_rad_per_sqrt_rad=0.01,
    centre_m=0.05,
    branch_rad=0.04,
)


def grid_world(rows, columns, rng=None):
    """Junctions of a street grid, and for each its neighbours."""
    gaps = (rng.uniform(3.5, 8.0, 40) if rng is not None else np.full(40, 5.0)).reshape(2, 20)
    x, y = np.cumsum(gaps[0][:columns]), np.cumsum(gaps[1][:rows])
    xy = {(r, c): np.array([x[c], y[r]]) for r in range(rows) for c in range(columns)}
    return xy, side_by_side(xy)


def side_by_side(xy):
    """For each junction (row, column) its neighbours."""
    steps = ((0, 1), (1, 0), (0, -1), (-1, 0))
    return {(r, c): [(r + dr, c + dc) for dr, dc in steps if (r + dr, c + dc) in xy] for r, c in xy}


def wander(beside, steps, rng):
    """A random route that seldom turns back."""
    route = [(0, 0)]
    while len(route) < steps:
        options = [v for v in beside[route[-1]] if len(route) < 2 or v != route[-2]]
        route.append(options[rng.integers(len(options))] if options else route[-2])
    return route


def record(world, route, rng=None, *, noise=NOISE, bias=0.0, unseen=(), breaks_before=()):
    """Odometry and passes of a drive through the junctions of a route.

    With an rng, the odometry drifts and the passes are off by `noise`. bias: [rad/m] that the
    odometry turns too far; unseen: steps of the route at which the detector is blind;
    breaks_before: steps before which the odometry jumps.
    Returns odometry, passes, and the junction of each pass.
    """
    xy, beside = world
    points, at = [xy[route[0]]], [0]
    for a, b in itertools.pairwise(route):
        n = max(round(float(np.hypot(*(xy[b] - xy[a])) / STEP_M)), 1)
        points += [xy[a] + (xy[b] - xy[a]) * k / n for k in range(1, n + 1)]
        at.append(len(points) - 1)
    if len(points) == 1:
        points.append(points[0] + [STEP_M, 0.0])
    true = np.array(points)
    step = np.diff(true, axis=0)
    heading = np.arctan2(step[:, 1], step[:, 0])
    heading = np.append(heading, heading[-1])
    pose = np.column_stack([true, heading])
    if rng is not None:
        ds = np.hypot(*step.T)
        turn = wrap(np.diff(heading)) + bias * ds
        turn = turn + rng.normal(size=len(ds)) * np.hypot(
            noise.heading_rad_per_sqrt_m * np.sqrt(ds),
            noise.heading_rad_per_sqrt_rad * np.sqrt(np.abs(turn)),
        )
        ds = ds + rng.normal(size=len(ds)) * noise.along_m_per_sqrt_m * np.sqrt(ds)
        theta = heading[0] + np.concatenate([[0.0], np.cumsum(turn)])
        move = ds[:, None] * np.column_stack([np.cos(theta[:-1]), np.sin(theta[:-1])])
        pose = np.column_stack(
            [true[0] + np.concatenate([[[0.0, 0.0]], np.cumsum(move, axis=0)]), theta]
        )
    breaks = []
    for k in breaks_before:
        row = at[k] - 15
        breaks.append(row)
        pose[row:] = compose(np.array([50.0, 3.0, 1.0]), pose[row:])
    time_ns = T0 + np.arange(len(pose)) * 100_000_000
    odometry = Odometry(time_ns, pose * [1, 1, 0] + [0, 0, 1] * wrap(pose), np.array(breaks, int))
    rows = [k for k in range(len(route)) if k not in set(unseen)]
    centre, branches, entry, exit_ = [], [], [], []
    for k in rows:
        here, turned = route[k], pose[at[k], 2] - heading[at[k]]
        out = [xy[v] - xy[here] for v in beside[here]]
        angle = np.array([np.arctan2(d[1], d[0]) for d in out])
        seen = wrap(angle + turned + (rng.normal(0, noise.branch_rad, len(angle)) if rng else 0))
        order = np.argsort(seen)
        offset = rng.normal(0, noise.centre_m, 2) if rng is not None else 0.0
        centre.append(pose[at[k], :2] + offset)
        branches.append(seen[order])
        # An unseen neighbour does not change the branch that was driven.
        for ends, other in ((entry, k - 1), (exit_, k + 1)):
            if 0 <= other < len(route):
                d = xy[route[other]] - xy[here]
                off = np.abs(wrap(angle[order] - np.arctan2(d[1], d[0])))
                ends.append(int(off.argmin()))
            else:
                ends.append(NO_BRANCH)
    when = time_ns[[at[k] for k in rows]]
    rows_of_branches = Ragged.from_rows(branches)
    passes = Passes(
        time_ns=when,
        start_ns=when,
        end_ns=when,
        centre=np.array(centre),
        branches=rows_of_branches,
        support=Ragged(rows_of_branches.offsets, np.ones(len(rows_of_branches.values))),
        entry=np.array(entry),
        exit=np.array(exit_),
        messages=np.full(len(rows), 9),
        confidence=np.ones(len(rows)),
    )
    return odometry, passes, [route[k] for k in rows]


def partition(labels):
    """Labels as numbers by first appearance: equal partitions give equal arrays."""
    seen: dict = {}
    return np.array([seen.setdefault(v, len(seen)) for v in labels])


def test_a_perfect_walk_is_closed_completely():
    world = grid_world(3, 3)
    route = [(0, 0), (0, 1), (0, 2), (1, 2), (1, 1), (0, 1), (0, 0), (1, 0), (1, 1), (1, 2)]
    odometry, passes, truth = record(world, route)
    closed = full_closure(make_walk(odometry, passes, NOISE))
    assert closed.place.tolist() == partition(truth).tolist()
    xy = np.array([world[0][v] for v in dict.fromkeys(truth)])
    np.testing.assert_allclose(closed.layout.xy, xy, atol=1e-6)


@pytest.mark.parametrize("seed", range(6))
def test_drifting_walks_are_closed_without_a_false_identification(seed):
    rng = np.random.default_rng(seed)
    world = grid_world(5, 5, rng)
    route = wander(world[1], 90, rng)
    odometry, passes, truth = record(world, route, rng)
    closed = full_closure(make_walk(odometry, passes, NOISE))
    names = list(dict.fromkeys(truth))
    assert closed.place.tolist() == partition(truth).tolist()
    there = np.array([world[0][v] for v in names])
    off = apply(fit_rigid(there, closed.layout.xy), closed.layout.xy) - there
    assert np.sqrt((off**2).sum(axis=1).mean()) < 0.25
    # The odometry alone ends far off.
    raw = np.hypot(*(passes.centre[-1] - world[0][truth[-1]]))
    assert np.hypot(*(closed.layout.pose[-1, :2] - closed.layout.xy[closed.place[-1]])) < 0.3
    assert raw > 0.3


def test_the_result_does_not_depend_on_the_frame_of_the_odometry():
    rng = np.random.default_rng(7)
    world = grid_world(4, 4, rng)
    odometry, passes, _ = record(world, wander(world[1], 60, rng), rng)
    T = np.array([12.0, -30.0, 2.2])
    turned = [np.sort(wrap(row + T[2])) for row in (passes.branches[i] for i in range(len(passes)))]
    shift = [int(np.argsort(wrap(passes.branches[i] + T[2]))[0]) for i in range(len(passes))]
    count = passes.branches.counts

    def renumbered(index):
        moved = (index - np.array(shift)) % count
        return np.where(index == NO_BRANCH, NO_BRANCH, moved)

    moved = replace(
        passes,
        centre=apply(T, passes.centre),
        branches=Ragged.from_rows(turned),
        entry=renumbered(passes.entry),
        exit=renumbered(passes.exit),
    )
    there = Odometry(odometry.time_ns, compose(T, odometry.pose), odometry.breaks)
    a = full_closure(make_walk(odometry, passes, NOISE))
    b = full_closure(make_walk(there, moved, NOISE))
    assert a.place.tolist() == b.place.tolist()
    # The layout is solved until steps are small against its errors of centimetres, no further.
    np.testing.assert_allclose(apply(T, a.layout.xy), b.layout.xy, atol=1e-3)


def test_twice_the_same_gives_the_same():
    rng = np.random.default_rng(8)
    world = grid_world(4, 4, rng)
    odometry, passes, _ = record(world, wander(world[1], 60, rng), rng)
    a, b = (full_closure(make_walk(odometry, passes, NOISE)) for _ in range(2))
    assert a.layout.xy.tobytes() == b.layout.xy.tobytes()
    assert [astuple(q) for q in a.asked] == [astuple(q) for q in b.asked]


def test_a_wrong_noise_costs_recall_at_most():
    rng = np.random.default_rng(9)
    world = grid_world(5, 5, rng)
    odometry, passes, truth = record(world, wander(world[1], 80, rng), rng)
    for factor in (0.4, 2.5):
        names = NOISE.__dataclass_fields__
        wrong = replace(NOISE, **{name: getattr(NOISE, name) * factor for name in names})
        closed = full_closure(make_walk(odometry, passes, wrong))
        for place in range(closed.place.max() + 1):
            members = {truth[i] for i in np.flatnonzero(closed.place == place)}
            assert len(members) == 1


def test_every_identification_keeps_its_evidence():
    rng = np.random.default_rng(10)
    world = grid_world(4, 4, rng)
    odometry, passes, truth = record(world, wander(world[1], 50, rng), rng)
    closed = full_closure(make_walk(odometry, passes, NOISE))
    made = [q for q in closed.asked if q.accepted]
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
    walk = make_walk(odometry, passes, NOISE, SystematicErrors(turn_rad_per_m=0.04))
    start = lay_out(walk, np.arange(len(walk)))
    scene = _scene(walk, start)
    plain = candidates(scene, np.arange(len(walk)), start, exact=False)
    assert len(plain) == 0  # nothing is plain by position
    closed = full_closure(walk)
    assert closed.place.tolist() == partition(truth).tolist()


def _scene(walk, layout):
    places = tabulate(walk, np.arange(len(walk)), layout.pose[:, 2], 0.35)
    common = background(walk, walk.noise)
    return Scene(walk, places, layout.xy, common, branches_of(places, common, EvidenceSettings()))


def revisions(closed):
    """Standing and revised answers, after checking what must hold of any."""
    made = [q for q in closed.asked if q.accepted]
    refused = [q for q in closed.asked if not q.accepted]
    assert all(q.round >= 1 for q in closed.asked + closed.revised)
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


def test_what_was_put_off_keeps_the_round_and_the_reason():
    rng = np.random.default_rng(17)
    world = grid_world(7, 7)
    loud = replace(NOISE, heading_rad_per_sqrt_m=0.08)
    odometry, passes, _ = record(world, wander(world[1], 40, rng), rng, noise=loud)
    closed = full_closure(make_walk(odometry, passes, loud))
    made, refused, revised = revisions(closed)
    assert revised
    joined = {(q.first, q.second): q.round for q in made}
    later = [q for q in revised if (q.first, q.second) in joined]
    assert later
    assert all(q.round < joined[q.first, q.second] for q in later)
    assert max(q.round for q in refused) >= max(q.round for q in made)


def test_what_is_taken_back_is_kept_with_both_rounds(monkeypatch):
    """With hardly any strain allowed, passes are torn away from places that are right."""
    rng = np.random.default_rng(10)
    world = grid_world(4, 4, rng)
    odometry, passes, _ = record(world, wander(world[1], 50, rng), rng)
    tight = replace(LIKELIHOOD, gate_sigmas=0.67)
    monkeypatch.setattr("topobatch.topology.closure.incremental.LIKELIHOOD", tight)
    closed = full_closure(make_walk(odometry, passes, NOISE))
    _, refused, revised = revisions(closed)
    back = [q for q in refused + revised if q.accepted_round is not None]
    assert back
    assert all(q.reason.startswith("taken back") for q in back)
    assert all(1 <= q.accepted_round <= q.round for q in back)


def test_a_better_reason_replaces_only_that_nothing_was_sure():
    unsure = Identification(0, 5, False, 2.0, "not sure enough", round=4)
    other = replace(unsure, second=6, reason="corridors disagree")
    doubts = {(0, 5): unsure, (0, 6): other}
    found = explained(doubts, {(0, 5): "rivals", (0, 6): "rivals", (1, 2): "rivals"})
    assert list(found) == [(0, 5)]
    assert astuple(found[0, 5]) == astuple(replace(unsure, reason="rivals"))


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


def test_streets_of_one_length_make_likeness_common():
    """Blocks of a regular grid look alike; in crooked streets nothing does."""
    taken_off = []
    xy, beside = grid_world(6, 6)
    crooked = {v: p + np.random.default_rng(v).uniform(-1.6, 1.6, 2) for v, p in xy.items()}
    for world in ((xy, beside), (crooked, beside)):
        rng = np.random.default_rng(22)
        odometry, passes, _ = record(world, wander(world[1], 120, rng), rng)
        walk = make_walk(odometry, passes, NOISE)
        start = lay_out(walk, np.arange(len(walk)))
        found = candidates(_scene(walk, start), np.arange(len(walk)), start, exact=False)
        assert len(found) > 20
        assert np.all(found.commonness >= 0)
        taken_off.append(float(np.median(found.commonness)))
    assert taken_off[0] > taken_off[1] + 2


def test_likeness_is_worth_its_rarity_among_strangers():
    strangers = np.sort(np.random.default_rng(1).normal(0.0, 3.0, 2000))
    alike = np.linspace(-10.0, 40.0, 101)
    odds = likeness_odds(alike, strangers)
    assert np.all(np.diff(odds) >= 0)
    # Half of the strangers look like that: odds of two to one.
    assert likeness_odds(np.array([np.median(strangers)]), strangers)[0] == pytest.approx(
        np.log(2), abs=0.01
    )
    top = strangers[-1]
    beyond = likeness_odds(np.array([top + 1e-9, top + 7.0]), strangers)
    assert beyond[0] == pytest.approx(np.log(2001), abs=0.01)
    assert beyond[1] - beyond[0] == pytest.approx(7.0)


def test_to_be_among_the_most_alike_is_worth_little_where_most_are_nearly_so():
    rows_of_crops = np.sort(np.random.default_rng(2).normal(14.0, 1.0, 2000))
    alike = rows_of_crops[[-20, -200, 1000]]
    odds = likeness_odds(alike, rows_of_crops, slack=3.0)
    assert np.all(odds <= likeness_odds(alike, rows_of_crops))
    assert np.all(odds < 1.5)


def test_without_strangers_likeness_is_taken_as_it_is():
    alike = np.linspace(-10.0, 40.0, 101)
    np.testing.assert_array_equal(likeness_odds(alike, np.zeros(0)), alike)


def aisles(count, length=40.0, spacing=3.0, aslant=0.0):
    """Rows of one length, joined at both ends: every one looks like the next.

    aslant: (count,) [rad] how far each is turned.
    """
    off = length * np.broadcast_to(aslant, count)
    xy = {
        (r, c): np.array([spacing * c + r * off[c], length * r])
        for r in (0, 1)
        for c in range(count)
    }
    return xy, side_by_side(xy)


def test_a_pattern_is_found_by_its_steps():
    odometry, passes, truth = record(aisles(8), [(0, c) for c in range(8)] + [(1, 7), (1, 6)])
    walk = make_walk(odometry, passes, NOISE)
    place = partition(truth)
    layout = lay_out(walk, place)
    places = tabulate(walk, place, layout.pose[:, 2], 0.35)
    pattern = pattern_of(places, layout.xy, core_m=2.0, typical_m=3.0)
    order = np.argsort(pattern.steps[:, 0])
    found = [-9.0, -6.0, -3.0, 3.0, 6.0, 9.0]
    np.testing.assert_allclose(pattern.steps[order, 0], found, atol=0.1)
    assert np.abs(pattern.steps[:, 1]).max() < 0.1
    assert pattern.share.max() == pytest.approx(0.8)  # 8 of 10 have one to the right
    asked = np.array([[3.2, 0.1], [1.5, 0], [0, 3.0]])
    assert pattern.is_step(asked).tolist() == [True, False, False]
    sharp = np.tile(0.1**2 * np.eye(2), (3, 1, 1))
    step, between, across = pattern.density(np.array([[3.0, 0], [1.5, 0], [0, 3.0]]), sharp)
    assert step > 50 * between
    assert step > 50 * across
    # Known to 3 m, the line of neighbours is a blur.
    blurred = pattern.density(np.array([[3.0, 0], [1.5, 0]]), np.tile(9.0 * np.eye(2), (2, 1, 1)))
    assert blurred[0] == pytest.approx(blurred[1], rel=0.2)


def test_each_piece_of_a_broken_odometry_has_steps_of_its_own():
    """Three pieces in frames turned against each other: together no step leads from most places."""
    row = [(0, c) for c in range(72)]
    odometry, passes, truth = record(aisles(72), row, breaks_before=(24, 48))
    walk = make_walk(odometry, passes, NOISE)
    place = np.arange(len(truth))
    layout = lay_out(walk, place)
    places = tabulate(walk, place, layout.pose[:, 2], 0.35)
    turn = np.repeat([0.0, 0.7, 1.4], 24)
    at = 3.0 * np.tile(np.arange(24), 3)[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    pattern = pattern_of(places, at, core_m=2.0, typical_m=3.0)
    asked = 3.0 * np.stack([np.cos([0.0, 0.7, 1.4, 0.35]), np.sin([0.0, 0.7, 1.4, 0.35])], axis=1)
    assert pattern.is_step(asked).tolist() == [True, True, True, False]


def test_a_map_of_one_place_has_no_pattern():
    odometry, passes, truth = record(aisles(2), [(0, 0)])
    walk = make_walk(odometry, passes, NOISE)
    place = partition(truth)
    places = tabulate(walk, place, np.zeros(1), 0.35)
    pattern = pattern_of(places, np.zeros((1, 2)), core_m=2.0, typical_m=3.0)
    assert len(pattern.steps) == 0
    assert pattern.density(np.ones((2, 2)), np.tile(np.eye(2), (2, 1, 1))).tolist() == [0, 0]


@pytest.mark.parametrize(
    ("heading_noise", "seed", "found_again"),
    [(0.001, 0, 100), (0.003, 1, 20), (0.005, 0, 0), (0.008, 2, 0)],
)
def test_equal_rows_side_by_side_are_not_taken_for_each_other(heading_noise, seed, found_again):
    rng = np.random.default_rng(40 + seed)
    world = aisles(14)
    noise = replace(NOISE, heading_rad_per_sqrt_m=heading_noise)
    odometry, passes, truth = record(world, wander(world[1], 160, rng), rng, noise=noise)
    place = full_closure(make_walk(odometry, passes, noise)).place
    homes = {}
    for p, v in zip(place.tolist(), truth, strict=True):
        homes.setdefault(p, set()).add(v)
    assert all(len(found) == 1 for found in homes.values())
    assert len(truth) - len(homes) >= found_again


def test_what_dead_reckoning_excludes_is_judged_in_the_axes_of_the_map():
    rng = np.random.default_rng(3)
    world = grid_world(5, 5, rng)
    odometry, passes, _ = record(world, wander(world[1], 60, rng), rng)
    walk = make_walk(odometry, passes, NOISE)
    each = np.arange(len(walk))
    layout = lay_out(walk, each)
    turned = lay_out(walk, each, compose(np.array([2.0, 1.0, 0.7]), layout.pose))
    found, again = (candidates(_scene(walk, x), each, x, exact=False) for x in (layout, turned))
    assert len(found) > 20
    assert list(zip(found.a, found.b, strict=True)) == list(zip(again.a, again.b, strict=True))
    np.testing.assert_allclose(again.position, found.position, atol=1e-3)


@pytest.mark.parametrize(("seed", "steps"), [(13, 80), (17, 40)])
def test_doubts_are_kept_with_what_became_of_them(seed, steps):
    rng = np.random.default_rng(seed)
    world = grid_world(7, 7)  # regular: much looks alike
    loud = replace(NOISE, heading_rad_per_sqrt_m=0.08)
    odometry, passes, _ = record(world, wander(world[1], steps, rng), rng, noise=loud)
    closed = closure_without_grid(make_walk(odometry, passes, loud))
    doubts = [q for q in closed.asked if not q.accepted]
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


def _ends_of_a_long_way(offsets, street=(0, 7, 13, 22)):
    """A street driven twice, 150 m of ways without branches in common between the two drives.

    offsets: where the second drive comes by junctions of the first, and how far it seems off [m].
    """
    first = np.array([[x, 0.0] for x in street])
    away = np.array([[60.0, 40.0 + 10 * k] for k in range(4)])
    again = first[: len(offsets)] + np.asarray(offsets)
    centre = np.vstack([first, away, again])
    pose = np.vstack([np.linspace(p, q, 60) for p, q in itertools.pairwise(centre)])
    pose = np.column_stack([pose, np.zeros(len(pose))])
    time_ns = T0 + np.arange(len(pose)) * 100_000_000
    odometry = Odometry(time_ns, pose, np.zeros(0, int))
    when = time_ns[np.minimum(np.arange(len(centre)) * 60, len(pose) - 1)]
    none = Ragged.from_rows([np.zeros(0)] * len(centre))
    count = len(centre)
    passes = Passes(
        time_ns=when, start_ns=when, end_ns=when, centre=centre, branches=none, support=none,
        entry=np.full(count, NO_BRANCH), exit=np.full(count, NO_BRANCH),
        messages=np.full(count, 9), confidence=np.ones(count),
    )  # fmt: skip
    walk = make_walk(odometry, passes, replace(NOISE, heading_rad_per_sqrt_m=0.012))
    return walk, lay_out(walk, np.arange(count))


def _asked(a, b, position, alike):
    """Candidates with nothing but position and likeness."""
    zero = np.zeros(len(a))
    likeness = np.asarray(alike, float)
    return Candidates(np.array(a), np.array(b), position, likeness, zero, zero, zero, zero)


@pytest.mark.parametrize(
    ("offsets", "together"),
    [
        ([[2.0, 1.5]] * 4, True),  # all are off by the same: one drift explains it
        ([[2.0, 1.5], [-2.0, 3.5], [4.0, -2.5], [-3.0, -3.0]], False),
        ([[2.0, 1.5]], False),  # one alone is not sure
    ],
)
def test_identifications_that_agree_on_one_position_are_sure_together(offsets, together):
    walk, layout = _ends_of_a_long_way(offsets)
    k = len(offsets)
    common = background(walk, walk.noise)
    a, b = np.arange(k), 8 + np.arange(k)
    position = np.full(k, -2.0)
    found = _asked(a, b, position, np.full(k, 4.0))
    rows, odds, reason = agreeing(layout, found, common, EvidenceSettings(), least_odds=9.0)
    assert (rows.tolist() == list(range(k))) is together
    assert (np.all(odds > 4.5), reason) == (True, "")


@pytest.mark.parametrize(("off", "expected"), [(3.0, []), (0.4, [0, 1, 2])])
def test_a_rival_that_agrees_as_well_leaves_it_open(off, expected):
    """Junctions 6 m apart, passed again: by these, or each by the next one?"""
    walk, layout = _ends_of_a_long_way([[off, 0.0]] * 3, street=(0, 6, 12, 18))
    a, b = np.array([0, 1, 2, 1, 2, 3]), np.array([8, 9, 10, 8, 9, 10])
    found = _asked(a, b, np.full(6, -2.0), np.full(6, 5.0))
    agreed = agreeing(
        layout, found, background(walk, walk.noise), EvidenceSettings(), least_odds=9.0
    )
    accepted = [] if agreed.reason else agreed.rows.tolist()
    assert accepted == expected
    assert ("exclude" in agreed.reason) is (expected == [])
    assert len(agreed.odds) == len(accepted)


def test_layout_begins_with_the_headings_of_the_grid():
    """Odometry that has turned round by itself twice is laid straight at once."""
    rng = np.random.default_rng(23)
    world = grid_world(8, 8, rng)
    loud = replace(NOISE, heading_rad_per_sqrt_m=0.03)
    odometry, passes, truth = record(world, wander(world[1], 700, rng), rng, noise=loud, bias=0.004)
    walk = make_walk(odometry, passes, loud)
    layout = lay_out(walk, np.arange(len(walk)), grid=grid_headings(walk))
    assert layout.solution.converged
    assert layout.solution.iterations < 10
    true = np.array([world[0][v] for v in truth])
    step, there = np.diff(layout.pose[:, :2], axis=0), np.diff(true, axis=0)
    turn = np.arctan2(*step.T[::-1]) - np.arctan2(*there.T[::-1])
    assert np.quantile(np.abs(wrap(turn - np.median(turn))), 0.99) < 0.2


def test_the_gated_closure_is_honest_and_finds_less():
    rng = np.random.default_rng(11)
    world = grid_world(5, 5, rng)
    odometry, passes, truth = record(world, wander(world[1], 80, rng), rng)
    closed = gated_closure(make_walk(odometry, passes, NOISE), RoundSettings())
    place, asked = closed.place, closed.asked
    groups = [{truth[i] for i in np.flatnonzero(place == k)} for k in range(place.max() + 1)]
    assert all(len(group) == 1 for group in groups)
    assert len(set(truth)) <= len(groups) < len(truth)
    assert any(q.accepted for q in asked)


def test_pieces_of_a_broken_odometry_stay_apart():
    rng = np.random.default_rng(12)
    world = grid_world(3, 3, rng)
    route = [(0, 0), (0, 1), (1, 1), (1, 0), (0, 0), (0, 1), (1, 1), (1, 0), (0, 0)]
    odometry, passes, _ = record(world, route, rng, breaks_before=(5,))
    walk = make_walk(odometry, passes, NOISE)
    closed = full_closure(walk)
    assert set(closed.place[:5]).isdisjoint(closed.place[5:])
    assert closed.place[0] == closed.place[4]
    layout = set_apart(walk, closed.place, closed.layout)
    left, right = layout.xy[closed.place[:5]], layout.xy[closed.place[5:]]
    assert left[:, 0].max() < right[:, 0].min()
    # Moved, not bent.
    np.testing.assert_allclose(
        np.diff(layout.xy[closed.place[5:]], axis=0),
        np.diff(closed.layout.xy[closed.place[5:]], axis=0),
        atol=1e-9,
    )


@pytest.mark.parametrize(
    "route",
    [[(0, 0)], [(0, 0), (0, 1)], [(0, 0), (0, 1), (0, 0)], [(0, 0), (0, 1), (0, 0), (0, 1)]],
)
def test_tiny_walks(route):
    odometry, passes, truth = record(grid_world(2, 2), route)
    closed = full_closure(make_walk(odometry, passes, NOISE))
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
    walk = make_walk(odometry, passes, NOISE)
    closed = full_closure(walk)
    assert truth == ["a", "a"]
    assert closed.place.tolist() == [0, 0]
    places = tabulate(walk, closed.place, closed.layout.pose[:, 2], 0.35)
    assert places.next_place[0][:2].tolist() == [0, 0]


def test_a_missed_junction_becomes_an_unseen_visit():
    world = grid_world(2, 4)
    there = [(0, 0), (0, 1), (0, 2), (0, 3)]
    route = [*there, *there[-2::-1], *there[1:]]
    odometry, passes, truth = record(world, route, unseen=(5,))
    walk = make_walk(odometry, passes, NOISE)
    closed = full_closure(walk)
    assert closed.place.tolist() == partition(truth).tolist()
    corrected = correct_detections(walk, odometry, closed.place, closed.layout)
    assert int((~corrected.visits.seen).sum()) == 1
    again = corrected.visits.vertex.tolist()
    assert again == partition(route).tolist()


def test_a_place_driven_by_unseen_again_and_again_is_a_phantom():
    world = grid_world(1, 4)
    xy, beside = world
    xy["ghost"] = np.array([7.5, 5.0])
    beside["ghost"] = [(0, 0), (0, 1)]
    beside[0, 0], beside[0, 1] = [(0, 1), "ghost"], [(0, 0), (0, 2), "ghost"]
    first = [(0, 0), "ghost", (0, 1), (0, 2)]
    back = [(0, 1), (0, 0), (0, 1), (0, 2), (0, 1), (0, 0)]
    odometry, passes, truth = record(world, first + back)
    walk = make_walk(odometry, passes, NOISE)
    closed = full_closure(walk)
    corrected = correct_detections(walk, odometry, closed.place, closed.layout)
    assert corrected.place[truth.index("ghost")] == -1
    assert len(corrected.xy) == 3
    # Once is not enough for a place with a side branch.
    places = tabulate(walk, closed.place, closed.layout.pose[:, 2], 0.35)
    assert not phantoms(walk, places, np.zeros(len(places), int)).any()


def a_crossing_seen_as_two_forks():
    """A crossing at 0, 0, and the two forks beside each other that some looks show in its place."""
    xy = {"west": (-6, 0), "east": (6, 0), "north": (0, 6), "south": (0, -6)}
    xy |= {"crossing": (0, 0), "left": (-0.5, 0), "right": (0.5, 0)}
    beside = {
        **{end: ["crossing"] for end in ("west", "east", "north", "south")},
        "crossing": ["west", "east", "north", "south"],
        "left": ["west", "right", "north"],
        "right": ["east", "left", "south"],
    }
    return {name: np.array(at, float) for name, at in xy.items()}, beside


def corrected_by_sight(route, resolution_m):
    """Every description of a place taken for a place of its own, then corrected."""
    odometry, passes, truth = record(a_crossing_seen_as_two_forks(), route)
    walk, place = make_walk(odometry, passes, NOISE), partition(truth)
    corrected = correct_detections(
        walk, odometry, place, lay_out(walk, place), resolution_m=resolution_m
    )
    return corrected, {name: int(corrected.place[k]) for k, name in reversed([*enumerate(truth)])}


THERE = ["west", "left", "right", "east"]


def test_two_forks_in_place_of_a_crossing_are_the_crossing_that_was_seen_better():
    route = [*THERE, "crossing", "west", "crossing", "north"]
    corrected, number = corrected_by_sight(route, 1.3)
    assert number["left"] == number["crossing"]
    assert number["right"] == NOWHERE  # the same visit
    assert corrected.visits.vertex.tolist() == [0, 2, 1, 2, 0, 2, 3]
    assert corrected.xy[2] - corrected.xy[0] == pytest.approx([6.0, 0.0], abs=0.1)
    assert corrected.fair.tolist() == [True, False, False, *[True] * 5]
    assert [q.reason for q in corrected.asked] == [resolution.REASON] * 2
    # It lies amid all looks: the three here, of which two are a little aside.
    assert np.hypot(*(corrected.xy[2] - corrected.xy[0] - [6.0, 0.0])) < 0.01
    assert all(q.accepted and q.bits > 0 for q in corrected.asked)


def test_two_forks_that_were_seen_better_are_no_crossing():
    route = [*THERE, *THERE[-2::-1], *THERE[1:], "crossing", "west"]
    corrected, number = corrected_by_sight(route, 1.3)
    assert number["left"] != number["right"]
    assert number["crossing"] in (number["left"], number["right"])
    assert len(corrected.xy) == 4


def test_what_a_detector_tells_apart_stays_apart():
    route = [*THERE, "crossing", "west"]
    assert len(corrected_by_sight(route, 0.0)[0].xy) == 5
    assert len(corrected_by_sight(route, 0.3)[0].xy) == 5
    told, number = corrected_by_sight([*THERE, *THERE[-2::-1]], 1.3)
    assert number["left"] != number["right"]
    assert told.asked == []


def test_places_that_may_well_be_farther_apart_stay_two():
    odometry, passes, truth = record(a_crossing_seen_as_two_forks(), [*THERE, "crossing", "west"])
    vague = replace(NOISE, along_m_per_sqrt_m=0.2)
    walk, place = make_walk(odometry, passes, vague), partition(truth)
    corrected = correct_detections(walk, odometry, place, lay_out(walk, place), resolution_m=1.3)
    assert len(corrected.xy) == 5


def test_dead_reckoning_covariance_is_that_of_many_drives():
    world = grid_world(4, 4)
    route = [(0, 0), (0, 1), (1, 1), (1, 2), (2, 2), (2, 1)]
    ends = []
    for seed in range(400):
        rng = np.random.default_rng(seed)
        _, passes, _ = record(world, route, rng, noise=replace(NOISE, centre_m=0.0))
        ends.append(passes.centre[-1] - passes.centre[0])
    odometry, passes, _ = record(world, route)
    quiet = make_walk(odometry, passes, NOISE)
    expected = relative_covariance(quiet, np.array([0]), np.array([5]))[0]
    # The model lets positions walk sideways as much as along; the drive does not.
    slack = NOISE.along_m_per_sqrt_m**2 * quiet.way[-1]
    found = np.cov(np.array(ends).T)
    assert np.all(np.abs(found - expected[:2, :2]) < 0.25 * np.trace(expected[:2, :2]) + slack)
    more = dead_reckoning_covariance(quiet, np.array([0]), np.array([5]))[0]
    assert np.all(np.linalg.eigvalsh(more - expected) > -1e-12)


def test_a_jump_adds_its_own_uncertainty_and_keeps_it():
    world = grid_world(4, 4)
    route = [(0, 0), (0, 1), (1, 1), (1, 2), (2, 2), (2, 1)]
    odometry, passes, _ = record(world, route)
    row = int(np.searchsorted(odometry.time_ns, passes.time_ns[3])) - 15
    jumping = replace(
        odometry,
        jumps=np.array([row]),
        jump_sigma=np.array([[0.4, 0.3]]),
        jump_other=np.zeros((1, 3)),
    )
    quiet, walk = make_walk(odometry, passes, NOISE), make_walk(jumping, passes, NOISE)
    first, second = np.array([0, 0, 3]), np.array([2, 5, 5])
    more = relative_covariance(walk, first, second) - relative_covariance(quiet, first, second)
    np.testing.assert_allclose(more[[0, 2]], 0.0, atol=1e-12)
    arm = passes.centre[5] - odometry.pose[row, :2]
    turned = np.array([-arm[1], arm[0], 1.0])
    np.testing.assert_allclose(
        more[1], 0.3**2 * np.outer(turned, turned) + 0.4**2 * np.diag([1, 1, 0]), atol=1e-12
    )
    # However loud the rest is taken to be, the jump is as large as it is.
    for factor in (0.35, 4.0):
        again = relative_covariance(scale_noise(walk, factor), first, second)
        again -= relative_covariance(scale_noise(quiet, factor), first, second)
        np.testing.assert_allclose(again, more, atol=1e-12)
    assert np.flatnonzero(np.isnan(walk.leg)).tolist() == [2]  # no corridor is known by its length
    layout = lay_out(walk, np.arange(len(walk)))
    found = layout.relative_covariance(np.array([2]), np.array([3]))[0]
    np.testing.assert_allclose(found, relative_covariance(walk, [2], [3])[0], atol=1e-3)


def test_grid_headings_follow_the_drift():
    rng = np.random.default_rng(13)
    world = grid_world(5, 5, rng)
    odometry, passes, junctions = record(world, wander(world[1], 60, rng), rng)
    walk = make_walk(odometry, passes, NOISE)
    grid = grid_headings(walk)
    assert grid is not None
    seen = [passes.branches[i] for i in range(len(passes))]
    aligned = [wrap(4 * (seen[i] + t)) / 4 for i, t in zip(grid.row, grid.turn, strict=True)]
    spread = np.concatenate([a - aligned[0].mean() for a in aligned])
    assert np.abs(np.asarray(wrap(4 * spread)) / 4).max() < 0.2
    # Streets at any angle are no grid.
    fork = np.array([-2.0, 0.1, 2.2])
    bent = replace(
        passes,
        branches=Ragged.from_rows([fork] * len(passes)),
        support=Ragged.from_rows([np.ones(3)] * len(passes)),
        entry=np.zeros(len(passes), int),
        exit=np.ones(len(passes), int),
    )
    assert grid_headings(replace(walk, passes=bent)) is None
    # Nor are streets that cross at right angles, each crossing turned by itself.
    own = {v: rng.uniform(-0.4, 0.4) for v in world[0]}
    turned = np.array([own[v] for v in junctions])[passes.branches.owner]
    branches = Ragged(passes.branches.offsets, passes.branches.values + turned)
    assert grid_headings(replace(walk, passes=replace(passes, branches=branches))) is None


def to_and_fro(count):
    """A route up one aisle and down the next, then back along a cross way."""
    route = [(k % 2, c) for c in range(count) for k in (c, c + 1)]
    last = route[-1][0]
    return route + [(last, c) for c in range(count - 2, -1, -1)]


def test_corridors_of_a_grid_go_straight_or_round_one_corner():
    route = [(0, 0), (0, 1), (0, 2), (1, 2), (1, 3), (0, 3), (0, 4), (0, 3)]
    odometry, passes, _ = record(aisles(5, 30.0), route, unseen=(3,))
    walk = make_walk(odometry, passes, NOISE)
    grid = grid_headings(walk)
    turn = np.zeros(len(walk))
    found = grid_corridors(walk, grid, turn, 3.0)
    # Back the same way is another corridor; nobody saw where the third one bent.
    assert found.corridor.tolist() == [0, 0, 0, 1, 1, 2, 2, 3, 3, 4, 4]
    assert found.row.tolist() == [0, 1, 2, 2, 3, 3, 4, 4, 5, 5, 6]
    np.testing.assert_allclose(found.aside, [0, 0, 0, 0, -3, 0, 0, 0, 0, 0, 0], atol=1e-6)
    ahead = np.array([0, 1, -1, 0, 2]) * np.pi / 2
    np.testing.assert_allclose(wrap(found.direction - ahead), 0.0, atol=1e-6)
    # Who might have come out on a corridor beside it says nothing.
    assert len(grid_corridors(replace(walk, leg=walk.leg + 3.0), grid, turn, 3.0).row) == 0


def test_along_straight_corridors_nobody_drifts_aside():
    rng = np.random.default_rng(31)
    world = aisles(12)
    odometry, passes, truth = record(world, to_and_fro(12), rng)
    walk, place = make_walk(odometry, passes, NOISE), np.arange(len(passes))
    grid = grid_headings(walk)
    plain = lay_out(walk, place, grid=grid)
    corridors = grid_corridors(walk, grid, plain.pose[:, 2], 3.0)
    straight = lay_out(walk, place, grid=grid, corridors=corridors)
    ends = np.array([0]), np.array([len(place) - 1])
    before, after = (
        np.linalg.eigvalsh(layout.relative_covariance(*ends)[0][:2, :2])[-1]
        for layout in (plain, straight)
    )
    assert after < 0.5 * before
    true = np.array([world[0][v] for v in truth])
    off = apply(fit_rigid(true, straight.xy), straight.xy) - true
    assert np.abs(off).max() < 3 * np.sqrt(after)


@pytest.mark.parametrize(("aslant", "least", "most"), [(0.0, 0.0, 0.015), (0.05, 0.03, 0.08)])
def test_corridors_are_held_as_straight_as_loops_show_them(aslant, least, most):
    rng = np.random.default_rng(32)
    world = aisles(14, aslant=aslant * rng.normal(size=14))
    odometry, passes, truth = record(world, to_and_fro(14), rng)
    walk = make_walk(odometry, passes, NOISE)
    grid = grid_headings(walk)
    turn = lay_out(walk, partition(truth), grid=grid).pose[:, 2]
    corridors = grid_corridors(walk, grid, turn, 3.0)
    for _ in range(3):
        layout = lay_out(walk, partition(truth), grid=grid, corridors=corridors)
        corridors = with_shown_spread(corridors, layout, grid)
    across, along = (corridors.spread_rad[corridors.side == k] for k in (0, 1))
    assert least < along.min() == along.max() < most
    # What crosses the aisles is straight, however these are.
    assert across.min() == across.max() < 0.02


@pytest.mark.parametrize("faults", ["none", "mild", "harsh"])
def test_equal_rows_close_without_a_wrong_identification(faults):
    settings = ScenarioSettings(
        world="rows", runs=1, junctions_per_run=60, drift="mid", faults=faults, seed=602
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


def test_every_piece_of_a_broken_odometry_follows_the_grid_in_its_own_frame():
    rng = np.random.default_rng(14)
    world = grid_world(5, 5, rng)
    odometry, passes, _ = record(world, wander(world[1], 60, rng), rng, breaks_before=(20, 45))
    walk = make_walk(odometry, passes, NOISE)
    grid = grid_headings(walk)
    assert grid is not None
    pieces = [walk.chain[grid.row] == k for k in range(3)]
    for piece in pieces:
        aligned = [
            passes.branches[i] + t for i, t in zip(grid.row[piece], grid.turn[piece], strict=True)
        ]
        quarter = np.exp(4j * np.concatenate(aligned))
        spread = np.angle(quarter / quarter.mean()) / 4
        assert np.abs(spread).max() < 0.2
        assert grid.turn[piece][0] == 0.0
    # Laid out, every piece is as straight as the grid.
    layout = lay_out(walk, np.arange(len(walk)), grid=grid)
    start = lay_out(walk, np.arange(len(walk)))
    for k in range(3):
        rows = np.flatnonzero(walk.chain == k)
        along = np.diff(layout.xy[rows], axis=0)
        plain = np.diff(start.xy[rows], axis=0)
        heading, bent = (np.exp(4j * np.arctan2(d[:, 1], d[:, 0])) for d in (along, plain))
        assert abs(heading.mean()) > max(0.99, abs(bent.mean()))


def test_layout_of_a_square_spreads_the_error():
    world = grid_world(2, 2)
    odometry, passes, _ = record(world, [(0, 0), (0, 1), (1, 1), (1, 0), (0, 0)])
    bent = replace(passes, centre=passes.centre + np.linspace(0, 1, 5)[:, None] * [0.4, 0.0])
    walk = make_walk(odometry, bent, NOISE)
    layout = lay_out(walk, np.array([0, 1, 2, 3, 0]))
    apart = np.hypot(*(layout.pose[4, :2] - layout.pose[0, :2]))
    assert apart < 0.15
    assert len(layout.xy) == 4
    side = np.hypot(*np.diff(layout.xy[[0, 1, 2, 3, 0]], axis=0).T)
    assert np.all(np.abs(side - 5.0) < 0.3)


def test_tables_of_places():
    world = grid_world(2, 2)
    route = [(0, 0), (0, 1), (0, 0), (0, 1), (1, 1)]
    odometry, passes, truth = record(world, route)
    walk = make_walk(odometry, passes, NOISE)
    place = partition(truth)
    places = tabulate(walk, place, np.zeros(len(passes)), 0.35)
    assert places.visits.tolist() == [2, 2, 1]
    east = int(np.nanargmin(np.abs(places.heading[0])))
    assert places.next_place[0, east] == 1
    assert places.driven[0, east] == places.tried[0, east] == 3
    assert places.length[0, east] == pytest.approx(5.0)
    assert (places.next_place[0] == NOWHERE).sum() == places.heading.shape[1] - 1
    rates = measured_rates(places, NOISE)
    assert rates.miss_rate < NOISE.miss_rate
    assert rates.branch_fault_rate == pytest.approx(NOISE.branch_fault_rate)


def test_settings_are_the_gate_keeper():
    rng = np.random.default_rng(14)
    world = grid_world(4, 4, rng)
    odometry, passes, truth = record(world, wander(world[1], 40, rng), rng)
    walk = make_walk(odometry, passes, NOISE)
    strict = RoundSettings(wrong_share=1e-300)
    closed = full_closure(walk, strict)
    assert closed.place.tolist() == list(range(len(truth)))
    assert any(not q.accepted and q.bits > 0 for q in closed.asked)


def test_a_grid_that_bends_on_its_way_is_found_out():
    """Streets that meet at right angles and bend between: the walk closes, held by no grid."""
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
        closed = full_closure(make_walk(odometry, passes, NOISE), RoundSettings(grid=lax))
        assert (closed.grid is not None) == found
        assert len(closed.layout.xy) == len(set(truth))


def test_blocks_between_the_same_two_streets_count_once():
    """One street off, the blocks along it are as long: that makes no place of two."""
    rng = np.random.default_rng(33)
    world = grid_world(6, 6, rng)
    odometry, passes, truth = record(world, wander(world[1], 150, rng), rng)
    walk, place = make_walk(odometry, passes, NOISE), partition(truth)
    layout = lay_out(walk, place)
    places = tabulate(walk, place, layout.pose[:, 2], 0.35)
    common = background(walk, walk.noise)
    scene = Scene(walk, places, layout.xy, common, branches_of(places, common, EvidenceSettings()))
    number = {v: int(place[k]) for k, v in enumerate(truth)}
    off = [(number[v], number[v[0] + 1, v[1]]) for v in number if (v[0] + 1, v[1]) in number]
    a, b = np.array(off).T
    turned = align(scene.branches, a, b, turn_sigma=np.full(len(a), 0.05))
    lengths = GrowthSettings(branch_cap=0.0)
    independent = grow(scene, a, b, turned, replace(lengths, line_m=0.0))
    together = grow(scene, a, b, turned, lengths)
    assert (together.gain <= independent.gain + 1e-9).all()
    assert together.gain.mean() < 0.6 * independent.gain.mean()
