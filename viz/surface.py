"""What a picture is drawn on: a page of matplotlib, or a figure of Bokeh."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from ..topology.arrays import FloatArray
from ..topology.run import Grid
from .geometry import Marker
from .palette import Colour, Theme


@dataclass(frozen=True, slots=True)
class Look:
    """How lines or marks are drawn.

    pens: width or size, in widths of a corridor's line; tips: what each says when pointed at, or
    one text of all; key: what they are, an entry of the key of the picture; ring, marker: shape of
    marks.
    """

    colour: Colour
    pens: float = 1.0
    tips: Sequence[str] = ()
    key: str = ""
    ring: bool = False
    marker: Marker = "circle"


class Surface(Protocol):
    """A picture in metres. What is drawn later lies above."""

    theme: Theme

    @property
    def pen_m(self) -> float:
        """Width of a corridor's line [m]."""

    def lines(self, paths: Sequence[FloatArray], look: Look) -> None:
        """Draw polylines, (k, 2) each [m]."""

    def dots(self, xy: FloatArray, look: Look) -> None:
        """Draw filled marks, or rings, at xy (n, 2) [m]."""

    def words(self, xy: FloatArray, texts: Sequence[str], *, bold: bool = False) -> None:
        """Write a text beside each of the points (n, 2) [m], where there is room."""

    def cells(self, grid: Grid, look: Look, alpha: float = 1.0) -> None:
        """Draw the occupied cells of a grid that lies along the axes."""
