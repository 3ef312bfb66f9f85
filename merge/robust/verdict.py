"""From candidate alignments of two maps to one of three verdicts."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ...topology.digits import BITS, rounded
from ..result import Verdict
from .alignment import Candidate
from .prepare import Prepared
from .repetition import CopyModel, Sameness, sameness_of, size_sigmas
from .settings import MATCH, RobustSettings

OTHER_SIZE = "one is larger throughout: this may be a copy of another size"

MAYBE_COPY = "the building repeats itself and this may be another copy of the place"


@dataclass(frozen=True, slots=True)
class PairCount:
    """Pairs of runs of a batch: all of them, and those beyond chance. A copy can only be merged
    wrongly where chance does not explain it already."""

    all: int
    beyond: int


@dataclass(frozen=True, slots=True)
class Threshold:
    """What a pair must reach. need_bits: against chance; need_copy_bits: against copies, of an
    alignment that may well be one; copied: junctions of the largest part of a map that lies on
    another part of it; copies: how copies differ there."""

    need_bits: float
    need_copy_bits: float
    copied: float
    copies: CopyModel
    settings: RobustSettings

    def may_be_copy(self, best: Candidate) -> float:
        """0 to 1: whether an alignment is as small as copies are. One no larger than what a map
        shares with another part of itself is none that copies do not offer; one of twice as many
        junctions is. Without it tunnels are merged wrongly (`benchmarks/aliasing.py --without
        "small copies"`)."""
        return _share(2.0 - len(best) / self.copied) if self.copied else 0.0


@dataclass(frozen=True, slots=True)
class Answers:
    """What a placement answers to the two questions, and the one number made of it, in bits.

    need: what merging needs. against_chance: all that speaks for it less all that speaks against
    it; carried: the same with what agrees cut to what its junctions can carry (`counted_bits`).
    repetition: 0 to 1, whether it may be a copy; same_place: what says that it is the place and
    not a copy of it, None where that was not asked; need_same: what merging needs of it.
    """

    need: float
    against_chance: float
    carried: float
    repetition: float = 0.0
    same_place: float | None = None
    need_same: float = 0.0

    @property
    def bits(self) -> float:
        """The evidence: that of the question answered worst. The second counts on the scale of the
        first: as many bits beyond what either needs make both answers as sure."""
        return min(self.carried, self.from_copies)

    @property
    def from_copies(self) -> float:
        """The answer to the second question on the scale of the first; infinite if not asked."""
        if self.same_place is None:
            return np.inf
        return self.same_place + self.need - self.need_same


@dataclass(frozen=True, slots=True)
class Faint:
    """An alignment that chance offers as well: of how many junctions, and its evidence;
    against_chance: `beyond_chance_bits` of all that there were."""

    junctions: int
    bits: float
    against_chance: float = 0.0


def faint_of(candidates: Sequence[Candidate], settings: RobustSettings) -> Faint | None:
    """The best of some candidates in short; None if there is none."""
    if not candidates:
        return None
    best = candidates[0]
    return Faint(len(best), counted_bits(best), beyond_chance_bits(candidates, settings))


@dataclass(frozen=True, slots=True, eq=False)
class Opinion:
    """A verdict on two maps, alone.

    need_bits: the evidence that merging needs. ranked: placements beyond chance, best first, each
    with its evidence; best, runner_up, bits and margin are read off it; answers: how the evidence
    of each follows. why: what was missing, "" where merged; faint: the best alignment where none is
    beyond chance; against_chance: `beyond_chance_bits`; discarded: a person took back whatever was
    found.
    """

    verdict: Verdict
    need_bits: float
    ranked: tuple[tuple[Candidate, float], ...] = ()
    answers: tuple[Answers, ...] = ()
    why: str = ""
    faint: Faint | None = None
    against_chance: float = 0.0
    discarded: bool = False

    @property
    def best(self) -> Candidate | None:
        """The placement that the verdict speaks of, if any is beyond chance."""
        return self.ranked[0][0] if self.ranked else None

    @property
    def bits(self) -> float:
        """The evidence for the best placement; 0 if no placement was found at all."""
        if self.ranked:
            return self.ranked[0][1]
        return 0.0 if self.faint is None else self.faint.bits

    @property
    def same_bits(self) -> float | None:
        """What the best placement says to the second question, None where it was not asked."""
        return self.answers[0].same_place if self.answers else None

    @property
    def runner_up(self) -> Candidate | None:
        """The next best placement, if there is one beyond chance."""
        return self.ranked[1][0] if len(self.ranked) > 1 else None

    @property
    def margin(self) -> float | None:
        """The lead in bits over the runner-up, if there is one."""
        if len(self.ranked) < 2:
            return None
        return max(self.ranked[0][1] - self.ranked[1][1], 0.0)  # less is rounding


def threshold_for(
    count: PairCount,
    copies: CopyModel,
    settings: RobustSettings,
    *,
    copied: float = 0.0,
) -> Threshold:
    """The threshold in a batch of so many pairs: each may err at its share of the false-merge rate,
    at either question."""
    against_copies = max(needed_bits(count.beyond, settings) - settings.copy_margin_bits, 0.0)
    need = needed_bits(count.all, settings)
    return Threshold(need, against_copies, copied, copies, settings)


def needed_bits(pairs: int, settings: RobustSettings) -> float:
    """The evidence with which chance merges any of so many pairs at the false-merge rate.

    Pairs are counted in steps, so that one more run seldom changes what all the others must reach,
    and what was said of these still holds.
    """
    return float(np.log2(max(in_steps(pairs), 1) / settings.false_merge_rate))


def in_steps(pairs: int) -> int:
    """A number of pairs, rounded up."""
    step = 1 << max(pairs.bit_length() - MATCH.pair_digits, 0)
    return -(-pairs // step) * step


def beyond_chance_bits(candidates: Sequence[Candidate], settings: RobustSettings) -> float:
    """The most evidence against chance of any alignment that may be merged; 0 if there is none."""
    bits = (counted_bits(c) for c in candidates if len(c) >= settings.min_matches)
    return max((rounded(b, BITS) for b in bits), default=0.0)


def uniformity(a: Prepared, b: Prepared) -> float:
    """0 to 1: how little the length of a corridor tells in these two maps.

    A building of few sizes repeats itself, though neither run may have seen it do so. Measured by
    how often two different corridors of one map are equally long, which is right for small maps,
    too.
    """
    alike, pairs = a.alike + b.alike, a.alike_pairs + b.alike_pairs
    tells = -float(np.log2(alike / pairs)) if alike > 0 else np.inf
    return _share(2.0 - tells / MATCH.uniform_bits)


def counted_bits(c: Candidate) -> float:
    """The evidence of an alignment against chance: what agrees, as far as its junctions can carry
    it, less all that contradicts.

    What agrees hangs together (a room or a tunnel piece of a standard form brings its junctions,
    corridors and angles with it), so that its sum overstates what it tells; a contradiction needs a
    fault of its own to explain it, so that each counts in full.
    """
    against = c.contradicting_bits
    return min(c.bits + against, MATCH.junction_bits * len(c)) - against


def _share(value: float) -> float:
    """Bounded to 0 … 1."""
    return min(max(value, 0.0), 1.0)


Found = tuple[Prepared, Prepared, Sequence[Candidate], Threshold]
"""Two maps, their candidate alignments, and what they must reach."""


def opinion(
    a: Prepared, b: Prepared, candidates: Sequence[Candidate], threshold: Threshold
) -> Opinion:
    """The verdict on a pair from its candidate alignments."""
    return opinions([(a, b, candidates, threshold)])[0]


def opinions(pairs: Sequence[Found]) -> list[Opinion]:
    """Verdicts on pairs of one batch from their candidate alignments.

    merged: enough evidence against chance, the same place rather than a copy of it, and a lead
    over every other placement. ambiguous: an alignment that chance hardly offers, but one of the
    three is missing, or too few junctions agree. unrelated: no such alignment.

    The second question is asked where the building has corridors of few sizes, and of alignments
    as small as copies are. Its bits are counted on the scale of the first: with as many bits beyond
    what either question must yield, both answers are as sure.
    """
    shown = [_beyond_chance(candidates, threshold) for _, _, candidates, threshold in pairs]
    shares = [_repetitions(*pair, odd) for pair, odd in zip(pairs, shown, strict=True)]
    cases = [
        (a, b, c)
        for (a, b, _, _), odd, share in zip(pairs, shown, shares, strict=True)
        if max(share, default=0.0) > 0
        for c in odd
    ]
    same = sameness_of(cases, pairs[0][3].copies) if cases else iter(())
    told = zip(pairs, shown, shares, strict=True)
    return [_opinion(pair, odd, share, same) for pair, odd, share in told]


def _repetitions(
    a: Prepared, b: Prepared, _: object, threshold: Threshold, odd: Sequence[Candidate]
) -> list[float]:
    """0 to 1 of each alignment: how far the second question is asked of it."""
    uniform = uniformity(a, b) if odd else 0.0
    return [max(uniform, threshold.may_be_copy(c)) for c in odd]


def _opinion(
    pair: Found,
    odd: Sequence[Candidate],
    shares: Sequence[float],
    same: Iterator[Sameness],
) -> Opinion:
    """The verdict on a pair. odd: alignments beyond chance; shares: how far the second question is
    asked of each; same: what it yields, if any asks it."""
    a, b, candidates, threshold = pair
    if not odd:
        return Opinion(
            Verdict.UNRELATED, threshold.need_bits, faint=faint_of(candidates, threshold.settings)
        )
    asked = max(shares) > 0
    answers = []
    for c, share in zip(odd, shares, strict=True):
        same_bits = next(same).bits if asked else None
        need_same = share * threshold.need_copy_bits
        carried = counted_bits(c)
        answers.append(Answers(threshold.need_bits, c.bits, carried, share, same_bits, need_same))
    ranking = sorted(range(len(odd)), key=lambda i: -round(answers[i].bits, MATCH.ranked_decimals))
    ranked = tuple((odd[i], answers[i].bits) for i in ranking)
    margin = None if len(odd) < 2 else ranked[0][1] - ranked[1][1]
    why = _missing(odd[ranking[0]], answers[ranking[0]], margin, threshold)
    if not why and size_sigmas(a, b, odd[ranking[0]].corridors) > threshold.settings.size_sigmas:
        why = OTHER_SIZE
    return Opinion(
        verdict=Verdict.AMBIGUOUS if why else Verdict.MERGED,
        need_bits=threshold.need_bits,
        ranked=ranked,
        answers=tuple(answers[i] for i in ranking),
        why=why,
        against_chance=beyond_chance_bits(candidates, threshold.settings),
    )


def _beyond_chance(candidates: Sequence[Candidate], threshold: Threshold) -> list[Candidate]:
    """The alignments worth a word: those of enough junctions, or, if there are none, those of fewer
    that chance hardly offers."""
    odd = [c for c in candidates if c.bits > MATCH.lead_bits]
    enough = [c for c in odd if len(c) >= threshold.settings.min_matches]
    return enough or [c for c in odd if c.bits > threshold.need_bits]


def _missing(best: Candidate, answers: Answers, margin: float | None, threshold: Threshold) -> str:
    """What an alignment lacks for being merged, as a clause; "" if nothing."""
    if answers.from_copies < min(answers.carried, threshold.need_bits):
        return MAYBE_COPY
    if answers.carried < threshold.need_bits:
        return "chance offers as much too often"
    if len(best) < threshold.settings.min_matches:
        return f"{threshold.settings.min_matches} junctions at least must agree"
    if margin is not None and margin < MATCH.lead_bits:
        return "another placement fits nearly as well"
    return ""
