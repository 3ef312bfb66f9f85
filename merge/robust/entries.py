"""The final verdict on one pair of maps, given all that concerns the pair."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from ...topology.digits import BITS, rounded
from ...topology.wording import counted
from ..discards import REASON
from ..locks import Lock
from ..result import AcceptedBy, Alignment, PairVerdict, Verdict
from .advice import advice
from .alignment import Candidate, same_matches, same_placement
from .components import Refusal
from .prepare import Prepared
from .rematching import Reunion
from .verdict import DOUBTS, Answers, Assessment, counted_bits
from .view_ties import view_ties
from .wording import contradictions, nothing, summary

MAPS_ALONE = "the maps alone say:"
"""In a reason, before what the evidence of two maps says where a lock says otherwise."""

ELSEWHERE = "by another placement"
"""What it says where a lock joins two maps that their evidence joins in another way."""


@dataclass(frozen=True, slots=True, eq=False)
class Case:
    """All that is known of two maps: by themselves, by locks, by the other runs."""

    a: Prepared
    b: Prepared
    view: Assessment
    forced: Candidate | None = None
    lock: Lock | None = None
    refused: Refusal | None = None
    reunion: Reunion | None = None
    corroborated: Candidate | None = None
    together: bool = False

    def verdict(self) -> PairVerdict:
        """The verdict on the pair. Locks come first, then the consistency of the component, then
        the pair's own evidence, then that of other runs."""
        lock, says = self.lock, self._says()
        if lock is not None and lock.decision == "never":
            reason = f"locked apart by a person; {MAPS_ALONE} {says}"
            return self._not_joined(Verdict.UNRELATED, reason)
        if lock is not None and self.forced is None and self.reunion is None:
            return self._dishonoured(lock)
        if self.refused is not None:
            reason = f"{says}; but {self.refused.reason}"
            if lock is not None:
                reason = f"locked as the same, but {self.refused.reason}; {MAPS_ALONE} {says}"
            return self._not_joined(Verdict.AMBIGUOUS, reason)
        return self._by_evidence()

    def _says(self) -> str:
        """The evidence of the two maps alone, as a clause."""
        view = self.view
        if view.discarded:
            return REASON
        if view.best is None:
            return nothing(view.faint, view.need_bits)
        return summary(view.best, view.bits, view.need_bits, view.margin)

    def _dishonoured(self, lock: Lock) -> PairVerdict:
        """The verdict where a lock as the same is infeasible: no alignment satisfies it."""
        reason = "locked as the same, but no alignment of the two honours the lock"
        if self.together:
            reason = f"{reason}; other runs place them in one component"
        elif lock.at is None:
            reason = (
                f"{reason}: name a junction of each run that is one place in it (--at), if more "
                "speaks for that than against it"
            )
        verdict = self.view.verdict
        if verdict is Verdict.MERGED:  # by an alignment that the lock rules out
            verdict = Verdict.AMBIGUOUS
        return self._not_joined(
            verdict,
            f"{reason}; {MAPS_ALONE} {self._says()}",
            f"clear the lock of {lock.a} and {lock.b}, or name junctions in it that are one place",
        )

    def _by_evidence(self) -> PairVerdict:
        """The verdict where nothing forbids joining."""
        view = self.view
        if self.forced is not None:
            told = "locked as the same by a person; {}"
            why = view.why
            if view.best is not None and not same_placement(view.best, self.forced, self.b):
                why = why or ELSEWHERE
            if why or view.verdict is not Verdict.MERGED:
                told += f"; {MAPS_ALONE} {view.verdict}" + (f", {why}" if why else "")
            return self._accepted(self.forced, by="lock", reason=told)
        if view.verdict is Verdict.MERGED and view.best is not None:
            return self._accepted(view.best, by="pair")
        if self.reunion is not None:
            said = self.reunion
            found = (said.alignment, None, said.assessment.margin)
            return self._joined(said.reason, found, by="components")
        if self.corroborated is not None:
            told = "joined with the help of other runs, which place the two in the same way: {}"
            return self._accepted(self.corroborated, by="runs", reason=told)
        says = self._says()
        return self._not_joined(view.verdict, f"{says}; {view.why}" if view.why else says)

    def _accepted(self, chosen: Candidate, *, by: AcceptedBy, reason: str = "{}") -> PairVerdict:
        """Joined by an alignment of the pair, not necessarily its best. The alignment's summary
        replaces the braces in the reason."""
        best = self._alignment(chosen)
        others = (c for c, _ in self.view.ranked if not same_placement(c, chosen, self.b))
        second = next(map(self._alignment, others), None)
        bits = best.evidence_bits
        margin = None if second is None else bits - second.evidence_bits
        told = reason.format(summary(chosen, bits, self.view.need_bits, margin))
        return self._joined(told, (best, second, margin), by=by)

    def _alignment(self, c: Candidate) -> Alignment:
        """A candidate with the evidence that the assessment gives it, if it has it."""
        known = zip(self.view.ranked, self.view.answers, strict=True)
        answers = next((told for (other, _), told in known if same_matches(other, c)), None)
        return alignment_of(c, self.a, self.b, answers)

    def _joined(
        self,
        reason: str,
        found: tuple[Alignment, Alignment | None, float | None],
        *,
        by: AcceptedBy,
    ) -> PairVerdict:
        """found: the alignment that joins the two, the next best one, the margin [bits]."""
        best, runner_up, margin = found
        reunion = self.reunion if by == "components" else None
        view = self.view if reunion is None else reunion.assessment
        return PairVerdict(
            a=self.a.run,
            b=self.b.run,
            verdict=Verdict.MERGED,
            accepted=True,
            evidence_bits=best.evidence_bits,
            threshold_bits=view.need_bits,
            reason=reason,
            best=best,
            runner_up=runner_up,
            margin_bits=margin,
            accepted_by=by,
            together=None if reunion is None else reunion.sides,
            locked=None if self.lock is None else self.lock.decision,
            lead_needed_bits=view.lead_bits,
            extra=_extra(view),
        )

    def _not_joined(
        self, verdict: Verdict, reason: str, settling: str | None = None
    ) -> PairVerdict:
        """settling: what would settle an ambiguous pair, if that is not another recording."""
        view = self.view
        shown = [self._alignment(c) for c, _ in view.ranked[:2]]
        if self.refused is not None:
            settling = self.refused.advice
        if verdict is not Verdict.AMBIGUOUS:
            settling = None
        elif settling is None:
            settling = advice(self.a, self.b, view)
        return PairVerdict(
            a=self.a.run,
            b=self.b.run,
            verdict=verdict,
            accepted=False,
            evidence_bits=view.bits,
            threshold_bits=view.need_bits,
            reason=reason,
            best=shown[0] if shown else None,
            runner_up=shown[1] if len(shown) > 1 else None,
            margin_bits=view.margin,
            advice=settling,
            locked=None if self.lock is None else self.lock.decision,
            lacks=view.why,
            lead_needed_bits=view.lead_bits if shown else None,
            extra=_extra(view) | self._copy_test(verdict),
        )

    def _copy_test(self, verdict: Verdict) -> dict[str, Any]:
        """The test for a copy, of runs that a person locked apart: of unrelated ones the document
        states no alignment that could."""
        tested = self.view.answers[0].copy_test if self.view.answers else None
        if verdict is not Verdict.UNRELATED or tested is None:
            return {}
        return {"copy_test": asdict(tested)}


def doubt(pair: PairVerdict) -> str:
    """What the maps of a pair that their evidence does not join say against joining them, beyond
    too little evidence: that it may be another place, contradictions, or nothing in common; "" if
    nothing."""
    if pair.through or (pair.accepted and pair.accepted_by != "lock"):
        return ""
    _, locked, alone = pair.reason.partition(MAPS_ALONE)
    if pair.accepted and not locked:
        return ""
    found = [why for why in (*DOUBTS, ELSEWHERE) if why in (alone or pair.reason)]
    against = () if pair.best is None else pair.best.contradictions
    if against:
        found.append(f"{counted(len(against), 'contradiction')}: {against[0]}")
    nothing_alike = f"{MAPS_ALONE} {Verdict.UNRELATED}" in pair.reason
    if not found and (nothing_alike or (pair.verdict is Verdict.UNRELATED and pair.locked is None)):
        found.append("they have nothing in common that chance would not offer")
    return "; ".join(found)


def _extra(view: Assessment) -> dict[str, Any]:
    """What a document says of an assessment beside its evidence."""
    out: dict[str, Any] = {}
    if view.against_chance > 0:
        out["against_chance_bits"] = view.against_chance
    if view.same_bits is not None:
        out["same_place_bits"] = rounded(view.same_bits, BITS)
    return out


def alignment_of(c: Candidate, a: Prepared, b: Prepared, answers: Answers | None) -> Alignment:
    """A candidate as an alignment. answers: its evidence; None if it was not assessed."""
    order = np.argsort(c.a, kind="stable")
    against = contradictions(c, a, b)
    return Alignment(
        transform=c.transform,
        evidence_bits=counted_bits(c) if answers is None else answers.bits,
        matched=np.column_stack([c.a, c.b])[order],
        rmse_m=c.rmse_m,
        corridors=len(c.corridors),
        contradictions=tuple(told for told, _, _ in against),
        contradicting=tuple((of_a, of_b) for _, of_a, of_b in against),
        copy_test=None if answers is None else answers.copy_test,
        ties=view_ties(a, b, c.views),
    )
