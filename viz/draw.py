"""Static drawings (SVG, PNG): one run's map, a merge, the decision on a pair."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np

from ..merge.decision import Decision, Term
from ..merge.decision_text import advice, because, digits_of, headline, itemised
from ..merge.result import (
    Alignment,
    FusedMap,
    MergeResult,
    of_site,
    site_views,
)
from ..topology.arrays import FloatArray
from ..topology.driven_branches import driven_branches
from ..topology.matching.views import AGREES, CONTRADICTS, SILENT
from ..topology.se2 import apply, compose, turned
from ..topology.topomap import Graph, TopoMap
from ..topology.turning_points import FRONTIER, TRACK_END, TURNING_POINT
from ..topology.turning_vertices import with_turning_points
from ..topology.views import CELL_M, REACH_M, Views
from ..topology.wording import counted, to_turning_points
from .canvas import SMALL_PT, TEXT_PT, Canvas, Key, width_of
from .drawing import (
    MOST_NUMBERED,
    SHEET_MARGIN,
    bounds,
    branch_arrows,
    extent,
    strands,
)
from .palette import Order, Theme
from .parts import Part, lay_out, ranks
from .placements import CORNERS, WIDTHS, Overlay, against, overlays, placements
from .sheet import Cell, arrange, corners_of, outline, sheet_margin_m, upright_rad
from .walls import FINE_M, map_walls, site_walls, strokes, wall_points, walls_of

NO_MAPS: Mapping[str, TopoMap] = MappingProxyType({})

MOST_TOLD = 3000
"""Above this many corridors or junctions they are drawn in groups, without tooltips."""

WIDTH_PT, WIDEST_PT = 720.0, 1440.0
COMPONENT_PT = 110.0
"""A merge's drawing is about this wide for each component across, within WIDTH_PT and WIDEST_PT."""

LINE_PT, THINNEST_PT = 2.2, 0.7
LINE_SHARE = 0.12
"""Width of a corridor's line in a merge over the median corridor length, within THINNEST_PT and
LINE_PT."""

_KINDS = ("nothing seen leaving", "dead end", "bend", "3 branches", "4 branches", "5 and more")


def draw_map(topomap: TopoMap, theme: Theme, *, name: str = "map") -> Canvas:
    """Draw one run's map: corridors, junctions coloured by their number of branches, branches that
    were never driven, and below them walls, where a laser or a saved map showed them."""
    turn, whole = np.array([0.0, 0.0, upright_rad(topomap.paths)]), with_turning_points(topomap)
    seen = wall_points(map_walls(topomap))
    low, high = bounds([apply(turn, np.concatenate([extent(whole), seen]))])
    canvas = Canvas(low, high, theme, WIDTH_PT, name)
    keys = [*_corridors_of(canvas, whole, turn), *_unexplored(canvas, whole, turn)]
    keys += _walls(canvas, [topomap.views], turn, theme["wall"])
    keys += [*_junctions_of(canvas, topomap, turn), *_turned_of(canvas, topomap, turn)]
    ways = topomap.turning_points
    told = (
        f"{counted(len(topomap), 'junction')}, {counted(len(topomap.source), 'corridor')}, "
        f"{topomap.length.sum():,.0f} m{to_turning_points(len(ways), ways.length.sum())}; "
        f"{counted(len(topomap.observation_vertex), 'pass', 'passes')}"
    )
    canvas.finish([topomap.run, told], [keys])
    return canvas


LEAST_CELL_PT = 1.0
"""Least width of a wall's cell: finer ones are not told apart, so that walls take no more space in
the file than the page has room for."""


def _walls(
    canvas: Canvas,
    views: Sequence[Views],
    T: FloatArray,
    colour: str,
    label: str = "wall",
    *,
    width: float = 1.0,
) -> list[Key]:
    """Draw the walls that views show, moved onto the sheet by T; width: of lines, over that of a
    cell."""
    cell_m = FINE_M
    while cell_m * canvas.points_per_m < LEAST_CELL_PT:
        cell_m *= 2
    grid = walls_of([v.moved(T) for v in views], "", cell_m)
    lines = [] if grid is None else strokes(grid)
    width_pt = width * cell_m * canvas.points_per_m
    canvas.lines(lines, colour, width_pt, order=Order.WALL)
    return [Key("wide line", colour, label)] if lines else []


def _corridors_of(canvas: Canvas, m: TopoMap, T: FloatArray) -> list[Key]:
    """Draw the corridors, wider the more often they were driven, with tooltips."""
    colour = canvas.theme["corridor"]
    if len(m.source) > MOST_TOLD:
        for times in (1, 2, 3, 4):
            rows = np.flatnonzero(np.clip(m.traversals, 1, 4) == times).tolist()
            canvas.lines([apply(T, m.paths[i]) for i in rows], colour, LINE_PT * _widening(times))
    for i, path in enumerate(m.paths if len(m.source) <= MOST_TOLD else ()):
        times = int(m.traversals[i])
        told = (
            f"corridor {m.source[i]} to {m.target[i]}: "
            f"{m.length[i]:.2f} ± {m.length_sigma[i]:.2f} m, "
            f"driven {counted(times, 'time')}"
        )
        canvas.lines([apply(T, path)], colour, LINE_PT * _widening(times), told=told)
    most = int(m.traversals.max()) if len(m.traversals) else 0
    keys = [Key("line", colour, "corridor")] if most else []
    return [*keys, Key("wide line", colour, "driven more often")] if most > 1 else keys


def _widening(times: int) -> float:
    return 0.8 + 0.4 * min(max(times, 1) - 1, 3)


def _unexplored(canvas: Canvas, m: Graph, T: FloatArray) -> list[Key]:
    free = ~driven_branches(m)
    if not free.any():
        return []
    origin, vector = branch_arrows(m, 8.0 / canvas.points_per_m)
    ends = [apply(T, np.stack([o, o + v])) for o, v in zip(origin[free], vector[free], strict=True)]
    canvas.lines(ends, canvas.theme["unexplored"], 1.5, order=Order.UNEXPLORED)
    return [Key("stub", canvas.theme["unexplored"], "branch never driven")]


def _junctions_of(canvas: Canvas, m: TopoMap, T: FloatArray) -> list[Key]:
    xy = apply(T, m.xy) if len(m) else np.zeros((0, 2))
    group = np.minimum(m.degree, len(_KINDS) - 1)
    passes = m.passes.tolist()
    keys = []
    for degree, label in enumerate(_KINDS):
        rows = np.flatnonzero(group == degree)
        if len(rows) == 0:
            continue
        colour, size = canvas.theme[f"degree {degree}"], 6.5 if degree >= 3 else 5.0
        if len(m) > MOST_TOLD:
            canvas.dots(xy[rows], colour, size)
        for i in rows.tolist() if len(m) <= MOST_TOLD else ():
            sigma = f", ± {m.position_sigma[i]:.2f} m" if m.position_sigma is not None else ""
            times = counted(passes[i], "pass", "passes")
            sure = f", confidence {m.confidence[i]:.2f}" if m.confidence[i] < 1 else ""
            told = f"{m.kind[i].replace('_', ' ')} {i}{_size_told(m, i)}: {times}{sigma}{sure}"
            canvas.dots(xy[i : i + 1], colour, size, told=told)
        keys.append(Key("big dot" if degree >= 3 else "dot", colour, label))
    if len(m) <= MOST_NUMBERED:
        for i, where in enumerate(_beside(m, T, xy, 8.0 / canvas.points_per_m)):
            canvas.words((float(where[0]), float(where[1])), str(i), size_pt=SMALL_PT)
    return keys


def _size_told(m: TopoMap, vertex: int) -> str:
    """How large a room is, and how wide a door."""
    if m.area_m2 is not None and m.area_m2[vertex] > 0:
        return f", {m.area_m2[vertex]:.0f} m²"
    if m.width_m is not None and m.width_m[vertex] > 0:
        return f", {m.width_m[vertex]:.2f} m wide"
    return ""


TURNED = {
    TURNING_POINT: "robot turned round",
    TRACK_END: "log begins or ends",
    FRONTIER: "unknown beyond",
}


def _turned_of(canvas: Canvas, m: TopoMap, T: FloatArray) -> list[Key]:
    """Draw where the robot turned round and where the log begins or ends between junctions."""
    points, colour = m.turning_points, canvas.theme["degree 1"]
    xy = apply(T, points.xy)
    for k, kind in enumerate(points.kind):
        told = f"{TURNED[kind]}, {points.length[k]:.2f} m from junction {points.vertex[k]}"
        canvas.dots(xy[k : k + 1], colour, 4.0, told=told)
    return [Key("dot", colour, label) for kind, label in TURNED.items() if kind in points.kind]


def _beside(m: TopoMap, T: FloatArray, xy: FloatArray, away_m: float) -> FloatArray:
    """(n, 2) positions of the junctions' numbers: `away_m` along the middle of the widest gap
    between the junction's branches."""
    out = np.array(xy)
    for i in range(len(m)):
        heading = np.sort(np.mod(m.branches[i] + T[2], 2 * np.pi))
        middle = np.pi / 4
        if len(heading):
            gaps = np.diff(np.r_[heading, heading[0] + 2 * np.pi])
            k = int(gaps.argmax())
            middle = heading[k] + gaps[k] / 2
        out[i] += away_m * np.array([np.cos(middle), np.sin(middle)])
    return out


def draw_site(
    result: MergeResult, component: int, theme: Theme, maps: Mapping[str, TopoMap] = NO_MAPS
) -> Canvas:
    """Draw one component of a merge, with the numbers that its junctions have in the document.
    maps: as of `draw_merged`."""
    numbers = np.flatnonzero(result.fused.component == component).tolist()
    return draw_merged(of_site(result, component), theme, numbers=numbers, maps=maps)


def draw_merged(
    result: MergeResult,
    theme: Theme,
    *,
    numbers: Sequence[int] = (),
    maps: Mapping[str, TopoMap] = NO_MAPS,
) -> Canvas:
    """Draw the fused map of every component: each corridor as parallel strands, one for each run
    that drove it; junctions seen by several runs are larger.

    numbers: of the fused vertices, to be shown beside up to MOST_NUMBERED junctions; maps: of runs
    whose walls are drawn as well.
    """
    views = {c.id: site_views(result.fused, c, maps) for c in result.components}
    walls = {c.id: site_walls(result.fused, c, maps) for c in result.components}
    seen = {c: wall_points(grid) for c, grid in walls.items() if grid is not None}
    parts = lay_out(result, for_paper=True, walls=seen)
    cells = [part.cell for part in parts]
    width = float(np.clip(COMPONENT_PT * np.sqrt(2 * len(parts)), WIDTH_PT, WIDEST_PT))
    canvas = _sheet(cells, theme, width, "merged")
    rank = ranks(result)
    _frames(canvas, cells, [_title(canvas, part) for part in parts])
    pen = _pen_pt(canvas, result.fused)
    walled: list[Key] = []
    for part in parts:
        _fused(canvas, result.fused, part, rank, pen)
        if numbers and result.fused.junctions <= MOST_NUMBERED:
            _numbered(canvas, result.fused, part, numbers)
        own = views[part.component.id]
        walled = [*walled, *_walls(canvas, own, part.cell.T_sheet_map, theme["wall"])]
    pairs = sum(pair.accepted for pair in result.verdicts)
    runs = sum(len(c.poses) for c in result.components)
    corridors_m, ways_m = result.fused.lengths_m
    told = (
        f"{counted(result.fused.junctions, 'junction')}, {corridors_m:,.0f} m of corridors"
        f"{to_turning_points(result.fused.turned, ways_m)}; {counted(pairs, 'pair')} of "
        f"{sum(result.standings().values()):,} merged"
    )
    title = f"{counted(runs, 'run')} of {counted(len(result.components), 'site')}"
    if len(parts) == 1 and parts[0].component.site:
        title = f"{parts[0].component.site}: {counted(runs, 'run')}"
    marks, runs_told = _merged_keys(result, parts, rank, theme)
    canvas.finish([title, told], [[*marks, *walled[:1]], runs_told])
    return canvas


def _numbered(canvas: Canvas, fused: FusedMap, part: Part, numbers: Sequence[int]) -> None:
    """Write the numbers of a part's junctions beside them."""
    rows = [k for k in part.vertices.tolist() if fused.kind[k] not in TURNED]
    xy = apply(part.cell.T_sheet_map, fused.xy[rows].reshape(-1, 2)) + 8.0 / canvas.points_per_m
    for k, (x, y) in zip(rows, xy.tolist(), strict=True):
        canvas.words((x, y), str(numbers[k]), size_pt=SMALL_PT)


def _title(canvas: Canvas, part: Part) -> str:
    """The longest of the component's titles that fits its cell."""
    room = (part.cell.high[0] - part.cell.low[0]) * canvas.points_per_m
    fitting = (title for title in part.titles if width_of(title, TEXT_PT) < room)
    return next(fitting, part.titles[-1])


def _merged_keys(
    result: MergeResult, parts: list[Part], rank: Mapping[str, int], theme: Theme
) -> list[list[Key]]:
    """The entries for marks, then those for the runs of every component of several runs."""
    several = [part for part in parts if len(part.component.poses) > 1]
    fused = result.fused
    places = fused.members[: fused.junctions]
    shared, single = any(len(m) > 1 for m in places), any(len(m) == 1 for m in places)
    marks: list[Key] = []
    if shared:
        marks.append(Key("big dot", theme["shared"], "junction seen by several runs"))
    if single:
        marks.append(Key("dot", theme["single"], "junction seen by one run"))
    found = {kind: label for kind, label in TURNED.items() if kind in fused.kind}
    marks += [Key("dot", theme["degree 1"], label) for label in found.values()]
    if len(several) < len(parts):
        marks.append(Key("line", theme["single"], "run that is merged with none"))
    runs: list[Key] = []
    for part in several:
        if len(several) > 1:
            runs.append(Key("title", theme["ink"], part.component.name))
        names = sorted(part.component.poses)
        runs += [Key("line", theme.run(rank[run]), run) for run in names]
    return [marks, runs]


def _sheet(cells: Sequence[Cell], theme: Theme, width_pt: float, name: str) -> Canvas:
    return Canvas(*bounds([corners_of(cells)], margin=SHEET_MARGIN), theme, width_pt, name)


def _frames(canvas: Canvas, cells: Sequence[Cell], titles: Sequence[str]) -> None:
    """With more than one cell, draw each one's frame and title."""
    if len(cells) < 2:
        return
    for cell, title in zip(cells, titles, strict=True):
        (x0, _), (x1, y1) = cell.low, cell.high
        canvas.lines([outline(cell.low, cell.high)], canvas.theme["card"], 0.8, order=Order.CARD)
        size = TEXT_PT if len(cells) < 12 else SMALL_PT
        at = (float(x0 + x1) / 2, float(y1) - 0.8 * size / canvas.points_per_m)
        canvas.words(at, title, size_pt=size, room_m=0.96 * float(x1 - x0))


def _pen_pt(canvas: Canvas, fused: FusedMap) -> float:
    usual = float(np.median(fused.length)) if len(fused.length) else 0.0
    return float(np.clip(LINE_SHARE * usual * canvas.points_per_m, THINNEST_PT, LINE_PT))


def _fused(
    canvas: Canvas, fused: FusedMap, part: Part, rank: Mapping[str, int], pen_pt: float
) -> None:
    T = part.cell.T_sheet_map
    alone = len(part.component.poses) == 1
    drawn: dict[tuple[str, float], list[FloatArray]] = {}
    for strand in strands(fused, part.edges, pen_pt / canvas.points_per_m):
        drawn.setdefault((strand.run, strand.share), []).append(apply(T, strand.path))
    for (run, share), paths in sorted(drawn.items()):
        colour = canvas.theme["single"] if alone else canvas.theme.run(rank[run])
        canvas.lines(paths, colour, pen_pt * share, told=run)
    shared = np.array([len(fused.members[i]) > 1 for i in part.vertices.tolist()], bool)
    turned = np.array([fused.kind[i] in TURNED for i in part.vertices.tolist()], bool)
    xy = apply(T, fused.xy[part.vertices]) if len(part.vertices) else np.zeros((0, 2))
    canvas.dots(xy[turned], canvas.theme["degree 1"], 1.0 * pen_pt)
    shared, single = shared & ~turned, ~shared & ~turned
    canvas.dots(xy[single], canvas.theme["single"], 1.4 * pen_pt)
    canvas.dots(xy[shared], canvas.theme["shared"], 2.1 * pen_pt, order=Order.TIE)


def draw_decision(a: TopoMap, b: TopoMap, decision: Decision, theme: Theme) -> Canvas:
    """Draw why two runs were merged or not: the placements of b over a, with lines between matched
    junctions, the links that speak for a placement and what speaks against it."""
    a, b = with_turning_points(a), with_turning_points(b)
    drawn, beside = placements(a, b, decision), overlays(decision)
    heading = [headline(decision), because(decision), advice(decision)]
    heading += [f"Note: {note}" for note in decision.notes]
    if not drawn:
        return _side_by_side(a, b, heading, theme, "pair")
    laid = [(p.title, p.T_a_b) for p in drawn]
    canvas, cells = _over(a, b, laid, theme, "pair", beside=beside)
    links = contradicted = matched = False
    digits = digits_of(decision)
    for picture, cell in zip(drawn, cells, strict=False):
        T_b = compose(cell.T_sheet_map, picture.T_a_b)
        if picture.placement is not None:
            xy = (apply(cell.T_sheet_map, a.xy), apply(T_b, b.xy))
            agreeing, others = (itemised(picture.placement, k) for k in ("corridor", "unseen"))
            links |= _links(canvas, agreeing, xy, digits, both=picture.tied)
            contradicted |= _against(canvas, others, xy, digits)
            matched |= _ties(canvas, picture.placement.alignment, xy, apart=picture.tied)
    keys = _pair_keys(
        *(theme, a.run, b.run),
        matched=matched,
        links=links,
        against=contradicted or bool(beside),
        walls=bool(len(a.views) and len(b.views)),
    )
    canvas.finish(heading, [keys])
    return canvas


FILLED, TINY_M = 0.85, 1e-3
"""Share of a cell that views take, below its title; length of the line that is drawn for a dot."""

VIEW_SHARE = 0.6
"""Least width of a picture of views over that of a placement: of large buildings views are drawn
larger than their maps."""


def _views(canvas: Canvas, overlay: Overlay, cell: Cell, turn_rad: float) -> None:
    """Draw two views over each other in a cell."""
    low, high = cell.low, cell.high
    scale = FILLED * float((high - low).min()) / (2 * REACH_M)
    dot_pt = CELL_M * scale * canvas.points_per_m
    for run, kind, xy in overlay.layers(turn_rad):
        colour = {
            SILENT: canvas.theme.pale_run(run),
            AGREES: canvas.theme.run(run),
            CONTRADICTS: canvas.theme["against"],
        }[kind]
        at = (low + high) / 2 + scale * xy
        canvas.lines(list(np.stack([at - TINY_M, at], axis=1)), colour, dot_pt * WIDTHS[run])


def _pair_keys(
    theme: Theme,
    a: str,
    b: str,
    *,
    matched: bool = False,
    links: bool = False,
    against: bool = False,
    walls: bool = False,
) -> list[Key]:
    keys = [Key("line", theme.run(0), a), Key("line", theme.run(1), b)]
    if walls:
        keys += [
            Key("wide line", theme.pale_run(k), f"walls of {run}") for k, run in ((0, a), (1, b))
        ]
    if matched:
        keys.append(Key("ring", theme["ink"], "matched junctions, tied"))
    if links:
        keys.append(Key("wide line", theme["agrees"], "link that speaks for it"))
    if against:
        keys.append(Key("ring", theme["against"], "what speaks against it"))
    return keys


def _over(
    a: TopoMap,
    b: TopoMap,
    laid: Sequence[tuple[str, FloatArray]],
    theme: Theme,
    name: str,
    *,
    beside: Sequence[Overlay] = (),
) -> tuple[Canvas, list[Cell]]:
    """Draw map b over map a once for each (title, T_a_b), and views beside these."""
    of_a, of_b = (np.concatenate([extent(m), wall_points(map_walls(m))]) for m in (a, b))
    points = [np.concatenate([of_a, apply(T, of_b)]) for _, T in laid]
    turn = upright_rad(a.paths)
    wide = min(float(np.ptp(p, axis=0).max()) for p in points)
    square = CORNERS * max(VIEW_SHARE * wide / (2 * REACH_M), 1.0)
    shown = [*points, *(turned(square, -turn) for _ in beside)]
    cells = arrange(shown, [turn] * len(shown), sheet_margin_m(points))
    canvas = _sheet(cells, theme, WIDTH_PT, name)
    _frames(canvas, cells, [*(title for title, _ in laid), *(o.title for o in beside)])
    for overlay, cell in zip(beside, cells[len(laid) :], strict=True):
        _views(canvas, overlay, cell, turn)
    for (_, T), cell in zip(laid, cells, strict=False):
        _own_map(canvas, a, cell.T_sheet_map, theme.run(0))
        _own_map(canvas, b, compose(cell.T_sheet_map, T), theme.run(1))
        # The walls of b are thinner, so that those of a show where both lie.
        _walls(canvas, [a.views], cell.T_sheet_map, theme.pale_run(0))
        T_sheet_b = compose(cell.T_sheet_map, T)
        _walls(canvas, [b.views], T_sheet_b, theme.pale_run(1), width=0.5)
    return canvas, cells


def _own_map(canvas: Canvas, m: TopoMap, T: FloatArray, colour: str) -> None:
    canvas.lines([apply(T, path) for path in m.paths], colour, 1.6, told=m.run)
    if len(m):
        canvas.dots(apply(T, m.xy), colour, 3.6)


def _side_by_side(
    a: TopoMap, b: TopoMap, heading: Sequence[str], theme: Theme, name: str
) -> Canvas:
    points = [extent(m) for m in (a, b)]
    cells = arrange(points, [upright_rad(m.paths) for m in (a, b)], sheet_margin_m(points))
    canvas = _sheet(cells, theme, WIDTH_PT, name)
    _frames(canvas, cells, [a.run, b.run])
    for k, (m, cell) in enumerate(zip((a, b), cells, strict=True)):
        _own_map(canvas, m, cell.T_sheet_map, theme.run(k))
    canvas.finish(heading, [_pair_keys(theme, a.run, b.run)])
    return canvas


def _ties(
    canvas: Canvas, alignment: Alignment, xy: tuple[FloatArray, FloatArray], *, apart: bool
) -> bool:
    """Draw rings round matched junctions, their numbers, of b only where it is drawn `apart`, and a
    line between each two; returns whether there are any."""
    pairs = alignment.matched
    if len(pairs) == 0:
        return False
    one, two = xy[0][pairs[:, 0]], xy[1][pairs[:, 1]]
    ink = canvas.theme["ink"]
    for (u, v), p, q in zip(pairs.tolist(), one, two, strict=True):
        canvas.lines(
            [np.stack([p, q])], ink, 0.7, order=Order.TIE, told=f"junction {u} = junction {v}"
        )
    canvas.dots(one, ink, 6.5, order=Order.TIE, ring=True)
    canvas.dots(two, ink, 6.5, order=Order.TIE, ring=True)
    aside = 7.0 / canvas.points_per_m
    for k, at in enumerate((one, two) if apart else (one,)):
        for v, (x, y) in zip(pairs[:MOST_NUMBERED, k].tolist(), at.tolist(), strict=False):
            canvas.words((x - aside, y + aside), str(v), size_pt=SMALL_PT)
    return True


def _links(
    canvas: Canvas,
    links: Sequence[Term],
    xy: tuple[FloatArray, FloatArray],
    digits: int,
    *,
    both: bool,
) -> bool:
    """Draw every link between two junctions of a, and if `both` also between those of b; returns
    whether any was drawn."""
    drawn = False
    for side in (0, 1) if both else (0,):
        for t in links:
            ends = (t.a, t.b)[side]
            if len(ends) == 2 and t.bits > 0:
                width = 2.0 + 0.5 * min(t.bits, 6.0)
                told = f"{t.bits:+z.{digits}f} bits: {t.text}"
                line = xy[side][list(ends)]
                canvas.lines([line], canvas.theme["agrees"], width, order=Order.EVIDENCE, told=told)
                drawn = True
    return drawn


def _against(
    canvas: Canvas, terms: Sequence[Term], xy: tuple[FloatArray, FloatArray], digits: int
) -> bool:
    """Mark junctions that the other run drove past without seeing them, and corridors that cross;
    returns whether there are any."""
    found = list(against(terms, *xy))
    for term, at in found:
        told = f"{term.bits:+z.{digits}f} bits: {term.text}"
        if len(at) == 1:
            _ring(canvas, at[0], told)
        else:
            colour, order = canvas.theme["against"], Order.CONTRADICTION
            canvas.lines([at], colour, 2.2, order=order, told=told)
    return bool(found)


def _ring(canvas: Canvas, xy: FloatArray, told: str) -> None:
    """Draw a ring in the colour of contradictions."""
    colour, order = canvas.theme["against"], Order.CONTRADICTION
    canvas.dots(xy[None], colour, 9.0, order=order, ring=True, told=told)
