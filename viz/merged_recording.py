"""The recording of a merge, `merged.rrd`: the fused map, and each run's own map in its place."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import rerun.blueprint as rrb

from ..merge.drive import Drive
from ..merge.result import FusedMap, MergeResult, site_views
from ..topology.arrays import FloatArray
from ..topology.driven_branches import driven_branches
from ..topology.run import Grid
from ..topology.se2 import apply
from ..topology.topomap import TopoMap
from ..topology.turning_vertices import with_turning_points
from ..topology.wording import MOST_NAMES
from .geometry import bounds, contradiction_spots, pen_m, strands
from .pages import merge_page
from .palette import DARK, LARGE, MEDIUM, SMALL, Colour, Order
from .parts import Part, colours_of, lay_out
from .recording import (
    UP,
    PathParts,
    Recording,
    blueprint,
    map_view,
    markdown,
    placed,
    write_branches,
    write_cards,
    write_corridors,
    write_grid,
    write_junctions,
    write_recording,
)
from .sheet import Cell, corners_of
from .walls import FINE_M, wall_points, walls_of

RECORDING_ID = "merged"

FUSED, RUNS = "map", "runs"
"""Entity roots of the two views of the components."""


def write_merged_recording(
    path: Path, result: MergeResult, maps: Sequence[TopoMap], drives: Sequence[Drive] = ()
) -> None:
    """Write the recording of a merge, `merged.rrd`, atomically.

    maps: of every run in the result, in any order; drives: what to record next. Raises OSError if
    the file cannot be written.
    """
    by_name = {m.run: with_turning_points(m) for m in maps}
    colours = colours_of(result)
    pen = pen_m(result.fused)

    def fill(recording: Recording) -> rrb.Blueprint:
        walls = _walls_by_component(result, by_name)
        to_hold = {c: wall_points(grid) for c, grid in walls.items()}
        parts = lay_out(result, to_hold)
        sheet = [part.cell for part in parts]
        for root in (FUSED, RUNS):
            recording.static((root,), UP)
            write_cards(recording, root, sheet, [part.title for part in parts])
            for part in parts:
                recording.static((root, part.name), placed(part.cell.T_sheet_map))
        free, home = ~driven_branches(result.fused), result.fused.component
        home = home[result.fused.branches.owner]
        for part in parts:
            _ribbons(recording, result.fused, part, colours, pen)
            path, own = (FUSED, part.name, "branches never driven"), home == part.component.id
            write_branches(recording, path, result.fused, free & own, colour=DARK["faint"], pen=pen)
            _junctions(recording, result.fused, part, pen)
            if part.component.id in walls:
                write_grid(recording, (FUSED, part.name, "walls"), walls[part.component.id])
            for run, pose in sorted(part.component.poses.items()):
                own = (RUNS, part.name, run)
                recording.static(own, placed(pose))
                _own_map(recording, own, by_name[run], colours[run], pen)
        _contradictions(recording, result, by_name, parts, pen)
        _drives(recording, drives, parts, pen)
        _run_names(recording, result.fused, parts, colours)
        recording.static(("summary",), markdown(merge_page(result)))
        return _blueprint(sheet)

    write_recording(path, RECORDING_ID, fill)


def _blueprint(sheet: list[Cell]) -> rrb.Blueprint:
    """The fused map and those of the runs, beside them the summary."""
    low, high = bounds([corners_of(sheet)])
    maps = [map_view([root], name, low, high) for root, name in ((FUSED, "Map"), (RUNS, "Runs"))]
    summary = rrb.TextDocumentView(origin="/summary", name="Summary")
    root = rrb.Horizontal(
        rrb.Tabs(*maps, active_tab=0, name="Maps"), summary, column_shares=[5, 2], name="Merged map"
    )
    return blueprint(root, rrb.TimePanel(state="hidden"))


def _run_names(
    recording: Recording, fused: FusedMap, parts: Sequence[Part], colours: Mapping[str, Colour]
) -> None:
    """Write the names of the runs of each site in their colours, each amid the longest corridor
    that it drove and that has no name yet."""
    runs, at = [], []
    for part in parts:
        own = sorted(part.component.poses)
        longest = sorted(part.edges.tolist(), key=lambda e: -fused.length[e])
        for run in own if 1 < len(own) <= MOST_NAMES else ():
            drove = (e for e in longest if any(run == who for who, _ in fused.edge_members[e]))
            if (edge := next(drove, None)) is not None:
                longest.remove(edge)
                runs.append(run)
                at.append(apply(part.cell.T_sheet_map, fused.paths[edge].mean(axis=0)))
    if runs:
        recording.words((FUSED, "names"), at, runs, [colours[run] for run in runs])


MOST_CELLS = 1 << 24
"""Cells of the walls of all components together, 50 MB in the viewer; with more they are larger."""


def _walls_by_component(result: MergeResult, maps: Mapping[str, TopoMap]) -> dict[int, Grid]:
    """The walls and the free space that all runs of a component saw, in its frame, by its id; none
    of components without any."""
    seen = {c.id: site_views(result.fused, c, maps) for c in result.components}
    cell_m = FINE_M
    while True:
        laid = {c: walls_of(own, "", cell_m) for c, own in seen.items()}
        grids = {c: grid for c, grid in laid.items() if grid is not None}
        if sum(grid.free.size for grid in grids.values()) <= MOST_CELLS:
            return grids
        cell_m *= 2


def _ribbons(
    recording: Recording, fused: FusedMap, part: Part, colours: Mapping[str, Colour], pen: float
) -> None:
    """Write each corridor as parallel lines of the runs that drove it."""
    of_run: dict[str, dict[int, FloatArray]] = {}
    widths: dict[str, list[float]] = {}
    for (run, pens), own in strands(fused, part.edges, pen).items():
        of_run.setdefault(run, {}).update(own)
        widths.setdefault(run, []).extend([pens * pen] * len(own))
    for run, own in of_run.items():
        drove = [", ".join(sorted({who for who, _ in fused.edge_members[e]})) for e in own]
        write_corridors(
            *(recording, (FUSED, part.name, "corridors", run), fused, own),
            colours=colours[run],
            pens=widths[run],
            more={"driven_by": drove},
        )


def _junctions(recording: Recording, fused: FusedMap, part: Part, pen: float) -> None:
    """Write the junctions of the fused map: white if several runs saw it, else grey."""
    rows = part.vertices
    members = [fused.members[i] for i in rows.tolist()]
    several = [len(runs) > 1 for runs in members]
    values = {
        "runs": np.array([len(runs) for runs in members]),
        "fused_from": [
            "; ".join(f"{run}: {', '.join(map(str, own))}" for run, own in sorted(runs.items()))
            for runs in members
        ],
        "passes": np.array([len(fused.observations[i]) for i in rows.tolist()]),
    }
    write_junctions(
        *(recording, (FUSED, part.name, "junctions"), fused, rows),
        colours=[DARK["ink" if own else "single"] for own in several],
        sizes=pen * np.where(several, LARGE, MEDIUM),
        more=values,
    )


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
            path, at = (FUSED, name, "contradictions"), [xy for xy, _ in spots]
            values = {"contradiction": [words for _, words in spots]}
            look = {"radii": LARGE * pen / 2}
            recording.dots(path, at, Order.CONTRADICTION, DARK["against"], values, **look)


def _drives(
    recording: Recording, drives: Sequence[Drive], parts: Sequence[Part], pen: float
) -> None:
    """Write the ways of the drives to record next, in the frame of the site where they begin."""
    for part in parts:
        if own := [drive for drive in drives if drive.component == part.component.id]:
            where, settles = zip(*(drive.words for drive in own), strict=True)
            values, look = {"drive": where, "settles": settles}, {"radii": LARGE * pen / 2}
            path, ways = (FUSED, part.name, "to record"), [drive.path for drive in own]
            recording.lines(path, ways, Order.DRIVE, DARK["planned"], values, **look)


def _own_map(recording: Recording, path: PathParts, m: TopoMap, colour: Colour, pen: float) -> None:
    """Write a run's own map below its entity path, in its own frame and in one colour."""
    lines, rows = dict(enumerate(m.paths)), np.arange(len(m))
    write_corridors(recording, (*path, "corridors"), m, lines, colours=colour, pens=pen)
    write_junctions(*(recording, (*path, "junctions"), m, rows), colours=colour, sizes=SMALL * pen)
