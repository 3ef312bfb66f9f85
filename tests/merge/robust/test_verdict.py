"""From candidate alignments to one of three verdicts."""

from dataclasses import replace

import numpy as np
import pytest

from topobatch.merge.result import CopyTest, Verdict
from topobatch.merge.robust.alignment import match, same_placement
from topobatch.merge.robust.prepare import prepare
from topobatch.merge.robust.settings import MATCH
from topobatch.merge.robust.verdict import (
    MAYBE_COPY,
    NO_WORSE,
    _missing,
    assess,
    threshold_for,
    uniformity,
    walls_fit,
)
from topobatch.merge.robust.view_evidence import NO_VIEW_EVIDENCE
from topobatch.simulation.world import straight, world_of_links
from topobatch.simulation.worlds import make_world
from topobatch.topology.views import SIDE, Views

from .plans import COPIES, EDGES, POINTS, SETTINGS


def test_few_junctions_carry_little_whatever_they_seem_to_tell(drawn):
    a, b = prepare(drawn("a", POINTS, EDGES)), prepare(drawn("b", POINTS, EDGES))
    told = replace(match(a, b, SETTINGS)[0], bits=99.0)
    assert told.counted_bits == MATCH.junction_bits * len(told)
    assert replace(told, bits=7.0).counted_bits == 7.0
    doubted = replace(
        told,
        conflicts=replace(told.conflicts, elsewhere=np.zeros((2, 2), np.int64), elsewhere_bits=3.0),
    )
    assert doubted.counted_bits == told.counted_bits - doubted.conflicts.bits
    alone, among_many = (
        threshold_for(n, n, COPIES, SETTINGS, copied=len(told)) for n in (1, 10**6)
    )
    assert assess(a, b, [told], alone).verdict is Verdict.MERGED
    view = assess(a, b, [told], among_many)
    assert view.verdict is Verdict.AMBIGUOUS
    (answers,) = view.ranked
    assert answers.chance_bits == MATCH.junction_bits * len(told)
    assert view.bits == answers.copy_bits < answers.chance_bits
    assert "another copy" in view.why
    unasked = replace(answers, copy_test=None)
    assert unasked.bits == answers.chance_bits
    assert _missing(unasked, None, among_many) == "chance offers as much too often"
    # Beyond its threshold the test for copies bounds the less, the less likely a copy is.
    for repetition, carried in ((1.0, 1.5), (0.5, 3.0), (0.0, np.inf)):
        tested = CopyTest(bits=6.0, needed_bits=4.5, repetition=repetition)
        assert replace(answers, copy_test=tested).copy_bits == answers.need + carried
    tested = CopyTest(bits=3.0, needed_bits=4.5, repetition=0.5)
    assert replace(answers, copy_test=tested).copy_bits == answers.need - 1.5


def test_furniture_shifts_junctions_not_walls(drawn):
    """Where the walls of three parts agree in one placement, lengths that differ are no doubt."""
    a, b = prepare(drawn("a", POINTS, EDGES)), prepare(drawn("b", POINTS, EDGES))
    told = match(a, b, SETTINGS)[0]
    pose = np.array([[0.0, 0.0, 0.0], [9.0, 0.0, 0.0], [0.0, 9.0, 0.0]])
    views = Views(np.zeros(3, np.int64), pose, np.zeros((3, SIDE, SIDE), np.uint8))
    a, b = (replace(m, topomap=replace(m.topomap, views=views)) for m in (a, b))
    three = np.arange(3)
    evidence = replace(
        NO_VIEW_EVIDENCE, first=three, second=three, cell=three, z=np.full(3, 4.0), bits=np.ones(3)
    )
    for off_m, fit in ((0.0, True), (0.6, False)):
        transform = np.array([[0.0, 0.0, 0.0], [off_m, 0.0, 0.0], [0.0, 0.0, 0.0]])
        seen = replace(told, views=replace(evidence, transform=transform))
        assert walls_fit(a, b, seen) == fit


def _repetition(answers):
    return 0.0 if answers.copy_test is None else answers.copy_test.repetition


def test_walls_say_whether_a_building_of_few_lengths_repeats_itself(drawn):
    """A home has few corridors, which may well be equally long by chance."""
    cross = [(0.0, 0.0), (6.0, 0.0), (-6.0, 0.0), (0.0, 6.0)], [(0, 1), (0, 2), (0, 3)]
    a, b = prepare(drawn("a", *cross)), prepare(drawn("b", *cross))
    assert uniformity(a, b) == 1.0
    told = match(a, b, SETTINGS)[0]
    threshold = threshold_for(1, 1, COPIES, SETTINGS)
    four = replace(NO_VIEW_EVIDENCE, first=np.zeros(4, np.int64), bits=np.full(4, 4.0))
    for level, asked in ((1.4, 0.0), (2.1, 0.4), (3.0, 1.0)):  # of the z of copies
        seen = replace(told, bits=20.0, views=replace(four, null=np.array([level, 0.5])))
        (answers,) = assess(a, b, [seen], threshold).ranked
        assert _repetition(answers) == pytest.approx(asked)
    (answers,) = assess(a, b, [replace(told, bits=20.0)], threshold).ranked
    assert _repetition(answers) == 1.0


def test_floors_of_one_plan_that_differ_a_little_are_not_merged(see):
    """Every junction of the second floor lies up to 0.3 m from where it lies in the first."""
    plan = make_world("maze", 60, 0)
    xy = plan.xy + np.random.default_rng(0).uniform(-0.3, 0.3, plan.xy.shape)
    ends = zip(plan.source.tolist(), plan.target.tolist(), strict=True)
    other = world_of_links("floor", "maze", xy, [straight(xy, u, v) for u, v in ends])
    maps = [see(w, list(range(len(w))), k, f"r{k}") for k, w in enumerate((plan, plan, other))]
    a, again, moved = (prepare(m) for m in maps)
    threshold = threshold_for(1, 1, COPIES, SETTINGS)
    views = [assess(a, m, match(a, m, SETTINGS), threshold) for m in (again, moved)]
    assert [view.verdict for view in views] == [Verdict.MERGED, Verdict.AMBIGUOUS]
    assert views[1].ranked[0].chance_bits > views[1].need_bits  # beyond chance, and yet
    assert views[1].why == MAYBE_COPY


@pytest.fixture
def wings(drawn):
    """A building that has one wing twice, and the wing."""
    n = len(POINTS)
    twice = [*POINTS, *[(x + 40.0, y) for x, y in POINTS]]
    edges = [*EDGES, *[(u + n, v + n) for u, v in EDGES], (2, n)]
    a, b = prepare(drawn("both", twice, edges)), prepare(drawn("one", POINTS, EDGES))
    return a, b


def test_two_placements_that_fit_alike_are_ambiguous(wings):
    """There is no telling which."""
    a, b = wings
    found = match(a, b, SETTINGS)
    assert len(found) >= 2
    assert not same_placement(found[0], found[1], b)
    view = assess(a, b, found, threshold_for(1, 1, COPIES, SETTINGS))
    assert view.verdict == "ambiguous"
    assert view.runner_up is not None
    assert view.margin < MATCH.lead_bits


def test_a_placement_with_no_more_against_it_keeps_the_best_from_being_merged(wings):
    a, b = wings
    best, other = match(a, b, SETTINGS)[:2]
    lax = replace(SETTINGS, copy_margin_bits=12.0)  # what copies differ in is not asked for
    threshold = threshold_for(1, 1, COPIES, lax)
    best, other = replace(best, bits=30.0), replace(other, bits=threshold.need_bits + 0.1)
    refused = assess(a, b, [best, other], threshold)
    assert (refused.verdict, refused.why) == (Verdict.AMBIGUOUS, NO_WORSE)
    assert MATCH.lead_bits < refused.margin < refused.lead_bits == MATCH.contested_bits
    less = replace(other, bits=threshold.need_bits - 1.0)
    doubt = replace(other.conflicts, elsewhere=np.zeros((1, 2), np.int64), elsewhere_bits=1.0)
    for told in (less, replace(other, conflicts=doubt)):
        merged = assess(a, b, [best, told], threshold)
        assert (merged.verdict, merged.lead_bits) == (Verdict.MERGED, MATCH.lead_bits)
