"""All maps of a batch matched with each other: which pairs are matched, and the verdict on each
pair by itself."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ...topology.arrays import FloatArray, IntArray
from ...topology.topomap import TopoMap
from ..result import PairVerdict, Verdict, pairs_of
from .alignment import Candidate
from .components import ELSEWHERE, Components, Refusal, agrees, as_alignment, overlapping_pairs
from .entries import Case
from .pairing import Means, Pair, Pairwise, Summary, tile_order
from .prepare import Prepared
from .repetition import sameness
from .screening import pairs_to_match
from .settings import MATCH, RobustSettings
from .thresholds import ThresholdOf, thresholds
from .verdict import Assessment, Matched, assess_all, held_against_image


@dataclass(eq=False)
class Batch:
    """The matches between the maps of a batch, and the verdicts on pairs by their two maps alone.

    locked, discarded: pairs named by a lock, and those whose match the user discarded; summaries:
    results of matching, of all pairs that were matched; verdicts: on each of these pairs.
    Assessments would fill the memory: the few that are needed later are made again.
    """

    matcher: Pairwise
    locked: Collection[Pair] = ()
    discarded: Collection[Pair] = ()
    summaries: dict[Pair, Summary] = field(default_factory=dict)
    verdicts: dict[Pair, PairVerdict] = field(default_factory=dict)

    def match_likely(self) -> None:
        """Match all pairs of a small batch; of a large one those that pass screening, and those
        that a lock or a discarded match names."""
        pairs = pairs_to_match_in(self.matcher, {*self.locked, *self.discarded})
        runs = len(self.matcher.maps)
        self.log(f"{runs} maps, {len(pairs)} of {pairs_of(runs)} pairs to match")
        self.match(pairs)

    def match(self, pairs: IntArray) -> None:
        """Match (k, 2) pairs and assess them."""
        summaries = dict(zip(map(tuple, pairs.tolist()), self.matcher.pairs(pairs), strict=True))
        summaries |= {pair: Summary() for pair in self.discarded if pair in summaries}
        self.summaries.update(summaries)
        for batch in in_batches(list(summaries)):
            for pair, assessment in self.assessments(batch).items():
                self.verdicts[pair] = Case(*self.prepared(pair), assessment).verdict()

    def prepared(self, pair: Pair) -> tuple[Prepared, Prepared]:
        """The two maps of a pair."""
        return self.matcher.prepared[pair[0]], self.matcher.prepared[pair[1]]

    def log(self, text: str) -> None:
        """Report an event."""
        self.matcher.means.log(text)

    @cached_property
    def threshold(self) -> ThresholdOf:
        """The thresholds, by the pairs that were matched first."""
        against_chance = {pair: summary.against_chance for pair, summary in self.summaries.items()}
        prepared, settings = self.matcher.prepared, self.matcher.settings
        return thresholds(prepared, settings, against_chance, self.matcher.with_themselves())

    def assessments(self, pairs: Sequence[Pair]) -> dict[Pair, Assessment]:
        """Assessments of pairs by their two maps alone. Those that would be merged are held against
        their mirror images."""
        candidates = self.candidates(pairs)
        cases = [
            Matched(*self.prepared(pair), candidates.get(pair, ()), self.threshold(pair))
            for pair in pairs
        ]
        assessments = dict(zip(pairs, assess_all(cases), strict=True))
        for pair, assessment in assessments.items():
            faint = self.summaries[pair].faint or assessment.faint
            assessments[pair] = replace(assessment, faint=faint, discarded=pair in self.discarded)
        merged = [pair for pair, found in assessments.items() if found.verdict is Verdict.MERGED]
        for pair, bits in zip(merged, self.matcher.image_bits(_rows(merged)), strict=True):
            assessments[pair] = held_against_image(assessments[pair], bits)
        return assessments

    def candidates(self, pairs: Iterable[Pair]) -> dict[Pair, tuple[Candidate, ...]]:
        """The candidates of the pairs; pairs without any beyond chance are left out."""
        full = [pair for pair in pairs if self.summaries[pair].full]
        return dict(zip(full, self.matcher.candidates(_rows(full)), strict=True))

    @property
    def unlocked(self) -> dict[Pair, PairVerdict]:
        """The verdicts on pairs that no lock names."""
        return {pair: v for pair, v in self.verdicts.items() if pair not in self.locked}

    def corroborated(self, pairs: Iterable[Pair], components: Components) -> dict[Pair, Candidate]:
        """For pairs of one component the first candidate that agrees with the placement by other
        runs; pairs without one are left out."""
        together = [pair for pair in pairs if components.together(*pair)]
        agreeing = {
            (i, j): self._agreeing(candidates, components.relative(i, j), j)
            for (i, j), candidates in self.candidates(together).items()
        }
        return {pair: c for pair, c in agreeing.items() if c is not None}

    def _agreeing(
        self, candidates: Iterable[Candidate], T_i_j: FloatArray, j: int
    ) -> Candidate | None:
        """The first candidate that places run j as T_i_j does; None if there is none."""
        b = self.matcher.prepared[j]
        return next((c for c in candidates if agrees(as_alignment(c), T_i_j, b)), None)

    def same_place_bits(self, pairs: Sequence[Pair]) -> list[float]:
        """Evidence that the alignments of merged pairs are not copies [bits], without those of
        pairs that a lock names."""
        unlocked = [pair for pair in pairs if pair not in self.locked]
        cases = []
        for pair, candidates in self.candidates(unlocked).items():
            best = self.verdicts[pair].best
            assert best is not None
            chosen = self._agreeing(candidates, best.transform, pair[1])
            cases += [] if chosen is None else [(*self.prepared(pair), chosen)]
        if not cases:
            return []
        copies = self.threshold(sorted({k for pair in pairs for k in pair})).copies
        return [same.bits for same in sameness(cases, copies)]

    def plausible(self) -> list[Pair]:
        """Pairs with a placement better than chance, merged or not."""
        return [
            pair
            for pair, v in self.verdicts.items()
            if v.best is not None and v.evidence_bits > MATCH.lead_bits
        ]

    def match_overlapping(
        self, components: Components, joined: Iterable[Pair]
    ) -> dict[Pair, Refusal]:
        """Match the pairs that were screened out and now overlap, or were joined by their
        components. Returns the refusals of those merged elsewhere."""
        maps = self.matcher.prepared
        if len(self.summaries) == pairs_of(len(maps)):
            return {}
        overlapping = {*overlapping_pairs(components, maps), *joined}
        unmatched = sorted(pair for pair in overlapping if pair not in self.summaries)
        self.match(_rows(unmatched))
        refused = {}
        for i, j in unmatched:
            best = self.verdicts[i, j].best if self.verdicts[i, j].accepted else None
            if best is not None and not agrees(best, components.relative(i, j), maps[j]):
                refused[i, j] = ELSEWHERE
        return refused


def _rows(pairs: Sequence[Pair]) -> IntArray:
    """(k, 2) pairs as an array."""
    return np.array(pairs, np.int64).reshape(-1, 2)


def in_batches(pairs: Sequence[Pair]) -> Iterator[Sequence[Pair]]:
    """The pairs in batches of `MATCH.at_once`."""
    return (pairs[k : k + MATCH.at_once] for k in range(0, len(pairs), MATCH.at_once))


def pairs_to_match_in(matcher: Pairwise, named: Iterable[Pair] = ()) -> IntArray:
    """(k, 2) pairs of a batch to be matched: `pairs_to_match`, and the named ones."""
    likely = pairs_to_match(matcher.prepared, matcher.settings)
    return np.unique(np.concatenate([likely, _rows(sorted(named))]), axis=0)


def match_shard(
    maps: Sequence[TopoMap], settings: RobustSettings, share: tuple[int, int], means: Means
) -> int:
    """Match the i-th of n shares of the pairs (i from 1 on) for the store; returns their number."""
    matcher = Pairwise(sorted(maps, key=lambda m: m.run), settings, means)
    pairs = pairs_to_match_in(matcher)
    of_share = np.array_split(pairs[tile_order(pairs)], share[1])[share[0] - 1]
    matcher.pairs(of_share)
    return len(of_share)
