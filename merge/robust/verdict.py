"""From candidate alignments of two maps to one of three verdicts."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ...topology.digits import BITS, rounded
from ..result import CopyTest, Verdict
from .alignment import Candidate
from .prepare import Prepared
from .repetition import CopyModel, Sameness, fits_by_noise, sameness_of, size_sigmas
from .settings import MATCH, RobustSettings
from .view_evidence import CONSISTENT_M

OTHER_SIZE = "one is larger throughout: this may be a copy of another size"

NO_WORSE = "another placement that chance does not explain has no more against it"
MAYBE_COPY = "this may be another copy of the place, as buildings in this merge repeat themselves"

MISFITS = "this may be another copy of the place, as its lengths differ by more than noise"

NEARLY = "another placement fits nearly as well"

MIRRORED = "its mirror image fits nearly as well: this may be a copy built the other way round"

ELSEWHERE = "by another placement"
"""What the evidence of two maps says where a lock joins them in another way."""

NOTHING_ALIKE = "they have nothing in common that chance would not offer"

DOUBTS = (OTHER_SIZE, NO_WORSE, MAYBE_COPY, MISFITS, NEARLY, MIRRORED, ELSEWHERE, NOTHING_ALIKE)
"""What two maps lack that is more than too little evidence: they may belong elsewhere."""


@dataclass(frozen=True, slots=True)
class Threshold:
    """The evidence that a pair must reach.

    need_bits: against chance; need_copy_bits: against being a copy, for an alignment that is likely
    to be one; copied: junctions of the largest part of either map that matches another part of it;
    copies: how copies differ in buildings like theirs; unrepeated_bits: evidence that such
    buildings do not repeat themselves, where corridors of few lengths suggest it.
    """

    need_bits: float
    need_copy_bits: float
    copied: float
    copies: CopyModel
    settings: RobustSettings
    unrepeated_bits: float = 0.0

    def few_lengths(self, a: Prepared, b: Prepared) -> float:
        """0 to 1: how much two maps are asked whether they show copies, because their corridors
        have few lengths."""
        told = self.unrepeated_bits / self.need_copy_bits if self.need_copy_bits else 0.0
        return max(uniformity(a, b) - told, 0.0)

    def may_be_copy(self, best: Candidate) -> float:
        """0 to 1: how likely an alignment is a copy, by its size.

        1 if it has no more junctions than the largest repetition within a map, 0 from twice as many
        on; parts of the overlap that agree count as junctions where views proposed it. Without this
        tunnels are merged wrongly (`benchmarks/aliasing.py --without "small copies"`).
        """
        size = len(best) + (best.views.agreeing if best.by_views else 0)
        return _share(2.0 - size / self.copied) if self.copied else 0.0

    def looks_repeated(self, c: Candidate) -> float:
        """0 to 1: how likely an alignment is a copy, by its views; 0 where the junctions alone
        suffice and no junctions of either map stand twice."""
        by_junctions = c.bits - c.views.total >= self.need_bits and not self.copied
        return 0.0 if by_junctions else c.views.repeated


@dataclass(frozen=True, slots=True, eq=False)
class Weighed:
    """A placement better than chance with its evidence for the two questions (chance? a copy?), in
    bits.

    need: the threshold against chance; copy_test: the second question, None if it was not asked.
    """

    candidate: Candidate
    need: float
    copy_test: CopyTest | None = None

    @property
    def carried(self) -> float:
        """The answer to the first question: `counted_bits`."""
        return self.candidate.counted_bits

    @property
    def bits(self) -> float:
        """The evidence: the lower one of the two answers, the second shifted to the threshold of
        the first."""
        return min(self.carried, self.from_copies)

    @property
    def from_copies(self) -> float:
        """The answer to the second question, shifted so that its threshold is `need`; inf if not
        tested. The less likely a copy, the less it bounds the evidence."""
        asked = self.copy_test
        if asked is None or not asked.repetition:
            return np.inf
        beyond = asked.bits - asked.needed_bits
        return self.need + (beyond / asked.repetition if beyond > 0 else beyond)


@dataclass(frozen=True, slots=True)
class Faint:
    """An alignment no better than chance: its junctions and evidence [bits]."""

    junctions: int
    bits: float


def faint_of(candidates: Sequence[Candidate]) -> Faint | None:
    """The best candidate in short; None if there is none."""
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
    """The threshold in a batch of so many pairs, `beyond` of them with an alignment that chance
    does not explain: only these can be merged wrongly because they are copies. Every pair has an
    equal share of the false-merge rate, for either question."""
    against_copies = max(needed_bits(beyond, settings) - settings.copy_margin_bits, 0.0)
    need = needed_bits(pairs, settings)
    return Threshold(need, against_copies, copied, copies, settings, unrepeated_bits)


def needed_bits(pairs: int, settings: RobustSettings) -> float:
    """Threshold against chance with `pairs` pairs (Bonferroni): log2(pairs / rate).

    Pairs are counted in steps (`in_steps`), so that one more run seldom changes the threshold of
    all others.
    """
    return float(np.log2(max(in_steps(pairs), 1) / settings.false_merge_rate))


def in_steps(pairs: int) -> int:
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
    tells = -float(np.log2(alike / pairs)) if alike > 0 else np.inf
    return _share(2.0 - tells / MATCH.uniform_bits)


def falls_short(c: Candidate) -> float:
    """0 to 1: how far the evidence of an alignment falls short of what its junctions could give.

    Two runs of one place agree in nearly everything. Places built after the same plan, or of the
    same parts, do not, however far they are beyond chance.
    """
    least = MATCH.least_told * MATCH.junction_bits * len(c)
    return _share(2.0 - c.counted_bits / least) if least else 0.0


def walls_fit(a: Prepared, b: Prepared, c: Candidate) -> bool:
    """Whether the walls of several parts lie on each other in one placement: then lengths fit, too,
    and neither map is larger, whatever junctions say. Furniture shifts junctions, not walls."""
    return c.views.residual_m(a.views, b.views) <= CONSISTENT_M


def misfits(a: Prepared, b: Prepared, c: Candidate) -> float:
    """1 if lengths that agree differ by more than noise, so that the alignment is taken for a copy,
    else 0. Places of one design can agree in every junction, and differ by a little in many
    corridors, of which each might be noise."""
    if walls_fit(a, b, c):
        return 0.0
    return float(fits_by_noise(a, b, c.corridors) < MATCH.misfit_rate)


def _share(value: float) -> float:
    """Clipped to 0 … 1."""
    return min(max(value, 0.0), 1.0)


Found = tuple[Prepared, Prepared, Sequence[Candidate], Threshold]
"""Two maps, their candidate alignments, and their threshold."""


def assess(
    a: Prepared, b: Prepared, candidates: Sequence[Candidate], threshold: Threshold
) -> Assessment:
    """The verdict on a pair from its candidate alignments."""
    return assess_all([(a, b, candidates, threshold)])[0]


def assess_all(pairs: Sequence[Found]) -> list[Assessment]:
    """Verdicts on pairs from their candidate alignments.

    merged: enough evidence against chance, not a copy, and a lead over every other placement and
    the mirror image.
    ambiguous: beyond chance, but one of the three is missing, or too few junctions agree.
    unrelated: nothing beyond chance.

    The test for copies is applied where the building has corridors of few lengths, to alignments no
    larger than repetitions within the maps, whose lengths differ by more than noise, and where the
    best one has much less evidence than its junctions could give.
    """
    shown = [_beyond_chance(candidates, threshold) for _, _, candidates, threshold in pairs]
    shares = [_repetitions(*pair, odd) for pair, odd in zip(pairs, shown, strict=True)]
    cases: dict[CopyModel, list[tuple[Prepared, Prepared, Candidate]]] = defaultdict(list)
    for (a, b, _, threshold), odd, share in zip(pairs, shown, shares, strict=True):
        if max(share, default=0.0) > 0:
            cases[threshold.copies] += [(a, b, c) for c in odd]
    same = {copies: sameness_of(some, copies) for copies, some in cases.items()}
    told = zip(pairs, shown, shares, strict=True)
    return [
        _assess(pair, odd, share, same.get(pair[3].copies, iter(()))) for pair, odd, share in told
    ]


def _repetitions(
    a: Prepared, b: Prepared, _: object, threshold: Threshold, odd: Sequence[Candidate]
) -> list[float]:
    """0 to 1 for each alignment: how likely it is a copy."""
    uniform = threshold.few_lengths(a, b) if odd else 0.0
    shares = [
        max(
            # Walls show better than lengths of corridors whether a building repeats itself.
            uniform * c.views.self_similarity,
            threshold.may_be_copy(c),
            misfits(a, b, c),
            threshold.looks_repeated(c),
        )
        for c in odd
    ]
    if odd and (any(shares) or falls_short(max(odd, key=lambda c: c.counted_bits)) > 0):
        shares = [max(share, falls_short(c)) for share, c in zip(shares, odd, strict=True)]
    return shares


def _assess(
    pair: Found,
    odd: Sequence[Candidate],
    shares: Sequence[float],
    same: Iterator[Sameness],
) -> Assessment:
    """The verdict on a pair. odd: alignments beyond chance; shares: how likely each is a copy;
    same: results of the test for copies, if any needs it."""
    a, b, candidates, threshold = pair
    if not odd:
        return Assessment(Verdict.UNRELATED, threshold.need_bits, faint=faint_of(candidates))
    asked = max(shares) > 0
    ranked = []
    for c, share in zip(odd, shares, strict=True):
        tested = None
        if asked:
            bits = _no_copy(next(same).bits, c.views.copies)
            tested = CopyTest(bits, share * threshold.need_copy_bits, share)
        ranked.append(Weighed(c, threshold.need_bits, tested))
    ranked.sort(key=lambda w: -round(w.bits, BITS))
    first, *others = ranked
    best = first.candidate
    margin = first.bits - others[0].bits if others else None
    why = _missing(first, margin, threshold)
    if why == MAYBE_COPY and misfits(a, b, best):
        why = MISFITS
    contested = not why and _contested(ranked)
    # If something else is missing, the explanation states the lead required over the runner-up.
    no_worse = contested or any(_contests(other, first) for other in others[:1])
    why = NO_WORSE if contested else why
    if first.carried >= threshold.need_bits:
        larger = size_sigmas(a, b, best.corridors) > threshold.settings.size_sigmas
        why = OTHER_SIZE if larger and not walls_fit(a, b, best) else why
    if not why and best.image_bits > best.bits - MATCH.lead_bits:
        why = MIRRORED
    return Assessment(
        verdict=Verdict.AMBIGUOUS if why else Verdict.MERGED,
        need_bits=threshold.need_bits,
        ranked=tuple(ranked),
        why=why,
        lead_bits=MATCH.contested_bits if no_worse else MATCH.lead_bits,
    )


def _no_copy(lengths: float, views: float) -> float:
    """The evidence of lengths and changes, and that of views, that an alignment is no copy [bits].

    Both see the same walls: what one says is no news up to `MATCH.junction_bits` of the other.
    """
    most, least = max(lengths, views), min(lengths, views)
    return most + max(least - MATCH.junction_bits, 0.0) if views else lengths


def _beyond_chance(candidates: Sequence[Candidate], threshold: Threshold) -> list[Candidate]:
    """Alignments better than chance (`lead_bits`): those with enough junctions to be merged, or, if
    there are none, smaller ones that reach the threshold, or by their views that of two runs."""
    odd = [c for c in candidates if c.bits > MATCH.lead_bits]
    enough = [c for c in odd if c.witnesses >= threshold.settings.min_matches]
    alone = needed_bits(1, threshold.settings)
    return enough or [c for c in odd if c.bits > threshold.need_bits or c.counted_bits > alone]


def _missing(first: Weighed, margin: float | None, threshold: Threshold) -> str:
    """What an alignment lacks for being merged, as a clause; "" if nothing."""
    best = first.candidate
    if first.from_copies < min(first.carried, threshold.need_bits):
        return MAYBE_COPY
    if first.carried < threshold.need_bits:
        return "chance offers as much too often"
    if best.rival:
        return MAYBE_COPY
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
    """Whether another placement contests the first of ranked ones and is less than `contested_bits`
    behind.

    Then one of the two is a copy without any difference that both runs saw, and the evidence
    overstates the difference between the two: twice the lead is required. Rows merge wrongly
    without it, rotated by half a turn (4.4 bits ahead); correct pairs of offices lead by more
    (11.8), and of the alias and standard suites it costs none.
    """
    first, *others = ranked
    return any(
        first.bits - other.bits < MATCH.contested_bits and _contests(other, first)
        for other in others
    )


def _contests(other: Weighed, first: Weighed) -> bool:
    """Whether another placement is not explained by chance either, and has no more evidence against
    it."""
    against, least = (w.candidate.contradicting_bits for w in (other, first))
    return other.carried >= other.need and against <= least
