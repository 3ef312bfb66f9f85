from collections.abc import Callable
from dataclasses import replace

import numpy as np

from topobatch.merge.result import MergeResult, Standing
from topobatch.topology.topomap import TopoMap
from topobatch.viz.pages import closure_texts, map_page, merge_page
from topobatch.viz.parts import runs_in_order
from topobatch.viz.report_pairs import CLASS, DIAGONAL, verdict_matrix

Merge = Callable[..., tuple[MergeResult, list[TopoMap]]]


def test_the_matrix_says_what_the_verdicts_say(merge_of: Merge) -> None:
    result, _ = merge_of([["z"], ["a", "c"]], ambiguous=[("c", "z")])
    assert runs_in_order(result) == ["a", "c", "z"]
    expected = [
        [DIAGONAL, CLASS[Standing.MERGED], CLASS[Standing.UNRELATED]],
        [CLASS[Standing.MERGED], DIAGONAL, CLASS[Standing.AMBIGUOUS]],
        [CLASS[Standing.UNRELATED], CLASS[Standing.AMBIGUOUS], DIAGONAL],
    ]
    assert np.array_equal(verdict_matrix(result), expected)


def test_pairs_that_only_others_join_are_not_called_unrelated(merge_of: Merge) -> None:
    result, _ = merge_of([["a", "b"], ["c"]])
    joined = tuple(replace(v, through=("b",)) if v.b == "c" else v for v in result.verdicts)
    result = replace(result, verdicts=joined)
    assert verdict_matrix(result)[0, 2] == CLASS[Standing.JOINED]
    assert "2 joined through others, 0 ambiguous, 0 unrelated" in merge_page(result)


def test_a_map_is_told_with_refusals_and_warnings(make_map: Callable[..., TopoMap]) -> None:
    topomap = make_map("lab_2*")
    told = map_page(topomap, closure_texts(topomap))
    assert "# lab\\_2\\*" in told
    assert "5 junctions, 5 corridors, 38 m; 8 passes" in told
    assert "1 branch seen and never driven" in told
    assert "1 visit recognised, 1 refused" in told
    assert "**Red** lines" in told
    assert "2 messages were empty" in told
