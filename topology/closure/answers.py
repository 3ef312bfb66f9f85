"""Identifications of passes that loop closure accepted or refused, by round."""

from __future__ import annotations

from dataclasses import dataclass, replace

from ..arrays import IntArray

AGREE = "position, branches and corridors agree"
TOGETHER = "sure together with others that agree on one position"
UNSURE = "not sure enough"
DISAGREE = "corridors disagree"
COMMON = "places that are certainly two look as much alike"
APART = "too far apart once the run was laid out anew"
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


def explained(
    doubts: dict[tuple[int, int], Identification], reasons: dict[tuple[int, int], str]
) -> dict[tuple[int, int], Identification]:
    """The doubts that are "not sure enough", with the more specific reasons in `reasons`."""
    return {
        pair: replace(doubts[pair], reason=reason)
        for pair, reason in reasons.items()
        if pair in doubts and doubts[pair].reason == UNSURE
    }


def taken_back(q: Identification, number: int) -> Identification:
    """An accepted identification, refused in round `number`."""
    return replace(q, accepted=False, reason=TORN, round=number, accepted_round=q.round)


def standing_doubts(
    place: IntArray, doubts: dict[tuple[int, int], Identification]
) -> list[Identification]:
    """Refusals that still concern two different places: the latest per pair of places, sorted."""
    latest: dict[tuple[int, int], Identification] = {}
    for (i, j), q in doubts.items():
        a, b = sorted((int(place[i]), int(place[j])))
        if a != b:
            latest[a, b] = q
    return [latest[pair] for pair in sorted(latest)]
