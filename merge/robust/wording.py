"""The sentences of verdicts."""

from __future__ import annotations

from ...topology.wording import counted
from ..result import shown_bits, shown_lead
from ..wording import decimals, told_bits, what_agrees
from .alignment import Candidate
from .verdict import Faint


def summary(best: Candidate, bits: float, need_bits: float, margin: float | None) -> str:
    """What agrees, what contradicts, the evidence, and how far the next alignment is behind or
    ahead."""
    agree = what_agrees(len(best), len(best.corridors), best.views.agreeing)
    against = len(best.conflicts)
    contradicted = f"{against} {'contradicts' if against == 1 else 'contradict'}"
    if not best.searched:
        contradicted = "contradictions were not looked for"
    text = f"{agree}, {contradicted}: {told_bits(bits, need_bits)}"
    if margin is None:
        return f"{text}; no other alignment comes near"
    digits = decimals(bits, need_bits)
    lead = shown_lead(bits, bits - margin, digits)
    bits_apart = shown_bits(abs(lead), digits)
    if lead < 0:
        return f"{text}; another alignment has {bits_apart} bits more"
    return f"{text}; next best alignment {bits_apart} bits behind"


def nothing(best: Faint | None, need_bits: float) -> str:
    """Why two maps without an alignment beyond chance are unrelated."""
    if best is None:
        return "no significant match: no alignment holds"
    agree = f"{counted(best.junctions, 'junction')} {'agrees' if best.junctions == 1 else 'agree'}"
    return f"no significant match: {agree}, {told_bits(best.bits, need_bits)}"
