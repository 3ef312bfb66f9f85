"""The method as a whole, on random mazes; the paper's own example is in test_example.py."""

from __future__ import annotations

from dataclasses import replace

import pytest

from topobatch.merge.paper.explain import explain, lines
from topobatch.merge.paper.meeting import Meeting
from topobatch.merge.paper.method import PaperSettings, decide, judge, prepare_map
from topobatch.merge.result import Verdict
from topobatch.topology.matching.correspondence import GrowthSettings
from topobatch.topology.se2 import wrap


@pytest.mark.parametrize("world", ["auto", "general"])
@pytest.mark.parametrize("degree", ["exact", "inexact"])
def test_mazes_are_merged_where_they_overlap(maze_pair, world, degree):
    settings = PaperSettings(GrowthSettings(world, degree))
    for seed in range(2):
        a, b, truth = maze_pair(seed)
        verdict = judge(prepare_map(a), prepare_map(b), settings)
        assert verdict.verdict is Verdict.MERGED
        right = {tuple(p) for p in truth.tolist()}
        got = {tuple(p) for p in verdict.best.matched.tolist()}
        assert len(got & right) >= 0.5 * len(truth)  # the overlap may be in several parts
        assert len(got - right) <= (1 if degree == "inexact" else 0)
        assert abs(wrap(verdict.best.transform[2] + 0.7)) < 0.02
        assert verdict.best.rmse_m < 0.2
        assert verdict.evidence_bits > 10


def test_moving_and_renumbering_a_map_moves_the_answer_alike(maze_pair):
    a, b, _ = maze_pair(3)
    settings = PaperSettings(GrowthSettings())
    before = judge(prepare_map(a), prepare_map(b), settings)
    swapped = judge(prepare_map(replace(b, run="a")), prepare_map(replace(a, run="b")), settings)
    assert {tuple(p) for p in before.best.matched[:, ::-1].tolist()} == {
        tuple(p) for p in swapped.best.matched.tolist()
    }
    assert wrap(before.best.transform[2] + swapped.best.transform[2]) == pytest.approx(0, abs=1e-6)


def test_maps_with_nothing_in_common_are_unrelated(draw):
    a = draw("a", {"p": (0, 0), "q": (5, 0)}, [("p", "q")])
    b = draw("b", {"p": (0, 0), "q": (9, 0)}, [("p", "q")])
    (verdict,) = decide([b, a])
    assert verdict.verdict is Verdict.UNRELATED
    assert verdict.best is None
    assert verdict.threshold_bits == pytest.approx(10.0, abs=0.1)
    assert (
        verdict.reason == "4 compatible pairs of junctions, none of which fits along its corridors"
    )
    table = lines(explain(a, b))
    assert "4 compatible pairs, 4 with their rotations; 0 hypotheses in 0 clusters" in table[0]
    assert not any(line.startswith("cluster") for line in table)
    bend = draw("c", {"p": (0, 0)}, [], stubs=[("p", 0.0), ("p", 1.5), ("p", 3.0)])
    (verdict,) = decide([bend, a])
    assert verdict.reason == "no pair of junctions is compatible"


def test_runs_that_met_and_share_nothing_there(draw):
    a = draw("a", {"p": (0, 0), "q": (5, 0)}, [("p", "q")])
    b = draw("b", {"p": (0, 0), "q": (9, 0)}, [("p", "q")])
    met = PaperSettings(meetings=(Meeting("a", 0, "b", 0, range_m=1.0),))
    (verdict,) = decide([a, b], met)
    assert verdict.reason.startswith("1 compatible pair of junctions near both robots, none of ")
