"""Layers: who rests on whom, and what falls."""

from __future__ import annotations

import numpy as np

from topobatch.merge.layers import discard_dependents, discard_match, layers, layers_to_document
from topobatch.merge.result import Alignment, PairVerdict, Verdict


def match(a, b, bits=10.0, accepted=True):
    best = Alignment(np.zeros(3), bits, np.array([[0, 0]]), 0.0)
    verdict = Verdict.MERGED if accepted else Verdict.UNRELATED
    return PairVerdict(a, b, verdict, accepted, bits, "", best=best)


CHAIN = (match("a", "b"), match("b", "c"), match("c", "d"), match("e", "f"))


def test_layers_count_matches_from_the_own_map():
    view = layers("a", CHAIN)
    assert [(m.run, m.layer, m.depends_on) for m in view.maps] == [
        ("a", 0, None),
        ("b", 1, "a"),
        ("c", 2, "b"),
        ("d", 3, "c"),
    ]
    assert view.layer_of("e") is None
    assert layers("e", CHAIN).layer_of("f") == 1
    assert layers("c", CHAIN).layer_of("a") == 2


def test_a_map_depends_on_the_strongest_match_to_the_layer_below():
    view = layers("a", (match("a", "b"), match("a", "c"), match("b", "d", 5), match("c", "d", 9)))
    assert next(m.depends_on for m in view.maps if m.run == "d") == "c"
    assert layers("a", (match("a", "b", 0.0),)).layer_of("b") == 1


def test_discarding_a_match_discards_what_depends_on_it_and_nothing_else():
    view = layers("a", CHAIN)
    assert view.dependents("b") == ("b", "c", "d")
    assert view.dependents("d") == ("d",)
    left = discard_match(CHAIN, "c", "b")
    assert [m.run for m in layers("a", left).maps] == ["a", "b"]
    assert [m.run for m in layers("c", left).maps] == ["c", "d"]
    assert left[3] is CHAIN[3]


def test_a_map_that_another_match_supports_stays_unless_dependents_fall():
    ring = (match("a", "b", 9), match("a", "c", 5), match("b", "d", 9), match("c", "d", 5))
    left = discard_match(ring, "a", "b")
    assert [m.run for m in layers("a", left).maps] == ["a", "c", "d", "b"]
    strict = discard_dependents(ring, "a", "a", "b")
    assert [m.run for m in layers("a", strict).maps] == ["a", "c"]
    assert [v.accepted for v in strict] == [False, True, True, False]
    assert "depends on a match that was discarded" in strict[3].reason


def test_layers_as_json():
    assert layers_to_document("d", CHAIN)[1] == {"run": "c", "layer": 1, "depends_on": "d"}
