"""All maps of a batch matched with each other: which pairs are matched, and the verdict on each
pair by itself."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ...topology.arrays import FloatArray, IntArray
from ...topology.topomap import TopoMap
from ..result import PairVerdict, Verdict, pairs_of
from .alignment import Candidate
from .components import ELSEWHERE, Components, Refusal, agrees, as_alignment, lying_over
from .entries import Case
from .pairing import Means, Pair, Pairwise, Summary, tile_order
from .prepare import Prepared
from .repetition import sameness_of
from .screening import pairs_to_match
from .settings import MATCH, RobustSettings
from .thresholds import ThresholdOf, thresholds
from .verdict import Assessment, assess_all


@dataclass(eq=False)
class Batch:
    """The matches between the maps of a batch, and the verdicts on pairs by their two maps alone.

    locked, discarded: pairs named by a lock, and those whose match the user discarded. found:
    result of matching, in short; verdicts: on each of these pairs. Assessments with all candidates
    would fill the memory: they are made again for the few pairs that other runs concern.
    """

    matcher: Pairwise
    locked: Collection[Pair] = ()
    discarded: Collection[Pair] = ()
    found: dict[Pair, Summary] = field(default_factory=dict)
    verdicts: dict[Pair, PairVerdict] = field(default_factory=dict)

    def match_likely(self) -> None:
        """Match all pairs of a small batch; of a large one those that pass screening, and those
        that a person named."""
        named = {*self.locked, *self.discarded}
        wanted = wanted_pairs(self.matcher, named)
        runs = len(self.matcher.maps)
        self.say(f"{runs} maps, {len(wanted)} of {pairs_of(runs)} pairs to match")
        self.match(wanted)

    def match(self, wanted: IntArray) -> None:
        """Match (k, 2) pairs and assess them."""
        results = self.matcher.pairs(wanted)
        found = {(i, j): short for (i, j), short in zip(wanted.tolist(), results, strict=True)}
        found |= {pair: Summary() for pair in self.discarded if pair in found}
        self.found.update(found)
        for some in in_parts(list(found)):
            for pair, assessment in self.assessments(some).items():
                self.verdicts[pair] = Case(*self.prepared(pair), assessment).verdict()

    def prepared(self, pair: Pair) -> tuple[Prepared, Prepared]:
        """The two maps of a pair."""
        return self.matcher.prepared[pair[0]], self.matcher.prepared[pair[1]]

    def say(self, text: str) -> None:
        """Report an event."""
        self.matcher.means.say(text)

    @cached_property
    def threshold(self) -> ThresholdOf:
        """The thresholds, given the pairs that were matched first."""
        against_chance = {pair: short.against_chance for pair, short in self.found.items()}
        prepared, settings = self.matcher.prepared, self.matcher.settings
        return thresholds(prepared, settings, against_chance, self.matcher.with_themselves())

    def assessments(self, pairs: Sequence[Pair]) -> dict[Pair, Assessment]:
        """Assessments of pairs by their two maps alone. Those that would be merged must lead every
        other hypothesis beyond chance, and the mirror image."""
        known = self.candidates(pairs)
        out = self._assessed({pair: known.get(pair, ()) for pair in pairs})
        for pair, assessment in out.items():
            faint = self.found[pair].faint or assessment.faint
            out[pair] = replace(assessment, faint=faint, discarded=pair in self.discarded)
        merged = [pair for pair, assessment in out.items() if assessment.verdict is Verdict.MERGED]
        thorough = self.matcher.thorough(_rows(merged))
        return out | self._assessed(dict(zip(merged, thorough, strict=True)))

    def _assessed(self, candidates: Mapping[Pair, tuple[Candidate, ...]]) -> dict[Pair, Assessment]:
        """The assessment of each pair by these candidates."""
        cases = [
            (*self.prepared(pair), found, self.threshold(pair))
            for pair, found in candidates.items()
        ]
        return dict(zip(candidates, assess_all(cases), strict=True))

    def candidates(self, pairs: Iterable[Pair]) -> dict[Pair, tuple[Candidate, ...]]:
        """The candidates of those of the pairs that have any beyond chance."""
        full = [pair for pair in pairs if self.found[pair].full]
        return dict(zip(full, self.matcher.candidates(_rows(full)), strict=True))

    @property
    def unlocked(self) -> dict[Pair, PairVerdict]:
        """The verdicts on pairs that no lock names."""
        return {pair: v for pair, v in self.verdicts.items() if pair not in self.locked}

    def corroborated(self, pairs: Iterable[Pair], components: Components) -> dict[Pair, Candidate]:
        """Pairs of one component with a candidate that agrees with where other runs place the two:
        the first such candidate. Pairs without one are left out."""
        together = [pair for pair in pairs if components.together(*pair)]
        found = {
            (i, j): self._agreeing(candidates, components.relative(i, j), j)
            for (i, j), candidates in self.candidates(together).items()
        }
        return {pair: c for pair, c in found.items() if c is not None}

    def _agreeing(
        self, candidates: Iterable[Candidate], T_i_j: FloatArray, j: int
    ) -> Candidate | None:
        """The first candidate that places run j as T_i_j does; None if there is none."""
        place = self.matcher.places[j]
        return next((c for c in candidates if agrees(as_alignment(c), T_i_j, place)), None)

    def same_place_bits(self, pairs: Sequence[Pair]) -> list[float]:
        """Evidence that the alignments of merged pairs are not copies [bits], without those of
        pairs that a lock names."""
        cases = []
        for pair, found in self.candidates(p for p in pairs if p not in self.locked).items():
            best = self.verdicts[pair].best
            assert best is not None
            chosen = self._agreeing(found, best.transform, pair[1])
            cases += [] if chosen is None else [(*self.prepared(pair), chosen)]
        if not cases:
            return []
        copies = self.threshold(sorted({k for pair in pairs for k in pair})).copies
        return [same.bits for same in sameness_of(cases, copies)]

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
        components; refused are those that are merged by themselves with another placement."""
        places = self.matcher.places
        if len(self.found) == pairs_of(len(places)):
            return {}
        over = {*lying_over(components, places), *joined}
        fresh = sorted(p for p in over if p not in self.found)
        self.match(_rows(fresh))
        out = {}
        for i, j in fresh:
            found = self.verdicts[i, j].best if self.verdicts[i, j].accepted else None
            if found is not None and not agrees(found, components.relative(i, j), places[j]):
                out[i, j] = ELSEWHERE
        return out


def _rows(pairs: Sequence[Pair]) -> IntArray:
    """(k, 2) pairs as an array."""
    return np.array(pairs, np.int64).reshape(-1, 2)


def in_parts(pairs: Sequence[Pair]) -> Iterator[Sequence[Pair]]:
    """The pairs, as many as are assessed at once."""
    return (pairs[k : k + MATCH.at_once] for k in range(0, len(pairs), MATCH.at_once))


def wanted_pairs(matcher: Pairwise, named: Iterable[Pair] = ()) -> IntArray:
    """(k, 2) pairs to be matched: all of a small batch; of a large one those that pass screening,
    and those named by locks."""
    likely = pairs_to_match(matcher.prepared, matcher.settings)
    return np.unique(np.concatenate([likely, _rows(sorted(named))]), axis=0)


def match_shard(
    maps: Sequence[TopoMap], settings: RobustSettings, share: tuple[int, int], means: Means
) -> int:
    """Match the i-th of n shares of the pairs (i from 1 on) for the store; returns their number."""
    matcher = Pairwise(sorted(maps, key=lambda m: m.run), settings, means)
    wanted = wanted_pairs(matcher)
    mine = np.array_split(wanted[tile_order(wanted)], share[1])[share[0] - 1]
    matcher.pairs(mine)
    return len(mine)
