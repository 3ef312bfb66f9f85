"""Static drawings (SVG, PNG): one run's map, a merge."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from types import MappingProxyType

import numpy as np

from ..merge.change import Change, ChangeKind, numbered
from ..merge.drive import Drive
from ..merge.result import FusedMap, MergeResult, Standing, of_sites, site_views
from ..topology.arrays import BoolArray, FloatArray
from ..topology.driven_branches import driven_branches
from ..topology.se2 import apply
from ..topology.topomap import Graph, TopoMap
from ..topology.turning_vertices import with_turning_points
from ..topology.views import Views
from ..topology.wording import counted, to_turning_points
from .canvas import SMALL_PT, TEXT_PT, Canvas, letters
from .geometry import (
    LINE_SHARE,
    MOST_NUMBERED,
    SHEET_MARGIN,
    TURNED,
    TURNED_MARKERS,
    bounds,
    branch_arrows,
    changed_path,
    extent,
    strands,
)
from .pages import describe_corridor, describe_map
from .palette import Order, Theme
from .parts import Part, lay_out, ranks
from .sheet import Cell, corners_of, fitting, outline, upright_rad
from .walls import FINE_M, wall_points, walls_of

NO_MAPS: Mapping[str, TopoMap] = MappingProxyType({})

WIDTH_PT, WIDEST_PT = 720.0, 1440.0
COMPONENT_PT = 110.0
"""A merge's drawing is about this wide for each component across, within WIDTH_PT and WIDEST_PT."""

LINE_PT, THINNEST_PT = 2.2, 0.7
"""Widths of a corridor's line; in a merge it follows from LINE_SHARE, within these bounds."""

MOST_TIMES = 4
"""Corridors driven more often than this are drawn no wider."""

_KINDS = ("nothing seen leaving", "dead end", "bend", "3 branches", "4 branches", "5 and more")


def draw_map(topomap: TopoMap, theme: Theme) -> Canvas:
    """Draw one run's map: corridors, junctions coloured by their number of branches, branches that
    were never driven, and below them walls, where a laser or a saved map showed them."""
    turn, whole = np.array([0.0, 0.0, upright_rad(topomap.paths)]), with_turning_points(topomap)
    seen = wall_points(walls_of([topomap.views], topomap.frame))
    low, high = bounds([apply(turn, np.concatenate([extent(whole), seen]))])
    canvas = Canvas(low, high, theme, WIDTH_PT, "map")
    _corridors_of(canvas, whole, turn)
    _unexplored(canvas, whole, turn, ~driven_branches(whole))
    draw_walls(canvas, [topomap.views], turn, theme["wall"])
    _junctions_of(canvas, topomap, turn)
    _turned_of(canvas, topomap, turn)
    canvas.finish([topomap.run, f"{describe_map(topomap)}{_turned_by(turn)}"])
    return canvas


def _turned_by(T_sheet_map: FloatArray) -> str:
    """By how much the picture is turned from the frame of its map, to be added to a title."""
    degrees = round(float(np.degrees(T_sheet_map[2])))
    return f"; turned by {degrees}°" if degrees else ""


LEAST_CELL_PT = 1.0
"""Least width of a wall's cell: finer ones would take space in the file and not be seen."""


def draw_walls(
    canvas: Canvas,
    views: Sequence[Views],
    T: FloatArray,
    colour: str,
    *,
    alpha: float = 1.0,
    key: str = "wall",
) -> None:
    """Draw the walls that views show, moved onto the sheet by T."""
    cell_m = FINE_M
    while cell_m * canvas.points_per_m < LEAST_CELL_PT:
        cell_m *= 2
    grid = walls_of([v.moved(T) for v in views], "", cell_m)
    if grid is not None:
        canvas.cells(grid, colour, alpha, key)


def _corridors_of(canvas: Canvas, m: TopoMap, T: FloatArray) -> None:
    """Draw the corridors, wider the more often they were driven, with tooltips."""
    colour, times = canvas.theme["corridor"], np.clip(m.traversals, 1, MOST_TIMES)
    for often in range(1, MOST_TIMES + 1):
        rows = np.flatnonzero(times == often).tolist()
        paths, tips = [apply(T, m.paths[i]) for i in rows], [describe_corridor(m, i) for i in rows]
        key = "corridor" if often == 1 else "corridor, driven more often"
        canvas.lines(paths, colour, LINE_PT * (0.4 + 0.4 * often), tips=tips, key=key)


def _unexplored(canvas: Canvas, m: Graph, T: FloatArray, free: BoolArray) -> None:
    """Draw the branches that were never driven, `free` (total branches,)."""
    arrows = branch_arrows(m, free, 8.0 / canvas.points_per_m)
    ends = [apply(T, np.stack([o, o + v])) for o, v in zip(*arrows, strict=True)]
    colour, key = canvas.theme["unexplored"], "branch never driven"
    canvas.lines(ends, colour, 1.5, order=Order.UNEXPLORED, key=key)


def _junctions_of(canvas: Canvas, m: TopoMap, T: FloatArray) -> None:
    """Draw the junctions, coloured by their branches, with their numbers."""
    xy = apply(T, m.xy)
    group = np.minimum(m.degree, len(_KINDS) - 1)
    for degree, label in enumerate(_KINDS):
        rows = np.flatnonzero(group == degree).tolist()
        colour, size_pt = canvas.theme[f"degree {degree}"], 6.5 if degree >= 3 else 5.0
        tips = [_describe_junction(m, i) for i in rows]
        canvas.dots(xy[rows], colour, size_pt, tips=tips, key=label)
    if len(m) <= MOST_NUMBERED:
        _numbered(canvas, m, T, range(len(m)))


def _describe_junction(m: TopoMap, i: int) -> str:
    sigma = f", ± {m.position_sigma[i]:.2f} m" if m.position_sigma is not None else ""
    sure = f", confidence {m.confidence[i]:.2f}" if m.confidence[i] < 1 else ""
    passes = counted(int(m.passes[i]), "pass", "passes")
    return f"{m.kind[i].replace('_', ' ')} {i}{_describe_size(m, i)}: {passes}{sigma}{sure}"


def _describe_size(m: TopoMap, vertex: int) -> str:
    """How large a room is, and how wide a door."""
    if m.area_m2 is not None and m.area_m2[vertex] > 0:
        return f", {m.area_m2[vertex]:.0f} m²"
    if m.width_m is not None and m.width_m[vertex] > 0:
        return f", {m.width_m[vertex]:.2f} m wide"
    return ""


def _turned_of(canvas: Canvas, m: TopoMap, T: FloatArray) -> None:
    """Draw where the robot turned round and where the log begins or ends between junctions."""
    points = m.turning_points
    for kind, marker in TURNED_MARKERS.items():
        rows = [k for k, own in enumerate(points.kind) if own == kind]
        tips = [
            f"{TURNED[kind]}, {points.length[k]:.2f} m from junction {points.vertex[k]}"
            for k in rows
        ]
        xy, colour = apply(T, points.xy[rows]), canvas.theme["degree 1"]
        canvas.dots(xy, colour, 4.0, tips=tips, marker=marker, key=TURNED[kind])


def _numbered(canvas: Canvas, m: Graph, T: FloatArray, junctions: Iterable[int]) -> None:
    """Write the numbers of junctions amid the widest gaps between their branches."""
    away_m = 8.0 / canvas.points_per_m
    for i in junctions:
        heading = np.sort(np.mod(m.branches[i] + T[2], 2 * np.pi))
        middle = np.pi / 4
        if len(heading):
            gaps = np.diff(np.r_[heading, heading[0] + 2 * np.pi])
            k = int(gaps.argmax())
            middle = heading[k] + gaps[k] / 2
        aside = away_m * np.array([np.cos(middle), np.sin(middle)])
        at = apply(T, m.xy[i])
        canvas.words(at + aside, str(i), size_pt=SMALL_PT, of=at)


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
    name. maps: of runs whose walls are drawn as well; drives: to record next, for a picture of
    these and of branches that nobody drove; changes: for a picture of these.
    """
    fused, shown = result.fused, result if sites is None else of_sites(result, sites)
    views = {c.id: site_views(fused, c, maps) for c in shown.components}
    to_hold = {c: [wall_points(walls_of(own, ""))] for c, own in views.items()}
    for drive in drives or ():
        to_hold.get(drive.component, []).append(drive.path)
    parts = lay_out(result, {c: np.concatenate(own) for c, own in to_hold.items()}, views)
    cells, rank, free = [part.cell for part in parts], ranks(result), ~driven_branches(fused)
    width_pt = float(np.clip(COMPONENT_PT * np.sqrt(2 * len(parts)), WIDTH_PT, WIDEST_PT))
    canvas = sheet_canvas(cells, theme, width_pt, "merged")
    _key_of_runs(canvas, parts, rank)
    draw_frames(canvas, cells, [*map(_titles, parts)])
    pen_pt = _pen_pt(canvas, shown.fused)
    numbered = set() if sites is None else _to_number(shown, fused, free, drives, changes or ())
    for part in parts:
        T = part.cell.T_sheet_map
        _fused(canvas, fused, part, rank, pen_pt, numbers=sites is not None)
        _numbered(canvas, fused, T, [v for v in part.vertices.tolist() if v in numbered])
        draw_walls(canvas, views[part.component.id], T, theme["wall"])
        if drives is not None:
            _unexplored(canvas, fused, T, free & np.isin(fused.branches.owner, part.vertices))
            _drives(canvas, part, drives)
        _changes(canvas, fused, part, changes or (), pen_pt)
    too_many = sites is not None and shown.fused.junctions > MOST_NUMBERED
    canvas.finish(_heading(shown, parts, drives, changes, too_many=too_many))
    return canvas


def _key_of_runs(canvas: Canvas, parts: Sequence[Part], rank: Mapping[str, int]) -> None:
    """Add the runs of components of several to the key, below the names of their sites if these are
    more than one."""
    several = [part.component for part in parts if len(part.component.poses) > 1]
    for component in several:
        if len(several) > 1:
            canvas.run(component.name, None)
        for run in sorted(component.poses):
            canvas.run(run, canvas.theme.run(rank[run]))


def _titles(part: Part) -> tuple[str, ...]:
    """Forms of a component's title, longest first: the longer ones also with its turn."""
    turn = _turned_by(part.cell.T_sheet_map)
    return (*(title + turn for title in part.titles[:2]), *part.titles)


def _to_number(
    shown: MergeResult,
    fused: FusedMap,
    free: BoolArray,
    drives: Sequence[Drive] | None,
    changes: Sequence[Change],
) -> set[int]:
    """The junctions whose numbers are written: all, or of many those that a drive or a change
    names, and with drives those with a branch that nobody drove (`free` (total branches,))."""
    junctions = {*np.flatnonzero(~fused.is_turned).tolist()}
    if shown.fused.junctions <= MOST_NUMBERED:
        return junctions
    named = {stop.junction for drive in drives or () for stop in drive.stops}
    named |= {junction for change in changes for junction in change.junctions}
    named |= set() if drives is None else {*fused.branches.owner[free].tolist()}
    return junctions & named


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
    title = f"{runs} of {counted(len(parts), 'site')}"
    if alone is not None and alone.component.site:
        title = f"{alone.component.site}: {runs}"
    title = title if drives is None else f"What to record next: {title}"
    title += "" if drives is None or drives else ": no drive is proposed"
    title = title if changes is None else f"What changed: {title}"
    title += "" if changes is None or changes else ": nothing changed"
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


DRIVE_PT = 7.0
"""Width of a drive to record, below the lines of runs."""


def _drives(canvas: Canvas, part: Part, drives: Sequence[Drive]) -> None:
    """Draw the drives that begin in a component, each with its number where it begins, and the
    numbers that its junctions in another site have there."""
    T, away_m = part.cell.T_sheet_map, 1.6 * TEXT_PT / canvas.points_per_m
    begins: dict[tuple[float, float], list[str]] = {}
    for k, drive in enumerate(drives, 1):
        if drive.component != part.component.id:
            continue
        path, tips = [apply(T, drive.path)], [f"drive {k}: {drive.words[0]}"]
        colour, key = canvas.theme["planned"], "drive to record, from its number on"
        canvas.lines(path, colour, DRIVE_PT, order=Order.EVIDENCE, tips=tips, key=key)
        begins.setdefault(drive.stops[0].xy, []).append(str(k))
        others = {s.xy: s.junction for s in drive.stops if s.site != drive.site}
        for xy, junction in others.items():
            at = apply(T, np.array(xy))
            aside = away_m * np.array([-1.0, 0.5])
            canvas.words(at + aside, str(junction), size_pt=SMALL_PT, of=at)
    for xy, numbers in begins.items():
        at = apply(T, np.array(xy))
        canvas.dots(at[None], canvas.theme["unexplored"], 2 * DRIVE_PT, order=Order.RING, ring=True)
        canvas.words(at + np.array([0.0, away_m]), ", ".join(numbers), bold=True, of=at)


CHANGED = {
    ChangeKind.GONE: ("against", "gone, with its number in the list"),
    ChangeKind.NEW: ("agrees", "new, with its number in the list"),
    ChangeKind.DIFFERS: ("unexplored", "there at times, with its number in the list"),
}
"""Colours of changes, and what the key calls them."""


def _changes(
    canvas: Canvas, fused: FusedMap, part: Part, changes: Sequence[Change], pen_pt: float
) -> None:
    """Draw what changed in a component, each with its number in the list: a rim round the lines of
    a corridor's runs, a ring round a junction."""
    T, aside = part.cell.T_sheet_map, 1.0 * TEXT_PT / canvas.points_per_m
    for k, change in numbered(changes):
        if change.component != part.component.id:
            continue
        path = [apply(T, changed_path(fused, part.edges, change))]
        at, tips = apply(T, np.array(change.xy)), [f"change {k}"]
        ink, key = CHANGED[change.kind]
        colour, rim_pt = canvas.theme[ink], pen_pt * (len(change.there) + 3)
        if change.edge is None:
            canvas.dots(at[None], colour, 2 * DRIVE_PT, order=Order.RING, ring=True, key=key)
        canvas.lines(path, colour, rim_pt, order=Order.EVIDENCE, tips=tips, key=key)
        canvas.words(at + aside, str(k), bold=True, of=at)


def sheet_canvas(cells: Sequence[Cell], theme: Theme, width_pt: float, name: str) -> Canvas:
    """An empty drawing of the cells of a sheet."""
    return Canvas(*bounds([corners_of(cells)], margin=SHEET_MARGIN), theme, width_pt, name)


def draw_frames(canvas: Canvas, cells: Sequence[Cell], titles: Sequence[Sequence[str]]) -> None:
    """With more than one cell, draw each one's frame and title, in the longest form that fits."""
    if len(cells) < 2:
        return
    size = TEXT_PT if len(cells) < 12 else SMALL_PT
    for cell, forms in zip(cells, titles, strict=True):
        (x0, _), (x1, top) = cell.low, cell.high
        canvas.lines([outline(cell.low, cell.high)], canvas.theme["card"], 0.8, order=Order.CARD)
        title = fitting(forms, letters(0.96 * (x1 - x0) * canvas.points_per_m, size))
        at = np.array([(x0 + x1) / 2, top - 0.8 * size / canvas.points_per_m])
        canvas.words(at, title, size_pt=size)


def _pen_pt(canvas: Canvas, fused: FusedMap) -> float:
    """Width of a run's line: a share of the median corridor, within bounds [points]."""
    usual = float(np.median(fused.length)) if len(fused.length) else 0.0
    return float(np.clip(LINE_SHARE * usual * canvas.points_per_m, THINNEST_PT, LINE_PT))


def _fused(
    canvas: Canvas,
    fused: FusedMap,
    part: Part,
    rank: Mapping[str, int],
    pen_pt: float,
    *,
    numbers: bool,
) -> None:
    """Draw a component's corridors as strands of its runs, its junctions and turning points. With
    `numbers`, pointing at a junction tells its own."""
    T = part.cell.T_sheet_map
    alone = len(part.component.poses) == 1
    drawn: dict[tuple[str, float], list[FloatArray]] = {}
    for strand in strands(fused, part.edges, pen_pt / canvas.points_per_m):
        drawn.setdefault((strand.run, strand.share), []).append(apply(T, strand.path))
    for (run, share), paths in sorted(drawn.items()):
        colour = canvas.theme["single"] if alone else canvas.theme.run(rank[run])
        key = "run that is merged with none" if alone else ""
        canvas.lines(paths, colour, pen_pt * share, tips=[run], key=key)
    shared = np.array([len(fused.members[i]) > 1 for i in part.vertices.tolist()], bool)
    kinds = np.array([fused.kind[i] for i in part.vertices.tolist()], object)
    turned = np.array([kind in TURNED for kind in kinds], bool)
    xy = apply(T, fused.xy[part.vertices])
    for kind, marker in TURNED_MARKERS.items():
        own, colour = xy[kinds == kind], canvas.theme["degree 1"]
        canvas.dots(own, colour, 1.2 * pen_pt, marker=marker, key=TURNED[kind])
    for which, ink, pens, order, key in (
        (~shared, "single", 1.4, Order.JUNCTION, "junction seen by one run"),
        (shared, "shared", 2.1, Order.TIE, "junction seen by several runs"),
    ):
        rows = np.flatnonzero(which & ~turned)
        tips = [f"junction {v}" for v in part.vertices[rows].tolist()] if numbers else []
        size_pt = pens * pen_pt
        canvas.dots(xy[rows], canvas.theme[ink], size_pt, order=order, tips=tips, key=key)
