"""A merge's fused maps as layers of a recording."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import chain

import numpy as np
import rerun as rr

from ..merge.result import FusedMap, MergeResult, site_views
from ..topology.arrays import IntArray
from ..topology.columns import take
from ..topology.driven_branches import driven_branches
from ..topology.run import Grid
from ..topology.se2 import apply
from ..topology.topomap import TopoMap
from ..topology.views import Views
from . import palette
from .drawing import Strand, branch_arrows, pen_m, strands
from .grid_layer import write_grid
from .growing import colour_columns, light_up_by_step
from .map_sheet import write_cards, write_contradictions, write_own_maps
from .parts import Part, rows_of
from .placements import Spot, contradiction_spots
from .recording import UP, PathParts, Recording, placed, strips
from .sheet import Cell
from .story import Step, first_steps, shared_from
from .walls import FINE_M, walls_of

FUSED, AGREEMENT, RUNS, LEGEND = "map", "agreement", "runs", "legend"
"""Entity roots of the three views of the components, and of the key to the runs' colours."""

LEGEND_ROWS, LEGEND_COLUMN = 34, 8.0
"""Rows of a column of the key, and the distance of columns in rows."""


def write_fused_layers(
    recording: Recording,
    result: MergeResult,
    maps: Mapping[str, TopoMap],
    parts: list[Part],
    *,
    colours: Mapping[str, palette.Colour],
    steps: Sequence[Step],
) -> None:
    """Write the fused map in the runs' colours as it grew by the steps of merging, the number of
    runs that share each part of it, and each run's own map in its place."""
    for root in (FUSED, AGREEMENT, RUNS):
        recording.static((root,), UP)
        titles = [part.titles for part in parts] if len(parts) > 1 else []
        write_cards(recording, root, [part.cell for part in parts], titles)
        for part in parts:
            recording.static((root, part.name), placed(part.cell.T_sheet_map))
    pen = pen_m([result.fused])
    first = first_steps(steps)
    own_steps: dict[int, list[tuple[int, Step]]] = {}
    for number, step in enumerate(steps, start=1):
        own_steps.setdefault(step.component, []).append((number, step))
    _ribbons(recording, result.fused, parts, colours, pen=pen, first=first)
    _agreement(recording, result.fused, parts, pen)
    _junctions(recording, result.fused, parts, pen)
    for part in parts:
        own = own_steps.get(part.component.id, ())
        _junctions_in_time(recording, result.fused, part, own, first)
    _unexplored(recording, result.fused, parts, pen)
    lying = [(part, run) for part in parts for run in sorted(part.component.poses)]
    for part, run in lying:
        recording.static((RUNS, part.name, run), placed(part.component.poses[run]))
    write_own_maps(
        recording,
        [(RUNS, part.name, run) for part, run in lying],
        [maps[run] for _, run in lying],
        [colours[run] for _, run in lying],
        pen,
    )


def write_fused_contradictions(
    recording: Recording, result: MergeResult, maps: Mapping[str, TopoMap], parts: list[Part]
) -> None:
    """Write red dots where merged runs contradict each other."""
    pen = pen_m([result.fused])
    found: dict[int, list[Spot]] = {}
    home = {run: part for part in parts for run in part.component.poses}
    for pair in result.verdicts:
        if pair.accepted and pair.best is not None and pair.best.contradicting:
            poses = home[pair.a].component.poses
            of_a, of_b = (apply(poses[run], maps[run].xy) for run in (pair.a, pair.b))
            against = zip(pair.best.contradictions, pair.best.contradicting, strict=False)
            spots = contradiction_spots(against, of_a, of_b)
            found.setdefault(home[pair.a].component.id, []).extend(spots)
    for part in parts:
        path = (FUSED, part.name, "contradictions")
        write_contradictions(recording, path, found.get(part.component.id, []), pen)


MOST_VIEWS = 5000
"""Views that are laid over each other, a millisecond each; of more every second, third … is, which
still overlap."""

MOST_CELLS = 1 << 24
"""Cells of the walls of all components together, 50 MB in the viewer; with more they are larger."""


def walls_by_component(result: MergeResult, maps: Mapping[str, TopoMap]) -> dict[int, Grid]:
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


def write_walls(recording: Recording, grids: Mapping[int, Grid], parts: list[Part]) -> None:
    """Write the walls of every component below its map."""
    for part in parts:
        if part.component.id in grids:
            write_grid(recording, (FUSED, part.name, "walls"), grids[part.component.id])


def write_legend(
    recording: Recording, parts: list[Part], colours: Mapping[str, palette.Colour]
) -> list[Cell]:
    """Write the names of all merged runs in their colours, in columns, each component under its
    title; nothing where no runs are merged."""
    several = [part for part in parts if len(part.component.poses) > 1]
    if not several:
        return []
    entries: list[tuple[str, palette.Colour]] = []
    for part in several:
        entries.append((part.component.name, palette.TITLE))
        entries += [(run, colours[run]) for run in sorted(part.component.poses)]
    rows = min(LEGEND_ROWS, len(entries))
    number = np.arange(len(entries))
    places = np.stack([LEGEND_COLUMN * (number // rows), -(number % rows)], axis=-1)
    names = rr.Points2D(
        places.astype(np.float64),
        radii=rr.Radius.ui_points(2.0),
        colors=[colour for _, colour in entries],
        labels=[name for name, _ in entries],
        show_labels=True,
    )
    recording.static((LEGEND,), UP)
    recording.static((LEGEND, "runs"), names)
    low = np.array([-LEGEND_COLUMN, -rows - 1.0])
    high = np.array([LEGEND_COLUMN * (-(-len(entries) // rows)), 1.0])
    return [Cell(np.zeros(3), low, high)]


def _ribbons(
    recording: Recording,
    fused: FusedMap,
    parts: list[Part],
    colours: Mapping[str, palette.Colour],
    *,
    pen: float,
    first: Mapping[str, int],
) -> None:
    """Write each corridor as parallel lines of the runs that drove it, dim until the run is joined
    with another; first: at which step that happens."""
    of_run: dict[PathParts, list[Strand]] = {}
    home = {run: part.name for part in parts for run in part.component.poses}
    edges = np.concatenate([np.zeros(0, np.int64), *(part.edges for part in parts)])
    for strand in strands(fused, edges, pen):
        own = (FUSED, home[strand.run], "corridors", strand.run)
        of_run.setdefault(own, []).append(strand)
    if not of_run:
        return
    drawn = list(chain.from_iterable(of_run.values()))
    lines = rr.LineStrips2D.from_fields(
        strips=strips([strand.path for strand in drawn]),
        radii=[pen * strand.share / 2 for strand in drawn],
        draw_order=palette.Order.CORRIDOR,
    )
    told = _corridor_info(fused, np.array([strand.edge for strand in drawn]))
    recording.static_each([*of_run], [len(own) for own in of_run.values()], lines, told)
    for path in of_run:
        run = path[-1]
        if run in first:
            when = np.array([first[run]])
            light_up_by_step(recording, path, rr.LineStrips2D, when, colours[run])
        else:
            recording.static(path, rr.LineStrips2D.from_fields(colors=colours[run]))


def _agreement(recording: Recording, fused: FusedMap, parts: list[Part], pen: float) -> None:
    edges = np.concatenate([np.zeros(0, np.int64), *(part.edges for part in parts)])
    if len(edges) == 0:
        return
    runs = np.array([len({run for run, _ in fused.edge_members[i]}) for i in edges.tolist()])
    lines = rr.LineStrips2D(
        strips([fused.paths[i] for i in edges.tolist()]),
        radii=pen * (0.4 + 0.2 * np.minimum(runs, 4)),
        colors=palette.by_count(runs),
        draw_order=palette.Order.CORRIDOR,
    )
    paths = [(AGREEMENT, part.name, "corridors") for part in parts]
    counts = [len(part.edges) for part in parts]
    recording.static_each(paths, counts, lines, _corridor_info(fused, edges))


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


def _junctions(recording: Recording, fused: FusedMap, parts: list[Part], pen: float) -> None:
    """Write the junctions of the fused map, whose colours `_junctions_in_time` adds, and of the
    view of agreement."""
    rows = np.concatenate([np.zeros(0, np.int64), *(part.vertices for part in parts)])
    if len(rows) == 0:
        return
    runs = np.array([len(fused.members[i]) for i in rows.tolist()])
    told = rr.AnyValues(
        vertex=rows,
        kind=[fused.kind[i] for i in rows.tolist()],
        branches=fused.branches.counts[rows],
        runs=runs,
        fused_from=[_members_told(fused.members[i]) for i in rows.tolist()],
        passes=np.array([len(fused.observations[i]) for i in rows.tolist()]),
    )
    for root, colours in ((AGREEMENT, palette.by_count(runs)), (FUSED, None)):
        points = rr.Points2D.from_fields(
            positions=fused.xy[rows],
            radii=pen * np.where(runs > 1, 2.4, 1.4),
            colors=colours,
            labels=list(map(str, rows.tolist())),
            show_labels=False,
            draw_order=palette.Order.JUNCTION,
        )
        paths = [(root, part.name, "junctions") for part in parts]
        recording.static_each(paths, [len(part.vertices) for part in parts], points, told)


def _junctions_in_time(
    recording: Recording,
    fused: FusedMap,
    part: Part,
    steps: Sequence[tuple[int, Step]],
    first: Mapping[str, int],
) -> None:
    """Write the junctions' colours by step: dim until a run that saw it is joined, grey until two
    such runs are joined with each other, then white."""
    if len(part.vertices) == 0:
        return
    path = (FUSED, part.name, "junctions")
    runs = sorted(part.component.poses)
    members = [fused.members[i] for i in part.vertices.tolist()]
    runs_at = np.array([[run in at for run in runs] for at in members], bool)
    single = np.array(palette.SINGLE, np.uint8)
    if not first.keys() & set(runs):
        colours = np.tile(single, (len(members), 1))
        colours[runs_at.sum(axis=1) > 1] = palette.WHITE
        recording.static(path, rr.Points2D.from_fields(colors=colours))
        return
    joined = np.array([first.get(run, 0) for run in runs])
    when = np.where(runs_at, joined[None, :], np.iinfo(np.int64).max).min(axis=1)
    shared = shared_from(part, steps, runs_at)
    numbers = np.unique(np.concatenate([[0], when, shared]))
    rows = np.where(
        (when[None, :] <= numbers[:, None])[:, :, None], single, np.array(palette.UNLIT, np.uint8)
    )
    rows[(shared[None, :] > 0) & (shared[None, :] <= numbers[:, None])] = palette.WHITE
    recording.over_steps(path, numbers, colour_columns(rr.Points2D, rows.astype(np.uint8)))


def _members_told(members: Mapping[str, tuple[int, ...]]) -> str:
    return "; ".join(
        f"{run}: {', '.join(map(str, vertices))}" for run, vertices in sorted(members.items())
    )


def _unexplored(recording: Recording, fused: FusedMap, parts: list[Part], pen: float) -> None:
    """Write the branches that no run drove."""
    free = np.flatnonzero(~driven_branches(fused))
    owner = fused.component[fused.branches.owner[free]]
    own = [free[rows] for rows in rows_of(owner, [part.component.id for part in parts])]
    if len(free) == 0:
        return
    origins, vectors = branch_arrows(fused, 6 * pen)
    bare = np.concatenate(own)
    arrows = rr.Arrows2D(
        origins=origins[bare],
        vectors=vectors[bare],
        radii=pen / 3,
        colors=palette.FAINT,
        draw_order=palette.Order.STUB,
    )
    paths = [(FUSED, part.name, "branches never driven") for part in parts]
    recording.static_each(paths, [len(rows) for rows in own], arrows)
