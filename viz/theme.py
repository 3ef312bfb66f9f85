"""Colours of drawings: for light paper, for a dark screen, or for whatever a page turns to."""

from __future__ import annotations

import colorsys
import re
from dataclasses import dataclass

from . import palette

INKS = (
    "paper",
    "ink",
    "dim",
    "card",
    "corridor",
    "single",
    "shared",
    "unexplored",
    "agrees",
    "against",
    "degree 0",
    "degree 1",
    "degree 2",
    "degree 3",
    "degree 4",
    "degree 5",
)
"""What a theme has a colour for, besides runs."""

_LIGHT = (
    "#ffffff",
    "#1b1f24",
    "#8a929c",
    "#dde1e6",
    "#6c93c2",
    "#7b8490",
    "#1b1f24",
    "#d97f00",
    "#1f9d55",
    "#d43a3a",
    "#8b929b",
    "#d6304f",
    "#8b929b",
    "#1f78d1",
    "#1f9d55",
    "#8e44cf",
)
_LIGHT_RUNS = (
    "#1f77d0",
    "#e8590c",
    "#12934f",
    "#d1359c",
    "#a88400",
    "#6741d9",
    "#0c8599",
    "#c92a2a",
    "#5c940d",
    "#8d6748",
)


def _hex(colour: tuple[int, int, int]) -> str:
    return "#{:02x}{:02x}{:02x}".format(*colour)


_DARK = tuple(
    _hex(colour)
    for colour in (
        palette.BACKGROUND,
        palette.TITLE,
        palette.DIM,
        palette.CARD,
        palette.CORRIDOR,
        palette.SINGLE,
        palette.WHITE,
        palette.UNEXPLORED,
        palette.MERGED,
        palette.REFUSED,
        *(tuple(row) for row in palette.DEGREES.tolist()),
    )
)


@dataclass(frozen=True, slots=True)
class Theme:
    """A colour, as #rrggbb, for each of INKS and for the first, second, … run of a map."""

    name: str
    inks: tuple[str, ...]

    def __getitem__(self, ink: str) -> str:
        return self.inks[INKS.index(ink)]

    def run(self, rank: int) -> str:
        """The colour of a run by its rank among those drawn together, from 0.

        The first ten are picked by hand; later ones step round the hues by the golden angle.
        """
        if self.name == "dark":
            return _hex(palette.of_rank(rank))
        if rank < len(_LIGHT_RUNS):
            return _LIGHT_RUNS[rank]
        step = rank - len(_LIGHT_RUNS)
        hue = (0.31 + 0.61803398875 * step) % 1.0
        rgb = colorsys.hsv_to_rgb(hue, 0.65 + 0.15 * (step % 3), 0.72)
        return _hex((round(255 * rgb[0]), round(255 * rgb[1]), round(255 * rgb[2])))


def _stand_in(number: int) -> str:
    return f"#fd{number:04x}"


class Switchable(Theme):
    """Stand-ins that `as_variables` turns into CSS variables, so that a page chooses the theme."""

    __slots__ = ()

    def __init__(self) -> None:
        super().__init__("switchable", tuple(map(_stand_in, range(len(INKS)))))

    def run(self, rank: int) -> str:
        """The stand-in of a run's colour."""
        return _stand_in(len(INKS) + rank)


LIGHT, DARK = Theme("light", _LIGHT), Theme("dark", _DARK)
SWITCHABLE = Switchable()


def as_variables(style: str) -> str:
    """A style with its stand-ins as CSS variables --c0, --c1, …"""
    return re.sub("#fd([0-9a-f]{4})", lambda found: f"var(--c{int(found[1], 16)})", style)


def css_variables(theme: Theme, runs: int) -> str:
    """What the variables are in a theme, for pictures of up to so many runs together."""
    values = [*theme.inks, *map(theme.run, range(runs))]
    return ";".join(f"--c{k}:{value}" for k, value in enumerate(values))
