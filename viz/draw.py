"""Static drawings (SVG, PNG): one run's map, a merge."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from types import MappingProxyType

import numpy as np

from ..merge.change import Change, numbered
from ..merge.decision_text import short
from ..merge.drive import Drive
from ..merge.result import MergeResult, Standing, of_sites, site_views
from ..topology.arrays import FloatArray
from ..topology.driven_branches import driven_branches
from ..topology.se2 import apply
from ..topology.topomap import TopoMap
from ..topology.turning_vertices import with_turning_points
from ..topology.wording import counted, to_turning_points
from .canvas import TEXT_PT, WIDTH_PT, Canvas, letters
from .geometry import MOST_NUMBERED, ROOM_MARKERS, TURNED, bounds, extent, usual_m
from .pages import describe_corridor, describe_map
from .palette import LARGE, MEDIUM, THIN, Theme
from .parts import Part, lay_out
from .scene import draw_component, draw_ends, draw_frame, draw_unexplored, draw_walls
from .sheet import Cell, corners_of, outline, upright_rad
from .surface import Look
from .walls import wall_points, walls_of

NO_MAPS: Mapping[str, TopoMap] = MappingProxyType({})

CELL_PT = WIDTH_PT / 4
"""A merge's drawing is about this wide for each component across, up to twice as wide as others."""

MOST_TIMES = 3
"""Corridors driven more often than this are drawn no wider."""

_KINDS = ("nothing seen leaving", "dead end", "bend", "3 branches", "4 branches", "5 and more")
_MARKS = {
    **{label: (f"degree {k}", LARGE if k >= 3 else MEDIUM) for k, label in enumerate(_KINDS)},
    "room": ("ink", LARGE),
    "door": ("single", MEDIUM),
}
"""Colour and size of each kind of vertex."""


def draw_map(topomap: TopoMap, theme: Theme) -> Canvas:
    """Draw one run's map: corridors, junctions coloured by their number of branches, branches that
    were never driven, and below them walls, where a laser or a saved map showed them."""
    turn, whole = np.array([0.0, 0.0, upright_rad(topomap.paths)]), with_turning_points(topomap)
    seen = wall_points(walls_of([topomap.views], topomap.frame))
    low, high = bounds([apply(turn, np.concatenate([extent(whole), seen]))])
    canvas = Canvas(low, high, theme, usual_m(whole.length), name="map")
    draw_walls(canvas, [topomap.views], turn, theme["wall"])
    _corridors_of(canvas, whole, turn)
    draw_unexplored(canvas, whole, turn, ~driven_branches(whole))
    points = topomap.turning_points
    away = zip(points.kind, points.length.tolist(), points.vertex.tolist(), strict=True)
    tips = [f"{TURNED[kind]}, {way:.2f} m from junction {v}" for kind, way, v in away]
    draw_ends(canvas, apply(turn, points.xy), points.kind, tips)
    draw_frame(canvas, Cell(turn, low, high))
    _junctions_of(canvas, topomap, turn)
    canvas.finish([topomap.run, f"{describe_map(topomap)}{_turned_by(turn)}"])
    return canvas


def _turned_by(T_sheet_map: FloatArray) -> str:
    """By how much the picture is turned from the frame of its map, to be added to a title."""
    degrees = round(float(np.degrees(T_sheet_map[2])))
    return f"; drawn turned by {degrees}°" if degrees else ""


def _corridors_of(canvas: Canvas, m: TopoMap, T: FloatArray) -> None:
    """Draw the corridors, wider the more often they were driven, with tooltips."""
    times = np.clip(m.traversals, 1, MOST_TIMES)
    for often in range(1, MOST_TIMES + 1):
        rows = np.flatnonzero(times == often).tolist()
        paths, tips = [apply(T, m.paths[i]) for i in rows], [describe_corridor(m, i) for i in rows]
        key = "corridor" if often == 1 else "corridor, driven more often"
        pens = THIN * (1 + often)
        canvas.lines(paths, Look(canvas.theme["single"], pens, tips=tips, key=key))


def _junctions_of(canvas: Canvas, m: TopoMap, T: FloatArray) -> None:
    """Draw the junctions, coloured by their branches, rooms and doors, with their numbers."""
    xy = apply(T, m.xy)
    group = np.minimum(m.degree, len(_KINDS) - 1).tolist()
    label_of = [
        kind if kind in ROOM_MARKERS else _KINDS[k] for kind, k in zip(m.kind, group, strict=True)
    ]
    for label, (ink, pens) in _MARKS.items():
        rows = [i for i, own in enumerate(label_of) if own == label]
        tips, marker = [_describe_vertex(m, i) for i in rows], ROOM_MARKERS.get(label, "circle")
        canvas.dots(xy[rows], Look(canvas.theme[ink], pens, tips=tips, key=label, marker=marker))
    if len(m) <= MOST_NUMBERED:
        canvas.words(xy, [*map(str, range(len(m)))])


def _describe_vertex(m: TopoMap, i: int) -> str:
    """A vertex in a line; of a room its area, of a door its width."""
    text = f"{m.kind[i].replace('_', ' ')} {i}"
    for sizes, what in ((m.area_m2, "{:.0f} m²"), (m.width_m, "{:.2f} m wide")):
        text += f", {what.format(sizes[i])}" if sizes is not None and sizes[i] > 0 else ""
    text += f": {counted(int(m.passes[i]), 'pass', 'passes')}"
    text += f", ± {m.position_sigma[i]:.2f} m" if m.position_sigma is not None else ""
    return text + (f", confidence {m.confidence[i]:.2f}" if m.confidence[i] < 1 else "")


def draw_merged(
    result: MergeResult,
    theme: Theme,
    *,
    sites: Collection[int] | None = None,
    maps: Mapping[str, TopoMap] = NO_MAPS,
    drives: Sequence[Drive] | None = None,
    changes: Sequence[Change] | None = None,
) -> Canvas:
    """Draw the fused maps of components side by side: each corridor as parallel strands, one for
    each run that drove it; junctions seen by several runs are larger.

    sites: ids of the components to draw, all by default. With them junctions have the numbers of
    the document: all of up to MOST_NUMBERED junctions, of more those that `drives` or `changes`
    name, or without any drive those with branches that nobody drove. maps: of runs whose walls are
    drawn as well; drives: to record next, for a picture of these and of branches that nobody drove;
    changes: for a picture of these.
    """
    fused, shown = result.fused, result if sites is None else of_sites(result, sites)
    views = {c.id: site_views(fused, c, maps) for c in shown.components}
    to_hold = {c: [wall_points(walls_of(own, ""))] for c, own in views.items()}
    for drive in drives or ():
        to_hold.get(drive.component, []).append(drive.path)
    parts = lay_out(result, {c: np.concatenate(own) for c, own in to_hold.items()}, views)
    cells = [part.cell for part in parts]
    width_pt = float(np.clip(CELL_PT * np.sqrt(len(parts)), WIDTH_PT, 2 * WIDTH_PT))
    corners, usual = bounds([corners_of(cells)]), usual_m(shown.fused.length)
    canvas = Canvas(*corners, theme, usual, width_pt, name="merged")
    draw_frames(canvas, cells, [part.title for part in parts])
    too_many = sites is not None and shown.fused.junctions > MOST_NUMBERED
    numbers = set() if sites is None else _named(drives, changes) if too_many else None
    undriven = None if drives is None else ~driven_branches(fused)
    if too_many and undriven is not None and not drives:
        numbers = set(fused.branches.owner[undriven].tolist())
    several = sum(len(part.component.poses) > 1 for part in parts)
    for part in parts:
        draw_walls(canvas, views[part.component.id], part.cell.T_sheet_map, theme["wall"])
        draw_component(
            canvas,
            fused,
            part,
            several=several,
            detailed=sites is not None,
            numbers=numbers,
            drives=drives or (),
            changes=changes or (),
            undriven=undriven,
        )
    canvas.finish(_heading(shown, parts, drives, changes, too_many=too_many))
    return canvas


def _named(drives: Sequence[Drive] | None, changes: Sequence[Change] | None) -> set[int]:
    """The junctions that drives and changes name."""
    named = {stop.junction for drive in drives or () for stop in drive.stops}
    named |= {junction for change in changes or () for junction in change.junctions}
    return {junction for junction in named if junction is not None}


def _heading(
    shown: MergeResult,
    parts: Sequence[Part],
    drives: Sequence[Drive] | None,
    changes: Sequence[Change] | None,
    *,
    too_many: bool,
) -> list[str]:
    """What is drawn; its size, and how many pairs were merged; a line for each drive and change.
    too_many: whether junctions are too many for their numbers."""
    runs = counted(sum(len(c.poses) for c in shown.components), "run")
    alone = parts[0] if len(parts) == 1 else None
    title = f"{runs}: {shown.described_sites}"
    if alone is not None and alone.component.site:
        title = f"{alone.component.site}: {runs}"
    if drives is not None:
        title = f"What to record next: {title}{'' if drives else ': no drive is proposed'}"
    if changes is not None:
        title = f"What changed: {title}{'' if changes else ': nothing changed'}"
    count, (corridors_m, ways_m) = shown.standings(), shown.fused.lengths_m
    joined = count[Standing.JOINED]
    size = (
        f"{counted(shown.fused.junctions, 'junction')}, {corridors_m:,.0f} m of corridors"
        f"{to_turning_points(shown.fused.turned, ways_m)}; "
        f"{counted(sum(count.values()), 'pair')}: {count[Standing.MERGED]:,} merged"
        f"{f', {joined:,} joined through others' if joined else ''}"
        f"{'' if alone is None else _turned_by(alone.cell.T_sheet_map)}"
    )
    if too_many and drives is None and changes is None:
        size += "; too many junctions for their numbers: in an SVG, point at one"
    names = {c.id: c.name for c in shown.components}
    lines = [f"{k}. {'; '.join(d.words)}; {d.way}" for k, d in enumerate(drives or (), 1)]
    lines += [f"{k}. {'; '.join(c.words(names[c.component]))}" for k, c in numbered(changes or ())]
    return [title, size, *lines]


def draw_frames(canvas: Canvas, cells: Sequence[Cell], titles: Sequence[str]) -> None:
    """With more than one cell, draw each one's frame and title, shortened to fit."""
    if len(cells) < 2:
        return
    for cell, title in zip(cells, titles, strict=True):
        (x0, _), (x1, top) = cell.low, cell.high
        canvas.lines([outline(cell.low, cell.high)], Look(canvas.theme["card"], THIN))
        room = letters((x1 - x0) * canvas.points_per_m, TEXT_PT)
        canvas.title(np.array([(x0 + x1) / 2, top]), short(title, room))
