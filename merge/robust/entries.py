"""The final verdict on one pair of maps, given all that concerns the pair."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ...topology.arrays import IntArray
from ...topology.matching.likelihood import LIKELIHOOD
from ...topology.passes import NO_BRANCH
from ...topology.se2 import wrap
from ...topology.wording import counted
from ..locks import DISCARDED, Lock
from ..result import AcceptedBy, Alignment, PairVerdict, Verdict
from .alignment import Candidate, same_matches, same_placement
from .components import Refusal
from .conflicts import contradictions
from .prepare import Prepared
from .rematching import ComponentMatch
from .verdict import DOUBTS, ELSEWHERE, NOTHING_ALIKE, Assessment, Weighed
from .view_ties import view_ties
from .wording import describe_evidence, describe_match

MAPS_ALONE = "the maps alone say:"
"""Introduces the evidence of two maps in a reason where a lock decides otherwise."""


@dataclass(frozen=True, slots=True, eq=False)
class Case:
    """All that decides on two maps: their own evidence, locks, and the other runs.

    forced: the alignment that a lock "same" demands; refused: why the pair was not joined;
    by_components: the match of their components; corroborated: a candidate that agrees with other
    runs; together: whether the two are in one component.
    """

    a: Prepared
    b: Prepared
    assessment: Assessment
    forced: Candidate | None = None
    lock: Lock | None = None
    refused: Refusal | None = None
    by_components: ComponentMatch | None = None
    corroborated: Candidate | None = None
    together: bool = False

    def verdict(self) -> PairVerdict:
        """The verdict on the pair. Locks come first, then the consistency of the component, then
        the pair's own evidence, then that of other runs."""
        lock, found = self.lock, self._evidence()
        if lock is not None and lock.decision == "never":
            reason = f"locked apart by a person; {MAPS_ALONE} {found}"
            return self._not_joined(Verdict.UNRELATED, reason)
        if lock is not None and self.forced is None and self.by_components is None:
            return self._infeasible(lock)
        if self.refused is not None:
            reason = f"{found}; but {self.refused.reason}"
            if lock is not None:
                reason = f"locked as the same, but {self.refused.reason}; {MAPS_ALONE} {found}"
            return self._not_joined(Verdict.AMBIGUOUS, reason)
        return self._by_evidence()

    def _evidence(self) -> str:
        """The evidence of the two maps alone, as a clause."""
        return DISCARDED if self.assessment.discarded else describe_evidence(self.assessment)

    def _infeasible(self, lock: Lock) -> PairVerdict:
        """The verdict where a lock as the same is infeasible: no alignment satisfies it."""
        reason = "locked as the same, but no alignment of the two honours the lock"
        if self.together:
            reason = f"{reason}; other runs place them in one component"
        elif lock.at is None:
            reason = (
                f"{reason}: name a junction of each run that is one place in it (--at), if more "
                "speaks for that than against it"
            )
        verdict = self.assessment.verdict
        if verdict is Verdict.MERGED:  # by an alignment that the lock rules out
            verdict = Verdict.AMBIGUOUS
        return self._not_joined(
            verdict,
            f"{reason}; {MAPS_ALONE} {self._evidence()}",
            f"clear the lock of {lock.a} and {lock.b}, or name junctions in it that are one place",
        )

    def _by_evidence(self) -> PairVerdict:
        """The verdict where nothing forbids joining."""
        assessment, best = self.assessment, self.assessment.best
        if self.forced is not None:
            reason, lacks = "locked as the same by a person; {}", assessment.why
            if best is not None and not same_placement(best, self.forced, self.b):
                lacks = lacks or ELSEWHERE
            if lacks or assessment.verdict is not Verdict.MERGED:
                reason += f"; {MAPS_ALONE} {assessment.verdict}" + (f", {lacks}" if lacks else "")
            if assessment.verdict is Verdict.UNRELATED:
                lacks = NOTHING_ALIKE
            return self._accepted(self.forced, by="lock", reason=reason, lacks=lacks)
        if assessment.verdict is Verdict.MERGED and best is not None:
            return self._accepted(best, by="pair")
        if self.by_components is not None:
            of_components = self.by_components.assessment
            return self._pair(
                of_components,
                verdict=Verdict.MERGED,
                reason=self.by_components.reason,
                best=self.by_components.alignment,
                margin_bits=of_components.margin,
                accepted_by="components",
                together=self.by_components.sides,
            )
        if self.corroborated is not None:
            reason = "joined with the help of other runs, which place the two in the same way: {}"
            return self._accepted(self.corroborated, by="runs", reason=reason)
        evidence, why = self._evidence(), assessment.why
        return self._not_joined(assessment.verdict, f"{evidence}; {why}" if why else evidence)

    def _accepted(
        self, chosen: Candidate, *, by: AcceptedBy, reason: str = "{}", lacks: str = ""
    ) -> PairVerdict:
        """The verdict of a pair joined by one of its alignments, in words at the braces."""
        best = self._alignment(chosen)
        ranked = (w.candidate for w in self.assessment.ranked)
        others = (c for c in ranked if not same_placement(c, chosen, self.b))
        second = next(map(self._alignment, others), None)
        bits = best.evidence_bits
        margin = None if second is None else bits - second.evidence_bits
        return self._pair(
            self.assessment,
            verdict=Verdict.MERGED,
            reason=reason.format(describe_match(chosen, bits, self.assessment.need_bits, margin)),
            best=best,
            runner_up=second,
            margin_bits=margin,
            accepted_by=by,
            lacks=lacks,
        )

    def _alignment(self, c: Candidate) -> Alignment:
        """A candidate as an alignment, with its evidence by the assessment, if it was assessed."""
        known = (w for w in self.assessment.ranked if same_matches(w.candidate, c))
        return alignment_of(c, self.a, self.b, next(known, None))

    def _not_joined(
        self, verdict: Verdict, reason: str, settled_by: str | None = None
    ) -> PairVerdict:
        """The verdict of a pair that is not joined. settled_by: what would settle it, if ambiguous;
        by default `advice`."""
        assessment = self.assessment
        candidates = (assessment.best, assessment.runner_up)
        best, second = (None if c is None else self._alignment(c) for c in candidates)
        if self.refused is not None:
            settled_by = self.refused.advice
        if verdict is not Verdict.AMBIGUOUS:
            settled_by = None
        elif settled_by is None:
            settled_by = advice(self.a, self.b, assessment)
        return self._pair(
            assessment,
            verdict=verdict,
            reason=reason,
            best=best,
            runner_up=second,
            margin_bits=assessment.margin,
            advice=settled_by,
            lacks=assessment.why,
        )

    def _pair(
        self,
        by: Assessment,
        *,
        verdict: Verdict,
        reason: str,
        best: Alignment | None,
        accepted_by: AcceptedBy | None = None,
        **more: Any,
    ) -> PairVerdict:
        """The verdict, by the assessment of the two maps or of two components."""
        joined = accepted_by is not None and best is not None
        return PairVerdict(
            self.a.run,
            self.b.run,
            verdict,
            accepted=joined,
            evidence_bits=best.evidence_bits if joined and best is not None else by.bits,
            reason=reason,
            best=best,
            threshold_bits=by.need_bits,
            accepted_by=accepted_by,
            locked=None if self.lock is None else self.lock.decision,
            lead_needed_bits=None if best is None else by.lead_bits,
            **more,
        )


def doubt(pair: PairVerdict) -> str:
    """The evidence of the maps against joining a pair that is not joined by evidence: it may be
    another place, contradictions, nothing in common; "" if there is none."""
    if pair.through or (pair.accepted and pair.accepted_by != "lock"):
        return ""
    doubts = [pair.lacks] if pair.lacks in DOUBTS else []
    contradictions = () if pair.best is None else pair.best.contradictions
    if contradictions:
        doubts.append(f"{counted(len(contradictions), 'contradiction')}: {contradictions[0]}")
    if not doubts and pair.verdict is Verdict.UNRELATED and pair.locked is None:
        doubts.append(NOTHING_ALIKE)
    return "; ".join(doubts)


def alignment_of(
    c: Candidate, a: Prepared, b: Prepared, weighed: Weighed | None = None
) -> Alignment:
    """A candidate as an alignment. weighed: its evidence, if it was assessed."""
    order = np.argsort(c.a, kind="stable")
    against = contradictions(c.conflicts, a, b)
    return Alignment(
        transform=c.transform,
        evidence_bits=c.counted_bits if weighed is None else weighed.bits,
        matched=np.column_stack([c.a, c.b])[order],
        rmse_m=c.rmse_m,
        corridors=len(c.corridors),
        contradictions=tuple(x.sentence(a.run, b.run) for x in against),
        contradicting=tuple((x.of_a, x.of_b) for x in against),
        copy_test=None if weighed is None else weighed.copy_test,
        ties=view_ties(a, b, c.views),
    )


def advice(a: Prepared, b: Prepared, assessment: Assessment) -> str | None:
    """A sentence that names a corridor to drive: one that leaves a matched junction by a branch
    that both runs saw and one drove. Corridors at junctions that the runner-up matches differently
    are preferred, because they can refute it. None without a placement."""
    best = assessment.best
    if best is None:
        return None
    options = [
        *_driven_by_one(a, b, best.a, best.b, best.transform[2]),
        *_driven_by_one(b, a, best.b, best.a, -best.transform[2]),
    ]
    if not options:
        return (
            f"record {a.run} or {b.run} again, further along the edge of what both have seen: "
            "every corridor they share has been driven by both"
        )
    second = assessment.runner_up
    pairs = () if second is None else zip(second.b.tolist(), second.a.tolist(), strict=True)
    runner_up = dict(pairs)

    def refutes(o: _Option) -> bool:
        """Whether the runner-up matches the junction with another one."""
        of_a, of_b = (o.vertex, o.other_vertex) if o.known is a else (o.other_vertex, o.vertex)
        return bool(runner_up.get(of_b, of_a) != of_a)

    best_option = max(options, key=lambda o: (refutes(o), o.length, -o.other_vertex))
    driver, vertex, end, length, other, other_vertex = best_option
    record, beyond = f"record with {other.run}'s robot", "where that run turned another way"
    if not other.topomap.is_driven:
        record, beyond = "record", "a saved map that does not show where it leads"
    known = "drove" if driver.topomap.is_driven else "shows"
    return (
        f"{record} the corridor that {driver.run} {known} from its junction {vertex} to {end} "
        f"({length:.1f} m): it leaves junction {other_vertex} of {other.run}, {beyond}"
    )


class _Option(NamedTuple):
    """A corridor that the run `known` drove from `vertex` to `end`, of a length [m]. The run
    `other` saw it leave the matched `other_vertex`, and did not drive it."""

    known: Prepared
    vertex: int
    end: int
    length: float
    other: Prepared
    other_vertex: int


def _driven_by_one(
    known: Prepared, other: Prepared, matched_known: IntArray, matched_other: IntArray, turn: float
) -> list[_Option]:
    """Corridors of `known` at matched junctions by branches that `other` saw and did not drive."""
    partner = np.full(len(known), -1)
    partner[matched_known] = matched_other
    rows = ((partner[known.tail] >= 0) & (known.leave != NO_BRANCH)).nonzero()[0]
    tail = known.tail[rows]
    vertex, headings = partner[tail], other.heading[partner[tail]]
    turn_rad = np.abs(wrap(headings - (known.heading[tail, known.leave[rows]] - turn)[:, None]))
    turn_rad[np.isnan(headings)] = np.pi  # as far off as can be
    branch = turn_rad.argmin(axis=1)
    undriven = (turn_rad.min(axis=1) < LIKELIHOOD.branch_gate_rad) & (
        other.by_branch[vertex, branch] < 0
    )
    columns = (tail, known.head[rows], known.length[rows], vertex)
    return [
        _Option(known, u, end, length, other, v)
        for u, end, length, v in zip(*(c[undriven].tolist() for c in columns), strict=True)
    ]
