"""Runs that only others join."""

import numpy as np

from topobatch.merge.result import Alignment, PairVerdict, Verdict
from topobatch.merge.through import joined_through

HERE = Alignment(np.zeros(3), 20.0, np.zeros((0, 2)), 0.0)


def pair(a, b, accepted):
    verdict = Verdict.MERGED if accepted else Verdict.UNRELATED
    return PairVerdict(a, b, verdict, accepted, 20.0, "", HERE if accepted else None)


def test_the_shortest_chain_joins_two_runs():
    #   d - a - b - c - e, and a - f - e; g by itself
    joined = {("a", "b"), ("a", "d"), ("b", "c"), ("c", "e"), ("a", "f"), ("e", "f")}
    runs = "abcdefg"
    verdicts = [pair(x, y, (x, y) in joined) for x in runs for y in runs if x < y]
    found = joined_through(verdicts)
    assert found["a", "c"] == ("b",)
    assert found["a", "e"] == ("f",)
    assert found["d", "e"] == ("a", "f")
    assert found["b", "d"] == ("a",)
    assert not any("g" in key for key in found)
    assert not joined & set(found)
