"""The drawing of a decision: the placements of one map on another side by side, and the views that
speak most for a placement and against it, laid over each other."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..merge.decision import AGAINST, LINKS, Decision, Placement, Term
from ..merge.decision_text import (
    advice,
    because,
    digits_of,
    headline,
    itemised,
    listed,
    named_views,
    other_name,
    to_record,
)
from ..merge.result import shown_bits
from ..topology.arrays import FloatArray
from ..topology.matching.views import CONTRADICTS, SILENT, Compared
from ..topology.se2 import apply, compose, turned
from ..topology.topomap import TopoMap
from ..topology.turning_vertices import with_turning_points
from ..topology.views import CELL_M, REACH_M
from .canvas import Canvas
from .draw import draw_frames
from .geometry import MOST_NUMBERED, between, bounds, contradiction_spots, extent, usual_m
from .palette import LARGE, RING, SMALL, THIN, Theme
from .scene import draw_frame, draw_walls, view_layers
from .sheet import arrange, corners_of, outline, upright_rad
from .surface import Look
from .walls import wall_points, walls_of

TINY_M = 1e-3
"""Length of the slant line that is drawn for a cell of a wall; an upright one would be snapped."""

CONTRADICTIONS = "what speaks against it"


def draw_decision(a: TopoMap, b: TopoMap, decision: Decision, theme: Theme) -> Canvas:
    """Draw why two runs were merged or not: the placements of b over a, with lines between matched
    junctions, the links that speak for a placement and what speaks against it. Where nothing fits,
    the maps side by side."""
    pictures, upright = _pictures(decision), [upright_rad(m.paths) for m in (a, b)]  # as alone
    a, b = with_turning_points(a), with_turning_points(b)
    of_a, of_b = (
        np.concatenate([extent(m), wall_points(walls_of([m.views], m.frame))]) for m in (a, b)
    )
    points = [np.concatenate([of_a, apply(T_a_b, of_b)]) for *_, T_a_b in pictures] or [of_a, of_b]
    wide = min(float(np.ptp(own, axis=0).max()) if len(own) else 0.0 for own in points)
    larger = max(wide / (4 * REACH_M), 1.0)
    views = [(t, t.seen) for p in decision.placements[:1] for t in p.of("views") if t.seen]
    square = outline((-larger * REACH_M,) * 2, (larger * REACH_M,) * 2)
    points += [turned(square, -upright[0])] * len(views)
    cells = arrange(points, upright[:1] * len(points) if pictures else upright)
    usual = usual_m(np.concatenate([a.length, b.length]))
    canvas = Canvas(*bounds([corners_of(cells)]), theme, usual, name="pair")
    titles = [title for title, *_ in pictures] or [a.run, b.run]
    titles += [named_views(t) for t, _ in views]
    draw_frames(canvas, cells, titles)
    asked = to_record(decision.pair) if advice(decision) else None
    for (_, placement, T_a_b), cell in zip(pictures, cells, strict=False):
        poses = (cell.T_sheet_map, compose(cell.T_sheet_map, T_a_b))
        draw_frame(canvas, cell)
        if asked is not None:
            side = (a.run, b.run).index(asked[0])
            paths = [apply(poses[side], path) for path in between((a, b)[side], asked[1])]
            canvas.lines(paths, Look(canvas.theme["planned"], RING, key="corridor to record"))
        _own_maps(canvas, (a, b), poses)
        if placement is not None:
            at = (apply(poses[0], a.xy), apply(poses[1], b.xy))
            _evidence(canvas, placement, at, digits_of(decision))
            _numbers(canvas, placement, (a, b), at, asked)
    if not pictures:
        _own_maps(canvas, (a, b), [cell.T_sheet_map for cell in cells])
    for (_, seen), cell in zip(views, cells[len(pictures) :], strict=bool(views)):
        _seen(canvas, seen, cell.T_sheet_map, larger)
    heading = [headline(decision), because(decision), advice(decision)]
    canvas.finish([*heading, *(f"Note: {note}" for note in decision.notes)])
    return canvas


def _pictures(decision: Decision) -> list[tuple[str, Placement | None, FloatArray]]:
    """The pictures of b over a, each with a title, the placement shown, and T_a_b: the verdict's
    placement, and the next best one. A pair joined through other runs starts with the placement
    that follows from those."""
    out: list[tuple[str, Placement | None, FloatArray]] = []
    if decision.by_others is not None:
        title = f"joined through {listed(decision.pair.through, 2)}"
        out.append((title, None, decision.by_others))
    for k, placement in enumerate(decision.placements):
        called = other_name(decision) if k else "placement"
        bits = shown_bits(placement.alignment.evidence_bits)
        out.append((f"{called}: {bits} bits", placement, placement.alignment.transform))
    return out


def _own_maps(canvas: Canvas, maps: tuple[TopoMap, TopoMap], poses: Sequence[FloatArray]) -> None:
    """Draw the maps at their poses on the sheet, their walls below; those of a show through those
    of b."""
    theme = canvas.theme
    for k, (m, T) in enumerate(zip(maps, poses, strict=True)):
        pale, key = theme.pale(theme.run(k)), f"walls of {m.run}"
        draw_walls(canvas, [m.views], T, pale, alpha=1 / (1 + k), key=key)
    for k, (m, T) in enumerate(zip(maps, poses, strict=True)):
        canvas.lines([apply(T, p) for p in m.paths], Look(theme.run(k), tips=[m.run], key=m.run))
        canvas.dots(apply(T, m.xy), Look(theme.run(k), SMALL))


def _evidence(
    canvas: Canvas, placement: Placement, at: tuple[FloatArray, FloatArray], digits: int
) -> None:
    """Draw what a picture shows besides the two maps: links between junctions of a, matched
    junctions with a line between each two, contradictions. at: positions of the junctions on the
    sheet; digits: decimals of bits."""
    pairs, theme = placement.alignment.matched, canvas.theme
    for term in reversed(itemised(placement, LINKS)):
        if len(term.a) == 2:
            if term.bits > 0:
                ink, key = "agrees", "link that speaks for it"
            elif term.contradicts:
                ink, key = "against", CONTRADICTIONS
            else:
                ink, key = "dim", "link that says little"
            tips = [_describe_term(term, digits)]
            canvas.lines([at[0][[*term.a]]], Look(theme[ink], SMALL, tips=tips, key=key))
    same = [f"junction {u} = junction {v}" for u, v in pairs.tolist()]
    ends = [at[k][pairs[:, k]] for k in (0, 1)]
    canvas.lines([*np.stack(ends, axis=1)], Look(theme["ink"], THIN, tips=same))
    for xy in ends:
        key = "matched junctions, tied"
        canvas.dots(xy, Look(theme["ink"], LARGE, ring=True, tips=same, key=key))
    terms = [t for t in itemised(placement, AGAINST) if t.a or t.b]
    against = ((_describe_term(t, digits), (t.a, t.b)) for t in terms)
    for spot, words in contradiction_spots(against, *at):
        colour, key = theme["against"], CONTRADICTIONS
        canvas.dots(spot[None], Look(colour, RING, ring=True, tips=[words], key=key))


def _seen(canvas: Canvas, seen: Compared, T: FloatArray, larger: float) -> None:
    """Draw the walls of two views over each other, those of a wider. larger: how much larger than
    in the map."""
    theme, xy = canvas.theme, apply(T, larger * seen.xy)
    for which, ink, kind, run in view_layers(seen, theme):
        canvas.lines(
            [*np.stack([xy[which] - TINY_M, xy[which]], axis=1)],
            Look(
                theme.pale(ink) if kind == SILENT else ink,
                larger * CELL_M / canvas.pen_m / (1 + run),
                key="walls that contradict each other" if kind == CONTRADICTS else "",
            ),
        )


def _numbers(
    canvas: Canvas,
    placement: Placement,
    maps: tuple[TopoMap, TopoMap],
    at: tuple[FloatArray, FloatArray],
    asked: tuple[str, tuple[int, int]] | None,
) -> None:
    """Write the numbers of junctions, each in the colour of its run. Of large maps only those of
    matched junctions and of the corridor to record (`to_record`)."""
    for k, (m, xy) in enumerate(zip(maps, at, strict=True)):
        rows = np.flatnonzero(~m.is_turned)
        if len(rows) > MOST_NUMBERED:
            ends = asked[1] if asked is not None and asked[0] == m.run else ()
            rows = np.intersect1d(rows, [*placement.alignment.matched[:, k], *ends])
        canvas.words(xy[rows], [*map(str, rows.tolist())], ink=canvas.theme.run(k))


def _describe_term(term: Term, digits: int) -> str:
    return f"{term.bits:+.{digits}f} bits: {term.text}"
