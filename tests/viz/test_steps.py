from collections.abc import Callable

import numpy as np

from topobatch.merge.result import Alignment, Component, MergeResult, PairVerdict, Verdict
from topobatch.topology.topomap import TopoMap
from topobatch.viz.steps import joining_steps

Merge = Callable[..., tuple[MergeResult, list[TopoMap]]]


def with_evidence(result: MergeResult, bits: dict[tuple[str, str], float]) -> MergeResult:
    """The same components, joined by pairs of the given evidence alone."""
    here = Alignment(np.zeros(3), 0.0, np.zeros((0, 2)), 0.0)
    pairs = [
        PairVerdict(a, b, Verdict.MERGED, True, value, "fits", here)
        for (a, b), value in sorted(bits.items())
    ]
    return MergeResult(result.components, result.fused, tuple(pairs))


def test_every_run_joins_once_by_its_strongest_link(merge_of: Merge) -> None:
    result, _ = merge_of([["a", "b", "c", "d"]])
    bits = {("a", "b"): 10.0, ("c", "d"): 50.0, ("b", "c"): 20.0, ("a", "d"): 15.0}
    steps = joining_steps(with_evidence(result, bits))
    assert [step.runs for step in steps] == [("c", "d"), ("b",), ("a",)]
    assert [step.pair.evidence_bits for step in steps] == [50.0, 20.0, 15.0]


def test_components_are_told_one_after_the_other(merge_of: Merge) -> None:
    result, _ = merge_of([["a", "d"], ["b", "c"], ["e"]])
    steps = joining_steps(with_evidence(result, {("a", "d"): 5.0, ("b", "c"): 9.0}))
    assert [(step.component, step.runs) for step in steps] == [(0, ("a", "d")), (1, ("b", "c"))]


def test_runs_alone_take_no_step() -> None:
    lonely = (Component(0, {"a": np.zeros(3)}),)
    assert joining_steps(MergeResult(lonely, None, ())) == []
