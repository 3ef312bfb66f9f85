"""From candidate alignments of two maps to one of three verdicts."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ...topology.digits import BITS, rounded
from ..result import CopyTest, Verdict
from .alignment import Candidate
from .prepare import Prepared
from .repetition import CopyModel, Sameness, sameness, size_sigmas
from .settings import MATCH, RobustSettings
from .view_evidence import CONSISTENT_M

OTHER_SIZE = "one is larger throughout: this may be a copy of another size"

NO_WORSE = "another placement that chance does not explain has no more against it"
MAYBE_COPY = "this may be another copy of the place, as buildings in this merge repeat themselves"

NEARLY = "another placement fits nearly as well"

MIRRORED = "its mirror image fits nearly as well: this may be a copy built the other way round"

ELSEWHERE = "by another placement"
"""The doubt where a lock joins two maps by another placement than their evidence."""

NOTHING_ALIKE = "they have nothing in common that chance would not offer"

DOUBTS = (OTHER_SIZE, NO_WORSE, MAYBE_COPY, NEARLY, MIRRORED, ELSEWHERE, NOTHING_ALIKE)
"""Reasons against merging other than too little evidence: the two may be different places."""


@dataclass(frozen=True, slots=True)
class Threshold:
    """The evidence that a pair must reach.

    need_bits: against chance; need_copy_bits: against being a copy, in full for an alignment of
    repetition 1; copied: junctions of the largest part of either map that matches another part of
    it; copies: how copies differ in buildings like theirs; unrepeated_bits: evidence that such
    buildings do not repeat themselves, where corridors of few lengths suggest it.

    A repetition is how likely an alignment is a copy by one of its features, 0 to 1.
    """

    need_bits: float
    need_copy_bits: float
    copied: float
    copies: CopyModel
    settings: RobustSettings
    unrepeated_bits: float = 0.0

    def repetition_by_lengths(self, a: Prepared, b: Prepared) -> float:
        """The repetition by corridors of few lengths, for all alignments of two maps."""
        unrepeated = self.unrepeated_bits / self.need_copy_bits if self.need_copy_bits else 0.0
        return max(uniformity(a, b) - unrepeated, 0.0)

    def repetition_by_size(self, best: Candidate) -> float:
        """The repetition by size: 1 if an alignment has no more junctions than the largest copy
        within a map, 0 from twice as many on.

        Agreeing parts of the overlap count as junctions where views proposed it. Without this
        tunnels are merged wrongly (`benchmarks/aliasing.py --without "small copies"`).
        """
        size = len(best) + (best.views.agreeing if best.by_views else 0)
        return _share(2.0 - size / self.copied) if self.copied else 0.0

    def repetition_by_views(self, c: Candidate) -> float:
        """The repetition by views; 0 where junctions alone suffice and neither map shows a copy."""
        by_junctions = c.bits - c.views.total >= self.need_bits and not self.copied
        return 0.0 if by_junctions else c.views.repeated


@dataclass(frozen=True, slots=True, eq=False)
class Weighed:
    """A placement better than chance, with its evidence against chance and against being a copy.

    need: the threshold against chance [bits]; copy_test: the test for copies, None if not applied.
    """

    candidate: Candidate
    need: float
    copy_test: CopyTest | None = None

    @property
    def chance_bits(self) -> float:
        """Evidence against chance: `counted_bits`."""
        return self.candidate.counted_bits

    @property
    def bits(self) -> float:
        """The evidence for merging: the lower one of the two."""
        return min(self.chance_bits, self.copy_bits)

    @property
    def copy_bits(self) -> float:
        """Evidence against being a copy, shifted so that its threshold is `need`; inf if not
        tested. The less likely a copy, the less it bounds the evidence."""
        test = self.copy_test
        if test is None or not test.repetition:
            return np.inf
        beyond = test.bits - test.needed_bits
        return self.need + (beyond / test.repetition if beyond > 0 else beyond)


@dataclass(frozen=True, slots=True)
class Faint:
    """An alignment no better than chance: its junctions and evidence [bits]."""

    junctions: int
    bits: float


def faint_alignment(candidates: Sequence[Candidate]) -> Faint | None:
    """Junctions and evidence of the best candidate; None if there is none."""
    return next((Faint(len(c), c.counted_bits) for c in candidates), None)


@dataclass(frozen=True, slots=True, eq=False)
class Assessment:
    """The assessment of two maps by themselves, without locks and other runs.

    need_bits: the threshold. ranked: placements better than chance, best first; lead_bits: required
    lead of the best one. why: what was missing for merging, "" if merged; faint: the best alignment
    if none is better than chance; discarded: whether the match was discarded by the user.
    """

    verdict: Verdict
    need_bits: float
    ranked: tuple[Weighed, ...] = ()
    why: str = ""
    faint: Faint | None = None
    discarded: bool = False
    lead_bits: float = MATCH.lead_bits

    @property
    def best(self) -> Candidate | None:
        """The placement that the verdict refers to, if any is beyond chance."""
        return self.ranked[0].candidate if self.ranked else None

    @property
    def bits(self) -> float:
        """The evidence for the best placement; 0 if no placement was found at all."""
        if self.ranked:
            return self.ranked[0].bits
        return 0.0 if self.faint is None else self.faint.bits

    @property
    def copy_test(self) -> CopyTest | None:
        """Whether the best placement is a copy, None if not tested."""
        return self.ranked[0].copy_test if self.ranked else None

    @property
    def runner_up(self) -> Candidate | None:
        """The next best placement, if there is one beyond chance."""
        return self.ranked[1].candidate if len(self.ranked) > 1 else None

    @property
    def margin(self) -> float | None:
        """The lead over the runner-up [bits], if there is one."""
        if len(self.ranked) < 2:
            return None
        return max(self.ranked[0].bits - self.ranked[1].bits, 0.0)  # less is rounding


def threshold_for(
    pairs: int,
    beyond: int,
    copies: CopyModel,
    settings: RobustSettings,
    *,
    copied: float = 0.0,
    unrepeated_bits: float = 0.0,
) -> Threshold:
    """The threshold in a batch of so many pairs. Every pair has an equal share of the false-merge
    rate. beyond: number of pairs with an alignment beyond chance: only these can be merged wrongly
    because they are copies; copies, copied, unrepeated_bits: as in `Threshold`."""
    against_copies = max(needed_bits(beyond, settings) - settings.copy_margin_bits, 0.0)
    need = needed_bits(pairs, settings)
    return Threshold(need, against_copies, copied, copies, settings, unrepeated_bits)


def needed_bits(pairs: int, settings: RobustSettings) -> float:
    """Threshold against chance with `pairs` pairs (Bonferroni): log2(pairs / rate).

    The number of pairs is `rounded_up`: one more run seldom changes it.
    """
    return float(np.log2(max(rounded_up(pairs), 1) / settings.false_merge_rate))


def rounded_up(pairs: int) -> int:
    """`pairs` rounded up to `MATCH.pair_digits` binary digits."""
    step = 1 << max(pairs.bit_length() - MATCH.pair_digits, 0)
    return -(-pairs // step) * step


def beyond_chance_bits(candidates: Sequence[Candidate], settings: RobustSettings) -> float:
    """Largest evidence against chance of all alignments with enough junctions to be merged; 0 if
    none."""
    bits = (c.counted_bits for c in candidates if c.witnesses >= settings.min_matches)
    return max((rounded(b, BITS) for b in bits), default=0.0)


def uniformity(*maps: Prepared) -> float:
    """0 to 1: how uninformative the length of a corridor is in these maps.

    A building with few different lengths repeats itself, even if neither run saw it do so. Measured
    by how often two different corridors of one map are equally long, which is unbiased for small
    maps, too.
    """
    alike, pairs = sum(m.alike for m in maps), sum(m.alike_pairs for m in maps)
    bits = -float(np.log2(alike / pairs)) if alike > 0 else np.inf
    return _share(2.0 - bits / MATCH.uniform_bits)


def shortfall(c: Candidate) -> float:
    """0 to 1: how far the evidence of an alignment falls short of the bound of its junctions.

    Two runs of one place agree in nearly everything. Places built after the same plan, or of the
    same parts, do not, however far they are beyond chance.
    """
    least = MATCH.least_share_of_bound * MATCH.junction_bits * len(c)
    return _share(2.0 - c.counted_bits / least) if least else 0.0


def walls_fit(a: Prepared, b: Prepared, c: Candidate) -> bool:
    """Whether the walls of several parts lie on each other in one placement. Then neither map is
    larger, whatever the junctions: furniture shifts junctions, not walls."""
    return c.views.residual_m(a.views, b.views) <= CONSISTENT_M


def _share(value: float) -> float:
    """Clipped to 0 … 1."""
    return min(max(value, 0.0), 1.0)


class Matched(NamedTuple):
    """Two maps, their candidate alignments, and their threshold."""

    a: Prepared
    b: Prepared
    candidates: Sequence[Candidate]
    threshold: Threshold


def assess(
    a: Prepared, b: Prepared, candidates: Sequence[Candidate], threshold: Threshold
) -> Assessment:
    """The verdict on a pair from its candidate alignments."""
    return assess_all([Matched(a, b, candidates, threshold)])[0]


def assess_all(pairs: Sequence[Matched]) -> list[Assessment]:
    """Verdicts on pairs from their candidate alignments.

    merged: enough evidence against chance, not a copy, and a lead over every other placement; it
    must also lead the mirror image (`held_against_image`). ambiguous: beyond chance, but one of the
    three is missing, or too few junctions agree. unrelated: nothing beyond chance.

    The test for copies is applied where the building has corridors of few lengths, to alignments no
    larger than repetitions within the maps, and where the best one has much less evidence than the
    bound of its junctions.
    """
    likely = [_beyond_chance(pair.candidates, pair.threshold) for pair in pairs]
    repetitions = list(map(_repetitions, pairs, likely))
    to_test: dict[CopyModel, list[tuple[Prepared, Prepared, Candidate]]] = defaultdict(list)
    for pair, beyond, repetition in zip(pairs, likely, repetitions, strict=True):
        if max(repetition, default=0.0) > 0:
            to_test[pair.threshold.copies] += [(pair.a, pair.b, c) for c in beyond]
    tests = {copies: sameness(cases, copies) for copies, cases in to_test.items()}
    return [
        _assess(pair, beyond, repetition, tests.get(pair.threshold.copies, iter(())))
        for pair, beyond, repetition in zip(pairs, likely, repetitions, strict=True)
    ]


def _repetitions(pair: Matched, beyond: Sequence[Candidate]) -> list[float]:
    """The largest repetition (`Threshold`) of each alignment beyond chance."""
    a, b, _, threshold = pair
    by_lengths = threshold.repetition_by_lengths(a, b) if beyond else 0.0
    repetitions = [
        max(
            # Walls show better than lengths of corridors whether a building repeats itself.
            by_lengths * c.views.self_similarity,
            threshold.repetition_by_size(c),
            threshold.repetition_by_views(c),
        )
        for c in beyond
    ]
    if beyond and (any(repetitions) or shortfall(max(beyond, key=lambda c: c.counted_bits)) > 0):
        repetitions = [max(r, shortfall(c)) for r, c in zip(repetitions, beyond, strict=True)]
    return repetitions


def _assess(
    pair: Matched,
    beyond: Sequence[Candidate],
    repetitions: Sequence[float],
    tests: Iterator[Sameness],
) -> Assessment:
    """The verdict on a pair. beyond: alignments beyond chance; repetitions: how likely each is a
    copy; tests: the next results of the test for copies, one for each if any is likely."""
    a, b, candidates, threshold = pair
    if not beyond:
        return Assessment(Verdict.UNRELATED, threshold.need_bits, faint=faint_alignment(candidates))
    is_tested = max(repetitions) > 0
    ranked = []
    for c, repetition in zip(beyond, repetitions, strict=True):
        test = None
        if is_tested:
            bits = _combined_copy_bits(next(tests).bits, c.views.copies)
            test = CopyTest(bits, repetition * threshold.need_copy_bits, repetition)
        ranked.append(Weighed(c, threshold.need_bits, test))
    ranked.sort(key=lambda w: -round(w.bits, BITS))
    first, *others = ranked
    best = first.candidate
    margin = first.bits - others[0].bits if others else None
    why = _missing(first, margin, threshold)
    contested = not why and _contested(ranked)
    # If something else is missing, the explanation states the lead required over the runner-up.
    no_worse = contested or any(_contests(other, first) for other in others[:1])
    why = NO_WORSE if contested else why
    if first.chance_bits >= threshold.need_bits:
        larger = size_sigmas([(a, b, best.corridors)]) > threshold.settings.size_sigmas
        why = OTHER_SIZE if larger and not walls_fit(a, b, best) else why
    return Assessment(
        verdict=Verdict.AMBIGUOUS if why else Verdict.MERGED,
        need_bits=threshold.need_bits,
        ranked=tuple(ranked),
        why=why,
        lead_bits=MATCH.contested_bits if no_worse else MATCH.lead_bits,
    )


def held_against_image(assessment: Assessment, image_bits: float) -> Assessment:
    """The assessment of a pair that would be merged, given the evidence of its mirror image
    (`alignment.image_bits`)."""
    best = assessment.best
    if best is None or image_bits <= best.bits - MATCH.lead_bits:
        return assessment
    return replace(assessment, verdict=Verdict.AMBIGUOUS, why=MIRRORED)


def _combined_copy_bits(lengths: float, views: float) -> float:
    """Evidence against a copy [bits], from that of lengths and changes and that of views.

    Both depend on the same walls, so that they share up to `MATCH.junction_bits`.
    """
    most, least = max(lengths, views), min(lengths, views)
    return most + max(least - MATCH.junction_bits, 0.0) if views else lengths


def _beyond_chance(candidates: Sequence[Candidate], threshold: Threshold) -> list[Candidate]:
    """Alignments better than chance (`lead_bits`): those with enough junctions to be merged. If
    there are none, smaller ones that reach the threshold, or that of two runs by their counted
    bits."""
    beyond = [c for c in candidates if c.bits > MATCH.lead_bits]
    enough = [c for c in beyond if c.witnesses >= threshold.settings.min_matches]
    alone = needed_bits(1, threshold.settings)
    return enough or [c for c in beyond if c.bits > threshold.need_bits or c.counted_bits > alone]


def _missing(first: Weighed, margin: float | None, threshold: Threshold) -> str:
    """What an alignment lacks for being merged, as a clause; "" if nothing."""
    best = first.candidate
    if first.copy_bits < min(first.chance_bits, threshold.need_bits):
        return MAYBE_COPY
    if first.chance_bits < threshold.need_bits:
        return "chance offers as much too often"
    if best.witnesses - best.conflicts.junctions < threshold.settings.min_matches:
        fewest = f"{threshold.settings.min_matches} junctions at least must agree"
        return (
            f"{fewest}, and up to one more for every contradiction"
            if len(best.conflicts)
            else fewest
        )
    if margin is not None and margin < MATCH.lead_bits:
        return NEARLY
    return ""


def _contested(ranked: Sequence[Weighed]) -> bool:
    """Whether another placement contests the first one and is less than `contested_bits` behind.

    One of the two is then a copy, and neither run saw a difference. The evidence overstates their
    difference, so that twice the lead is required. Without this, rows merge wrongly, rotated by
    half a turn (4.4 bits ahead). Correct pairs of offices lead by more (11.8), and of the alias and
    standard suites it costs none.
    """
    first, *others = ranked
    return any(
        first.bits - other.bits < MATCH.contested_bits and _contests(other, first)
        for other in others
    )


def _contests(other: Weighed, first: Weighed) -> bool:
    """Whether another placement is beyond chance, too, and has no more evidence against it."""
    against_other, against_first = (w.candidate.contradicting_bits for w in (other, first))
    return other.chance_bits >= other.need and against_other <= against_first
