"""In which order the runs were joined, strongest evidence first: the story that a merge tells."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from ..merge.result import MergeResult, PairVerdict


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """`runs` come to a component, two for its first step, then one; `pair` is why."""

    component: int
    runs: tuple[str, ...]
    pair: PairVerdict


def joining_steps(result: MergeResult) -> list[Step]:
    """One component after the other, each grown from its strongest accepted pair by the strongest
    accepted pair that brings a new run (Prim's tree on evidence; ties go to the first names).

    Pairs that confirm what is joined already give no step. O(runs × accepted pairs) at worst.
    """
    accepted = sorted(
        (pair for pair in result.verdicts if pair.accepted),
        key=lambda pair: (-pair.evidence_bits, pair.a, pair.b),
    )
    home = {run: component.id for component in result.components for run in component.poses}
    by_component: dict[int, list[PairVerdict]] = {c.id: [] for c in result.components}
    for pair in accepted:
        if home.get(pair.a) is not None and home.get(pair.a) == home.get(pair.b):
            by_component[home[pair.a]].append(pair)
    return [step for c, pairs in by_component.items() for step in _grown(c, pairs)]


def _grown(component: int, pairs: list[PairVerdict]) -> Iterable[Step]:
    """Steps of one component; `pairs` descend in evidence."""
    joined: set[str] = set()
    while True:
        reaching = (
            pair for pair in pairs if not joined or (pair.a in joined) != (pair.b in joined)
        )
        pair = next(reaching, None)
        if pair is None:
            return
        new = tuple(run for run in (pair.a, pair.b) if run not in joined)
        joined.update(new)
        yield Step(component, new, pair)
