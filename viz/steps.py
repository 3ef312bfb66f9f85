"""In which order the runs were joined: the story that a merge tells."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from ..merge.result import MergeResult, PairVerdict

Group = tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """Two groups of runs become one, for the sake of a pair. joins, into: their runs, sorted, the
    smaller group first; component: the one that they end up in."""

    component: int
    joins: Group
    into: Group
    pair: PairVerdict


def joining_steps(result: MergeResult) -> list[Step]:
    """Every step of a merge in the order in which it was done: pairs that a person locked, then
    pairs by their evidence, then groups by that of their merged maps, strongest first.

    Pairs that confirm what is joined already give no step. O(pairs · log pairs).
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
    """Runs that are together so far."""

    def __init__(self, home: dict[str, int]) -> None:
        self._home = home
        self._of: dict[str, Group] = {run: (run,) for run in home}

    def are_sides(self, pair: PairVerdict) -> bool:
        """Are the two components that a pair speaks for groups of their own now?"""
        sides = pair.together or ()
        return all(self._of.get(side[0]) == tuple(sorted(side)) for side in sides if side)

    def joined(self, pair: PairVerdict) -> Iterable[Step]:
        """The step that brings a pair together, if it is not yet."""
        one, two = self._of[pair.a], self._of[pair.b]
        if one == two:
            return
        joins, into = sorted((one, two), key=lambda group: (len(group), group))
        if len(one) == len(two):  # a pair reads in the order of its names
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
