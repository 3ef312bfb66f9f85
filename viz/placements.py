"""What a picture of a decision shows: the placements of one map on another side by side, and the
views that speak most for a placement and against it, laid over each other."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ..merge.decision import Decision, Placement, Term
from ..merge.decision_text import listed, other_name
from ..merge.result import shown_bits
from ..topology.arrays import FloatArray
from ..topology.matching.views import AGREES, CONTRADICTS, SILENT, Compared
from ..topology.se2 import apply, compose, turned
from ..topology.topomap import TopoMap
from ..topology.views import REACH_M
from ..topology.wording import counted
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
    through other runs starts with the placement that follows from those."""
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
    return out


def _apart(a: TopoMap, b: TopoMap, T_a_b: FloatArray) -> FloatArray:
    """T_a_b translated so that b lies below a where a is drawn upright."""
    turn = upright_rad(a.paths)
    upright = np.array([0.0, 0.0, turn])
    of_a, of_b = apply(upright, a.xy), apply(compose(upright, T_a_b), b.xy)
    extent = max(float(np.ptp(np.concatenate([of_a, of_b]), axis=0).max()), 4.0)
    drop = of_a[:, 1].min() - of_b[:, 1].max() - APART * extent
    away = np.array([ASIDE * extent, drop, 0.0])
    return compose(np.array([0.0, 0.0, -turn]), compose(away, compose(upright, T_a_b)))


def against(
    terms: Iterable[Term], of_a: FloatArray, of_b: FloatArray
) -> Iterator[tuple[Term, FloatArray]]:
    """The given terms against a placement, each with where it lies, from the positions of both
    maps' junctions, (n, 2) each in one frame: (1, 2) a junction that the other run passed without
    seeing it, or (2, 2) a corridor that crosses another."""
    for term in terms:
        for of, ends in ((of_a, term.a), (of_b, term.b)):
            if len(ends) == 1 or (len(ends) == 2 and term.kind != "unseen"):
                yield term, of[list(ends)]


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
