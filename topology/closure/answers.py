"""Identifications of passes that loop closure accepted or refused, by round."""

from __future__ import annotations

from dataclasses import dataclass

AGREE = "position, branches and corridors agree"
TOGETHER = "sure together with others that agree on one position"
UNSURE = "not sure enough"
DISAGREE = "corridors disagree"
COMMON = "places that are certainly two look as much alike"
TORN = "taken back: a pass was torn away"


@dataclass(frozen=True, slots=True, eq=False)
class Identification:
    """The identification of passes `first` and `second` as by one place, accepted or refused.

    bits: evidence for it; turn_rad: rotation that aligns the branches of `second` with those of
    `first`, in addition to the estimate of that round [rad]; round: in which it was decided, from 1
    on, 0 if not by rounds; accepted_round: if taken back.
    """

    first: int
    second: int
    accepted: bool
    bits: float
    reason: str
    turn_rad: float = 0.0
    round: int = 0
    accepted_round: int | None = None
