"""The style of all pictures: colours on light and on dark paper, sizes in pens, and what lies above
what in the viewer."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum, auto
from types import MappingProxyType

Colour = str
"""#rrggbb"""

SMALL, MEDIUM, LARGE, RING = 2, 3, 4, 6
"""Sizes of marks in pens, the widths of a corridor's line: of a vertex of little weight, of a
junction, of one of many branches or runs, and of a ring round it. Bands under corridors, for what
is said of them, are as wide as a ring."""

THIN = 0.5
"""Width of a line that is no corridor, in pens."""


class Order(IntEnum):
    """Drawing order in the viewer, lowest first."""

    CARD = auto()
    GRID = auto()
    CLOSURE = auto()
    RECORDED = auto()
    CORRECTED = auto()
    SIGHTING = auto()
    DRIVE = auto()
    CORRIDOR = auto()
    UNEXPLORED = auto()
    JUNCTION = auto()
    TIE = auto()
    CONTRADICTION = auto()
    SEEN = auto()
    ROBOT = auto()
    WORDS = auto()


_HUES = ("blue", "orange", "green", "pink", "yellow", "violet", "cyan", "red", "lime", "brown")
_RUNS = (
    "#1f77d0 #e07b00 #12934f #d1359c #a88400 #6741d9 #0c8599 #c92a2a #5c940d #8d6748 "
    "#4b5a2d #c396a5 #694b78 #96a587 #00695a #ff785a #963c00 #874b4b #785a00 #9687c3 "
    "#006900 #00a5d2 #5aa596 #e178f0 #a5a54b #3c5a5a #a52d5a #f03c00 #ff7896 #695a5a "
    "#968778 #b47869 #697800 #a56996 #695a3c #962d96 #0f6987 #b4692d #5a5aa5 #4b785a"
)
"""Colours of runs on light paper, the first ten named; on dark they are a quarter nearer to white.
Each is farthest by CIEDE2000 on either paper from those before it (Glasbey et al. 2007): no two of
all forty differ by less than 10, on dark 8."""

_INKS: Mapping[str, str | float] = MappingProxyType(
    {
        "agrees": "green",
        "against": "red",
        "unexplored": "violet",
        "planned": "pale violet",
        "at times": "orange",
        "track": "pale green",
        "doubtful": "pale violet",
        "degree 1": "red",
        "degree 3": "blue",
        "degree 4": "green",
        "degree 5": "violet",
        # Greys: shares of ink on the paper.
        "paper": 0,
        "unlit": 1 / 16,
        "card": 1 / 8,
        "wall": 1 / 4,
        "faint": 3 / 8,
        "dim": 1 / 2,
        "degree 0": 1 / 2,
        "degree 2": 1 / 2,
        "single": 5 / 8,
        "ink": 1,
    }
)


def rgb(colour: Colour) -> tuple[int, int, int]:
    """Red, green and blue of a colour, to 255."""
    red, green, blue = bytes.fromhex(colour[1:])
    return red, green, blue


def mixed(one: Colour, other: Colour, share: float) -> Colour:
    """A colour between two: `share` of the first one."""
    both = zip(rgb(one), rgb(other), strict=True)
    return "#{:02x}{:02x}{:02x}".format(*(round(share * x + (1 - share) * y) for x, y in both))


@dataclass(frozen=True, slots=True)
class Theme:
    """Colours for one paper: its own, that of text, and one for each rank of a run."""

    paper: Colour
    ink: Colour
    runs: Sequence[Colour]

    def run(self, rank: int) -> Colour:
        """The colour of a run by its rank among those drawn together, from 0; after forty they
        come again."""
        return self.runs[rank % len(self.runs)]

    def pale(self, colour: Colour) -> Colour:
        """A colour half-way to the paper, as that of a run's walls."""
        return mixed(colour, self.paper, 0.5)

    def __getitem__(self, ink: str) -> Colour:
        """A colour by what it is for (`_INKS`), or by its hue."""
        what = _INKS.get(ink, ink)
        if isinstance(what, (int, float)):
            return mixed(self.ink, self.paper, what)
        hue = self.runs[_HUES.index(what.removeprefix("pale "))]
        return self.pale(hue) if what.startswith("pale ") else hue


LIGHT = Theme("#ffffff", "#1b1f24", _RUNS.split())
DARK = Theme("#0f1115", "#d6dbe2", [mixed(own, "#ffffff", 0.75) for own in LIGHT.runs])
BOTH = Theme(LIGHT.paper, LIGHT["single"], LIGHT.runs)
"""For what is seen on either paper: text has a contrast of 4 or more on both, greys 2.4."""

THEMES = {"light": LIGHT, "dark": DARK}
"""The themes by the names that commands have for them."""
