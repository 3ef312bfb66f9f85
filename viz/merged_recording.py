"""The recording of a merge, `merged.rrd`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import rerun.blueprint as rrb

from ..merge.result import MergeResult
from ..topology.topomap import TopoMap
from ..topology.turning_vertices import with_turning_points
from . import palette
from .fused_layers import (
    FUSED,
    RUNS,
    walls_by_component,
    write_fused_contradictions,
    write_fused_layers,
    write_walls,
)
from .map_sheet import sheet_view
from .matrix_layer import (
    MATRIX,
    matrix_bounds,
    write_matrix,
)
from .pages import merge_page
from .parts import colours_of, lay_out
from .recording import Recording, blueprint, markdown, write_recording
from .verdicts import (
    runs_in_order,
)
from .walls import wall_points

RECORDING_ID = "merged"


def write_merged_recording(path: Path, result: MergeResult, maps: Sequence[TopoMap]) -> None:
    """Write the recording of a merge, `merged.rrd`, atomically.

    maps: of every run in the result, in any order. Raises ValueError if one is missing or two share
    a name, OSError if the file cannot be written.
    """
    by_name = _by_name(result, maps)
    runs = runs_in_order(result)
    colours = colours_of(result)

    def fill(recording: Recording) -> rrb.Blueprint:
        walls = walls_by_component(result, by_name)
        parts = lay_out(result, {c: wall_points(grid) for c, grid in walls.items()})
        sheet = [part.cell for part in parts]
        write_fused_layers(recording, result, by_name, parts, colours)
        write_fused_contradictions(recording, result, by_name, parts)
        write_walls(recording, walls, parts)
        views = [
            sheet_view(FUSED, "Map", sheet),
            sheet_view(RUNS, "Runs", sheet),
        ]
        write_matrix(recording, result, runs, colours)
        recording.static(("summary",), markdown(merge_page(result)))
        return _blueprint(views, [_matrix_view(runs)] if len(runs) > 1 else [])

    write_recording(path, RECORDING_ID, fill)


def _by_name(result: MergeResult, maps: Sequence[TopoMap]) -> dict[str, TopoMap]:
    by_name = {m.run: m for m in maps}
    if len(by_name) < len(maps):
        raise ValueError("two maps have the same run name")
    needed = {run for component in result.components for run in component.poses}
    missing = sorted(needed - set(by_name))
    if missing:
        raise ValueError(f"the map of run {missing[0]!r} is missing ({len(missing)} in all)")
    return {run: with_turning_points(by_name[run]) for run in sorted(needed)}


def _matrix_view(runs: list[str]) -> rrb.Spatial2DView:
    low, high = matrix_bounds(runs)
    return rrb.Spatial2DView(
        origin=f"/{MATRIX}",
        name="Verdicts",
        background=palette.BACKGROUND,
        visual_bounds=rrb.VisualBounds2D(x_range=[low[0], high[0]], y_range=[low[1], high[1]]),
    )


def _blueprint(maps: list[rrb.Spatial2DView], verdicts: list[rrb.Spatial2DView]) -> rrb.Blueprint:
    summary = rrb.TextDocumentView(origin="/summary", name="Summary")
    return blueprint(
        rrb.Horizontal(
            rrb.Tabs(*maps, active_tab=0, name="Maps"),
            rrb.Vertical(summary, *verdicts, name="Verdicts"),
            column_shares=[5, 2],
            name="Merged map",
        ),
        rrb.TimePanel(state="hidden"),
    )
