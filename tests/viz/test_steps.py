from collections.abc import Callable

import numpy as np

from topobatch.merge.result import Alignment, MergeResult, PairVerdict, Verdict
from topobatch.topology.topomap import TopoMap
from topobatch.viz.story import first_steps, joining_steps

Merge = Callable[..., tuple[MergeResult, list[TopoMap]]]


def with_evidence(result: MergeResult, bits: dict[tuple[str, str], float]) -> MergeResult:
    """The same components, joined by pairs of the given evidence alone."""
    here = Alignment(np.zeros(3), 0.0, np.zeros((0, 2)), 0.0)
    pairs = [
        PairVerdict(a, b, Verdict.MERGED, True, value, "fits", here)
        for (a, b), value in sorted(bits.items())
    ]
    return MergeResult(result.components, result.fused, tuple(pairs))


def groups(result: MergeResult) -> list[tuple[tuple[str, ...], tuple[str, ...]]]:
    return [(step.joins, step.into) for step in joining_steps(result)]


def test_the_strongest_pair_joins_first(merge_of: Merge) -> None:
    result, _ = merge_of([["a", "b", "c", "d"]])
    bits = {("a", "b"): 30.0, ("c", "d"): 50.0, ("b", "c"): 20.0, ("a", "d"): 15.0}
    result = with_evidence(result, bits)
    assert groups(result) == [
        (("c",), ("d",)),
        (("a",), ("b",)),
        (("a", "b"), ("c", "d")),
    ]
    assert [step.pair.evidence_bits for step in joining_steps(result)] == [50.0, 30.0, 20.0]
    assert first_steps(joining_steps(result)) == {"c": 1, "d": 1, "a": 2, "b": 2}
