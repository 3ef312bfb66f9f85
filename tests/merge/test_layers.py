"""Layers: who rests on whom."""

from __future__ import annotations

import numpy as np

from topobatch.merge.layers import layers_to_document
from topobatch.merge.result import Alignment, PairVerdict, Verdict


def match(a, b, bits=10.0, accepted=True):
    best = Alignment(np.zeros(3), bits, np.array([[0, 0]]), 0.0)
    verdict = Verdict.MERGED if accepted else Verdict.UNRELATED
    return PairVerdict(a, b, verdict, accepted, bits, "", best=best)


CHAIN = (match("a", "b"), match("b", "c"), match("c", "d"), match("e", "f"))


def rows(own, verdicts):
    return [tuple(row.values()) for row in layers_to_document(own, verdicts)]


def test_layers_count_matches_from_the_own_map():
    assert rows("a", CHAIN) == [("a", 0, None), ("b", 1, "a"), ("c", 2, "b"), ("d", 3, "c")]
    assert rows("e", CHAIN) == [("e", 0, None), ("f", 1, "e")]
    assert rows("c", CHAIN) == [("c", 0, None), ("b", 1, "c"), ("d", 1, "c"), ("a", 2, "b")]
    assert rows("a", (match("a", "b", accepted=False),)) == [("a", 0, None)]


def test_a_map_depends_on_the_strongest_match_to_the_layer_below():
    ring = (match("a", "b"), match("a", "c"), match("b", "d", 5), match("c", "d", 9))
    assert rows("a", ring)[-1] == ("d", 2, "c")
    assert rows("a", (match("a", "b", 0.0),))[-1] == ("b", 1, "a")
    alike = (match("a", "c"), match("a", "b"), match("c", "d"), match("b", "d"))
    assert rows("a", alike)[-1] == ("d", 2, "b")
