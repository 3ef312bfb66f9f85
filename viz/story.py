"""A merge step by step: the order in which runs were joined, what is highlighted on the timeline
JOIN, and a line of text for each step."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import rerun as rr

from ..merge.result import MergeResult, PairVerdict, shown_bits
from ..topology.arrays import FloatArray
from ..topology.se2 import apply, compose
from ..topology.topomap import TopoMap
from ..topology.wording import listed
from . import palette
from .parts import Part
from .recording import Recording, light_up

Group = tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """Two groups of runs are joined because of a pair. joins, into: their runs, sorted, the smaller
    group first."""

    joins: Group
    into: Group
    pair: PairVerdict


def joining_steps(result: MergeResult) -> list[Step]:
    """The steps of a merge in order: pairs locked by a person, then pairs by their evidence, then
    groups by the evidence of their merged maps; strongest first.

    Pairs within one group give no step. O(pairs · log pairs).
    """
    home = {run: component.id for component in result.components for run in component.poses}
    group: dict[str, Group] = {run: (run,) for run in home}
    steps = []
    for pair in sorted((p for p in result.verdicts if p.accepted), key=_order):
        if pair.a not in home or home[pair.a] != home.get(pair.b):
            continue
        one, two = group[pair.a], group[pair.b]
        if one != two:
            # Equal sizes: in the pair's order.
            joins, into = sorted((one, two), key=len)
            steps.append(Step(joins, into, pair))
            both = tuple(sorted((*one, *two)))
            group |= dict.fromkeys(both, both)
    return steps


def _order(pair: PairVerdict) -> tuple[bool, bool, float, str, str]:
    by = pair.accepted_by
    return by != "lock", by == "components", -pair.evidence_bits, pair.a, pair.b


def first_steps(steps: Iterable[Step]) -> dict[str, int]:
    """For each run the number, from 1 on, of the step that first joined it with another."""
    first: dict[str, int] = {}
    for number, step in enumerate(steps, start=1):
        for run in (*step.joins, *step.into):
            first.setdefault(run, number)
    return first


STORY = "story"
"""Entity of the texts."""


def write_story(
    recording: Recording,
    root: str,
    steps: Sequence[Step],
    parts: Sequence[Part],
    maps: Mapping[str, TopoMap],
) -> None:
    """Write for each step a line between the centres of its two runs, white at that step, hidden
    before and thin after it; and what happens there as a line of text."""
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
    light_up(
        recording.over_steps,
        path,
        rr.LineStrips2D,
        np.arange(1, len(steps) + 1),
        palette.PAST,
        begin=0,
        now=palette.WHITE,
        dim=palette.BACKGROUND,
    )
    told = [f"{_step_told(step)}: {step.pair.reason}" for step in steps]
    numbers = np.arange(1, len(steps) + 1)
    recording.over_steps((STORY,), numbers, rr.TextLog.columns(text=told))


def _step_told(step: Step) -> str:
    joins, into = (listed(group, 4) for group in (step.joins, step.into))
    if len(step.joins) == len(step.into) == 1:
        return f"{joins} and {into} join"
    return f"{joins} {'joins' if len(step.joins) == 1 else 'join'} {into}"
