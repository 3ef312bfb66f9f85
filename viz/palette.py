"""Colours for the viewer's dark background, for drawings and the report, and the drawing order."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum, auto

import numpy as np

Colour = tuple[int, int, int]


class Order(IntEnum):
    """Drawing order, lowest first."""

    CARD = auto()
    GRID = auto()
    WALL = auto()
    CLOSURE = auto()
    RECORDED = auto()
    CORRECTED = auto()
    SIGHTING = auto()
    EVIDENCE = auto()
    CORRIDOR = auto()
    UNEXPLORED = auto()
    RING = auto()
    JUNCTION = auto()
    TIE = auto()
    CONTRADICTION = auto()
    SEEN = auto()
    ROBOT = auto()
    WORDS = auto()


# RGB, chosen by eye on the viewer's dark background.
BACKGROUND = (15, 17, 21)
CARD = (44, 49, 58)
TITLE = (214, 219, 226)
DIM = (112, 120, 133)
FAINT = (74, 80, 91)
SINGLE = (150, 157, 168)
WHITE = (245, 247, 250)
CORRIDOR = (98, 138, 186)
RAW = (82, 87, 97)
UNEXPLORED = (255, 178, 66)
REFUSED = (235, 87, 87)
ROBOT = (255, 255, 255)
TRAIL = (120, 235, 190)
CLOSED = (44, 128, 78)
TRACK = (52, 108, 96)
DETECTION = (196, 150, 235)
DOUBTFUL = (106, 84, 126)
WALL = (66, 76, 94)
UNLIT = (31, 35, 42)


DEGREES = np.array(
    [
        (140, 146, 156),  # 0: nothing seen leaving
        (240, 105, 125),  # 1: dead end
        (150, 158, 170),  # 2: bend
        (92, 178, 255),  # 3
        (122, 222, 140),  # 4
        (206, 147, 255),  # 5 and more
    ],
    np.uint8,
)

_RUNS: tuple[tuple[Colour, str], ...] = (
    ((80, 165, 250), "#1f77d0"),
    ((255, 160, 60), "#e07b00"),
    ((52, 205, 140), "#12934f"),
    ((244, 110, 186), "#d1359c"),
    ((248, 230, 90), "#a88400"),
    ((160, 128, 255), "#6741d9"),
    ((84, 226, 232), "#0c8599"),
    ((240, 82, 92), "#c92a2a"),
    ((170, 215, 70), "#5c940d"),
    ((214, 178, 140), "#8d6748"),
)
"""Colours of the first ten runs, on dark and on light paper: easy to tell apart."""

_MORE = (
    "#4b5a2d #c396a5 #694b78 #96a587 #00695a #ff785a #963c00 #874b4b #785a00 #9687c3 "
    "#006900 #00a5d2 #5aa596 #e178f0 #a5a54b #3c5a5a #a52d5a #f03c00 #ff7896 #695a5a "
    "#968778 #b47869 #697800 #a56996 #695a3c #962d96 #0f6987 #b4692d #5a5aa5 #4b785a"
)
"""Colours of further runs on light paper; on dark they are a quarter nearer to white. Each is
farthest by CIEDE2000 on either paper from those before it and from _INKS (Glasbey et al. 2007), of
those with a contrast of 2.5 on both papers, on dark 4.5: no two of all forty differ by less than
10.5; of the first ten two differ by 13.2."""


_INKS = {
    "paper": ("#ffffff", BACKGROUND),
    "ink": ("#1b1f24", TITLE),
    "dim": ("#8a929c", DIM),
    "card": ("#dde1e6", CARD),
    "corridor": ("#6c93c2", CORRIDOR),
    "single": ("#7b8490", SINGLE),
    "shared": ("#1b1f24", WHITE),
    "unexplored": ("#7c3aed", (178, 132, 255)),
    "planned": ("#cdb8fb", (84, 52, 150)),
    "agrees": ("#1f9d55", (72, 199, 116)),
    "against": ("#d43a3a", REFUSED),
    "degree 0": ("#8b929b", DEGREES[0]),
    "degree 1": ("#d6304f", DEGREES[1]),
    "degree 2": ("#8b929b", DEGREES[2]),
    "degree 3": ("#1f78d1", DEGREES[3]),
    "degree 4": ("#1f9d55", DEGREES[4]),
    "degree 5": ("#8e44cf", DEGREES[5]),
    "wall": ("#c9ced6", WALL),
}
"""Named colours besides those of runs: in the light and in the dark theme."""


def rgb(colour: str) -> Colour:
    """The colour of #rrggbb."""
    red, green, blue = bytes.fromhex(colour[1:])
    return red, green, blue


def _hex(colour: Iterable[int]) -> str:
    return "#{:02x}{:02x}{:02x}".format(*colour)


@dataclass(frozen=True, slots=True)
class Theme:
    """Colours as #rrggbb: the named ones of _INKS, and one for each rank of a run."""

    inks: Mapping[str, str]
    runs: Sequence[str]

    def run(self, rank: int) -> str:
        """The colour of a run by its rank among those drawn together, from 0; after forty they
        come again."""
        return self.runs[rank % len(self.runs)]

    def pale(self, rank: int) -> str:
        """The colour of a run's walls: half-way from its own to the paper."""
        both = zip(rgb(self.run(rank)), rgb(self["paper"]), strict=True)
        return _hex((x + y) // 2 for x, y in both)

    def __getitem__(self, ink: str) -> str:
        return self.inks[ink]


LIGHT = Theme(
    {name: light for name, (light, _) in _INKS.items()},
    [light for _, light in _RUNS] + _MORE.split(),
)
DARK = Theme(
    {name: _hex(dark) for name, (_, dark) in _INKS.items()},
    [
        *(_hex(dark) for dark, _ in _RUNS),
        *(_hex((3 * part + 255) // 4 for part in rgb(light)) for light in _MORE.split()),
    ],
)

THEMES = {"light": LIGHT, "dark": DARK}
"""The themes by the names that commands have for them."""
