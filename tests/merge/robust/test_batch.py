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
    batch.match_likely()
    (plain,), (thorough,) = (
        found(np.array([pair])) for found in (matcher.candidates, matcher.thorough)
    )
    assert [(len(c), c.rival) for c in plain] == 2 * [(n, False)]
    assert [c.rival for c in thorough].count(True) == 1
    threshold = batch.threshold(pair)
    assert assess(*matcher.prepared, thorough, threshold).verdict is Verdict.AMBIGUOUS
