"""All maps of a batch matched with each other: which pairs are matched, and the verdict on each
pair by itself."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import chain, islice

import numpy as np

from ...topology.arrays import FloatArray, IntArray
from ...topology.topomap import TopoMap
from ..result import Alignment, PairVerdict, Verdict, pairs_of
from .alignment import Candidate
from .assessment import ThresholdOf
from .components import ELSEWHERE, Components, Refusal, agrees, as_alignment, lying_over
from .mirror import doubt_mirrored
from .pairing import Means, Pair, Pairwise
from .repetition import sameness_of
from .screening import pairs_to_match
from .settings import MATCH, RobustSettings
from .tasks import Told, in_tiles
from .verdict import OTHER_SIZE, Assessment, PairCount, Threshold, assess_all, needed_bits


@dataclass(eq=False)
class Batch:
    """The matches between the maps of a batch, and the verdicts on pairs by their two maps alone.

    thresholds_of: the thresholds, given the pairs with a placement better than chance
    (`assessment.thresholds`). asked: pairs named by a lock. found: result of matching, in short.
    assessments: full assessments of locked and discarded pairs, and of pairs that would be merged
    but for a rival or a mirror image; joins: verdicts on pairs that are merged by themselves;
    alone: verdicts on all other pairs, the majority of a large batch, of which nothing but the
    verdict in words (`worded`) is kept.
    """

    matcher: Pairwise
    thresholds_of: Callable[[Mapping[Pair, float]], ThresholdOf]
    worded: Callable[[Pair, Assessment], PairVerdict]
    asked: Collection[Pair] = ()
    found: dict[Pair, Told] = field(default_factory=dict)
    assessments: dict[Pair, Assessment] = field(default_factory=dict)
    joins: dict[Pair, PairVerdict] = field(default_factory=dict)
    alone: dict[Pair, PairVerdict] = field(default_factory=dict)
    _count: dict[int, PairCount] = field(default_factory=dict)

    def threshold(self, some: Sequence[int], pairs: int | None = None) -> Threshold:
        """The threshold for two maps or two components if `pairs` pairs share the rate of false
        merges; by default all pairs of the batch, including those screened out."""
        pairs = pairs_of(len(self.matcher.maps)) if pairs is None else pairs
        if pairs not in self._count:
            need = needed_bits(pairs, self.matcher.settings)
            beyond = int(np.count_nonzero(self._against_chance >= need))
            self._count[pairs] = PairCount(pairs, beyond)
        return self._threshold_of(some, self._count[pairs])

    @cached_property
    def _threshold_of(self) -> ThresholdOf:
        """Given the pairs that were matched first."""
        found = self.found.items()
        chance = MATCH.lead_bits
        return self.thresholds_of(
            {p: t.against_chance for p, t in found if t.against_chance > chance}
        )

    @cached_property
    def _against_chance(self) -> FloatArray:
        """Evidence against chance of the pairs that were matched first [bits]."""
        return np.array([found.against_chance for found in self.found.values()])

    def look_at(self, wanted: IntArray, gone: Iterable[Pair] = ()) -> None:
        """Match (k, 2) pairs and assess them; matches of the pairs in `gone` are discarded."""
        told = self.matcher.pairs(wanted)
        found = {(i, j): short for (i, j), short in zip(wanted.tolist(), told, strict=True)}
        found |= {pair: Told() for pair in gone}
        self.found.update(found)
        likely, pairs = {}, list(found)
        for start in range(0, len(pairs), MATCH.at_once):
            for pair, (view, _) in self.views(pairs[start : start + MATCH.at_once]).items():
                if pair in gone:
                    likely[pair] = replace(view, discarded=True)
                elif view.verdict is Verdict.MERGED or pair in self.asked:
                    likely[pair] = view
                else:
                    self._hold(pair, view)
        likely |= self.beside_rivals(likely)
        for pair, view in doubt_mirrored(likely, self._image_bits).items():
            if view.verdict is Verdict.MERGED and pair not in self.asked:
                self._hold(pair, view)
            else:
                self.assessments[pair] = view

    def _hold(self, pair: Pair, view: Assessment) -> None:
        verdict = self.worded(pair, view)
        (self.joins if verdict.accepted else self.alone)[pair] = verdict

    def corroborated(self, pairs: Iterable[Pair], components: Components) -> dict[Pair, int]:
        """Pairs of one component with a candidate that agrees with where other runs place the two:
        the index of the first such candidate. Pairs without one are left out."""
        full = [pair for pair in pairs if self.found[pair].full and components.together(*pair)]
        out: dict[Pair, int] = {}
        for start in range(0, len(full), MATCH.at_once):
            some = full[start : start + MATCH.at_once]
            for pair, candidates in self.candidates(some).items():
                T_i_j, b = components.relative(*pair), self.matcher.places[pair[1]]
                for n, c in enumerate(candidates):
                    if c.bits > MATCH.lead_bits and agrees(as_alignment(c), T_i_j, b):
                        out[pair] = n
                        break
        return out

    def candidates(self, pairs: Sequence[Pair]) -> dict[Pair, tuple[Candidate, ...]]:
        """The candidates of those of the pairs that have any beyond chance."""
        full = [pair for pair in pairs if self.found[pair].full]
        rows = np.array(full, np.int64).reshape(-1, 2)
        return dict(zip(full, self.matcher.candidates(rows), strict=True))

    def views(self, pairs: Sequence[Pair]) -> dict[Pair, tuple[Assessment, tuple[Candidate, ...]]]:
        """Assessments of pairs by their two maps alone, without mirror images, with the candidates
        assessed."""
        known = self.candidates(pairs)
        candidates = [known.get(pair, ()) for pair in pairs]
        out = {}
        views = self._assessments(pairs, candidates)
        for pair, told, view in zip(pairs, candidates, views, strict=True):
            faint = self.found[pair].faint
            out[pair] = (view if faint is None else replace(view, faint=faint)), told
        return out

    def beside_rivals(self, views: Mapping[Pair, Assessment]) -> dict[Pair, Assessment]:
        """Assessments of the pairs that would be merged, after growing all hypotheses beyond
        chance."""
        pairs = [pair for pair, view in views.items() if view.verdict is Verdict.MERGED]
        found = self.matcher.beside_rivals(np.array(pairs, np.int64).reshape(-1, 2))
        return dict(zip(pairs, self._assessments(pairs, found), strict=True))

    def _assessments(
        self, pairs: Sequence[Pair], candidates: Sequence[tuple[Candidate, ...]]
    ) -> list[Assessment]:
        """The assessment of each pair by these candidates."""
        prepared = self.matcher.prepared
        told = zip(pairs, candidates, strict=True)
        return assess_all(
            [(prepared[i], prepared[j], c, self.threshold((i, j))) for (i, j), c in told]
        )

    def of_other_size(self) -> dict[Pair, Alignment]:
        """The alignments of pairs that are not merged because one map is larger throughout."""
        return {
            pair: told.best
            for pair, told in self.alone.items()
            if told.best is not None and told.lacks == OTHER_SIZE
        }

    def asked_for_copies(self) -> dict[Pair, tuple[Alignment, float]]:
        """The alignments of pairs that were tested for being a copy, with the result [bits]."""
        held = chain(self.joins.items(), self.alone.items())
        told = ((pair, v.best, v.extra.get("same_place_bits")) for pair, v in held)
        return {pair: (best, bits) for pair, best, bits in told if best and bits is not None}

    def same_place_bits(self, pairs: Sequence[Pair]) -> list[float]:
        """Evidence that the alignments of some merged pairs are not copies [bits]."""
        found, maps = self.candidates([pair for pair in pairs if pair in self.joins]), self.matcher
        cases = []
        for (i, j), candidates in found.items():
            best = self.joins[i, j].best
            assert best is not None
            T_i_j, b = best.transform, maps.places[j]
            chosen = (c for c in candidates if agrees(as_alignment(c), T_i_j, b))
            cases += [(maps.prepared[i], maps.prepared[j], c) for c in islice(chosen, 1)]
        if not cases:
            return []
        copies = self.threshold(sorted({k for pair in pairs for k in pair})).copies
        return [same.bits for same in sameness_of(cases, copies)]

    def undecided(self) -> list[Pair]:
        """Pairs with a placement better than chance, merged or not."""
        chance = MATCH.lead_bits
        known = ((pair, view.best, view.bits) for pair, view in self.assessments.items())
        held = chain(self.joins.items(), self.alone.items())
        worded = ((pair, told.best, told.evidence_bits) for pair, told in held)
        both = chain(known, worded)
        return [pair for pair, best, bits in both if best is not None and bits > chance]

    def _image_bits(self, pairs: list[Pair]) -> dict[Pair, float]:
        return self.matcher.image_bits(np.array(pairs, np.int64).reshape(-1, 2))

    def look_again(self, components: Components, joined: Iterable[Pair]) -> dict[Pair, Refusal]:
        """Match the pairs that were screened out and now overlap, or were joined by their
        components; refused are those that are merged by themselves with another placement."""
        places = self.matcher.places
        if len(self.found) == pairs_of(len(places)):
            return {}
        over = {*lying_over(components, places), *joined}
        fresh = sorted(p for p in over if p not in self.found)
        self.look_at(np.array(fresh, np.int64).reshape(-1, 2))
        out = {}
        for i, j in fresh:
            told = self.joins.get((i, j))
            if told is None or told.best is None:
                continue
            if not agrees(told.best, components.relative(i, j), places[j]):
                out[i, j] = ELSEWHERE
        return out


def wanted_pairs(matcher: Pairwise, locked: Iterable[Pair] = ()) -> IntArray:
    """(k, 2) pairs to be matched: all of a small batch; of a large one those that pass screening,
    and those named by locks."""
    likely = pairs_to_match(matcher.prepared, matcher.settings)
    asked = np.array(sorted(locked), np.int64).reshape(-1, 2)
    return np.unique(np.concatenate([likely, asked]), axis=0)


def match_shard(
    maps: Sequence[TopoMap], settings: RobustSettings, share: tuple[int, int], means: Means
) -> int:
    """Match the i-th of n shares of the pairs (i from 1 on) for the store; returns their number."""
    matcher = Pairwise(sorted(maps, key=lambda m: m.run), settings, means)
    wanted = in_tiles(wanted_pairs(matcher))
    mine = np.array_split(wanted, share[1])[share[0] - 1]
    matcher.pairs(mine)
    return len(mine)
