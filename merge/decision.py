"""A verdict on two runs with all its evidence, term by term, and the threshold.

This is what `topobatch explain` shows. All bits are those of `merged.json`: the terms of a
placement add up to its evidence, and the evidence is compared with the threshold.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal

from ..topology.arrays import FloatArray
from ..topology.digits import BITS, METRES, rounded
from ..topology.matching.views import Compared
from .document import bits_to_document, pose_to_document, rounded_copy_test, sigmas_to_document
from .result import Alignment, PairVerdict
from .wording import AGREES_BITS

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


COMMON_LENGTH = "common length"
"""The text of a link whose two lengths agree, as those of many corridors would."""


@dataclass(frozen=True, slots=True)
class Term:
    """A part of the evidence, in bits, positive if for the placement.

    text: in words; a, b: the junctions of the two maps that it concerns, a corridor as its two
    ends, as far as these runs have them; size_m: for a link its length in a and in b [m]; seen: of
    the views that speak most for a placement, and most against it, the walls of both, laid over
    each other, in the axes of a; a and b are then the junctions nearest to them.
    """

    kind: TermKind
    bits: float
    text: str
    a: tuple[int, ...] = ()
    b: tuple[int, ...] = ()
    size_m: tuple[float, float] | None = None
    seen: Compared | None = field(default=None, compare=False, repr=False)

    @property
    def contradicts(self) -> bool:
        """Whether the two maps differ here: it speaks against the placement, not only little
        (`AGREES_BITS`), and not because many corridors are as long."""
        return self.bits < -AGREES_BITS and self.text != COMMON_LENGTH

    @property
    def with_size(self) -> str:
        """The words, with both lengths of a link."""
        size = self.size_m
        return self.text if size is None else f"{self.text}: {size[0]:.2f} m, {size[1]:.2f} m"


@dataclass(frozen=True, slots=True, eq=False)
class Placement:
    """A placement of b over a with its evidence.

    The terms add up to `alignment.evidence_bits`; there are none of runs that components joined, as
    their evidence is of fused maps. searched: whether contradictions were searched,
    which is not done if the agreement is no better than chance.
    """

    alignment: Alignment
    terms: tuple[Term, ...]
    searched: bool = True

    def of(self, *kinds: TermKind) -> tuple[Term, ...]:
        """The terms of some kinds, by decreasing absolute value."""
        return tuple(sorted((t for t in self.terms if t.kind in kinds), key=lambda t: -abs(t.bits)))


@dataclass(frozen=True, slots=True)
class Requirement:
    """The requirements for merging.

    threshold_bits: log2(pairs / false_merge_rate); pairs: that share the false-merge rate;
    least_junctions: that must agree; lead_bits: required lead over the next best placement, more if
    that has no more evidence against it; junction_bits: bound per matched junction.
    """

    threshold_bits: float
    pairs: int
    false_merge_rate: float
    least_junctions: int
    lead_bits: float
    junction_bits: float


@dataclass(frozen=True, slots=True, eq=False)
class Decision:
    """Why two runs were merged, or not.

    pair: the verdict, as the last merge gave it (`of_merge`), or else as the notes say. placements:
    the one that the verdict refers to, and the next best with another position of b; none if
    nothing in the two maps is compatible. by_others: (3,) T_a_b of runs that only others join, and
    chain: the merged pairs that do, from a to b, with their evidence [bits]. why: what a rejected
    pair lacks; notes: on the documents that it was made from.
    """

    pair: PairVerdict
    of_merge: bool
    requirement: Requirement
    placements: tuple[Placement, ...]
    by_others: FloatArray | None = None
    chain: tuple[tuple[str, str, float], ...] = ()
    why: str = ""
    notes: tuple[str, ...] = ()


def to_document(decision: Decision) -> dict[str, Any]:
    """The decision as JSON values; angles in radians."""
    pair, need = decision.pair, decision.requirement
    copy_test = decision.placements[0].alignment.copy_test if decision.placements else None
    tested = {} if copy_test is None else rounded_copy_test(copy_test)
    return {
        "schema": DECISION_SCHEMA,
        "a": pair.a,
        "b": pair.b,
        "verdict": str(pair.verdict),
        "accepted": pair.accepted,
        "accepted_by": pair.accepted_by,
        "of_merge": decision.of_merge,
        "reason": pair.reason,
        "why": decision.why,
        "advice": pair.advice,
        "locked": pair.locked,
        "through": list(pair.through),
        "chain": [
            {"a": a, "b": b, "evidence_bits": rounded(bits, BITS)} for a, b, bits in decision.chain
        ],
        "together": pair.together and [list(side) for side in pair.together],
        "placed": sigmas_to_document(pair.placed),
        "by_others": None if decision.by_others is None else pose_to_document(decision.by_others),
        "evidence_bits": rounded(pair.evidence_bits, BITS),
        "threshold_bits": rounded(need.threshold_bits, BITS),
        "margin_bits": bits_to_document(pair.margin_bits),
        "requirement": {
            "pairs": need.pairs,
            "false_merge_rate": need.false_merge_rate,
            "least_junctions": need.least_junctions,
            "lead_bits": need.lead_bits,
            "junction_bits": need.junction_bits,
            "repetition": tested.get("repetition", 0.0),
            "same_place_bits": tested.get("bits"),
            "same_place_needed": tested.get("needed_bits"),
        },
        "placements": [_placement(p) for p in decision.placements],
        "start": None,  # of earlier versions: the best hypothesis, where none grew
        "notes": list(decision.notes),
    }


def _placement(placement: Placement) -> dict[str, Any]:
    """A placement as JSON values."""
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
                "bits": rounded(term.bits, BITS),
                "told": term.text,
                "a": list(term.a),
                "b": list(term.b),
            }
            | ({} if term.size_m is None else {"size_m": rounded(term.size_m, METRES)})
            for term in placement.terms
        ],
    }
