"""The fused maps of a merge, as layers of a recording."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from ..merge.result import FusedMap, MergeResult
from ..topology.topomap import TopoMap
from . import palette
from .drawing import branch_arrows, driven_branches, pen_m, ribbon
from .parts import Part
from .recording import UP, PathParts, Recording, placed
from .sheet import ASPECT, Cell

FUSED, AGREEMENT, RUNS = "map", "agreement", "runs"
"""Roots of the three pictures of the components."""

WIDEST_RIBBON = 4
"""A ribbon is at most this many pens wide; with more runs its strands get thinner."""

LEGEND_LINES = 26
"""A sheet as high as its view has room for this many lines of text."""

LEGEND_LINE = 0.2
"""Half the length of a legend's lines over its width."""

MOST_LONG_TITLES = 12
"""Up to this many components have a title with their number of junctions."""

MOST_TITLES = 60
"""Up to this many components are titled."""


def write_fused_layers(
    recording: Recording,
    result: MergeResult,
    maps: Mapping[str, TopoMap],
    parts: list[Part],
    colours: Mapping[str, tuple[int, int, int]],
) -> None:
    """The fused map by run, the agreement of the runs, and each run's own map."""
    for root in (FUSED, AGREEMENT, RUNS):
        recording.static((root,), UP)
        _cards(recording, root, parts, colours)
        for part in parts:
            recording.static((root, part.name), placed(part.cell.T_sheet_map))
    pen = pen_m([result.fused])
    driven = driven_branches(result.fused)
    for part in parts:
        _ribbons(recording, result.fused, part, colours, pen)
        _agreement(recording, result.fused, part, pen)
        for root in (FUSED, AGREEMENT):
            _junctions(recording, root, result.fused, part, pen)
        _unexplored(recording, result.fused, part, driven, pen)
        for run in sorted(part.component.poses):
            own = (RUNS, part.name, run)
            recording.static(own, placed(part.component.poses[run]))
            write_own_map(recording, own, maps[run], colours[run], pen)


def _cards(
    recording: Recording,
    root: str,
    parts: list[Part],
    colours: Mapping[str, tuple[int, int, int]],
) -> None:
    """The frame, title and legend of every component."""
    titles = [part.short_title if len(parts) > MOST_LONG_TITLES else part.title for part in parts]
    write_cards(recording, root, [part.cell for part in parts], titles if len(parts) > 1 else [])
    corners = np.array([(part.cell.low, part.cell.high) for part in parts]).reshape(-1, 2)
    for part in parts:
        if part.legend_m > 0:
            width, height = np.ptp(corners, axis=0)
            step_m = float(max(width / ASPECT, height)) / LEGEND_LINES
            entries = {run: colours[run] for run in sorted(part.component.poses)}
            if root == AGREEMENT:
                entries = _count_colours(part)
            _legend(recording, (root, "legends", part.name), part, entries, step_m)


def _count_colours(part: Part) -> dict[str, tuple[int, int, int]]:
    """What the colours of the agreement stand for."""
    most = len(palette.COUNTS)
    counts = range(1, min(len(part.component.poses), most) + 1)
    names = [
        f"{n} or more runs" if n == most else f"{n} runs" if n > 1 else "1 run" for n in counts
    ]
    return dict(zip(names, map(tuple, palette.COUNTS.tolist()), strict=False))


def _legend(
    recording: Recording,
    path: PathParts,
    part: Part,
    entries: Mapping[str, tuple[int, int, int]],
    step_m: float,
) -> None:
    """A short line for each entry with its name below, at the right of the map; step_m: their
    distance."""
    low, high = part.cell.low, part.cell.high
    rows = (len(entries) - 1) / 2 - np.arange(len(entries))
    middle = np.array([high[0] - part.legend_m / 2, (low + high)[1] / 2])
    places = middle + step_m * np.stack([np.zeros(len(entries)), rows], axis=-1)
    half = np.array([LEGEND_LINE * part.legend_m, 0.0])
    recording.static(
        (*path, "lines"),
        rr.LineStrips2D(
            np.stack([places - half, places + half], axis=1),
            radii=rr.Radius.ui_points(2.0),
            colors=list(entries.values()),
            draw_order=50.0,
        ),
    )
    recording.static(
        (*path, "names"),
        rr.Points2D(
            places,
            radii=0.0,
            colors=list(entries.values()),
            labels=list(entries),
            show_labels=True,
            draw_order=50.0,
        ),
    )


def write_cards(recording: Recording, root: str, cells: list[Cell], titles: list[str]) -> None:
    """A thin frame round every cell and a title in it; `titles` may be empty."""
    if len(cells) > 1:
        corners = [
            np.array([c.low, (c.high[0], c.low[1]), c.high, (c.low[0], c.high[1]), c.low])
            for c in cells
        ]
        frames = rr.LineStrips2D(
            corners, radii=rr.Radius.ui_points(0.75), colors=palette.CARD, draw_order=0.0
        )
        recording.static((root, "frames"), frames)
    if titles and len(titles) <= MOST_TITLES:
        tops = np.array([((c.low[0] + c.high[0]) / 2, c.high[1]) for c in cells])
        recording.static(
            (root, "titles"),
            rr.Points2D(
                tops,
                radii=0.0,
                colors=palette.TITLE,
                labels=titles,
                show_labels=True,
                draw_order=50.0,
            ),
        )


def _ribbons(
    recording: Recording,
    fused: FusedMap,
    part: Part,
    colours: Mapping[str, tuple[int, int, int]],
    pen: float,
) -> None:
    """Corridors with one strand beside the other for each run that drove them."""
    strands: dict[str, list[tuple[int, NDArray[np.float64], float]]] = {}
    for edge in part.edges.tolist():
        runs = sorted({run for run, _ in fused.edge_members[edge]})
        width = pen * min(1.0, WIDEST_RIBBON / max(len(runs), 1))
        for k, run in enumerate(runs):
            beside = ribbon(fused.paths[edge], (k - (len(runs) - 1) / 2) * width)
            strands.setdefault(run, []).append((edge, beside, width / 2))
    for run, drawn in sorted(strands.items()):
        edges = np.array([edge for edge, _, _ in drawn])
        lines = rr.LineStrips2D(
            [line for _, line, _ in drawn],
            radii=[radius for _, _, radius in drawn],
            colors=colours[run],
            draw_order=10.0,
        )
        recording.static((FUSED, part.name, "corridors", run), lines, _corridor_info(fused, edges))


def _agreement(recording: Recording, fused: FusedMap, part: Part, pen: float) -> None:
    if len(part.edges) == 0:
        return
    edges = part.edges
    runs = np.array([len({run for run, _ in fused.edge_members[i]}) for i in edges.tolist()])
    lines = rr.LineStrips2D(
        [fused.paths[i] for i in edges.tolist()],
        radii=pen * (0.4 + 0.2 * np.minimum(runs, 4)),
        colors=palette.by_count(runs),
        draw_order=10.0,
    )
    path = (AGREEMENT, part.name, "corridors")
    recording.static(path, lines, _corridor_info(fused, edges))


def _corridor_info(fused: FusedMap, edges: NDArray[np.int64]) -> rr.AnyValues:
    rows = edges.tolist()
    return rr.AnyValues(
        corridor=edges,
        between=[f"{fused.source[i]} - {fused.target[i]}" for i in rows],
        length_m=fused.length[edges],
        length_sigma_m=fused.length_sigma[edges],
        traversals=fused.traversals[edges],
        driven_by=[", ".join(sorted({run for run, _ in fused.edge_members[i]})) for i in rows],
    )


def _junctions(recording: Recording, root: str, fused: FusedMap, part: Part, pen: float) -> None:
    rows = part.vertices
    if len(rows) == 0:
        return
    runs = np.array([len(fused.members[i]) for i in rows.tolist()])
    shared = runs > 1
    colours = palette.by_count(runs)
    if root == FUSED:
        colours = np.where(shared[:, None], palette.WHITE, palette.SINGLE).astype(np.uint8)
    recording.static(
        (root, part.name, "junctions"),
        rr.Points2D(
            fused.xy[rows],
            radii=pen * np.where(shared, 2.4, 1.4),
            colors=colours,
            labels=list(map(str, rows.tolist())),
            show_labels=False,
            draw_order=20.0,
        ),
        rr.AnyValues(
            vertex=rows,
            kind=[fused.kind[i] for i in rows.tolist()],
            branches=fused.branches.counts[rows],
            runs=runs,
            fused_from=[_members_told(fused.members[i]) for i in rows.tolist()],
            passes=np.array([len(fused.observations[i]) for i in rows.tolist()]),
        ),
    )


def _members_told(members: Mapping[str, tuple[int, ...]]) -> str:
    return "; ".join(
        f"{run}: {', '.join(map(str, vertices))}" for run, vertices in sorted(members.items())
    )


def _unexplored(
    recording: Recording, fused: FusedMap, part: Part, driven: NDArray[np.bool_], pen: float
) -> None:
    free = np.isin(fused.branches.owner, part.vertices) & ~driven
    if not free.any():
        return
    origins, vectors = branch_arrows(fused, 6 * pen)
    arrows = rr.Arrows2D(
        origins=origins[free],
        vectors=vectors[free],
        radii=pen / 3,
        colors=palette.FAINT,
        draw_order=5.0,
    )
    recording.static((FUSED, part.name, "branches never driven"), arrows)


def write_own_map(
    recording: Recording,
    path: PathParts,
    topomap: TopoMap,
    colour: tuple[int, int, int],
    pen: float,
) -> None:
    """A run's own map below `path`, in its own frame and one colour."""
    if len(topomap.source):
        lines = rr.LineStrips2D(
            list(topomap.paths), radii=0.4 * pen, colors=colour, draw_order=10.0
        )
        info = rr.AnyValues(
            corridor=np.arange(len(topomap.source)),
            between=[f"{u} - {v}" for u, v in zip(topomap.source, topomap.target, strict=True)],
            length_m=topomap.length,
            length_sigma_m=topomap.length_sigma,
            traversals=topomap.traversals,
        )
        recording.static((*path, "corridors"), lines, info)
    if len(topomap):
        points = rr.Points2D(
            topomap.xy,
            radii=1.2 * pen,
            colors=colour,
            labels=list(map(str, range(len(topomap)))),
            show_labels=False,
            draw_order=20.0,
        )
        info = rr.AnyValues(
            vertex=np.arange(len(topomap)), kind=list(topomap.kind), branches=topomap.degree
        )
        recording.static((*path, "junctions"), points, info)
