"""What a picture of a decision shows: the placements of one map on another side by side, and the
views that speak most for a placement and against it, laid over each other."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from ..merge.decision import Decision, Placement, Term
from ..merge.decision_text import itemised, listed, other_name
from ..merge.result import shown_bits
from ..topology.arrays import FloatArray
from ..topology.matching.views import AGREES, CONTRADICTS, SILENT, Compared
from ..topology.se2 import apply, compose, inverse, turned
from ..topology.topomap import TopoMap
from ..topology.views import REACH_M
from ..topology.wording import counted
from .drawing import MOST_NUMBERED, extent
from .palette import Order
from .sheet import upright_rad

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


def placements(a: TopoMap, b: TopoMap, decision: Decision) -> list[Picture]:
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
    return out or [Picture("maps", "no placement", None, _below(a, b), tied=False)]


def _apart(a: TopoMap, b: TopoMap, T_a_b: FloatArray) -> FloatArray:
    """T_a_b translated so that b lies below a where a is drawn upright."""
    turn = upright_rad(a.paths)
    upright = np.array([0.0, 0.0, turn])
    of_a, of_b = apply(upright, a.xy), apply(compose(upright, T_a_b), b.xy)
    reach = max(float(np.ptp(np.concatenate([of_a, of_b]), axis=0).max()), 4.0)
    drop = of_a[:, 1].min() - of_b[:, 1].max() - APART * reach
    away = np.array([ASIDE * reach, drop, 0.0])
    return compose(np.array([0.0, 0.0, -turn]), compose(away, compose(upright, T_a_b)))


def _below(a: TopoMap, b: TopoMap) -> FloatArray:
    """A pose of b below a, both upright where a is."""
    upright = [np.array([0.0, 0.0, upright_rad(m.paths)]) for m in (a, b)]
    drawn = [extent(m) if len(m) else np.zeros((1, 2)) for m in (a, b)]
    of_a, of_b = map(apply, upright, drawn)
    gap = APART * max(float(np.ptp(of_a, axis=0).max()), float(np.ptp(of_b, axis=0).max()), 4.0)
    low, high = of_a.min(axis=0), of_b.max(axis=0)
    away = np.array([low[0] - of_b[:, 0].min(), low[1] - high[1] - gap, 0.0])
    return compose(inverse(upright[0]), compose(away, upright[1]))


@dataclass(frozen=True, slots=True, eq=False)
class Spot:
    """A contradiction: its position (2,) and text."""

    xy: FloatArray
    told: str


def contradiction_spots(
    against: Iterable[tuple[str, tuple[Sequence[int], Sequence[int]]]],
    of_a: FloatArray,
    of_b: FloatArray,
) -> list[Spot]:
    """Contradictions, each with its text and the junctions of a and of b that it concerns, in the
    frame of the given positions, (n, 2) each: at a junction that the other run did not see, or amid
    two corridors that cross."""
    spots = []
    for told, (a, b) in against:
        ends = [of[list(rows)] for of, rows in ((of_a, a), (of_b, b)) if len(rows)]
        alone = [points for points in ends if len(points) == 1]
        spots.append(Spot(np.concatenate(alone or ends).mean(axis=0), told))
    return spots


@dataclass(frozen=True, slots=True, eq=False)
class Mark:
    """Lines, rings or numbers on a picture of a placement, in the frame of a.

    name: of its entity; xy: (n, 2, 2) ends of lines, or (n, 2) points [m]; ink: of `Theme`, of
    each; told: of each what is said of it, or the number; info: columns for queries; pens: widths
    of lines, over that of a map's.
    """

    name: tuple[str, ...]
    form: Literal["line", "ring", "number"]
    xy: FloatArray
    ink: Sequence[str]
    told: Sequence[str]
    order: Order
    info: Mapping[str, Any] = field(default_factory=dict)
    pens: FloatArray = field(default_factory=lambda: np.ones(1))


FULL_BITS = 6.0
"""A link of this many bits is drawn widest."""


def marks(picture: Picture, a: TopoMap, b: TopoMap, digits: int) -> Iterator[Mark]:
    """What a picture shows besides the two maps: matched junctions with a line between each two and
    their numbers, of b only where it is drawn apart; links between junctions of a, with b apart
    also of b; contradictions. digits: decimals of bits."""
    placement = picture.placement
    if placement is None:
        return
    at = (a.xy, apply(picture.T_a_b, b.xy))
    pairs = placement.alignment.matched
    ends = [at[k][pairs[:, k]] for k in (0, 1)]
    n, sides = len(pairs), ((0, "a"), (1, "b"))
    if n:
        same = [f"junction {u} = junction {v}" for u, v in pairs.tolist()]
        info = {"junction_of_a": pairs[:, 0].tolist(), "junction_of_b": pairs[:, 1].tolist()}
        tied = np.stack(ends, axis=1)
        half = np.full(n, 0.5)
        yield Mark(("ties",), "line", tied, ["ink"] * n, same, Order.TIE, info, half)
        for k, side in sides:
            yield Mark(("matched", side), "ring", ends[k], ["ink"] * n, same, Order.RING)
        for k, side in sides[: 1 + picture.tied] if n <= MOST_NUMBERED else ():
            told = [str(v) for v in pairs[:, k].tolist()]
            yield Mark(("numbers", side), "number", ends[k], [f"run {k}"] * n, told, Order.WORDS)
    links = itemised(placement, "corridor")
    for k, side in sides[: 1 + picture.tied]:
        shown = [t for t in links if len((t.a, t.b)[k]) == 2]
        if shown:
            bits = np.array([t.bits for t in shown])
            yield Mark(
                ("links", side),
                "line",
                at[k][np.array([(t.a, t.b)[k] for t in shown])],
                ["agrees" if t.bits >= 0 else "against" for t in shown],
                [_bits_told(t, digits) for t in shown],
                Order.EVIDENCE,
                {"bits": bits.tolist(), "what": [t.text for t in shown]},
                1.2 + 1.8 * np.minimum(np.abs(bits) / FULL_BITS, 1.0),
            )
    terms = [t for t in itemised(placement, "unseen") if t.a or t.b]
    spots = contradiction_spots(((_bits_told(t, digits), (t.a, t.b)) for t in terms), *at)
    if spots:
        told = [spot.told for spot in spots]
        where = np.array([spot.xy for spot in spots])
        ink, info = ["against"] * len(spots), {"contradiction": told}
        yield Mark(("contradictions",), "ring", where, ink, told, Order.CONTRADICTION, info)


def _bits_told(term: Term, digits: int) -> str:
    return f"{term.bits:+.{digits}f} bits: {term.text}"


CORNERS = REACH_M * np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])
"""(4, 2) corners of a picture, about the place of the first view [m]."""

WIDTHS = (1.0, 0.5)
"""Widths of the walls of a and of b, over that of a cell: where both lie, both show."""


@dataclass(frozen=True, slots=True, eq=False)
class Overlay:
    """A picture: its name, its title, and its walls."""

    name: str
    title: str
    seen: Compared

    def layers(self, turn_rad: float) -> Iterator[tuple[int, int, FloatArray]]:
        """Of which run (0 or 1), of which kind, and the middles of the cells (k, 2) about the place
        of the first view, turned; what contradicts last."""
        xy = turned(self.seen.xy, turn_rad)
        for kind in (SILENT, AGREES, CONTRADICTS):
            for run in (0, 1):
                own = (self.seen.kind == kind) & (self.seen.of_second == (run == 1))
                if own.any():
                    yield run, kind, xy[own]


def overlays(decision: Decision) -> list[Overlay]:
    """The pictures of the first placement of a decision: what speaks for it, then against it."""
    shown = [t for p in decision.placements[:1] for t in p.of("views") if t.seen is not None]
    out = []
    for term in sorted(shown, key=lambda t: -t.bits):
        name = "for" if term.bits > 0 else "against"
        title = f"views {name} it: {term.bits:+.1f} bits"
        if term.seen is not None:
            out.append(Overlay(name, title, term.seen))
    return out
