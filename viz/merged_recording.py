"""The recording of a merge, `merged.rrd`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import rerun.blueprint as rrb

from ..merge.result import MergeResult
from ..topology.topomap import TopoMap
from . import palette
from .drawing import bounds
from .fused_layers import AGREEMENT, FUSED, RUNS, write_fused_layers
from .pair_layers import (
    MATRIX,
    STEPS,
    STORY,
    UNDECIDED,
    matrix_bounds,
    undecided,
    write_matrix,
    write_steps,
    write_undecided,
)
from .parts import lay_out
from .recording import JOIN, Recording, map_view, markdown, write_recording
from .sheet import Cell
from .steps import joining_steps
from .verdicts import merge_summary, pairs_told, runs_in_order

RECORDING_ID = "merged"


def write(path: Path, result: MergeResult, maps: Sequence[TopoMap]) -> None:
    """Write the recording of a merge; see `topobatch.viz.write_merged_recording`."""
    by_name = _by_name(result, maps)
    runs = runs_in_order(result)
    colours = palette.of_runs(runs)

    def fill(recording: Recording) -> rrb.Blueprint:
        parts = lay_out(result)
        sheet = [part.cell for part in parts]
        write_fused_layers(recording, result, by_name, parts, colours)
        views = [
            _view(FUSED, "Map", sheet),
            _view(AGREEMENT, "Agreement", sheet),
            _view(RUNS, "Runs", sheet),
        ]
        steps = joining_steps(result)
        if steps:
            cells = write_steps(recording, steps, parts, by_name, colours)
            views.append(_view(STEPS, "Step by step", cells))
        pairs = undecided(result)
        if pairs:
            cells = write_undecided(recording, pairs, by_name, colours)
            views.append(_view(UNDECIDED, "Undecided", cells))
        write_matrix(recording, result, runs)
        recording.static(("summary",), markdown(merge_summary(result)))
        recording.static(("pairs",), markdown(pairs_told(result)))
        return _blueprint(views, runs, told=bool(steps))

    write_recording(path, RECORDING_ID, fill)


def _by_name(result: MergeResult, maps: Sequence[TopoMap]) -> dict[str, TopoMap]:
    by_name = {m.run: m for m in maps}
    if len(by_name) < len(maps):
        raise ValueError("two maps have the same run name")
    needed = {run for component in result.components for run in component.poses}
    missing = sorted(needed - set(by_name))
    if missing:
        raise ValueError(f"the map of run {missing[0]!r} is missing ({len(missing)} in all)")
    return {run: by_name[run] for run in sorted(needed)}


def _view(root: str, name: str, cells: list[Cell]) -> rrb.Spatial2DView:
    corners = [corner for cell in cells for corner in (cell.low, cell.high)]
    low, high = bounds([np.array(corners).reshape(-1, 2)], margin=0.02)
    return map_view(root, name, low, high)


def _matrix_view(runs: list[str]) -> rrb.Spatial2DView:
    low, high = matrix_bounds(runs)
    return rrb.Spatial2DView(
        origin=f"/{MATRIX}",
        name="Verdicts",
        background=palette.BACKGROUND,
        visual_bounds=rrb.VisualBounds2D(x_range=[low[0], high[0]], y_range=[low[1], high[1]]),
    )


def _blueprint(views: list[rrb.Spatial2DView], runs: list[str], *, told: bool) -> rrb.Blueprint:
    pages: list[rrb.View] = [
        rrb.TextDocumentView(origin="/summary", name="Summary"),
        rrb.TextDocumentView(origin="/pairs", name="Pairs"),
    ]
    if told:
        pages.append(rrb.TextDocumentView(origin=f"/{STORY}", name="Story"))
    side: list[rrb.View | rrb.Container] = [rrb.Tabs(*pages, active_tab=0, name="Details")]
    if len(runs) > 1:
        side.append(_matrix_view(runs))
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Tabs(*views, active_tab=0, name="Maps"),
            rrb.Vertical(*side, row_shares=[3, 2][: len(side)], name="Verdicts"),
            column_shares=[3, 1],
            name="Merged map",
        ),
        rrb.BlueprintPanel(state="expanded"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=JOIN, play_state="paused", fps=1.0),
        auto_layout=False,
        auto_views=False,
    )
