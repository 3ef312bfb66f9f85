"""What became of each question of loop closure."""

from __future__ import annotations

from dataclasses import astuple, replace

from topobatch.topology.closure.answers import Identification, explained


def test_a_better_reason_replaces_only_that_nothing_was_sure():
    unsure = Identification(0, 5, False, 2.0, "not sure enough", round=4)
    other = replace(unsure, second=6, reason="corridors disagree")
    doubts = {(0, 5): unsure, (0, 6): other}
    found = explained(doubts, {(0, 5): "rivals", (0, 6): "rivals", (1, 2): "rivals"})
    assert list(found) == [(0, 5)]
    assert astuple(found[0, 5]) == astuple(replace(unsure, reason="rivals"))
