"""A merge step by step: what is highlighted on the timeline JOIN, and a page of text for each
step."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
import rerun as rr

from ..merge.result import shown_bits
from ..topology.arrays import BoolArray, FloatArray, IntArray
from ..topology.se2 import apply, compose
from ..topology.topomap import TopoMap
from . import palette
from .growing import light_up_by_step
from .parts import Part
from .recording import Recording
from .steps import Step
from .verdicts import joining_told

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
