from collections.abc import Callable
from dataclasses import replace

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


def test_locks_come_first_and_what_groups_say_together_last(merge_of: Merge) -> None:
    result, _ = merge_of([["a", "b", "c", "d", "e"]])
    bits = {("a", "b"): 10.0, ("c", "d"): 5.0, ("a", "c"): 90.0, ("a", "e"): 70.0}
    pairs = {(p.a, p.b): p for p in with_evidence(result, bits).verdicts}
    pairs["c", "d"] = replace(pairs["c", "d"], accepted_by="lock")
    sides = {("a", "c"): (("a", "b"), ("c", "d", "e")), ("a", "e"): (("c", "d"), ("e",))}
    for pair, together in sides.items():
        a, b = pair if pair != ("a", "e") else ("d", "e")
        pairs[pair] = replace(pairs[pair], a=a, b=b, accepted_by="components", together=together)
    result = replace(result, verdicts=tuple(pairs.values()))
    # The stronger one speaks of a group that the weaker one makes.
    assert groups(result) == [
        (("c",), ("d",)),
        (("a",), ("b",)),
        (("e",), ("c", "d")),
        (("a", "b"), ("c", "d", "e")),
    ]
