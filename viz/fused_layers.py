"""The fused maps of a merge, as layers of a recording."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from ..merge.result import Component, FusedMap, MergeResult
from ..topology.se2 import compose
from ..topology.topomap import TopoMap
from . import palette
from .drawing import branch_arrows, driven_branches, pen_m, ribbon
from .recording import UP, PathParts, Recording, placed
from .sheet import ASPECT, Cell, arrange, sheet_margin_m, upright_rad

FUSED, AGREEMENT, RUNS = "map", "agreement", "runs"
"""Roots of the three pictures of the components."""

WIDEST_RIBBON = 4
"""A ribbon is at most this many pens wide; with more runs its strands get thinner."""

MOST_LEGENDS = 6
"""Up to this many components of several runs get a legend beside them."""

MOST_NAMES = 16
"""Longest legend."""

LEGEND_LINES = 26
"""A sheet as high as its view has room for this many lines of text."""

LEGEND_LINE = 0.2
"""Half the length of a legend's lines over its width."""

MOST_LONG_TITLES = 12
"""Up to this many components have a title with their number of junctions."""

MOST_TITLES = 60
"""Up to this many components are titled."""


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """One component and its place on the sheet; vertices, edges: its rows of the fused map."""

    component: Component
    cell: Cell
    vertices: NDArray[np.int64]
    edges: NDArray[np.int64]
    legend_m: float

    @property
    def name(self) -> str:
        """Its entity's name."""
        return f"component_{self.component.id}"

    @property
    def title(self) -> str:
        """What stands above it."""
        merged = len(self.component.poses) > 1
        more = f" merged, {len(self.vertices)} junctions" if merged else ""
        return self.short_title + more

    @property
    def short_title(self) -> str:
        """The run's name, or how many runs there are."""
        runs = list(self.component.poses)
        return runs[0] if len(runs) == 1 else f"{len(runs)} runs"


def lay_out(result: MergeResult) -> list[Part]:
    """All components on one sheet, those of many runs first."""
    fused = result.fused
    order = sorted(result.components, key=lambda c: (-len(c.poses), c.id))
    of_edge = fused.component[fused.source] if len(fused.source) else np.zeros(0, np.int64)
    vertices = [np.flatnonzero(fused.component == c.id) for c in order]
    edges = [np.flatnonzero(of_edge == c.id) for c in order]
    paths = [[fused.paths[i] for i in rows.tolist()] for rows in edges]
    points = [
        np.concatenate([fused.xy[rows].reshape(-1, 2), *lines])
        for rows, lines in zip(vertices, paths, strict=True)
    ]
    legends = _legends(order, points)
    cells = arrange(points, [upright_rad(p) for p in paths], sheet_margin_m(points), legends)
    return [Part(*row) for row in zip(order, cells, vertices, edges, legends, strict=True)]


def _legends(order: list[Component], points: list[NDArray[np.float64]]) -> list[float]:
    """Room for each component's legend [m]; none where there are too many."""
    several = [2 <= len(c.poses) <= MOST_NAMES for c in order]
    if sum(several) > MOST_LEGENDS:
        return [0.0] * len(order)
    area = sum(float(np.prod(np.ptp(p, axis=0))) for p in points if len(p))
    sheet_m = 1.3 * np.sqrt(ASPECT * area)
    return [
        sheet_m * _legend_share(c) if shown else 0.0
        for c, shown in zip(order, several, strict=True)
    ]


def _legend_share(component: Component) -> float:
    """A legend's width over the sheet's: about as much as the longest name takes in a view."""
    return 0.04 + 0.008 * min(max(map(len, component.poses)), 40)


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


def pose_on_sheet(part: Part, run: str) -> NDArray[np.float64]:
    """(3,) T_sheet_run: where a run's own map lies on the sheet."""
    return compose(part.cell.T_sheet_map, part.component.poses[run])
