"""A verdict on two runs with all its evidence, term by term, and the threshold.

This is what `topobatch explain` shows. All bits are those of `merged.json`: the terms of a
placement add up to its evidence, and the evidence is compared with the threshold.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from math import floor
from typing import Any, Literal

from ..topology.arrays import FloatArray
from ..topology.digits import BITS, METRES, rounded
from ..topology.matching.views import Compared
from .document import bits_to_document, pose_to_document, sigmas_to_document
from .result import Alignment, PairVerdict

DECISION_SCHEMA: Literal["topobatch.decision/1"] = "topobatch.decision/1"

TermKind = Literal[
    "corridor", "position", "branches", "views", "unseen", "elsewhere", "hypotheses", "few",
    "copies",
]  # fmt: skip
"""What a term counts. corridor: the length of a corridor that both runs have; position: the
position of one matched junction relative to another near it; branches: those of one matched
junction; views: what lasers showed in one part of the overlap; unseen: a junction in the middle of
the other run's corridor; elsewhere: corridors that leave a matched junction by the same branch and
lead to different ones; hypotheses: the number among which the placement was chosen; few: the bound
by the number of junctions; copies: the test for a copy of the place."""

LINKS: tuple[TermKind, ...] = ("corridor", "position")
AGAINST: tuple[TermKind, ...] = ("unseen", "elsewhere")


@dataclass(frozen=True, slots=True)
class Term:
    """A part of the evidence, in bits, positive if for the placement.

    told: in words; a, b: the junctions of the two maps that it concerns, a corridor as its two
    ends, as far as these runs have them; size_m: for a link its length in a and in b [m]; seen: of
    the views that speak most for a placement, and most against it, the walls of both, laid over
    each other, in the axes of a; a and b are then the junctions nearest to them.
    """

    kind: TermKind
    bits: float
    told: str
    a: tuple[int, ...] = ()
    b: tuple[int, ...] = ()
    size_m: tuple[float, float] | None = None
    seen: Compared | None = field(default=None, compare=False, repr=False)

    @property
    def with_size(self) -> str:
        """The words, with both lengths of a link."""
        size = self.size_m
        return self.told if size is None else f"{self.told}: {size[0]:.2f} m, {size[1]:.2f} m"


def rounded_terms(bits: Sequence[float], digits: int, total: float | None = None) -> list[float]:
    """The parts rounded such that they add up to their rounded sum, or to a given rounded total
    (largest remainder method). Their order stays."""
    if not bits:
        return []
    unit = 10.0**digits
    exact = [part * unit for part in bits]
    whole = [floor(part) for part in exact]
    up = round(sum(exact) if total is None else total * unit) - sum(whole)
    largest = sorted(range(len(exact)), key=lambda k: whole[k] - exact[k])
    step = 1 if up > 0 else -1
    for k in range(abs(up)):
        whole[largest[k % len(largest)]] += step
    return [part / unit + 0.0 for part in whole]


@dataclass(frozen=True, slots=True, eq=False)
class Placement:
    """A placement of b over a with its evidence.

    The terms add up to `alignment.evidence_bits`: they are rounded as in documents, so that they
    read alike wherever they are shown. searched: whether contradictions were searched, which is not
    done if the agreement is no better than chance.
    """

    alignment: Alignment
    terms: tuple[Term, ...]
    searched: bool = True

    def __post_init__(self) -> None:
        bits = rounded_terms([term.bits for term in self.terms], BITS)
        terms = tuple(replace(t, bits=told) for t, told in zip(self.terms, bits, strict=True))
        object.__setattr__(self, "terms", terms)

    def of(self, *kinds: TermKind) -> tuple[Term, ...]:
        """The terms of some kinds, by decreasing absolute value."""
        return tuple(sorted((t for t in self.terms if t.kind in kinds), key=lambda t: -abs(t.bits)))


@dataclass(frozen=True, slots=True)
class Requirement:
    """The requirements for merging.

    threshold_bits: log2(pairs / false_merge_rate); pairs: that share the false-merge rate;
    least_junctions: that must agree; lead_bits: required lead over the next best placement, more if
    that has no more evidence against it; junction_bits: bound per matched junction; repetition: 0
    (certainly no copy) to 1; same_place_bits, same_place_needed: evidence that it is not a copy,
    and its threshold, None if not tested; unrounded_pairs: where `pairs` are rounded up.
    """

    threshold_bits: float
    pairs: int
    false_merge_rate: float
    least_junctions: int
    lead_bits: float
    junction_bits: float
    repetition: float
    same_place_bits: float | None = None
    same_place_needed: float | None = None
    unrounded_pairs: int | None = None


@dataclass(frozen=True, slots=True)
class Start:
    """The best hypothesis of a pair without any that grew. Of `expected` junctions of b that it
    puts inside the area of run a, `found` lie on a junction of a, and `needed` are required;
    hypotheses: their number."""

    found: int
    expected: int
    needed: int
    hypotheses: int


@dataclass(frozen=True, slots=True, eq=False)
class Decision:
    """Why two runs were merged, or not.

    said: the verdict, as the last merge gave it (`of_merge`), or else as the notes say. placements:
    the one that the verdict refers to, and the next best with another position of b; none if
    nothing in the two maps is compatible. start: set if the only placement is a hypothesis that did
    not grow: its terms do not add up to the verdict's evidence, which is 0. by_others: (3,) T_a_b
    of runs that only others join. why: what a rejected pair lacks; notes: on the documents that it
    was made from.
    """

    said: PairVerdict
    of_merge: bool
    requirement: Requirement
    placements: tuple[Placement, ...]
    start: Start | None = None
    by_others: FloatArray | None = None
    why: str = ""
    notes: tuple[str, ...] = ()


def to_document(decision: Decision) -> dict[str, Any]:
    """The decision as JSON values; angles in radians."""
    said, need = decision.said, decision.requirement
    return {
        "schema": DECISION_SCHEMA,
        "a": said.a,
        "b": said.b,
        "verdict": str(said.verdict),
        "accepted": said.accepted,
        "accepted_by": said.accepted_by,
        "of_merge": decision.of_merge,
        "reason": said.reason,
        "why": decision.why,
        "advice": said.advice,
        "locked": said.locked,
        "through": list(said.through),
        "together": said.together and [list(side) for side in said.together],
        "placed": sigmas_to_document(said.placed),
        "by_others": None if decision.by_others is None else pose_to_document(decision.by_others),
        "evidence_bits": rounded(said.evidence_bits, BITS),
        "threshold_bits": rounded(need.threshold_bits, BITS),
        "margin_bits": bits_to_document(said.margin_bits),
        "requirement": {
            "pairs": need.pairs,
            "false_merge_rate": need.false_merge_rate,
            "least_junctions": need.least_junctions,
            "lead_bits": need.lead_bits,
            "junction_bits": need.junction_bits,
            "repetition": rounded(need.repetition, 4),
            "same_place_bits": bits_to_document(need.same_place_bits),
            "same_place_needed": bits_to_document(need.same_place_needed),
        },
        "placements": [_placement(p) for p in decision.placements],
        "start": decision.start and asdict(decision.start),
        "notes": list(decision.notes),
    }


def _placement(placement: Placement) -> dict[str, Any]:
    a = placement.alignment
    return {
        "transform": pose_to_document(a.transform),
        "evidence_bits": rounded(a.evidence_bits, BITS),
        "matched": a.matched.tolist(),
        "corridors": a.corridors,
        "rmse_m": rounded(a.rmse_m, METRES),
        "contradictions": list(a.contradictions) if placement.searched else None,
        "terms": [
            {
                "kind": term.kind,
                "bits": term.bits,
                "told": term.told,
                "a": list(term.a),
                "b": list(term.b),
            }
            | ({} if term.size_m is None else {"size_m": rounded(term.size_m, METRES)})
            for term in placement.terms
        ],
    }
