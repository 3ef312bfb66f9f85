"""What would settle an ambiguous pair."""

import numpy as np

from topobatch.merge.decision_text import to_record
from topobatch.merge.result import PairVerdict, Verdict
from topobatch.merge.robust.alignment import match
from topobatch.merge.robust.entries import advice
from topobatch.merge.robust.prepare import prepare
from topobatch.merge.robust.verdict import assess, threshold_for

from .plans import COPIES, EDGES, POINTS, SETTINGS


def advised(a, b):
    found = match(a, b, SETTINGS)
    return advice(a, b, assess(a, b, found, threshold_for(1, 1, COPIES, SETTINGS)))


def test_the_corridor_that_one_run_left_out_is_named(drawn):
    a = prepare(drawn("a", [*POINTS, (18, 0), (0, -9)], [*EDGES, (2, 8), (0, 9)]))
    b = prepare(drawn("b", POINTS, EDGES, stubs=[(2, 0.0), (0, -np.pi / 2)]))
    told = advised(a, b)
    # Of two, the longer one.
    assert (
        "record with b's robot the corridor that a drove from its junction 0 to 9 (9.0 m)" in told
    )
    assert "it leaves junction 0 of b" in told
    pair = PairVerdict("a", "b", Verdict.AMBIGUOUS, False, 0.0, "", advice=told)
    assert to_record(pair) == ("a", (0, 9))
