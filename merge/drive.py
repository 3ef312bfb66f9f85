"""A drive to record next: where it starts, which way it goes, and what it would settle."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import groupby
from typing import Any

import numpy as np

from ..topology.arrays import FloatArray
from ..topology.digits import BITS, METRES, rounded
from ..topology.wording import counted


@dataclass(frozen=True, slots=True)
class Stop:
    """A place on the way. site: whose map has it; junction: its number in the merged document, None
    at the end of a way into the unknown; xy: in the frame of the drive's site [m]."""

    site: str
    junction: int | None
    xy: tuple[float, float]

    def label(self, home: str) -> str:
        """The junction's number; of another site than `home` with its name."""
        return f"{self.junction}" if self.site == home else f"{self.site}:{self.junction}"


@dataclass(frozen=True, slots=True, eq=False)
class Drive:
    """A drive through one site, into another one or into the unknown.

    component, site: where it starts; onto: the site that it would join to that one, None of a
    drive into the unknown; stops: in order, two or more; path: (k, 2) in the frame of the site
    [m], the corridors of another site as its best placement has them, and of the unknown a corridor
    of usual length; known_m, length_m: length of the part in the site's own map, and of all;
    heading_rad: of the branch never driven, in that frame; pairs: open pairs that it would settle;
    bits: expected evidence.
    """

    component: int
    site: str
    onto: str | None
    stops: tuple[Stop, ...]
    path: FloatArray
    known_m: float
    length_m: float
    pairs: tuple[tuple[str, str], ...]
    bits: float
    heading_rad: float | None = None

    def __repr__(self) -> str:
        return f"<drive of {'; '.join(self.words)}>"

    @property
    def bits_per_m(self) -> float:
        """Expected evidence for each metre driven, by which drives are ranked."""
        return self.bits / self.length_m

    @property
    def words(self) -> tuple[str, str]:
        """Where it is and what it would settle."""
        start, second = self.stops[:2]
        towards = "" if second.junction is None else f" towards {second.label(self.site)}"
        where = f"{self.length_m:.0f} m in {self.site}, from junction {start.junction}{towards}"
        if self.onto is None:
            return where, f"a branch of {self.site} that nobody drove"
        number = len(self.pairs)
        pairs = counted(number, "open pair")
        return where, f"joins {self.site} and {self.onto}, if they are one place: settles {pairs}"

    @property
    def way(self) -> str:
        """The stops in words."""
        known = [s for s in self.stops if s.junction is not None]
        parts: list[str] = []
        for site, stops in groupby(known, key=lambda s: s.site):
            numbers = ", ".join(f"{s.junction}" for s in stops)
            parts.append(f"in {site}: {numbers}" if parts else numbers)
        text = "by junctions " + "; ".join(parts)
        if self.heading_rad is None:
            return text
        rest, usual_m = (
            self.length_m - self.known_m,
            float(np.hypot(*(self.path[-1] - self.path[-2]))),
        )
        passed = f" past about {rest / usual_m:.0f} junctions" if usual_m else ""
        degrees = round(math.degrees(self.heading_rad)) % 360
        return (
            f"{text}; there by the branch never driven (to {degrees}° in the map), and on as "
            f"corridors lead,{passed} ({rest:.0f} m)"
        )


def drive_to_document(drive: Drive) -> dict[str, Any]:
    """A drive as JSON values."""
    where, settles = drive.words
    return {
        "site": drive.site,
        "component": drive.component,
        "onto": drive.onto,
        "length": rounded(drive.length_m, METRES),
        "known_length": rounded(drive.known_m, METRES),
        "bits": rounded(drive.bits, BITS),
        "bits_per_metre": round(drive.bits_per_m, 4),
        "pairs": [list(pair) for pair in drive.pairs],
        "heading": None if drive.heading_rad is None else round(drive.heading_rad, 4),
        "where": where,
        "settles": settles,
        "way": drive.way,
        "stops": [
            {"site": s.site, "junction": s.junction, "x": s.xy[0], "y": s.xy[1]}
            for s in drive.stops
        ],
        "path": rounded(drive.path, METRES),
    }


@dataclass(frozen=True, slots=True, eq=False)
class Undriven:
    """A branch that nobody drove. junction: its number in the merged document, at xy (2,) [m];
    heading_rad: where the branch leads; both in the frame of the site."""

    site: str
    junction: int
    xy: FloatArray
    heading_rad: float
