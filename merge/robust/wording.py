"""Sentences that a person understands."""

from __future__ import annotations

from ...topology.topomap import TopoMap
from ..result import shown_bits
from ..wording import counted, told_bits
from .alignment import Candidate
from .prepare import Prepared
from .verdict import Faint


def summary(best: Candidate, bits: float, need_bits: float, margin: float | None) -> str:
    """What agrees, what contradicts, the evidence that comes of it, and how far the next alignment
    is behind, or another ahead."""
    agree = f"{counted(len(best), 'junction')} and {counted(len(best.corridors), 'corridor')} agree"
    against = len(best.conflicts)
    text = f"{agree}, {against} {'contradicts' if against == 1 else 'contradict'}"
    text = f"{text}: {told_bits(bits, need_bits)}"
    if margin is None:
        return f"{text}; no other alignment comes near"
    lead = shown_bits(abs(margin))
    if margin < 0 and float(lead) > 0:
        return f"{text}; another alignment has {lead} bits more"
    return f"{text}; next best alignment {lead} bits behind"


def nothing(best: Faint | None, need_bits: float) -> str:
    """Why two maps without an alignment beyond chance are unrelated."""
    if best is None:
        return "nothing that chance would not offer: no alignment holds"
    agree = f"{counted(best.junctions, 'junction')} {'agrees' if best.junctions == 1 else 'agree'}"
    return f"nothing that chance would not offer: {agree}, {told_bits(best.bits, need_bits)}"


Ends = tuple[int, ...]


def contradictions(best: Candidate, a: Prepared, b: Prepared) -> list[tuple[str, Ends, Ends]]:
    """For every contradiction of an alignment a sentence, and the vertices of a and of b that it
    speaks of: one, or the two ends of a corridor."""
    c = best.conflicts
    said: list[tuple[str, Ends, Ends]] = []
    for vertex, row in zip(c.extra_b.tolist(), c.extra_b_in.tolist(), strict=True):
        said.append((_unseen(vertex, b.run, row, a), _ends(a, row), (vertex,)))
    for vertex, row in zip(c.extra_a.tolist(), c.extra_a_in.tolist(), strict=True):
        said.append((_unseen(vertex, a.run, row, b), (vertex,), _ends(b, row)))
    for row_a, row_b in c.crossing.tolist():
        told = (
            f"corridor {_name(a, row_a)} of {a.run} crosses corridor {_name(b, row_b)} of {b.run} "
            "where neither run saw a junction"
        )
        said.append((told, _ends(a, row_a), _ends(b, row_b)))
    for row_a, row_b in c.elsewhere.tolist():
        told = (
            f"corridor {_name(a, row_a)} of {a.run} and corridor {_name(b, row_b)} of {b.run} "
            "leave the same junction by the same branch and lead to different ones"
        )
        said.append((told, _ends(a, row_a), _ends(b, row_b)))
    return said


def _ends(m: Prepared, row: int) -> tuple[int, int]:
    return int(m.tail[row]), int(m.head[row])


def _unseen(vertex: int, run: str, row: int, other: Prepared) -> str:
    return (
        f"junction {vertex} of {run} falls inside corridor {_name(other, row)} of {other.run}, "
        "unseen there"
    )


def _name(m: Prepared, row: int) -> str:
    return f"{int(m.tail[row])} to {int(m.head[row])}"


def place(topomap: TopoMap, vertex: int) -> str:
    """A junction by number and position."""
    x, y = topomap.xy[vertex].tolist()
    return f"junction {vertex} ({x:.1f}, {y:.1f})"
