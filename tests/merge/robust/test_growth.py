"""Matches that grow from seeds."""

import numpy as np

from topobatch.merge.robust.growth import grow
from topobatch.merge.robust.links import Seed, candidate_links, seeds
from topobatch.merge.robust.prepare import prepare

from .plans import EDGES, POINTS, SETTINGS, lanes_of


def test_seeds_grow_as_each_would_alone(halves):
    a, b = (prepare(m) for m in halves)
    found = seeds(a, b, candidate_links(a, b), 3)
    wrong = Seed(np.array([0, 1]), np.array([7, 3]), 2.0, 5j, 1.0)
    several = [*found, wrong, *found]
    lanes = lanes_of([(a, b)] * len(several))
    grown = grow(lanes, several, SETTINGS)
    for k, seed in enumerate(several):
        alone = grow(lanes_of([(a, b)]), [seed], SETTINGS)
        mine, rows = grown.lane == k, lanes.lane == k
        assert (grown.a[mine] - lanes.a.vertex[k]).tolist() == alone.a.tolist()
        assert (grown.b[mine] - lanes.b.vertex[k]).tolist() == alone.b.tolist()
        assert grown.place[rows].tolist() == alone.place.tolist()
        assert grown.branch[mine].tolist() == alone.branch.tolist()
    assert np.count_nonzero(grown.lane == 0) > 10
    assert not (grown.lane == len(found)).any()


def test_a_match_of_few_of_the_junctions_that_should_be_there_is_given_up(drawn):
    a = prepare(drawn("a", POINTS, EDGES))
    for displaced, kept in ((2, [2, 3, 4, 6, 7]), (5, [])):
        aside = [
            (x + (k < displaced) * 2.0, y + (k < displaced) * 1.5)
            for k, (x, y) in enumerate(POINTS)
        ]
        b = prepare(drawn("b", aside, EDGES))
        seed = Seed(np.array([6, 7]), np.array([6, 7]), 0.0, 0j, 1.0)
        grown = grow(lanes_of([(a, b)]), [seed], SETTINGS)
        assert grown.a.tolist() == kept


def test_places_that_the_runs_joined_by_different_ways_are_matched_as_one(drawn):
    there = [(x + 30.0, y) for x, y in POINTS]
    edges = EDGES + [(u + 8, v + 8) for u, v in EDGES]
    a = prepare(drawn("a", [*POINTS, *there, (20, 20)], [*edges, (7, 16), (16, 13)]))
    b = prepare(drawn("b", [*POINTS, *there, (25, -25)], [*edges, (4, 16), (16, 11)]))
    seed = Seed(np.array([0, 1]), np.array([0, 1]), 0.0, 0j, 1.0)
    grown = grow(lanes_of([(a, b)]), [seed], SETTINGS)
    assert set(range(16)) - set(grown.a.tolist()) <= {4, 7, 11, 13}  # where the ways differ
    assert grown.a.tolist() == grown.b.tolist()


def test_what_stands_alone_far_off_is_not_matched(drawn):
    edges = [*EDGES, (4, 8), (7, 8)]
    far = [*POINTS, (36.0, 1.0)]
    a, b = prepare(drawn("a", far, edges)), prepare(drawn("b", far, edges))
    seed = Seed(np.array([0, 1]), np.array([0, 1]), 0.0, 0j, 1.0)
    assert grow(lanes_of([(a, b)]), [seed], SETTINGS).a.tolist() == list(range(8))
    far, edges = [*far, (36.0, 6.0)], [*edges, (8, 9)]
    a, b = prepare(drawn("a", far, edges)), prepare(drawn("b", far, edges))
    assert grow(lanes_of([(a, b)]), [seed], SETTINGS).a.tolist() == list(range(10))


def test_junctions_with_contradicting_branches_are_not_matched(drawn):
    a = prepare(drawn("a", POINTS, EDGES))
    other = [(7, heading) for heading in (0.8, 2.0, -0.8, -2.0)]
    b = prepare(drawn("b", POINTS, EDGES, stubs=other))
    seed = Seed(np.array([0, 1]), np.array([0, 1]), 0.0, 0j, 1.0)
    grown = grow(lanes_of([(a, b)]), [seed], SETTINGS)
    assert grown.a.tolist() == list(range(7))
