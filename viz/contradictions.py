"""Where two runs contradict each other, as dots on their maps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from ..merge.result import Alignment
from . import palette
from .recording import PathParts, Recording

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Spot:
    """A contradiction: where it lies (2,) and what it says."""

    xy: FloatArray
    told: str


def contradiction_spots(alignment: Alignment, of_a: FloatArray, of_b: FloatArray) -> list[Spot]:
    """Every contradiction of an alignment whose junctions are known, in the frame of the given
    positions of both maps' junctions, (n, 2) each: at the junction that the other run did not see,
    or amid corridors that cross."""
    spots = []
    for told, (a, b) in zip(alignment.contradictions, alignment.contradicting, strict=False):
        alone = [of[list(ends)] for of, ends in ((of_a, a), (of_b, b)) if len(ends) == 1]
        both = [of_a[list(a)], of_b[list(b)]]
        spots.append(Spot(np.concatenate(alone or both).mean(axis=0), told))
    return spots


def write_contradictions(
    recording: Recording, path: PathParts, spots: Sequence[Spot], pen: float
) -> None:
    """A red dot for each; selecting it tells what is wrong there."""
    if spots:
        recording.static(
            path,
            rr.Points2D(
                [spot.xy for spot in spots],
                radii=2.0 * pen,
                colors=palette.REFUSED,
                draw_order=28.0,
            ),
            rr.AnyValues(contradiction=[spot.told for spot in spots]),
        )
