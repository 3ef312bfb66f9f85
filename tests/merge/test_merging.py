"""The driver: any order, same bytes; removing a run or a match; locks; errors."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest

from topobatch.merge.document import merged_to_document
from topobatch.merge.locks import Lock
from topobatch.merge.merged_schema import MergedDocument
from topobatch.merge.merging import MergeSettings, merge_maps
from topobatch.merge.paper.meeting import Meeting
from topobatch.merge.paper.method import PaperSettings
from topobatch.merge.result import Verdict
from topobatch.topology.errors import DataError, UsageError
from topobatch.topology.matching.correspondence import GrowthSettings

PAPER = MergeSettings(method="paper", paper=PaperSettings(GrowthSettings()))


def text(result):
    document = merged_to_document(result)
    MergedDocument.model_validate(document)
    return json.dumps(document)


@pytest.fixture(name="fleet", scope="module")
def _fleet(mazes):
    """Three maps of one maze, the middle one overlapping both others, and one of another maze."""
    rng = np.random.default_rng(5)
    maze, other = mazes.random_maze(rng, 12, 12), mazes.random_maze(rng, 8, 8)
    order = np.argsort(maze.xy[:, 0] + 0.01 * maze.xy[:, 1])
    slices = [order[:55], order[25:95], order[60:]]
    error = mazes.Noise(floor_m=0.02, share=0.0)
    maps = [
        mazes.explored_map(maze, sorted(s.tolist()), rng, f"r{k}", noise=error, turn=0.9 * k)
        for k, s in enumerate(slices)
    ]
    far = mazes.explored_map(other, list(range(len(other.xy))), rng, "x", noise=error, turn=-1.0)
    return [*maps, far]


def runs(result):
    return [sorted(c.poses) for c in result.components]


def test_runs_are_merged_and_the_stranger_stays_alone(fleet):
    result = merge_maps(fleet, PAPER)
    assert runs(result) == [["r0", "r1", "r2"], ["x"]]
    assert [(v.a, v.b) for v in result.verdicts] == sorted((v.a, v.b) for v in result.verdicts)
    assert len(result.verdicts) == 6
    layers = result.info["layers"]["r0"]
    assert {m["run"]: m["layer"] for m in layers}["r1"] == 1


def test_the_order_of_the_maps_changes_nothing(fleet):
    expected = text(merge_maps(fleet, PAPER))
    for order in list(permutations(fleet))[1::7]:
        assert text(merge_maps(list(order), PAPER)) == expected


def test_removing_a_run_and_merging_again_is_never_having_had_it(fleet):
    without = merge_maps([m for m in fleet if m.run != "r1"], PAPER)
    merge_maps(fleet, PAPER)
    assert text(merge_maps([m for m in fleet if m.run != "r1"], PAPER)) == text(without)
    assert all("r1" not in c.poses for c in without.components)


def test_two_maps_of_one_run_are_refused(fleet):
    with pytest.raises(DataError, match="run 'r0' is given 2 times"):
        merge_maps([fleet[0], fleet[1], replace(fleet[2], run="r0")], PAPER)


def test_locked_apart_not_even_through_other_runs(fleet):
    result = merge_maps(fleet, PAPER, locks=[Lock("r0", "r2", "never")])
    assert not any({"r0", "r2"} <= set(c.poses) for c in result.components)
    assert any("r1" in c.poses and len(c.poses) == 2 for c in result.components)
    told = next(v for v in result.verdicts if (v.a, v.b) == ("r0", "r2"))
    assert told.locked == "never"
    assert told.verdict is Verdict.UNRELATED
    refused = [v for v in result.verdicts if "locked apart" in v.reason]
    assert len(refused) == 2


def test_locked_together_by_a_match_with_the_given_junctions(fleet):
    told = next(v for v in merge_maps(fleet, PAPER).verdicts if v.accepted)
    u, v = told.best.matched[0].tolist()
    locks = [Lock(told.b, told.a, "same", at=(v, u)), Lock("x", "r2", "same", at=(3, 4))]
    by_pair = {(v.a, v.b): v for v in merge_maps(fleet, PAPER, locks=locks).verdicts}
    locked, infeasible = by_pair[told.a, told.b], by_pair["r2", "x"]
    assert locked.accepted
    assert locked.accepted_by == "lock"
    assert [u, v] in locked.best.matched.tolist()
    assert not infeasible.accepted
    assert "no match of the two honours the lock" in infeasible.reason
    with pytest.raises(UsageError, match="names junction 999 of 'x'"):
        merge_maps(fleet, PAPER, locks=[Lock("r2", "x", "same", at=(0, 999))])


def test_a_meeting_of_a_run_that_is_not_there_is_refused(fleet):
    met = replace(PAPER, paper=replace(PAPER.paper, meetings=(Meeting("r0", 0, "zz", 0),)))
    with pytest.raises(UsageError, match="'zz'"):
        merge_maps(fleet, met)


def test_one_recording_under_two_names_is_told(fleet):
    again = replace(fleet[1], run="r1-copy", frame="other")
    assert merge_maps([*fleet, again], PAPER).info["warnings"] == [
        "r1, r1-copy are one recording under 2 names: what it tells counts 2 times; discard all "
        "but one"
    ]
    assert "warnings" not in merge_maps(fleet, PAPER).info
