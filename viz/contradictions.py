"""Where two runs contradict each other, as dots on their maps."""

from __future__ import annotations

from collections.abc import Sequence

import rerun as rr

from . import palette
from .placements import Spot
from .recording import PathParts, Recording


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
                draw_order=palette.Order.CONTRADICTION,
            ),
            rr.AnyValues(contradiction=[spot.told for spot in spots]),
        )
