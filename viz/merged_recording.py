"""The recording of a merge, `merged.rrd`: the fused map, each run's own map in its place, and the
matrix of verdicts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from ..merge.result import FusedMap, MergeResult, site_views
from ..topology.arrays import FloatArray, IntArray
from ..topology.columns import take
from ..topology.driven_branches import driven_branches
from ..topology.run import Grid
from ..topology.se2 import apply
from ..topology.topomap import TopoMap
from ..topology.turning_vertices import with_turning_points
from ..topology.views import Views
from . import palette
from .drawing import SHEET_MARGIN, Strand, bounds, branch_arrows, pen_m, strands
from .matrix_layer import MATRIX, matrix_bounds, write_matrix
from .pages import merge_page
from .parts import Part, colours_of, lay_out, rows_of, runs_in_order
from .placements import contradiction_spots
from .recording import (
    UP,
    PathParts,
    Recording,
    blueprint,
    corridors_told,
    map_view,
    markdown,
    placed,
    strips,
    write_cards,
    write_grid,
    write_recording,
)
from .sheet import Cell, corners_of
from .walls import FINE_M, wall_points, walls_of

RECORDING_ID = "merged"

FUSED, RUNS = "map", "runs"
"""Entity roots of the two views of the components."""


def write_merged_recording(path: Path, result: MergeResult, maps: Sequence[TopoMap]) -> None:
    """Write the recording of a merge, `merged.rrd`, atomically.

    maps: of every run in the result, in any order. Raises ValueError if one is missing or two share
    a name, OSError if the file cannot be written.
    """
    by_name = _by_name(result, maps)
    runs, colours = runs_in_order(result), colours_of(result)
    pen = pen_m([result.fused])

    def fill(recording: Recording) -> rrb.Blueprint:
        walls = _walls_by_component(result, by_name)
        parts = lay_out(result, {c: wall_points(grid) for c, grid in walls.items()})
        sheet = [part.cell for part in parts]
        for root in (FUSED, RUNS):
            recording.static((root,), UP)
            titles = [part.titles for part in parts] if len(parts) > 1 else []
            write_cards(recording, root, sheet, titles)
            for part in parts:
                recording.static((root, part.name), placed(part.cell.T_sheet_map))
        for part in parts:
            _ribbons(recording, result.fused, part, colours, pen)
            _junctions(recording, result.fused, part, pen)
            if part.component.id in walls:
                write_grid(recording, (FUSED, part.name, "walls"), walls[part.component.id])
            for run, pose in sorted(part.component.poses.items()):
                own = (RUNS, part.name, run)
                recording.static(own, placed(pose))
                _own_map(recording, own, by_name[run], colours[run], pen)
        _unexplored(recording, result.fused, parts, pen)
        _contradictions(recording, result, by_name, parts, pen)
        write_matrix(recording, result, runs, colours)
        recording.static(("summary",), markdown(merge_page(result)))
        return _blueprint(sheet, runs)

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


def _blueprint(sheet: list[Cell], runs: list[str]) -> rrb.Blueprint:
    """The fused map and those of the runs, beside them the summary and the matrix of verdicts."""
    low, high = bounds([corners_of(sheet)], margin=SHEET_MARGIN)
    maps = [map_view([root], name, low, high) for root, name in ((FUSED, "Map"), (RUNS, "Runs"))]
    verdicts = []
    if len(runs) > 1:
        low, high = matrix_bounds(runs)
        verdicts.append(
            rrb.Spatial2DView(
                origin=f"/{MATRIX}",
                name="Verdicts",
                background=palette.BACKGROUND,
                visual_bounds=rrb.VisualBounds2D(
                    x_range=[low[0], high[0]], y_range=[low[1], high[1]]
                ),
            )
        )
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


MOST_VIEWS = 5000
"""Views that are laid over each other, a millisecond each; of more every second, third … is, which
still overlap."""

MOST_CELLS = 1 << 24
"""Cells of the walls of all components together, 50 MB in the viewer; with more they are larger."""


def _walls_by_component(result: MergeResult, maps: Mapping[str, TopoMap]) -> dict[int, Grid]:
    """The walls and the free space that all runs of a component saw, in its frame, by its id; none
    of components without any."""
    seen = {c.id: site_views(result.fused, c, maps) for c in result.components}
    every = -(-sum(len(v) for own in seen.values() for v in own) // MOST_VIEWS)
    thinned = {c: [take(v, slice(None, None, every)) for v in own] for c, own in seen.items()}
    grids, cell_m = _grids(thinned, FINE_M), FINE_M
    while sum(grid.free.size for grid in grids.values()) > MOST_CELLS:
        cell_m *= 2
        grids = _grids(thinned, cell_m)
    return grids


def _grids(seen: Mapping[int, Sequence[Views]], cell_m: float) -> dict[int, Grid]:
    laid = {c: walls_of(own, "", cell_m) for c, own in seen.items()}
    return {c: grid for c, grid in laid.items() if grid is not None}


def _ribbons(
    recording: Recording,
    fused: FusedMap,
    part: Part,
    colours: Mapping[str, palette.Colour],
    pen: float,
) -> None:
    """Write each corridor as parallel lines of the runs that drove it."""
    of_run: dict[str, list[Strand]] = {}
    for strand in strands(fused, part.edges, pen):
        of_run.setdefault(strand.run, []).append(strand)
    for run, own in of_run.items():
        lines = rr.LineStrips2D.from_fields(
            strips=strips([strand.path for strand in own]),
            radii=[pen * strand.share / 2 for strand in own],
            colors=colours[run],
            draw_order=palette.Order.CORRIDOR,
        )
        edges = np.array([strand.edge for strand in own])
        told = _corridor_info(fused, edges)
        recording.static((FUSED, part.name, "corridors", run), lines, told)


def _corridor_info(fused: FusedMap, edges: IntArray) -> rr.AnyValues:
    rows = edges.tolist()
    return rr.AnyValues(
        corridor=edges,
        between=[f"{fused.source[i]} - {fused.target[i]}" for i in rows],
        length_m=fused.length[edges],
        length_sigma_m=fused.length_sigma[edges],
        traversals=fused.traversals[edges],
        driven_by=[", ".join(sorted({run for run, _ in fused.edge_members[i]})) for i in rows],
    )


def _junctions(recording: Recording, fused: FusedMap, part: Part, pen: float) -> None:
    """Write the junctions of the fused map: white if several runs saw it, else grey."""
    rows = part.vertices
    if len(rows) == 0:
        return
    members = [fused.members[i] for i in rows.tolist()]
    several = np.array([len(runs) > 1 for runs in members])
    points = rr.Points2D(
        fused.xy[rows],
        radii=pen * np.where(several, 2.4, 1.4),
        colors=np.where(several[:, None], palette.WHITE, palette.SINGLE).astype(np.uint8),
        labels=list(map(str, rows.tolist())),
        show_labels=False,
        draw_order=palette.Order.JUNCTION,
    )
    told = rr.AnyValues(
        vertex=rows,
        kind=[fused.kind[i] for i in rows.tolist()],
        branches=fused.branches.counts[rows],
        runs=np.array([len(runs) for runs in members]),
        fused_from=[_members_told(runs) for runs in members],
        passes=np.array([len(fused.observations[i]) for i in rows.tolist()]),
    )
    recording.static((FUSED, part.name, "junctions"), points, told)


def _members_told(members: Mapping[str, tuple[int, ...]]) -> str:
    return "; ".join(
        f"{run}: {', '.join(map(str, vertices))}" for run, vertices in sorted(members.items())
    )


def _unexplored(recording: Recording, fused: FusedMap, parts: list[Part], pen: float) -> None:
    """Write the branches that no run drove."""
    origins, vectors = branch_arrows(fused, 6 * pen)
    free = np.flatnonzero(~driven_branches(fused))
    owner = fused.component[fused.branches.owner[free]]
    of_parts = rows_of(owner, [part.component.id for part in parts])
    for part, rows in zip(parts, of_parts, strict=True):
        if len(rows):
            arrows = rr.Arrows2D(
                origins=origins[free[rows]],
                vectors=vectors[free[rows]],
                radii=pen / 3,
                colors=palette.FAINT,
                draw_order=palette.Order.STUB,
            )
            recording.static((FUSED, part.name, "branches never driven"), arrows)


def _contradictions(
    recording: Recording,
    result: MergeResult,
    maps: Mapping[str, TopoMap],
    parts: list[Part],
    pen: float,
) -> None:
    """Write a red dot where merged runs contradict each other; its text is shown on selection."""
    found: dict[str, list[tuple[FloatArray, str]]] = {}
    home = {run: part for part in parts for run in part.component.poses}
    for pair in result.verdicts:
        if pair.accepted and pair.best is not None and pair.best.contradicting:
            poses = home[pair.a].component.poses
            of_a, of_b = (apply(poses[run], maps[run].xy) for run in (pair.a, pair.b))
            against = zip(pair.best.contradictions, pair.best.contradicting, strict=False)
            spots = contradiction_spots(against, of_a, of_b)
            found.setdefault(home[pair.a].name, []).extend(spots)
    for name, spots in found.items():
        if spots:
            dots = rr.Points2D(
                [xy for xy, _ in spots],
                radii=2.0 * pen,
                colors=palette.REFUSED,
                draw_order=palette.Order.CONTRADICTION,
            )
            told = rr.AnyValues(contradiction=[told for _, told in spots])
            recording.static((FUSED, name, "contradictions"), dots, told)


def _own_map(
    recording: Recording, path: PathParts, m: TopoMap, colour: palette.Colour, pen: float
) -> None:
    """Write a run's own map below its entity path, in its own frame and in one colour."""
    if len(m.source):
        lines = rr.LineStrips2D.from_fields(
            strips=strips(m.paths),
            radii=0.4 * pen,
            colors=colour,
            draw_order=palette.Order.CORRIDOR,
        )
        recording.static((*path, "corridors"), lines, corridors_told(m))
    if len(m):
        points = rr.Points2D(
            m.xy,
            radii=1.2 * pen,
            colors=colour,
            labels=[*map(str, range(len(m)))],
            show_labels=False,
            draw_order=palette.Order.JUNCTION,
        )
        info = rr.AnyValues(vertex=np.arange(len(m)), kind=list(m.kind), branches=m.degree)
        recording.static((*path, "junctions"), points, info)
