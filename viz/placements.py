"""The picture of a decision: the placements of one map on another side by side, and the views that
speak most for a placement and against it, laid over each other.

It is a list of marks, which `draw` writes on paper and `decision_recording` into a recording.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from ..merge.decision import AGAINST, LINKS, Decision, Placement, Term
from ..merge.decision_text import digits_of, itemised, listed, other_name
from ..merge.result import shown_bits
from ..topology.arrays import FloatArray
from ..topology.matching.views import AGREES, CONTRADICTS, SILENT
from ..topology.se2 import apply, compose, turned
from ..topology.topomap import TopoMap
from ..topology.views import CELL_M, REACH_M
from ..topology.wording import counted
from .drawing import MOST_NUMBERED, extent
from .palette import Order
from .sheet import Cell, arrange, sheet_margin_m, upright_rad

APART, ASIDE = 0.15, 0.2
"""The vertical gap between two maps drawn apart, and their horizontal offset, so that connecting
lines do not follow the corridors of a grid; over the extent of both."""


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """One picture of map b with map a. T_a_b: b's pose in it; tied: drawn apart, with lines between
    matched junctions."""

    name: str
    title: str
    placement: Placement | None
    T_a_b: FloatArray
    tied: bool


def _placements(a: TopoMap, b: TopoMap, decision: Decision) -> list[Picture]:
    """The pictures of a decision: the verdict's placement, the same with the maps drawn apart, and
    the next best placement. An undecided pair has no picture with the maps apart; a pair joined
    through other runs starts with the placement that follows from those. Where nothing fits, the
    maps are shown apart alone."""
    out: list[Picture] = []
    if decision.by_others is not None:
        title = f"joined through {listed(decision.pair.through, 2)}"
        out.append(Picture("joined", title, None, decision.by_others, tied=False))
    for k, placement in enumerate(decision.placements):
        T = placement.alignment.transform
        bits = f"{shown_bits(placement.alignment.evidence_bits)} bits"
        name = ("placement", "next best")[k]
        called = other_name(decision) if k else name
        out.append(Picture(name, f"{called}: {bits}", placement, T, tied=False))
        alone = len(decision.placements) == 1 or decision.pair.accepted
        alone &= decision.by_others is None
        if k == 0 and alone and len(placement.alignment.matched):
            count = len(placement.alignment.matched)
            title = f"the {counted(count, 'matched junction')} tied"
            out.append(Picture("tied", title, placement, _apart(a, b, T), tied=True))
    if out:
        return out
    turn = upright_rad(a.paths) - upright_rad(b.paths)
    apart = _apart(a, b, np.array([0.0, 0.0, -turn]))
    return [Picture("maps", "no placement", None, apart, tied=False)]


def _apart(a: TopoMap, b: TopoMap, T_a_b: FloatArray) -> FloatArray:
    """T_a_b translated so that b lies below a where a is drawn upright."""
    turn = upright_rad(a.paths)
    upright = np.array([0.0, 0.0, turn])
    origin = np.zeros((1, 2))  # of maps without junctions
    of_a = apply(upright, extent(a) if len(a) else origin)
    of_b = apply(compose(upright, T_a_b), extent(b) if len(b) else origin)
    reach = max(float(np.ptp(np.concatenate([of_a, of_b]), axis=0).max()), 4.0)
    drop = of_a[:, 1].min() - of_b[:, 1].max() - APART * reach
    away = np.array([ASIDE * reach, drop, 0.0])
    return compose(np.array([0.0, 0.0, -turn]), compose(away, compose(upright, T_a_b)))


def contradiction_spots(
    against: Iterable[tuple[str, tuple[Sequence[int], Sequence[int]]]],
    of_a: FloatArray,
    of_b: FloatArray,
    *,
    apart: bool = False,
) -> list[tuple[FloatArray, str]]:
    """Where contradictions are drawn, (2,) each, and their texts. against: texts, and the junctions
    of a and of b that each concerns; of_a, of_b: their positions, (n, 2) each, in one frame.

    At a junction that the other run did not see, or amid two corridors that cross; of maps that are
    drawn apart on one of them.
    """
    spots = []
    for told, (a, b) in against:
        ends = [of[list(rows)] for of, rows in ((of_a, a), (of_b, b)) if len(rows)]
        shown = [points for points in ends if len(points) == 1] or ends
        spots.append((np.concatenate(shown[:1] if apart else shown).mean(axis=0), told))
    return spots


@dataclass(frozen=True, slots=True, eq=False)
class Mark:
    """Lines, dots, rings, numbers, or cells of walls.

    name: of its entity; xy: polylines (k, 2), or points (2,) [m]; ink: of `Theme`; told: what is
    said of each, or of all together if there is one text; pens: widths of lines, over that of a
    map's, or of cells [m]; key: what they are in the key of a drawing.
    """

    name: tuple[str, ...]
    form: Literal["line", "dot", "ring", "number", "cell"]
    xy: Sequence[FloatArray]
    ink: str
    order: Order
    told: Sequence[str] = ()
    pens: float | FloatArray = 1.0
    key: str = ""

    def moved(self, root: tuple[str, ...], T: FloatArray) -> Mark:
        """The mark moved by T, its entity below `root`."""
        xy = [apply(T, each.reshape(-1, 2)).reshape(each.shape) for each in self.xy]
        return replace(self, name=(*root, *self.name), xy=xy)


@dataclass(frozen=True, slots=True, eq=False)
class DecisionPicture:
    """Cells with their titles, and the marks in them. laid: for each placement the poses of a and
    of b on the sheet."""

    cells: list[Cell]
    titles: list[str]
    marks: list[Mark]
    laid: list[tuple[FloatArray, FloatArray]]


PLACEMENTS, VIEWS = "placements", "views"
"""Entity roots."""

VIEW_SHARE = 0.6
"""Least width of a picture of views over that of a placement: of large buildings views are drawn
larger than their maps."""

FILLED = 0.85
"""Share of a cell that views take, below its title."""

_CORNERS = REACH_M * np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])
"""(4, 2) corners of a view, about its place [m]."""

NO_POINTS = np.zeros((0, 2))


def decision_picture(
    a: TopoMap,
    b: TopoMap,
    decision: Decision,
    walls: tuple[FloatArray, FloatArray] = (NO_POINTS, NO_POINTS),
) -> DecisionPicture:
    """The picture of a decision on two maps. walls: further points (k, 2) of a and of b, in their
    frames, that have to lie in it."""
    drawn = _placements(a, b, decision)
    views = [t for p in decision.placements[:1] for t in p.of("views") if t.seen is not None]
    views.sort(key=lambda t: -t.bits)
    of_a, of_b = (np.concatenate([extent(m), own]) for m, own in zip((a, b), walls, strict=True))
    points = [np.concatenate([of_a, apply(p.T_a_b, of_b)]) for p in drawn]
    turn = upright_rad(a.paths)
    wide = min((float(np.ptp(p, axis=0).max()) for p in points if len(p)), default=0.0)
    square = turned(_CORNERS * max(VIEW_SHARE * wide / (2 * REACH_M), 1.0), -turn)
    shown = [*points, *(square for _ in views)]
    cells = arrange(shown, [turn] * len(shown), sheet_margin_m(points))
    titles, marks = [p.title for p in drawn], []
    for p, cell in zip(drawn, cells, strict=False):
        own = [*_maps(p, a, b), *_evidence(p, a, b, digits_of(decision))]
        marks += [mark.moved((PLACEMENTS, p.name), cell.T_sheet_map) for mark in own]
    for term, cell in zip(views, cells[len(drawn) :], strict=True):
        name = "for" if term.bits > 0 else "against"
        titles.append(f"views {name} it: {term.bits:+.1f} bits")
        marks += _seen(term, name, cell, turn)
    laid = [
        (cell.T_sheet_map, compose(cell.T_sheet_map, p.T_a_b))
        for p, cell in zip(drawn, cells, strict=False)
    ]
    return DecisionPicture(cells, titles, marks, laid)


def _maps(picture: Picture, a: TopoMap, b: TopoMap) -> Iterator[Mark]:
    """Both maps, in the frame of a."""
    for k, (m, T) in enumerate(((a, np.zeros(3)), (b, picture.T_a_b))):
        own, ink = ("ab"[k], m.run), f"run {k}"
        paths = [apply(T, path) for path in m.paths]
        name = (*own, "corridors")
        yield Mark(name, "line", paths, ink, Order.CORRIDOR, [m.run], key=m.run)
        if len(m):
            yield Mark((*own, "junctions"), "dot", [*apply(T, m.xy)], ink, Order.JUNCTION)


CONTRADICTIONS = "what speaks against it"

FULL_BITS = 6.0
"""A link of this many bits is drawn widest."""


def _evidence(picture: Picture, a: TopoMap, b: TopoMap, digits: int) -> Iterator[Mark]:
    """What a picture shows besides the two maps, in the frame of a: matched junctions with a line
    between each two and their numbers, of b only where it is drawn apart; links between junctions
    of a, with b apart also of b; contradictions. digits: decimals of bits."""
    placement = picture.placement
    if placement is None:
        return
    at = (a.xy, apply(picture.T_a_b, b.xy))
    pairs = placement.alignment.matched
    ends = [at[k][pairs[:, k]] for k in (0, 1)]
    sides = ((0, "a"), (1, "b"))
    if len(pairs):
        same = [f"junction {u} = junction {v}" for u, v in pairs.tolist()]
        tied = [*np.stack(ends, axis=1)]
        yield Mark(("ties",), "line", tied, "ink", Order.TIE, same, 0.5)
        for k, side in sides:
            key = "matched junctions, tied"
            yield Mark(("matched", side), "ring", [*ends[k]], "ink", Order.RING, same, key=key)
        for k, side in sides[: 1 + picture.tied] if len(pairs) <= MOST_NUMBERED else ():
            told = [str(v) for v in pairs[:, k].tolist()]
            yield Mark(("numbers", side), "number", [*ends[k]], f"run {k}", Order.WORDS, told)
    links = itemised(placement, LINKS)
    for k, side in sides[: 1 + picture.tied]:
        for ink, key in (("agrees", "link that speaks for it"), ("against", CONTRADICTIONS)):
            shown = [
                t for t in links if len((t.a, t.b)[k]) == 2 and (t.bits >= 0) == (ink == "agrees")
            ]
            if shown:
                xy = [at[k][list((t.a, t.b)[k])] for t in shown]
                told = [_bits_told(t, digits) for t in shown]
                bits = np.abs([t.bits for t in shown])
                pens = 1.2 + 1.8 * np.minimum(bits / FULL_BITS, 1.0)
                yield Mark(("links", side, ink), "line", xy, ink, Order.EVIDENCE, told, pens, key)
    terms = [t for t in itemised(placement, AGAINST) if t.a or t.b]
    against = ((_bits_told(t, digits), (t.a, t.b)) for t in terms)
    spots = contradiction_spots(against, *at, apart=picture.tied)
    if spots:
        where, told = (list(column) for column in zip(*spots, strict=True))
        name, order = ("contradictions",), Order.CONTRADICTION
        yield Mark(name, "ring", where, "against", order, told, key=CONTRADICTIONS)


def _bits_told(term: Term, digits: int) -> str:
    return f"{term.bits:+.{digits}f} bits: {term.text}"


WIDTHS = (1.0, 0.5)
"""Widths of the walls of a and of b, over that of a cell: where both lie, both show."""


def _seen(term: Term, name: str, cell: Cell, turn_rad: float) -> Iterator[Mark]:
    """Two views over each other in a cell; what contradicts last."""
    assert term.seen is not None
    scale = FILLED * float((cell.high - cell.low).min()) / (2 * REACH_M)
    xy = (cell.low + cell.high) / 2 + scale * turned(term.seen.xy, turn_rad)
    for kind, told in ((SILENT, "silent"), (AGREES, "agrees"), (CONTRADICTS, "contradicts")):
        for run in (0, 1):
            own = (term.seen.kind == kind) & (term.seen.of_second == (run == 1))
            if own.any():
                ink = {SILENT: f"pale {run}", AGREES: f"run {run}"}.get(kind, "against")
                entity, side = (VIEWS, name, "ab"[run], told), WIDTHS[run] * CELL_M * scale
                key = CONTRADICTIONS if kind == CONTRADICTS else ""
                yield Mark(entity, "cell", [*xy[own]], ink, Order.WALL, (), side, key)
