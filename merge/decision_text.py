"""A decision in words: one screen of a terminal, and the texts of a recording.

Degrees and decimals for people; documents hold radians.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from textwrap import wrap

import numpy as np

from ..topology.arrays import FloatArray
from ..topology.digits import BITS
from ..topology.wording import counted
from ..topology.wording import listed as names_listed
from .decision import AGAINST, LINKS, Decision, Placement, Start, Term, TermKind, rounded_terms
from .discards import REASON, discarded
from .result import PairVerdict, Verdict, shown_bits, shown_lead
from .wording import AGREES_BITS, decimals, what_agrees

WIDTH, HEIGHT = 79, 22
"""Columns and lines of the smallest usual terminal, minus two lines for the file and the prompt;
the default of `lines`."""

NOTABLE_BITS = 0.05
"""Smaller evidence against a placement is not listed first."""

LONGEST_NAME = 18
"""Longer names of runs are shortened in the middle."""


@dataclass(frozen=True, slots=True)
class Row:
    """A row of the table of evidence.

    told: in words; bits: of each placement, None if it has no such part; a, b: the junctions
    concerned; level: 0 for sums, 1 for their parts.
    """

    told: str
    bits: tuple[float | None, ...]
    a: str = ""
    b: str = ""
    level: int = 0


def short(run: str, most: int = LONGEST_NAME) -> str:
    """A run's name, shortened in the middle to fit a column."""
    if len(run) <= most:
        return run
    half = (most - 1) // 2
    return f"{run[: most - 1 - half]}…{run[len(run) - half :]}"


def headline(decision: Decision) -> str:
    """The verdict and its numbers, in one line."""
    said = decision.said
    pair = f"{short(said.a)} and {short(said.b)}"
    bits = f"{decision_bits(decision)} bits of evidence"
    need = f"{threshold(decision)} needed"
    if said.accepted:
        others = sorted({*(run for side in said.together or () for run in side)} - {said.a, said.b})
        by = {
            "pair": "merged",
            "components": f"merged, together with {listed(others)}",
            "runs": "merged, as other runs say",
            "lock": "merged, locked as the same",
            None: "merged",
        }[said.accepted_by]
        return f"{pair}: {by}: {bits}, {need}"
    if said.through:
        alone = f"by itself {said.verdict}, {decision_bits(decision)} bits"
        return f"{pair}: joined through {listed(said.through)}: {alone}"
    by = "locked apart" if said.locked == "never" else said.standing
    return f"{pair}: {by}: {bits}, {need}"


def listed(runs: Sequence[str], most: int = 3) -> str:
    """The first names, shortened, and how many more there are."""
    return names_listed(list(map(short, runs)), most)


def decision_bits(decision: Decision) -> str:
    """The evidence, with the decimals of this decision."""
    return shown_bits(decision.said.evidence_bits, digits_of(decision))


def threshold(decision: Decision) -> str:
    """The threshold, with the decimals of this decision."""
    return shown_bits(decision.requirement.threshold_bits, digits_of(decision))


def digits_of(decision: Decision) -> int:
    """Decimals that show on which side of the threshold the evidence lies, and whether the lead
    over the next best placement is the required one."""
    margin, required = decision.said.margin_bits, decision.requirement.lead_bits
    fewest = decimals(decision.said.evidence_bits, decision.requirement.threshold_bits)
    if margin is None:
        return fewest
    enough = (
        digits
        for digits in range(fewest, BITS)
        if (_lead(decision, margin, digits) < required) == (margin < required)
    )
    return next(enough, BITS)


def _lead(decision: Decision, margin: float, digits: int) -> float:
    """The lead of the first placement, as the difference of the two sums that are shown."""
    if len(decision.placements) < 2:
        return float(shown_bits(margin, digits))
    one, two = (p.alignment.evidence_bits for p in decision.placements[:2])
    return shown_lead(one, two, digits)


def because(decision: Decision) -> str:
    """The reason in one sentence."""
    said = decision.said
    if decided := _by_a_person(said):
        return decided
    if not decision.placements:
        return "No significant match: no similar corridors."
    if decision.start is not None:
        return _given_up(said, decision.start, decision.placements[0])
    agree = agreement(decision.placements[0])
    if said.accepted or decision.why:
        but = f", but {decision.why}" if decision.why else ""
        alone = "" if len(decision.placements) > 1 else "; no other placement comes near"
        return f"{agree}{but}{alone}."
    if said.verdict is Verdict.UNRELATED:
        return f"No significant match: {agree}; too little evidence."
    return f"{agree}; {said.reason.rsplit('; ', 1)[-1]}."


def _by_a_person(said: PairVerdict) -> str:
    """What a person decided against a pair; "" where nobody did."""
    if said.locked == "never":
        return "Locked apart by a person."
    if discarded(said):
        undo = "topobatch discard A:B --undo lets it count"
        return f"{REASON[0].upper()}{REASON[1:]}: what is shown does not count ({undo})."
    return ""


def _given_up(said: PairVerdict, start: Start, shown: Placement) -> str:
    """Why the best hypothesis was rejected. shown: the placement that it began with."""
    count = counted(start.hypotheses, "hypothesis", "hypotheses")
    begun = counted(len(shown.alignment.matched), "junction")
    found = f"{start.found} {'was' if start.found == 1 else 'were'} found"
    return (
        f"No significant match: the best of {count}, begun with the {begun} shown, was rejected. "
        f"Of {counted(start.expected, 'junction')} of {short(said.b)} that it places where "
        f"{short(said.a)} has been, {found}; {start.needed} needed. It counts as 0 bits."
    )


def agreement(placement: Placement) -> str:
    """What agrees, and what contradicts."""
    views = sum(t.bits > AGREES_BITS for t in placement.of("views"))
    junctions, corridors = len(placement.of("branches")), placement.alignment.corridors
    return f"{what_agrees(junctions, corridors, views)}, {_contradicted(placement)}"


def _contradicted(placement: Placement) -> str:
    against = len(placement.of(*AGAINST))
    if against:
        return f"{against} {'contradicts' if against == 1 else 'contradict'}"
    return "nothing contradicts" if placement.searched else "contradictions were not looked for"


def pose(placement: Placement) -> str:
    """Position of b in a's frame."""
    return pose_told(placement.alignment.transform)


def pose_told(transform: FloatArray) -> str:
    """A transform in metres and degrees."""
    x, y, theta = transform.tolist()
    return f"({x:.2f}, {y:.2f}) m, turned by {np.degrees(theta):.1f}°"


def lies(decision: Decision) -> str:
    """Where b lies in a's frame, or would lie; "" if unknown."""
    said = decision.said
    frame = f"in {short(said.a)}'s frame"
    if decision.by_others is not None:
        sure = ""
        if said.placed is not None:
            sure = f", to {said.placed[0]:.1f} m and {np.degrees(said.placed[1]):.1f}° (1 sigma)"
        return (
            f"By the others {short(said.b)} lies at {pose_told(decision.by_others)}, {frame}{sure}"
        )
    if not decision.placements:
        return ""
    if decision.start is not None and not _by_a_person(said):
        return (
            f"By it {short(said.b)} would lie at {pose(decision.placements[0])}, {frame}; a lock "
            "needs --at for that, and more for it than against it"
        )
    told = "lies" if said.accepted else "would lie"
    return f"{short(said.b)} {told} at {pose(decision.placements[0])}, {frame}"


def rows(decision: Decision, links: int) -> list[Row]:
    """The table of evidence: the sums of every placement, and at most `links` of the largest links
    of the first one. The column of each placement adds up as shown."""
    digits = digits_of(decision)
    columns = [_groups(p, digits) for p in decision.placements]
    if not columns:
        return []
    first = decision.placements[0]
    out = []
    for kind in [kind for kind in _GROUPS if any(kind in column for column in columns)]:
        bits = tuple(column.get(kind) for column in columns)
        out.append(Row(_group_told(kind, decision.placements), bits))
        if kind in ("corridor", "unseen") and bits[0] is not None:
            out += _parts(itemised(first, kind, digits), links, digits)
    return out


_GROUPS: dict[TermKind, tuple[TermKind, ...]] = {
    "corridor": LINKS,
    "branches": ("branches",),
    "views": ("views",),
    "unseen": AGAINST,
    "hypotheses": ("hypotheses",),
    "few": ("few",),
    "copies": ("copies",),
}
"""Kinds of terms that are summed in one row, in the order of rows."""


def _groups(placement: Placement, digits: int) -> dict[TermKind, float]:
    """The sum of every group of terms, rounded so that the sums add up; contradictions are listed
    even if there are none."""
    sums = [sum(t.bits for t in placement.of(*kinds)) for kinds in _GROUPS.values()]
    total = float(shown_bits(placement.alignment.evidence_bits, digits))
    shown = rounded_terms(sums, digits, total)
    there = {t.kind for t in placement.terms}
    always = ("corridor", "branches", "unseen", "hypotheses")
    return {
        kind: bits
        for kind, bits in zip(_GROUPS, shown, strict=True)
        if kind in always or kind in there
    }


def _group_told(kind: TermKind, placements: Sequence[Placement]) -> str:
    first = placements[0]
    count = len(first.of("branches"))
    return {
        "corridor": f"{counted(len(first.of(*LINKS)), 'link')} between matched junctions",
        "branches": f"branches of {counted(count, 'junction')}",
        "views": _views_told(placements),
        "unseen": _against_told(placements),
        "hypotheses": next((t.told for t in first.of("hypotheses")), ""),
        "few": next((t.told for p in placements for t in p.of("few")), ""),
        "copies": next((t.told for t in first.of("copies")), "is it a copy?"),
    }[kind]


def _views_told(placements: Sequence[Placement]) -> str:
    """In how many parts of the overlap views speak for the first placement, and against it."""
    bits = [t.bits for t in placements[0].of("views")]
    agree, against = sum(b > 0 for b in bits), sum(b < 0 for b in bits)
    return f"views in {counted(len(bits), 'part')} of the overlap: {agree} for, {against} against"


def _against_told(placements: Sequence[Placement]) -> str:
    """The number of contradictions of the first placement, or that only the next one has some."""
    first, *others = (len(p.of(*AGAINST)) for p in placements)
    if first:
        return counted(first, "contradiction")
    told = _contradicted(placements[0])
    return f"{told}; next: {counted(others[0], 'contradiction')}" if any(others) else told


def itemised(placement: Placement, group: TermKind, digits: int) -> list[Term]:
    """The terms of a group, evidence against it and the largest first, rounded so that they add up
    to the group's sum: each reads alike wherever it is shown."""
    terms = placement.of(*_GROUPS[group])
    ordered = sorted(terms, key=lambda t: (t.bits > -NOTABLE_BITS, -abs(t.bits)))
    bits = rounded_terms([t.bits for t in ordered], digits, _groups(placement, digits)[group])
    return [replace(t, bits=told) for t, told in zip(ordered, bits, strict=True)]


def _parts(terms: Sequence[Term], most: int, digits: int) -> list[Row]:
    """The first terms of a group, and the rest in one row."""
    count = len(terms) if len(terms) <= most else max(most - 1, 0)
    if count == 0:
        return []
    out, left = list(map(_link, terms[:count])), [t.bits for t in terms[count:]]
    return [*out, Row(f"{len(left)} more", (round(sum(left), digits),), level=1)] if left else out


def _link(term: Term) -> Row:
    ends = ("-".join(map(str, term.a)), "-".join(map(str, term.b)))
    return Row(term.with_size, (term.bits,), *ends, level=1)


def needs(decision: Decision) -> str:
    """What the threshold is made of, and the other requirements."""
    need = decision.requirement
    pairs = counted(need.pairs, "pair")
    if need.unrounded_pairs is not None:
        pairs = f"{counted(need.unrounded_pairs, 'pair')}, counted as {need.pairs:,},"
    return (
        f"log2({pairs} / rate {need.false_merge_rate:g}), "
        f"{need.least_junctions} junctions, lead {need.lead_bits:g} bits"
    )


def missing(decision: Decision) -> str:
    """What an ambiguous pair lacks and what would settle it; "" for others."""
    said = decision.said
    if said.verdict is not Verdict.AMBIGUOUS or said.accepted:
        return ""
    lacks = []
    digits, needed = digits_of(decision), decision.requirement.threshold_bits
    if said.evidence_bits < needed:
        lacking = float(threshold(decision)) - float(decision_bits(decision))
        lacks.append(f"{shown_bits(lacking, digits)} bits of evidence")
    required = decision.requirement.lead_bits
    if said.margin_bits is not None and said.margin_bits < required:
        lacking = required - _lead(decision, said.margin_bits, digits)
        lacks.append(f"{shown_bits(lacking, digits)} bits of lead")
    best = decision.placements[0].alignment if decision.placements else None
    count = len(best.matched) - len(best.contradictions) if best else 0
    if count < decision.requirement.least_junctions:
        lacks.append(counted(decision.requirement.least_junctions - count, "junction"))
    told = "Missing: " + " and ".join(lacks) if lacks else ""
    advice = f"To settle it: {said.advice}" if said.advice else ""
    return ". ".join(part for part in (told, advice) if part)


def sum_told(decision: Decision) -> str:
    """Label of the sum of the terms, with the lead over the next best placement."""
    if decision.start is not None:
        return "what the hypothesis had, not counted"
    if discarded(decision.said):
        return "what the match had, not counted"
    margin = decision.said.margin_bits
    if len(decision.placements) < 2 or margin is None:
        return "evidence"
    digits = digits_of(decision)
    lead = shown_bits(abs(_lead(decision, margin, digits)), digits)
    which = "behind" if other_name(decision) == OTHER else "ahead of"
    return f"evidence, {lead} bits {which} the {other_name(decision)}"


NEXT, OTHER = "next best", "other placement"


def other_name(decision: Decision) -> str:
    """What the second placement is called. It has more evidence than the first one where a person
    or other runs chose that."""
    margin = decision.said.margin_bits
    if margin is None or _lead(decision, margin, digits_of(decision)) >= 0:
        return NEXT
    return OTHER


def matched(placement: Placement) -> str:
    """The matched junctions, junction of a = junction of b."""
    return " ".join(f"{u}={v}" for u, v in placement.alignment.matched.tolist())


def lines(decision: Decision, links: int | None = None, width: int = WIDTH) -> list[str]:
    """The decision as lines of a terminal, `width` columns wide, the verdict first. links: most
    rows of links; by default as many as fit one screen."""
    if links is not None:
        return _lines(decision, links, width)
    tried = (_lines(decision, most, width) for most in range(HEIGHT, -1, -1))
    whole = next((found for found in tried if len(found) <= HEIGHT), None)
    return _lines(decision, 0, width, brief=True) if whole is None else whole


def _lines(decision: Decision, links: int, width: int, *, brief: bool = False) -> list[str]:
    """brief: without what the recording shows better, if long names leave too little room."""
    said = decision.said
    out = [
        *_folded(headline(decision), width),
        *_folded(because(decision), width, "  ", most=2 if brief else 3),
    ]
    out += _folded(lies(decision), width, "  ")
    if len(decision.placements) > 1:
        second = f"the {other_name(decision)} lays it at {pose(decision.placements[1])}"
        out += _folded(second, width, "  ")
    out += _table(decision, links, width)[brief:]
    if decision.placements and not brief:
        pairs = f"{short(said.a)} = {short(said.b)}: {matched(decision.placements[0])}"
        out += _folded(pairs, width, "  ", most=1)
    out += _folded(missing(decision), width, "  ", most=4)
    for note in decision.notes:
        out += _folded(f"Note: {note}", width, "  ")
    return out


def _folded(text: str, width: int, indent: str = "", most: int = 3) -> list[str]:
    """A text wrapped to several lines, cut after `most`. Long words, paths for instance, stay
    whole."""
    found = wrap(
        text,
        width,
        initial_indent=indent,
        subsequent_indent=indent + "  ",
        break_long_words=False,
        break_on_hyphens=False,
    )
    if len(found) > most:
        found = [*found[: most - 1], found[most - 1][: width - 2].rstrip() + " …"]
    return found


def _table(decision: Decision, links: int, width: int) -> list[str]:
    """The table of evidence, its sum and the requirements."""
    digits, count = digits_of(decision), len(decision.placements)
    if not count:
        return [_row([threshold(decision)], f"bits needed: {needs(decision)}", width)]
    names = (short(decision.said.a, 10), short(decision.said.b, 10))
    head = ["this", "next"][:count] if count > 1 else ["bits"]
    out = ["", _row(head, "for (+) and against it (-)", width, names)]
    for row in rows(decision, links):
        cells = ["" if bits is None else f"{bits:+.{digits}f}" for bits in row.bits]
        told = row.told
        if row.level:  # a part of the sum above: its bits stand out of the column that adds up
            told, cells = f"{cells[0]:>7}  {told}", [""]
        cells += [""] * (count - len(cells))
        out.append(_row(cells, told, width, (row.a, row.b)))
    sums = [f"= {shown_bits(p.alignment.evidence_bits, digits)}" for p in decision.placements]
    out.append(_row(sums, sum_told(decision), width))
    blank = [""] * (count - 1)
    need = wrap(f"needed: {needs(decision)}", width - 8 * count - 2, subsequent_indent="  ")
    out.append(_row([threshold(decision), *blank], need[0], width))
    return [*out, *(_row([""] * count, line, width) for line in need[1:])]


def _row(cells: Sequence[str], told: str, width: int, ends: tuple[str, str] = ("", "")) -> str:
    left = "".join(f"{cell:>8}" for cell in cells) + "  "
    right = f" {ends[0]:>10} {ends[1]:>10}" if any(ends) else ""
    room = width - len(left) - len(right)
    return f"{left}{told[:room]:<{room}}{right}".rstrip()
