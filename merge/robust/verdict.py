"""From candidate alignments of two maps to one of three verdicts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..result import Verdict
from .alignment import Candidate
from .settings import RobustSettings

ODD_BITS = 4.0
"""Alignments with less evidence are what chance offers to every pair."""

COPY_MARGIN_BITS = 3.0
"""The second question is asked with cautious rates: of copies, fewer than promised pass it by this
many bits (measured by `benchmarks/calibration.py`)."""

PLAIN_SELF_BITS = 5.0
REPETITIVE_SELF_BITS = 15.0
"""Best alignment of a map with another part of itself: up to the first value the building does not
repeat itself, from the second on the second question is asked in full."""


@dataclass(frozen=True, slots=True)
class Bar:
    """What a pair must reach. need_bits: against chance; repetition: 0 (the building does not
    repeat itself) to 1; settings' limits on matches and lead."""

    need_bits: float
    repetition: float
    settings: RobustSettings

    @property
    def need_same_bits(self) -> float:
        """What the second question must yield; minus infinity where it is not asked."""
        if self.repetition <= 0:
            return -np.inf
        return self.repetition * max(self.need_bits - COPY_MARGIN_BITS, 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class Opinion:
    """A verdict on two maps, alone. `why` tells in a clause what was missing, "" where merged."""

    verdict: Verdict
    best: Candidate | None
    runner_up: Candidate | None
    bits: float
    margin: float | None
    why: str


def bar(pairs: int, repetition: float, settings: RobustSettings) -> Bar:
    """The bar for a batch of so many pairs: each may err at its share of the false-merge rate."""
    return Bar(float(np.log2(max(pairs, 1) / settings.false_merge_rate)), repetition, settings)


def repetition_level(self_bits: float) -> float:
    """0 to 1: how much a building repeats itself, by the best match of its map with itself."""
    level = (self_bits - PLAIN_SELF_BITS) / (REPETITIVE_SELF_BITS - PLAIN_SELF_BITS)
    return float(np.clip(level, 0.0, 1.0))


def opinion(candidates: Sequence[Candidate], level: Bar) -> Opinion:
    """The verdict on a pair from its candidate alignments.

    merged: enough evidence against chance, the same place rather than a copy of it, and a lead
    over every other placement. ambiguous: an alignment that chance hardly offers, but one of the
    three is missing. unrelated: no such alignment.
    """
    settings = level.settings
    odd = [c for c in candidates if c.bits > ODD_BITS and len(c) >= settings.min_matches]
    if not odd:
        first = candidates[0] if candidates else None
        bits = first.bits if first else 0.0
        return Opinion(
            Verdict.UNRELATED, None, None, min(bits, 0.0) if not first else bits, None, ""
        )
    asked = level.repetition > 0 or any(_rivals(odd, level))
    ranked = sorted(odd, key=lambda c: -_score(c, asked))
    best = ranked[0]
    second = ranked[1] if len(ranked) > 1 else None
    bits = _score(best, asked)
    margin = bits - max(_score(second, asked), 0.0 if not asked else -np.inf) if second else None
    need_same = level.need_same_bits
    if asked and not np.isfinite(need_same):
        need_same = 0.0
    why = ""
    if best.bits < level.need_bits:
        why = f"chance offers as much too often ({best.bits:.0f} of {level.need_bits:.0f} bits)"
    elif asked and _same(best) < need_same:
        why = "the building repeats itself and this may be another copy of the place"
    elif margin is not None and margin < settings.lead_bits:
        why = "another placement fits nearly as well"
    verdict = Verdict.AMBIGUOUS if why else Verdict.MERGED
    return Opinion(verdict, best, second, bits, margin, why)


def _rivals(odd: Sequence[Candidate], level: Bar) -> list[Candidate]:
    """Alignments other than the best that are significant: a building where these exist repeats."""
    return [c for c in sorted(odd, key=lambda c: -c.bits)[1:] if c.bits > 0.75 * level.need_bits]


def _same(c: Candidate) -> float:
    return c.same.bits if c.same is not None else -np.inf


def _score(c: Candidate | None, asked: bool) -> float:
    """Bits by which candidates are ranked: of the questions asked the one answered worst."""
    if c is None:
        return -np.inf
    return min(c.bits, _same(c)) if asked else c.bits
