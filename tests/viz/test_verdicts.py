from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from topobatch.merge.result import FusedMap, MergeResult, Standing
from topobatch.topology.topomap import TopoMap
from topobatch.viz import verdicts
from topobatch.viz.history import history, questions
from topobatch.viz.map_summary import bulleted, map_summary
from topobatch.viz.story import joining_steps, joining_told
from topobatch.viz.verdicts import (
    CLASS,
    DIAGONAL,
    merge_summary,
    pairs_told,
    runs_in_order,
    verdict_matrix,
)

Merge = Callable[..., tuple[MergeResult, list[TopoMap]]]


def test_the_matrix_says_what_the_verdicts_say(merge_of: Merge) -> None:
    result, _ = merge_of([["z"], ["a", "c"]], ambiguous=[("c", "z")])
    runs = runs_in_order(result)
    assert runs == ["a", "c", "z"]
    expected = [
        [DIAGONAL, CLASS[Standing.MERGED], CLASS[Standing.UNRELATED]],
        [CLASS[Standing.MERGED], DIAGONAL, CLASS[Standing.AMBIGUOUS]],
        [CLASS[Standing.UNRELATED], CLASS[Standing.AMBIGUOUS], DIAGONAL],
    ]
    assert np.array_equal(verdict_matrix(result, runs), expected)


def test_every_pair_is_told_with_its_reason(merge_of: Merge) -> None:
    result, _ = merge_of([["a", "b"], ["c"]], ambiguous=[("b", "c")])
    told = pairs_told(result)
    assert "all fits" in told
    assert "two ways" in told
    assert "to settle it: go on" in told
    assert "a - c" in told
    assert told.index("Ambiguous (1)") < told.index("Merged (1)") < told.index("Unrelated (1)")


def test_pairs_beyond_those_that_are_told_are_counted(merge_of: Merge, monkeypatch) -> None:
    result, _ = merge_of([["a", "b"], ["c"]])
    monkeypatch.setattr(verdicts, "MOST_PAIRS", 2)
    assert "more, in `merged.json`" not in pairs_told(result)  # 2 of them are unrelated
    monkeypatch.setattr(verdicts, "MOST_PAIRS", 1)
    assert "… and 1 more, in `merged.json`" in pairs_told(result)


def test_summaries_count(merge_of: Merge) -> None:
    result, _ = merge_of([["a", "b"], ["c"]])
    told = merge_summary(result)
    assert "**3** runs of **2** sites" in told
    assert "**10** junctions, 5 of them seen by several runs" in told
    assert "**1** merged, **0** ambiguous, **2** unrelated" in told
    assert "take care" in told


def test_pairs_that_only_others_join_are_not_called_unrelated(merge_of: Merge) -> None:
    result, _ = merge_of([["a", "b"], ["c"]])
    joined = tuple(replace(v, through=("b",)) if v.b == "c" else v for v in result.verdicts)
    result = replace(result, verdicts=joined)
    assert verdict_matrix(result, ["a", "b", "c"])[0, 2] == CLASS[Standing.JOINED]
    assert "**2** joined through others, **0** ambiguous, **0** unrelated" in merge_summary(result)
    assert "Joined through others (2)" in pairs_told(result)


def test_a_merge_of_nothing_is_told(no_fused: FusedMap) -> None:
    nothing = MergeResult((), no_fused, ())
    assert "**0** runs" in merge_summary(nothing)
    assert "no pair" in pairs_told(nothing)


def test_the_story_has_a_page_for_every_step(merge_of: Merge) -> None:
    result, _ = merge_of([["a", "b", "c"]])
    pages = joining_told(joining_steps(result))
    assert len(pages) == 3
    assert "by itself" in pages[0]
    assert "**a** and **b** join" in pages[1]
    assert "**c** joins **a, b**" in pages[2]
    assert "all fits" in pages[2]


def test_a_map_is_told_with_refusals_and_warnings(make_map: Callable[..., TopoMap]) -> None:
    topomap = make_map("lab_2*")
    asked = questions(topomap, history(topomap).visit)
    told = map_summary(topomap, asked)
    assert "# lab\\_2\\*" in told
    assert "**5** vertices (2 bends, 1 dead end, 2 junctions)" in told
    assert "**1** branch seen and never driven" in told
    assert "**1** visit recognised, **1** refused" in told
    assert "2 \\| 1 have \\*other\\* branches" in told
    assert "junction 1 (visit 2) not taken for junction 2 (visit 1), -3.0 bits" in told
    assert "**Red** lines" in told
    assert "2 messages were empty" in told
    assert "- odometry: /odom, 140 messages\n- time: header" in told


@pytest.mark.parametrize("told", [None, 3, "lag_s", {"lag_s": 0.2}, {"lag_s": {"applied": "x"}}])
def test_a_map_is_told_with_what_it_was_corrected_by(make_map, told) -> None:
    applied = {"bias_rad_per_m": np.radians(0.5), "turn_scale": 0.0, "length_scale": 0.0428}
    known = {name: {"applied": value} for name, value in applied.items()}
    topomap = make_map("a")
    page = map_summary(replace(topomap, info={**topomap.info, "calibration": known}), [])
    assert "| heading, turned on per metre | 0.500 ° |\n| lengths, shorter by | 4.280 % |" in page
    assert "turns, larger" not in page
    foreign = replace(topomap, info={**topomap.info, "calibration": told})
    assert "Corrected" not in map_summary(foreign, [])


def test_an_empty_map_is_told(empty_map: TopoMap) -> None:
    assert "The map is empty" in map_summary(empty_map, [])


def test_long_lists_are_cut() -> None:
    told = bulleted((str(i) for i in range(50)), most=3)
    assert told.splitlines()[-1] == "- … and 47 more, in the JSON document"
