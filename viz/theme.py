"""Colours of static drawings, light and dark, and of the report."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

from . import palette

_INKS = {
    "paper": ("#ffffff", palette.BACKGROUND),
    "ink": ("#1b1f24", palette.TITLE),
    "dim": ("#8a929c", palette.DIM),
    "card": ("#dde1e6", palette.CARD),
    "corridor": ("#6c93c2", palette.CORRIDOR),
    "single": ("#7b8490", palette.SINGLE),
    "shared": ("#1b1f24", palette.WHITE),
    "unexplored": ("#d97f00", palette.UNEXPLORED),
    "agrees": ("#1f9d55", palette.MERGED),
    "against": ("#d43a3a", palette.REFUSED),
    "degree 0": ("#8b929b", palette.DEGREES[0]),
    "degree 1": ("#d6304f", palette.DEGREES[1]),
    "degree 2": ("#8b929b", palette.DEGREES[2]),
    "degree 3": ("#1f78d1", palette.DEGREES[3]),
    "degree 4": ("#1f9d55", palette.DEGREES[4]),
    "degree 5": ("#8e44cf", palette.DEGREES[5]),
    "wall": ("#c9ced6", palette.WALL),
}
"""Named colours besides those of runs: in the light and in the dark theme."""

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


def _hex(colour: Iterable[int]) -> str:
    return "#{:02x}{:02x}{:02x}".format(*colour)


@dataclass(frozen=True, slots=True)
class Theme:
    """Colours as #rrggbb: the named ones of _INKS, and one for each rank of a run."""

    inks: Mapping[str, str]
    run: Callable[[int], str]
    """The colour of a run by its rank among those drawn together, from 0."""

    def __getitem__(self, ink: str) -> str:
        return self.inks[ink]

    def pale_run(self, rank: int) -> str:
        """The colour of a run half-way to that of the paper: of its walls, below its map."""
        of_run, paper = (bytes.fromhex(c[1:]) for c in (self.run(rank), self["paper"]))
        return _hex((x + y) // 2 for x, y in zip(of_run, paper, strict=True))


def _light_run(rank: int) -> str:
    """The first ten chosen by hand, later ones by steps of the golden angle in hue."""
    if rank < len(_LIGHT_RUNS):
        return _LIGHT_RUNS[rank]
    return _hex(palette.stepped(rank - len(_LIGHT_RUNS), 0.65, 0.72))


LIGHT = Theme({name: light for name, (light, _) in _INKS.items()}, _light_run)
DARK = Theme(
    {name: _hex(dark) for name, (_, dark) in _INKS.items()},
    lambda rank: _hex(palette.of_rank(rank)),
)
