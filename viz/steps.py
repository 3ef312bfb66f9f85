"""The order in which a merge joined the runs."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from ..merge.result import MergeResult, PairVerdict

Group = tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """Two groups of runs are joined because of a pair. joins, into: their runs, sorted, the smaller
    group first; component: id of the one that holds them in the end."""

    component: int
    joins: Group
    into: Group
    pair: PairVerdict


def joining_steps(result: MergeResult) -> list[Step]:
    """The steps of a merge in order: pairs locked by a person, then pairs by their evidence, then
    groups by the evidence of their merged maps; strongest first.

    Pairs within one group give no step. O(pairs · log pairs).
    """
    home = {run: component.id for component in result.components for run in component.poses}
    groups = _Groups(home)
    inside = [p for p in result.verdicts if p.accepted and home.get(p.a) == home.get(p.b)]
    inside = [p for p in inside if p.a in home]
    alone = [p for p in inside if p.accepted_by != "components"]
    steps: list[Step] = []
    for pair in sorted(alone, key=_strength):
        steps += groups.joined(pair)
    waiting = sorted((p for p in inside if p.accepted_by == "components"), key=_strength)
    while waiting:
        pair = next((p for p in waiting if groups.are_sides(p)), waiting[0])
        waiting.remove(pair)
        steps += groups.joined(pair)
    return steps


def _strength(pair: PairVerdict) -> tuple[bool, float, str, str]:
    return (pair.accepted_by != "lock", -pair.evidence_bits, pair.a, pair.b)


class _Groups:
    """The groups of runs joined so far."""

    def __init__(self, home: dict[str, int]) -> None:
        self._home = home
        self._of: dict[str, Group] = {run: (run,) for run in home}

    def are_sides(self, pair: PairVerdict) -> bool:
        """Whether both components that the pair's evidence is from are groups now."""
        sides = pair.together or ()
        return all(self._of.get(side[0]) == tuple(sorted(side)) for side in sides if side)

    def joined(self, pair: PairVerdict) -> Iterable[Step]:
        """The step that joins the pair's groups; none if they are one already."""
        one, two = self._of[pair.a], self._of[pair.b]
        if one == two:
            return
        joins, into = sorted((one, two), key=lambda group: (len(group), group))
        if len(one) == len(two):  # equal sizes: in the pair's order
            joins, into = one, two
        both = tuple(sorted((*one, *two)))
        self._of |= dict.fromkeys(both, both)
        yield Step(self._home[pair.a], joins, into, pair)


def first_steps(steps: Iterable[Step]) -> dict[str, int]:
    """For each run the number, from 1 on, of the step that first joined it with another."""
    first: dict[str, int] = {}
    for number, step in enumerate(steps, start=1):
        for run in (*step.joins, *step.into):
            first.setdefault(run, number)
    return first
