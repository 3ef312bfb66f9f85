"""A merge step by step: the order in which runs were joined, what is highlighted on the timeline
JOIN, and a page of text for each step."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import rerun as rr

from ..merge.result import MergeResult, PairVerdict, shown_bits
from ..topology.arrays import BoolArray, FloatArray, IntArray
from ..topology.se2 import apply, compose
from ..topology.topomap import TopoMap
from ..topology.wording import listed
from . import palette
from .growing import light_up_by_step
from .map_summary import plain
from .parts import Part
from .recording import Recording

STORY_BEFORE, STORY_AFTER = 8, 12
"""Steps listed before and after a step on its page."""

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


STORY = "story"
"""Entity of the pages."""


def shared_from(part: Part, steps: Iterable[tuple[int, Step]], runs_at: BoolArray) -> IntArray:
    """(n,) the step at which two runs that share a junction are joined first, 0 for never.

    steps: of this component, with their numbers; runs_at: (n, r) whether each of its runs, sorted
    by name, has the junction. O(steps · n · r).
    """
    column = {run: k for k, run in enumerate(sorted(part.component.poses))}
    shared = np.zeros(len(runs_at), np.int64)
    for number, step in steps:
        one = runs_at[:, [column[run] for run in step.joins]].any(axis=1)
        two = runs_at[:, [column[run] for run in step.into]].any(axis=1)
        shared[(shared == 0) & one & two] = number
    return shared


def write_story(
    recording: Recording,
    root: str,
    steps: Sequence[Step],
    parts: Sequence[Part],
    maps: Mapping[str, TopoMap],
) -> None:
    """Write for each step a line between the centres of its two runs, white at that step, hidden
    before and thin after it; and a page of text for each step."""
    parted = {run: part for part in parts for run in part.component.poses}

    def middle(run: str) -> FloatArray:
        own, part = maps[run].xy, parted[run]
        at = own.mean(axis=0) if len(own) else np.zeros(2)
        T_sheet_run = compose(part.cell.T_sheet_map, part.component.poses[run])
        return np.asarray(apply(T_sheet_run, at[None])[0])

    path = (root, "joins")
    recording.static(
        path,
        rr.LineStrips2D.from_fields(
            strips=[np.stack([middle(s.pair.a), middle(s.pair.b)]) for s in steps],
            radii=rr.Radius.ui_points(1.25),
            draw_order=palette.Order.SIGHTING,
        ),
        rr.AnyValues(
            step=np.arange(1, len(steps) + 1),
            pair=[f"{s.pair.a} - {s.pair.b}" for s in steps],
            evidence=[f"{shown_bits(s.pair.evidence_bits)} bits" for s in steps],
            reason=[s.pair.reason for s in steps],
        ),
    )
    light_up_by_step(
        recording,
        path,
        rr.LineStrips2D,
        np.arange(1, len(steps) + 1),
        palette.PAST,
        now=palette.WHITE,
        dim=palette.BACKGROUND,
    )
    pages = joining_told(steps)
    columns = rr.TextDocument.columns(text=pages, media_type=["text/markdown"] * len(pages))
    recording.over_steps((STORY,), np.arange(len(pages)), columns)


def joining_told(steps: Sequence[Step]) -> list[str]:
    """A page of markdown for every step, that of step 0 first: what happens there, and around it.

    A page shows STORY_BEFORE steps before its own and STORY_AFTER after it.
    """
    lines = [_step_told(step) for step in steps]
    reasons = [f"{plain(s.pair.a)} - {plain(s.pair.b)}: {plain(s.pair.reason)}" for s in steps]
    pages = []
    for now in range(len(steps) + 1):
        head = f"# Step {now} of {len(steps)}\n\n"
        head += f"{lines[now - 1]}\n\n{reasons[now - 1]}" if now else "Every run is by itself."
        shown = range(max(0, now - 1 - STORY_BEFORE), min(len(steps), now + STORY_AFTER))
        rest = [f"- {'→ ' if i + 1 == now else ''}{i + 1}: {lines[i]}" for i in shown]
        pages.append(head + "\n\n## Before and after\n\n" + "\n".join(rest) + "\n")
    return pages


def _step_told(step: Step) -> str:
    joins, into = (listed(list(map(plain, group)), 4) for group in (step.joins, step.into))
    if len(step.joins) == len(step.into) == 1:
        return f"**{joins}** and **{into}** join"
    return f"**{joins}** {'joins' if len(step.joins) == 1 else 'join'} **{into}**"
