"""Pictures of the views that speak most for a placement, and most against it: the walls of one laid
over those of the other."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..merge.decision import Decision
from ..topology.arrays import FloatArray
from ..topology.matching.views import AGREES, CONTRADICTS, SILENT, Compared
from ..topology.se2 import turned
from ..topology.views import REACH_M

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
