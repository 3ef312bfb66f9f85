"""The sentences of verdicts."""

from __future__ import annotations

from ...topology.wording import counted
from ..result import shown_bits, shown_lead
from ..wording import decimals, describe_agreement, describe_bits
from .alignment import Candidate
from .verdict import Assessment


def describe_match(best: Candidate, bits: float, need_bits: float, margin: float | None) -> str:
    """An alignment in words: agreement, contradictions, evidence, and the lead over the next."""
    agree = describe_agreement(len(best), len(best.corridors), best.views.agreeing)
    against = len(best.conflicts)
    contradicted = f"{against} {'contradicts' if against == 1 else 'contradict'}"
    if not best.searched:
        contradicted = "contradictions were not looked for"
    text = f"{agree}, {contradicted}: {describe_bits(bits, need_bits)}"
    if margin is None:
        return f"{text}; no other alignment comes near"
    digits = decimals(bits, need_bits)
    lead = shown_lead(bits, bits - margin, digits)
    bits_apart = shown_bits(abs(lead), digits)
    if lead < 0:
        return f"{text}; another alignment has {bits_apart} bits more"
    return f"{text}; next best alignment {bits_apart} bits behind"


def describe_evidence(assessment: Assessment) -> str:
    """The evidence of two maps in words: the best alignment, or the best one within chance."""
    if assessment.best is not None:
        return describe_match(
            assessment.best, assessment.bits, assessment.need_bits, assessment.margin
        )
    faint = assessment.faint
    if faint is None:
        return "no significant match: no alignment holds"
    agree = (
        f"{counted(faint.junctions, 'junction')} {'agrees' if faint.junctions == 1 else 'agree'}"
    )
    return f"no significant match: {agree}, {describe_bits(faint.bits, assessment.need_bits)}"
