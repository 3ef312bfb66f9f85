"""What is found between the maps of a batch."""

from dataclasses import replace

from topobatch.merge.result import Verdict
from topobatch.merge.robust.batch import Batch
from topobatch.merge.robust.pairing import Pairwise

from .plans import EDGES, POINTS, SETTINGS


def test_what_would_be_merged_is_held_against_every_rival(drawn):
    """Of three copies in one map two may be merged; the third is a rival."""
    n, pair, two = len(POINTS), (0, 1), replace(SETTINGS, hypotheses=2)
    points = [(x + 40 * k, y) for k in range(3) for x, y in POINTS]
    edges = [(i + n * k, j + n * k) for k in range(3) for i, j in EDGES]
    matcher = Pairwise([drawn("a", points, edges), drawn("b", POINTS, EDGES)], two)
    batch = Batch(matcher)
    batch.match_likely()
    (found,) = batch.assessments([pair]).values()
    assert [w.candidate.rival for w in found.ranked].count(True) == 1
    assert found.verdict is Verdict.AMBIGUOUS
