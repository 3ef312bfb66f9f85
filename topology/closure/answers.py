"""The answers of loop closure to each question, by round, and which of them still stand."""

from __future__ import annotations

from collections.abc import Iterable
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
    """The question whether passes `first` and `second` were by one place, and its answer.

    bits: evidence for it; turn_rad: rotation of the branches of `second`, in addition to the
    estimate at that time, at which they meet those of `first` [rad]; round: in which it was
    answered, from 1 on, 0 if not by rounds; accepted_round: the round in which it had been
    accepted, if this takes it back.
    """

    first: int
    second: int
    accepted: bool
    bits: float
    reason: str
    turn_rad: float = 0.0
    round: int = 0
    accepted_round: int | None = None


Answer = tuple[int | str | None, ...]
"""Key of an answer: two passes or places, and the reason."""


def explained(
    doubts: dict[tuple[int, int], Identification], reasons: dict[tuple[int, int], str]
) -> dict[tuple[int, int], Identification]:
    """The doubts with the reason "not sure enough" for which `reasons` has a more specific one,
    with that."""
    return {
        pair: replace(doubts[pair], reason=reason)
        for pair, reason in reasons.items()
        if pair in doubts and doubts[pair].reason == UNSURE
    }


def is_open(q: Identification, place: IntArray) -> bool:
    """Whether the two passes are still at different places."""
    return bool(place[q.first] != place[q.second])


def taken_back(q: Identification, number: int) -> Identification:
    """An accepted identification, refused in round `number`."""
    return replace(q, accepted=False, reason=TORN, round=number, accepted_round=q.round)


def note(answers: dict[Answer, Identification], given: Iterable[Identification]) -> None:
    """Record answers, keeping the last one per pair of passes and reason."""
    for q in given:
        answers[q.first, q.second, q.reason, q.accepted_round] = q


def revised_answers(
    place: IntArray, answers: Iterable[Identification], identifications: list[Identification]
) -> list[Identification]:
    """Refusals in whose place another answer stands: the last one of each reason, per pair of
    places.

    identifications: the answers that stand. Two passes that were later identified keep an entry of
    their own.
    """

    def key(q: Identification) -> Answer:
        a, b = sorted((int(place[q.first]), int(place[q.second])))
        pair = (a, b) if a != b else (q.first, q.second)
        return *pair, a == b, q.reason, q.accepted_round

    last = {key(q): q for q in sorted(answers, key=lambda q: (q.round, q.first, q.second))}
    for q in identifications:
        last.pop(key(q), None)
    return list(last.values())


def standing_doubts(
    place: IntArray, doubts: dict[tuple[int, int], Identification]
) -> list[Identification]:
    """Refusals that still concern two places: the latest per pair of places, sorted."""
    latest: dict[tuple[int, int], Identification] = {}
    for (i, j), q in doubts.items():
        a, b = sorted((int(place[i]), int(place[j])))
        if a != b:
            latest[a, b] = q
    return [latest[pair] for pair in sorted(latest)]
