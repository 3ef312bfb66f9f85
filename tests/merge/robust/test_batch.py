"""What is found between the maps of a batch."""

from dataclasses import replace
from functools import partial

import numpy as np

from topobatch.merge.result import Verdict
from topobatch.merge.robust.assessment import thresholds
from topobatch.merge.robust.batch import Batch
from topobatch.merge.robust.entries import Case
from topobatch.merge.robust.pairing import Pairwise
from topobatch.merge.robust.repetition import sameness_of
from topobatch.merge.robust.settings import MATCH
from topobatch.merge.robust.verdict import assess

from .plans import EDGES, POINTS, SETTINGS


def test_what_would_be_merged_is_held_against_every_rival(drawn):
    """Of three copies in one map two are grown; the third is looked at before maps are merged."""
    n, pair, two = len(POINTS), (0, 1), replace(SETTINGS, hypotheses=2)
    points = [(x + 40 * k, y) for k in range(3) for x, y in POINTS]
    edges = [(i + n * k, j + n * k) for k in range(3) for i, j in EDGES]
    matcher = Pairwise([drawn("a", points, edges), drawn("b", POINTS, EDGES)], two)
    batch = Batch(matcher, partial(thresholds, matcher.prepared, two), lambda *_: None)
    (found,) = matcher.candidates(np.array([pair]))
    view = assess(*matcher.prepared, found, batch.threshold(pair))
    assert [(len(c), c.rival) for c, _ in view.ranked] == 2 * [(n, False)]
    beside = batch.beside_rivals({pair: replace(view, verdict=Verdict.MERGED), (1, 1): view})
    assert list(beside) == [pair]
    assert [c.rival for c, _ in beside[pair].ranked].count(True) == 1
    assert beside[pair].verdict is Verdict.AMBIGUOUS


def test_pairs_that_would_be_merged_answer_whether_they_are_copies(drawn):
    """As they would if they were asked; a pair that is not merged says nothing."""
    away = [(x + 9.0, 1.7 * y) for x, y in POINTS]
    maps = [drawn("a", POINTS, EDGES), drawn("b", POINTS, EDGES), drawn("c", away, EDGES)]
    matcher = Pairwise(maps, SETTINGS)
    prepared = matcher.prepared

    def worded(pair, view):
        return Case(*(prepared[k] for k in pair), view).verdict()

    batch = Batch(matcher, partial(thresholds, prepared, SETTINGS), worded)
    batch.look_at(np.array([(0, 1), (0, 2), (1, 2)]))
    assert list(batch.joins) == [(0, 1)]
    copies, best = batch.threshold((0, 1)).copies, batch.candidates([(0, 1)])[0, 1][0]
    (told,) = batch.same_place_bits([(0, 1), (0, 2)])
    (same,) = sameness_of([(prepared[0], prepared[1], best)], copies)
    assert told == same.bits > 0
    assert batch.same_place_bits([]) == []


def test_like_buildings_are_those_with_a_placement_better_than_chance(drawn):
    away = [(x + 9.0, 1.7 * y) for x, y in POINTS]
    shapes = {"a": POINTS, "b": away, "c": POINTS, "d": away}
    matcher = Pairwise([drawn(run, points, EDGES) for run, points in shapes.items()], SETTINGS)
    heard = []

    def thresholds_of(linked):
        heard.append(linked)
        return thresholds(matcher.prepared, SETTINGS, linked)

    batch = Batch(
        matcher,
        thresholds_of,
        lambda pair, view: Case(*map(matcher.prepared.__getitem__, pair), view).verdict(),
    )
    batch.look_at(np.array([(0, 1), (0, 2), (0, 3), (1, 2)]))
    batch.look_at(np.array([(1, 3)]))  # what was matched first decides
    assert heard == [[(0, 2)]]
    assert batch.found[1, 3].against_chance > MATCH.lead_bits
