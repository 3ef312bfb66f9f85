"""The sentences of verdicts."""

from __future__ import annotations

from ...topology.wording import counted
from ..result import shown_bits, shown_lead
from ..wording import decimals, told_bits, what_agrees
from .alignment import Candidate
from .conflicts import Contradiction, one_by_one
from .prepare import Prepared
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


Ends = tuple[int, ...]


def contradictions(best: Candidate, a: Prepared, b: Prepared) -> list[tuple[str, Ends, Ends]]:
    """For every contradiction of an alignment a sentence, and the vertices of a and of b that it
    concerns: one, or the two ends of a corridor."""
    return [(_sentence(c, a.run, b.run), c.of_a, c.of_b) for c in one_by_one(best.conflicts, a, b)]


def _sentence(c: Contradiction, run_a: str, run_b: str) -> str:
    one, two = (" to ".join(map(str, ends)) for ends in (c.of_a, c.of_b))
    if c.kind == "unseen":
        inside = len(c.of_a) == 1
        vertex, run, row, other = (one, run_a, two, run_b) if inside else (two, run_b, one, run_a)
        return f"junction {vertex} of {run} falls inside corridor {row} of {other}, unseen there"
    return (
        f"corridor {one} of {run_a} and corridor {two} of {run_b} "
        "leave the same junction by the same branch and lead to different ones"
    )
