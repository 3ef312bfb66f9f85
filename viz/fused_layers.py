"""A merge's fused maps as layers of a recording."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

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
from .map_sheet import write_cards, write_contradictions, write_own_map
from .parts import Part, rows_of
from .placements import Spot, contradiction_spots
from .recording import UP, PathParts, Recording, placed, strips
from .walls import FINE_M, walls_of

FUSED, RUNS = "map", "runs"
"""Entity roots of the two views of the components."""


def write_fused_layers(
    recording: Recording,
    result: MergeResult,
    maps: Mapping[str, TopoMap],
    parts: list[Part],
    colours: Mapping[str, palette.Colour],
) -> None:
    """Write the fused map in the runs' colours, and each run's own map in its place."""
    for root in (FUSED, RUNS):
        recording.static((root,), UP)
        titles = [part.titles for part in parts] if len(parts) > 1 else []
        write_cards(recording, root, [part.cell for part in parts], titles)
        for part in parts:
            recording.static((root, part.name), placed(part.cell.T_sheet_map))
    pen = pen_m([result.fused])
    _ribbons(recording, result.fused, parts, colours, pen)
    _junctions(recording, result.fused, parts, pen)
    _unexplored(recording, result.fused, parts, pen)
    for part in parts:
        for run, pose in sorted(part.component.poses.items()):
            path = (RUNS, part.name, run)
            recording.static(path, placed(pose))
            write_own_map(recording, path, maps[run], colours[run], pen)


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


def _ribbons(
    recording: Recording,
    fused: FusedMap,
    parts: list[Part],
    colours: Mapping[str, palette.Colour],
    pen: float,
) -> None:
    """Write each corridor as parallel lines of the runs that drove it."""
    of_run: dict[PathParts, list[Strand]] = {}
    for part in parts:
        for strand in strands(fused, part.edges, pen):
            of_run.setdefault((FUSED, part.name, "corridors", strand.run), []).append(strand)
    for path, own in of_run.items():
        lines = rr.LineStrips2D.from_fields(
            strips=strips([strand.path for strand in own]),
            radii=[pen * strand.share / 2 for strand in own],
            colors=colours[path[-1]],
            draw_order=palette.Order.CORRIDOR,
        )
        edges = np.array([strand.edge for strand in own])
        recording.static(path, lines, _corridor_info(fused, edges))


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
    """Write the junctions of the fused map: white if several runs saw it, else grey."""
    for part in parts:
        rows = part.vertices
        if len(rows) == 0:
            continue
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
