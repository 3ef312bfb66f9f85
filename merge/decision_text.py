"""A decision in words: one screen of a terminal, and the texts of drawings and of the report.

Degrees and decimals for people; documents hold radians.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from textwrap import wrap

import numpy as np

from ..topology.arrays import FloatArray
from ..topology.wording import MOST_NAMES, counted, folded
from ..topology.wording import listed as names_listed
from .decision import AGAINST, LINKS, Decision, Placement, Term, TermKind
from .locks import DISCARDED, discarded
from .result import PairVerdict, Standing, Verdict, shown_bits
from .robust.settings import MATCH
from .wording import AGREES_BITS, SAME_PLACE, decimals, describe_agreement, describe_bits

WIDTH = 79
"""Columns of the smallest usual terminal."""

MOST_LINKS = 8
"""Rows of links by default: with them most decisions fit a terminal of 24 lines."""

TITLE = "for (+) and against it (-)"
"""Of the table of evidence; a narrower column of texts has the junctions in it as well."""

INDENT = ("  ", "    ")
"""Of a line below the headline, and of its continuation."""

LONGEST_NAME = 18
"""Longer names of runs are shortened in the middle."""


@dataclass(frozen=True, slots=True)
class Row:
    """A row of the table of evidence.

    text: in words; bits: of each placement, None if it has no such part; a, b: the junctions
    concerned; level: 0 for sums, 1 for their parts.
    """

    text: str
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
    pair = decision.pair
    names = f"{short(pair.a)} and {short(pair.b)}"
    bits, need = _shown(decision, pair.evidence_bits), _threshold(decision)
    numbers = f"{bits} bits of evidence, {need} needed"
    if pair.accepted:
        others = sorted({*(run for side in pair.together or () for run in side)} - {pair.a, pair.b})
        by = {
            "pair": "merged",
            "components": f"merged, together with {listed(others)}",
            "runs": "merged, as other runs say",
            "lock": "merged, locked as the same",
            None: "merged",
        }[pair.accepted_by]
        return f"{names}: {by}: {numbers}"
    if pair.through:
        links = [f"{short(a)} + {short(b)} {shown_bits(own)} bits" for a, b, own in decision.chain]
        return f"{names}: one place through {listed(pair.through)}: {', '.join(links)}"
    by = "locked apart" if pair.locked == "never" else pair.standing
    return f"{names}: {by}: {numbers}"


def listed(runs: Sequence[str], most: int = 3) -> str:
    """The first names, shortened, and how many more there are."""
    return names_listed(list(map(short, runs)), most)


def _shown(decision: Decision, bits: float) -> str:
    """Evidence with the decimals of this decision."""
    return shown_bits(bits, digits_of(decision))


def _threshold(decision: Decision) -> str:
    return _shown(decision, decision.requirement.threshold_bits)


def digits_of(decision: Decision) -> int:
    """Decimals that show on which side of the threshold the evidence lies."""
    return decimals(decision.pair.evidence_bits, decision.requirement.threshold_bits)


def because(decision: Decision) -> str:
    """The reason in one sentence; of a pair that others join, what its own maps say."""
    pair = decision.pair
    if pair.through:
        bits = _shown(decision, pair.evidence_bits)
        alone = f"{pair.verdict}, {bits} bits, {_threshold(decision)} needed"
        own = because(replace(decision, pair=replace(pair, through=())))
        return f"By the two maps alone {alone}: {own[0].lower()}{own[1:]}"
    if decided := _by_a_person(pair):
        return decided
    if not decision.placements or not decision.placements[0].terms:
        nothing = "No significant match: no alignment of the two maps holds"
        reason = f"{pair.reason.partition(': ')[2] if decision.placements else nothing}."
        if pair.together:
            one, other = (listed(side, MOST_NAMES) for side in pair.together)
            reason += (
                f" The evidence is that of the maps that were joined: of {one}; and of {other}."
            )
        return reason
    agree = agreement(decision.placements[0])
    if pair.accepted or decision.why:
        but = f", but {decision.why}" if decision.why else ""
        alone = "" if len(decision.placements) > 1 else "; no other placement comes near"
        return f"{agree}{but}{alone}."
    if pair.verdict is Verdict.UNRELATED:
        return f"No significant match: {agree}; too little evidence."
    return f"{agree}; {pair.reason.rsplit('; ', 1)[-1]}."


def _by_a_person(pair: PairVerdict) -> str:
    """What a person decided against a pair; "" where nobody did."""
    if pair.locked == "never":
        return "Locked apart by a person."
    if discarded(pair):
        undo = "topobatch discard A:B --undo lets it count"
        return f"{DISCARDED[0].upper()}{DISCARDED[1:]}: what is shown does not count ({undo})."
    return ""


def agreement(placement: Placement) -> str:
    """What agrees, and what contradicts."""
    views = sum(t.bits > AGREES_BITS for t in placement.of("views"))
    junctions, corridors = len(placement.of("branches")), placement.alignment.corridors
    return f"{describe_agreement(junctions, corridors, views)}, {_contradicted(placement)}"


def _contradicted(placement: Placement) -> str:
    """How much contradicts a placement."""
    against = len(placement.of(*AGAINST))
    if against:
        return f"{against} {'contradicts' if against == 1 else 'contradict'}"
    return "nothing contradicts" if placement.searched else "contradictions were not looked for"


def weakest_links(pairs: Iterable[PairVerdict], home: Mapping[str, int]) -> dict[int, str]:
    """Of every component the pair with the least evidence of those that hold its runs together
    best, in words. home: the component of every run."""
    from scipy.cluster.hierarchy import DisjointSet

    out: dict[int, str] = {}
    joined = DisjointSet(home)
    for pair in sorted((p for p in pairs if p.accepted), key=lambda p: -p.evidence_bits):
        need = pair.threshold_bits
        if need is not None and pair.a in home and joined.merge(pair.a, pair.b):
            bits = describe_bits(pair.evidence_bits, need)
            why = "joined by a lock" if pair.accepted_by == "lock" else bits
            out[home[pair.a]] = f"; weakest link {pair.a} + {pair.b}, {why}"
    return out


def _pose(transform: FloatArray) -> str:
    """A transform in metres and degrees."""
    x, y, theta = transform.tolist()
    return f"({x:.2f}, {y:.2f}) m, turned by {np.degrees(theta):.1f}°"


def lies(decision: Decision) -> str:
    """Where b lies in a's frame, or would lie; "" if unknown."""
    pair = decision.pair
    frame = f"in {short(pair.a)}'s frame"
    if decision.by_others is not None:
        sure = ""
        if pair.placed is not None:
            sure = f", to {pair.placed[0]:.1f} m and {np.degrees(pair.placed[1]):.1f}° (1 sigma)"
        return f"{short(pair.b)} lies at {_pose(decision.by_others)}, {frame}{sure}"
    if not decision.placements:
        return ""
    text = "lies" if pair.accepted else "would lie"
    where = _pose(decision.placements[0].alignment.transform)
    return f"{short(pair.b)} {text} at {where}, {frame}"


def rows(decision: Decision, links: int) -> list[Row]:
    """The table of evidence: the sums of every placement, and at most `links` of the largest links
    of the first one."""
    placements = decision.placements
    shown = [p for p in placements if p.terms]
    out: list[Row] = []

    def add(text: str, *kinds: TermKind, always: bool = False, each: bool = False) -> None:
        """Add the sums of some kinds of terms. always: also where there are none; each: followed by
        the terms."""
        terms = [p.of(*kinds) for p in shown]
        if always or any(terms):
            bits = tuple(sum(t.bits for t in own) if own or always else None for own in terms)
            out.append(Row(text, bits))
            if each and bits[0] is not None:
                out.extend(_parts(itemised(shown[0], kinds), links))

    if shown:
        first = placements[0]
        number = counted(len(first.of(*LINKS)), "link")
        add(f"{number} between matched junctions", *LINKS, always=True, each=True)
        number = counted(len(first.of("branches")), "junction")
        add(f"branches of {number}", "branches", always=True)
        add(_views_text(placements), "views")
        add(_against_text(placements), *AGAINST, always=True, each=True)
        add(_first_text([first], "hypotheses"), "hypotheses", always=True)
        add(_first_text(placements, "few"), "few")
        add(_first_text([first], "copies") or SAME_PLACE, "copies")
    return out


def _views_text(placements: Sequence[Placement]) -> str:
    """In how many parts of the overlap views speak for the first placement, and against it."""
    bits = [t.bits for t in placements[0].of("views")]
    agree, against = sum(b > 0 for b in bits), sum(b < 0 for b in bits)
    return f"views in {counted(len(bits), 'part')} of the overlap: {agree} for, {against} against"


def _against_text(placements: Sequence[Placement]) -> str:
    """The number of contradictions of the first placement, or that only the next one has some."""
    first, *others = (len(p.of(*AGAINST)) for p in placements)
    if first:
        return counted(first, "contradiction")
    text = _contradicted(placements[0])
    return f"{text}; next: {counted(others[0], 'contradiction')}" if any(others) else text


def _first_text(placements: Sequence[Placement], *kinds: TermKind) -> str:
    """The words of the first such term of any placement, "" without one."""
    return next((t.text for p in placements for t in p.of(*kinds)), "")


def itemised(placement: Placement, kinds: Sequence[TermKind]) -> list[Term]:
    """The terms of some kinds, evidence against the placement and the largest first."""
    return sorted(placement.of(*kinds), key=lambda t: t.bits >= 0)


def _parts(terms: Sequence[Term], most: int) -> list[Row]:
    """The first terms of a group, and the rest in one row."""
    count = len(terms) if len(terms) <= most else max(most - 1, 0)
    if count == 0:
        return []
    out, left = list(map(_link, terms[:count])), [t.bits for t in terms[count:]]
    return [*out, Row(f"{len(left)} more", (sum(left),), level=1)] if left else out


def _link(term: Term) -> Row:
    ends = ("-".join(map(str, term.a)), "-".join(map(str, term.b)))
    return Row(term.with_size, (term.bits,), *ends, level=1)


def needs(decision: Decision) -> str:
    """What the threshold is made of, and the other requirements."""
    need = decision.requirement
    exact = need.pairs < 1 << MATCH.pair_digits
    pairs = counted(need.pairs, "pair") + ("" if exact else ", rounded up,")
    return (
        f"log2({pairs} / rate {need.false_merge_rate:g}); "
        f"{need.least_junctions} junctions; a lead of {need.lead_bits:g} bits"
    )


def advice(decision: Decision) -> str:
    """What would settle a pair that is open; "" for others."""
    pair = decision.pair
    is_open = pair.standing is Standing.AMBIGUOUS
    return f"To settle it: {pair.advice}" if is_open and pair.advice else ""


_ADVISED = re.compile(r"the corridor that (.+) (?:drove|shows) from its junction (\d+) to (\d+) ")


def to_record(pair: PairVerdict) -> tuple[str, tuple[int, int]] | None:
    """The corridor that the advice on a pair names: the run that has it, and its ends in the map of
    that run; None where it names none."""
    found = _ADVISED.search(pair.advice or "")
    return None if found is None else (found[1], (int(found[2]), int(found[3])))


def sum_label(decision: Decision) -> str:
    """Label of the sum of the terms, with the lead over the next best placement."""
    if discarded(decision.pair):
        return "what the match had, not counted"
    if decision.pair.together:
        return "evidence, of the maps that were joined"
    margin = decision.pair.margin_bits
    if len(decision.placements) < 2 or margin is None:
        return "evidence"
    lead = shown_bits(abs(margin), digits_of(decision))
    which = "behind" if other_name(decision) == OTHER else "ahead of"
    return f"evidence, {lead} bits {which} the {other_name(decision)}"


NEXT, OTHER = "next best", "other placement"


def other_name(decision: Decision) -> str:
    """What the second placement is called. It has more evidence than the first one where a person
    or other runs chose that."""
    margin = decision.pair.margin_bits
    return NEXT if margin is None or margin >= 0 else OTHER


def matched(placement: Placement) -> str:
    """The matched junctions, junction of a = junction of b."""
    return " ".join(f"{u}={v}" for u, v in placement.alignment.matched.tolist())


def lines(decision: Decision, links: int | None = None, width: int = WIDTH) -> list[str]:
    """The decision as lines of a terminal, `width` columns wide, the verdict first. links: most
    rows of links, `MOST_LINKS` by default."""
    pair = decision.pair
    out = folded(headline(decision), width, rest="  ")
    reasons = [because(decision), lies(decision)]
    poses = [p.alignment.transform for p in decision.placements]
    for line in reversed(reasons) if pair.through else reasons:
        out += folded(line, width, *INDENT)
    if pair.through and decision.placements:
        own = f"their own best placement, at {_pose(poses[0])}, does not count:"
        out += folded(own, width, *INDENT)
    elif len(decision.placements) > 1:
        second = f"the {other_name(decision)} lays it at {_pose(poses[1])}"
        out += folded(second, width, *INDENT)
    out += _table(decision, MOST_LINKS if links is None else links, width)
    if decision.placements:
        pairs = f"{short(pair.a)} = {short(pair.b)}: {matched(decision.placements[0])}"
        out += folded(pairs, width, *INDENT)
    out += folded(advice(decision), width, *INDENT)
    for note in decision.notes:
        out += folded(f"Note: {note}", width, *INDENT)
    return out


def _table(decision: Decision, links: int, width: int) -> list[str]:
    """The table of evidence, its sum and the requirements; the junctions of both on the right."""
    digits, count, pair = digits_of(decision), len(decision.placements), decision.pair

    def line(cells: Sequence[str], text: str, a: str = "", b: str = "") -> list[str]:
        left = "".join(f"{cell:>8}" for cell in [*cells, *[""] * (count - len(cells))]) + "  "
        right = f" {a:>10} {b:>10}" if a or b else ""
        room = width - len(left) - len(right)
        if right and room < len(TITLE):
            text, right, room = f"{text} ({a}, {b})", "", width - len(left)
        first, *more = wrap(text, room, subsequent_indent="  ", break_long_words=False)
        return [f"{left}{first:<{room}}{right}".rstrip(), *(" " * len(left) + m for m in more)]

    if not count:
        needed = f"{_threshold(decision)} bits needed: {needs(decision)}"
        return folded(needed, width, "    ", "      ")
    head = ["this", "next"][:count] if count > 1 else ["bits"]
    names = (short(pair.a, 10), short(pair.b, 10))
    shown = rows(decision, links)
    out = ["", *(line(head, TITLE, *names) if shown else ())]
    for row in shown:
        cells = ["" if bits is None else f"{bits:+z.{digits}f}" for bits in row.bits]
        text = row.text
        if row.level:  # a part of the sum above: its bits stand out of the column that adds up
            text, cells = f"{cells[0]:>7}  {text}", []
        out += line(cells, text, row.a, row.b)
    sums = [f"= {shown_bits(p.alignment.evidence_bits, digits)}" for p in decision.placements]
    out += line(sums, sum_label(decision))
    return out + line([_threshold(decision)], f"needed: {needs(decision)}")


def named_views(term: Term) -> str:
    """The title of a picture of two views."""
    return f"views {'for' if term.bits > 0 else 'against'} it: {term.bits:+.1f} bits"
