"""What is found between the maps of a batch."""

from dataclasses import replace

import numpy as np

from topobatch.merge.result import Verdict
from topobatch.merge.robust.batch import Batch
from topobatch.merge.robust.pairing import Pairwise
from topobatch.merge.robust.verdict import assess

from .plans import EDGES, POINTS, SETTINGS


def test_what_would_be_merged_is_held_against_every_rival(drawn):
    """Of three copies in one map two are grown; the third is looked at before maps are merged."""
    n, pair, two = len(POINTS), (0, 1), replace(SETTINGS, hypotheses=2)
    points = [(x + 40 * k, y) for k in range(3) for x, y in POINTS]
    edges = [(i + n * k, j + n * k) for k in range(3) for i, j in EDGES]
    matcher = Pairwise([drawn("a", points, edges), drawn("b", POINTS, EDGES)], two)
    batch = Batch(matcher)
    (found,) = matcher.candidates(np.array([pair]))
    view = assess(*matcher.prepared, found, batch.threshold(pair))
    assert [(len(w.candidate), w.candidate.rival) for w in view.ranked] == 2 * [(n, False)]
    beside = batch.beside_rivals([pair])
    assert list(beside) == [pair]
    assert [w.candidate.rival for w in beside[pair].ranked].count(True) == 1
    assert beside[pair].verdict is Verdict.AMBIGUOUS
