"""The drawing of a decision: the placements of one map on another side by side, and the views that
speak most for a placement and against it, laid over each other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..merge.decision import AGAINST, LINKS, Decision, Placement, Term
from ..merge.decision_text import (
    advice,
    because,
    digits_of,
    headline,
    itemised,
    listed,
    other_name,
)
from ..merge.result import shown_bits
from ..topology.arrays import FloatArray
from ..topology.matching.views import AGREES, CONTRADICTS, SILENT
from ..topology.se2 import apply, compose, turned
from ..topology.topomap import TopoMap
from ..topology.turning_vertices import with_turning_points
from ..topology.views import CELL_M, REACH_M
from ..topology.wording import counted
from .canvas import SMALL_PT, Canvas
from .draw import WIDTH_PT, draw_frames, draw_walls, sheet_canvas
from .geometry import MIN_SIDE_M, MOST_NUMBERED, contradiction_spots, extent
from .palette import Order, Theme
from .sheet import Cell, arrange, sheet_margin_m, upright_rad
from .walls import wall_points, walls_of

APART, ASIDE = 0.15, 0.2
"""The vertical gap between two maps drawn apart, and their horizontal offset, so that connecting
lines do not follow the corridors of a grid; over the extent of both."""

VIEW_SHARE = 0.6
"""Least width of a picture of views over that of a placement: of large buildings views are drawn
larger than their maps."""

FILLED = 0.85
"""Share of a cell that views take, below its title."""

PEN_PT, RING_PT, DOT_PT = 1.6, 6.5, 3.6
"""Width of a run's line, of the ring round a junction, and of a dot."""

FULL_BITS = 6.0
"""A link of this many bits is drawn widest."""

WALL_WIDTHS = (1.0, 0.5)
"""Widths of the walls of a and of b in views, over that of a cell: where both lie, both show."""

TINY_M = 1e-3
"""Length of the line that is drawn for a cell of a wall."""

CONTRADICTIONS = "what speaks against it"

_CORNERS = REACH_M * np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])
"""(4, 2) corners of a view, about its place [m]."""


def draw_decision(a: TopoMap, b: TopoMap, decision: Decision, theme: Theme) -> Canvas:
    """Draw why two runs were merged or not: the placements of b over a, with lines between matched
    junctions, the links that speak for a placement and what speaks against it."""
    a, b = with_turning_points(a), with_turning_points(b)
    pictures = _pictures(a, b, decision)
    views = [t for p in decision.placements[:1] for t in p.of("views") if t.seen is not None]
    views.sort(key=lambda t: -t.bits)
    of_a, of_b = (
        np.concatenate([extent(m), wall_points(walls_of([m.views], m.frame))]) for m in (a, b)
    )
    points = [np.concatenate([of_a, apply(p.T_a_b, of_b)]) for p in pictures]
    turn = upright_rad(a.paths)
    wide = min((float(np.ptp(p, axis=0).max()) for p in points if len(p)), default=0.0)
    square = turned(_CORNERS * max(VIEW_SHARE * wide / (2 * REACH_M), 1.0), -turn)
    shown = [*points, *(square for _ in views)]
    cells = arrange(shown, [turn] * len(shown), sheet_margin_m(points))
    canvas = sheet_canvas(cells, theme, WIDTH_PT, "pair")
    titles = [p.title for p in pictures]
    titles += [f"views {'for' if t.bits > 0 else 'against'} it: {t.bits:+.1f} bits" for t in views]
    draw_frames(canvas, cells, [(title,) for title in titles])
    for picture, cell in zip(pictures, cells, strict=False):
        poses = (cell.T_sheet_map, compose(cell.T_sheet_map, picture.T_a_b))
        for k, (m, T) in enumerate(zip((a, b), poses, strict=True)):
            _own_map(canvas, m, T, k)
        if picture.placement is not None:
            at = (apply(poses[0], a.xy), apply(poses[1], b.xy))
            _evidence(canvas, picture.placement, at, digits_of(decision), apart=picture.tied)
            _numbers(canvas, picture.placement, (a, b), at, apart=picture.tied)
    for term, cell in zip(views, cells[len(pictures) :], strict=True):
        _seen(canvas, term, cell, turn)
    heading = [headline(decision), because(decision), advice(decision)]
    canvas.finish([*heading, *(f"Note: {note}" for note in decision.notes)])
    return canvas


@dataclass(frozen=True, slots=True, eq=False)
class _Picture:
    """One picture of map b with map a. T_a_b: b's pose in it; tied: drawn apart, with lines between
    matched junctions."""

    title: str
    placement: Placement | None
    T_a_b: FloatArray
    tied: bool = False


def _pictures(a: TopoMap, b: TopoMap, decision: Decision) -> list[_Picture]:
    """The pictures of a decision: the verdict's placement, the same with the maps drawn apart, and
    the next best placement. An undecided pair has no picture with the maps apart; a pair joined
    through other runs starts with the placement that follows from those. Where nothing fits, the
    maps are shown apart alone."""
    out: list[_Picture] = []
    if decision.by_others is not None:
        title = f"joined through {listed(decision.pair.through, 2)}"
        out.append(_Picture(title, None, decision.by_others))
    for k, placement in enumerate(decision.placements):
        T = placement.alignment.transform
        called = other_name(decision) if k else "placement"
        bits = shown_bits(placement.alignment.evidence_bits)
        out.append(_Picture(f"{called}: {bits} bits", placement, T))
        alone = len(decision.placements) == 1 or decision.pair.accepted
        alone &= decision.by_others is None
        if k == 0 and alone and len(placement.alignment.matched):
            count = len(placement.alignment.matched)
            title = f"the {counted(count, 'matched junction')} tied"
            out.append(_Picture(title, placement, _apart(a, b, T), tied=True))
    if out:
        return out
    turn = upright_rad(a.paths) - upright_rad(b.paths)
    return [_Picture("no placement", None, _apart(a, b, np.array([0.0, 0.0, -turn])))]


def _apart(a: TopoMap, b: TopoMap, T_a_b: FloatArray) -> FloatArray:
    """T_a_b translated so that b lies below a where a is drawn upright."""
    turn = upright_rad(a.paths)
    upright = np.array([0.0, 0.0, turn])
    origin = np.zeros((1, 2))  # of maps without junctions
    of_a = apply(upright, extent(a) if len(a) else origin)
    of_b = apply(compose(upright, T_a_b), extent(b) if len(b) else origin)
    reach = max(float(np.ptp(np.concatenate([of_a, of_b]), axis=0).max()), MIN_SIDE_M)
    drop = of_a[:, 1].min() - of_b[:, 1].max() - APART * reach
    away = np.array([ASIDE * reach, drop, 0.0])
    return compose(np.array([0.0, 0.0, -turn]), compose(away, compose(upright, T_a_b)))


def _own_map(canvas: Canvas, m: TopoMap, T: FloatArray, side: int) -> None:
    """Draw the map of a (side 0) or of b (1) at T on the sheet. Walls of a show through those of
    b."""
    colour = canvas.theme.run(side)
    canvas.lines([apply(T, path) for path in m.paths], colour, PEN_PT, tips=[m.run], key=m.run)
    canvas.dots(apply(T, m.xy), colour, DOT_PT)
    alpha, key = (1.0, 0.75)[side], f"walls of {m.run}"
    draw_walls(canvas, [m.views], T, canvas.theme.pale(side), alpha=alpha, key=key)


def _evidence(
    canvas: Canvas,
    placement: Placement,
    at: tuple[FloatArray, FloatArray],
    digits: int,
    *,
    apart: bool,
) -> None:
    """Draw what a picture shows besides the two maps: matched junctions with a line between each
    two; links between junctions of a, with b apart also of b; contradictions. at: positions of the
    junctions on the sheet; digits: decimals of bits."""
    pairs, theme = placement.alignment.matched, canvas.theme
    ends = [at[k][pairs[:, k]] for k in (0, 1)]
    sides = (0, 1)[: 1 + apart]
    same = [f"junction {u} = junction {v}" for u, v in pairs.tolist()]
    tied = [*np.stack(ends, axis=1)]
    canvas.lines(tied, theme["ink"], 0.5 * PEN_PT, order=Order.TIE, tips=same)
    for xy in ends:
        key = "matched junctions, tied"
        canvas.dots(xy, theme["ink"], RING_PT, order=Order.RING, ring=True, tips=same, key=key)
    for term in reversed(itemised(placement, LINKS)):
        good = term.bits >= 0
        ink, key = ("agrees", "link that speaks for it") if good else ("against", CONTRADICTIONS)
        pen_pt = PEN_PT * (1.2 + 1.8 * min(abs(term.bits) / FULL_BITS, 1.0))
        lines = [at[k][[*rows]] for k, rows in ((0, term.a), (1, term.b)) if len(rows) == 2]
        for line in lines[: len(sides)]:
            tips = [_describe_term(term, digits)]
            canvas.lines([line], theme[ink], pen_pt, order=Order.EVIDENCE, tips=tips, key=key)
    terms = [t for t in itemised(placement, AGAINST) if t.a or t.b]
    against = ((_describe_term(t, digits), (t.a, t.b)) for t in terms)
    for xy, words in contradiction_spots(against, *at, apart=apart):
        canvas.dots(
            *(xy[None], theme["against"], RING_PT),
            order=Order.CONTRADICTION,
            ring=True,
            tips=[words],
            key=CONTRADICTIONS,
        )


def _numbers(
    canvas: Canvas,
    placement: Placement,
    maps: tuple[TopoMap, TopoMap],
    at: tuple[FloatArray, FloatArray],
    *,
    apart: bool,
) -> None:
    """Write the numbers of junctions, of a above and of b below them: advice and contradictions
    name also junctions that are not matched. Matched ones of b have theirs only where b is drawn
    apart, and large maps only those of matched junctions."""
    for k, (m, side) in enumerate(zip(maps, (-1.0, 1.0), strict=True)):
        matched = placement.alignment.matched[:, k].tolist()
        rows = {*np.flatnonzero(~m.is_turned).tolist()}
        rows = rows if len(rows) <= MOST_NUMBERED else {*matched}
        if k == 1 and not apart:
            rows -= {*matched}
        aside = 7.0 / canvas.points_per_m * np.array([side, -side])
        for v in sorted(rows) if len(rows) <= MOST_NUMBERED else ():
            canvas.words(at[k][v] + aside, str(v), size_pt=SMALL_PT, of=at[k][v])


def _describe_term(term: Term, digits: int) -> str:
    return f"{term.bits:+.{digits}f} bits: {term.text}"


def _seen(canvas: Canvas, term: Term, cell: Cell, turn_rad: float) -> None:
    """Draw two views over each other in a cell; what contradicts last."""
    assert term.seen is not None
    theme = canvas.theme
    scale = FILLED * float((cell.high - cell.low).min()) / (2 * REACH_M)
    xy = (cell.low + cell.high) / 2 + scale * turned(term.seen.xy, turn_rad)
    for kind in (SILENT, AGREES, CONTRADICTS):
        for run in (0, 1):
            own = xy[(term.seen.kind == kind) & (term.seen.of_second == (run == 1))]
            ink = {SILENT: theme.pale(run), AGREES: theme.run(run)}.get(kind, theme["against"])
            width_pt = WALL_WIDTHS[run] * CELL_M * scale * canvas.points_per_m
            key = CONTRADICTIONS if kind == CONTRADICTS else ""
            cells = [*np.stack([own - TINY_M, own], axis=1)]
            canvas.lines(cells, ink, width_pt, key=key)
