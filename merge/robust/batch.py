"""The maps of a batch matched with each other: which pairs, and what they say by themselves."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import chain

import numpy as np

from ...topology.topomap import TopoMap
from ..result import PairVerdict, Verdict, pairs_of
from .alignment import Candidate
from .components import ELSEWHERE, Components, Refusal, agrees, lying_over
from .mirror import doubt_mirrored
from .pairing import Means, Pair, Pairwise, Told, in_tiles
from .prepare import FloatArray, IntArray
from .screening import pairs_to_match
from .settings import MATCH, RobustSettings
from .verdict import Bar, Opinion, PairCount, needed_bits, opinions


@dataclass(eq=False)
class Batch:
    """What was found between the maps of a batch, and what the two maps of each pair say alone.

    asked: pairs that a person spoke of. opinions: of these, and of pairs that by themselves are
    merged, or would be but for a mirror image; alone: of all the others, which are most of a large
    batch, the verdict is `worded` at once, and nothing else is held.
    """

    matcher: Pairwise
    bar_of: Callable[[Sequence[int], PairCount], Bar]
    worded: Callable[[Pair, Opinion], PairVerdict]
    asked: Collection[Pair] = ()
    found: dict[Pair, Told] = field(default_factory=dict)
    opinions: dict[Pair, Opinion] = field(default_factory=dict)
    alone: dict[Pair, PairVerdict] = field(default_factory=dict)
    _count: dict[int, PairCount] = field(default_factory=dict)

    def level(self, some: Sequence[int], pairs: int | None = None) -> Bar:
        """What two maps, or two components, must reach: so many pairs share the rate of false
        merges. All of the batch if it is not told, also those that were found to have no chance."""
        pairs = pairs_of(len(self.matcher.maps)) if pairs is None else pairs
        if pairs not in self._count:
            need = needed_bits(pairs, self.matcher.settings)
            beyond = int(np.count_nonzero(self._against_chance >= need))
            self._count[pairs] = PairCount(pairs, beyond)
        return self.bar_of(some, self._count[pairs])

    @cached_property
    def _against_chance(self) -> FloatArray:
        """What the pairs that were matched first say against chance."""
        return np.array([found.against_chance for found in self.found.values()])

    def look_at(self, wanted: IntArray, gone: Iterable[Pair] = ()) -> None:
        """Match (k, 2) pairs; what is found between some is taken back."""
        told = self.matcher.pairs(wanted)
        found = {(i, j): short for (i, j), short in zip(wanted.tolist(), told, strict=True)}
        found |= {pair: Told() for pair in gone}
        self.found.update(found)
        likely = {}
        pairs = list(found)
        for start in range(0, len(pairs), MATCH.at_once):
            for pair, (view, _) in self.views(pairs[start : start + MATCH.at_once]).items():
                if pair in gone:
                    likely[pair] = replace(view, discarded=True)
                elif view.verdict is Verdict.MERGED or pair in self.asked:
                    likely[pair] = view
                else:
                    self.alone[pair] = self.worded(pair, view)
        self.opinions.update(doubt_mirrored(likely, self._image_bits))

    def views(self, pairs: Sequence[Pair]) -> dict[Pair, tuple[Opinion, tuple[Candidate, ...]]]:
        """What the two maps of each of some pairs say alone, but for mirror images, and the
        candidates that they say it by."""
        prepared, found = self.matcher.prepared, self.found
        full = [pair for pair in pairs if found[pair].full]
        rows = np.array(full, np.int64).reshape(-1, 2)
        candidates = dict(zip(full, self.matcher.candidates(rows), strict=True))
        cases = [
            (prepared[i], prepared[j], candidates.get((i, j), ()), self.level((i, j)))
            for i, j in pairs
        ]
        out = {}
        for pair, (_, _, told, _), view in zip(pairs, cases, opinions(cases), strict=True):
            faint = found[pair].faint
            out[pair] = (view if faint is None else replace(view, faint=faint)), told
        return out

    def undecided(self) -> list[Pair]:
        """Pairs with a placement that chance does not offer."""
        chance = MATCH.lead_bits
        known = ((pair, view.best, view.bits) for pair, view in self.opinions.items())
        worded = ((pair, told.best, told.evidence_bits) for pair, told in self.alone.items())
        both = chain(known, worded)
        return [pair for pair, best, bits in both if best is not None and bits > chance]

    def _image_bits(self, pairs: list[Pair]) -> dict[Pair, float]:
        return self.matcher.image_bits(np.array(pairs, np.int64).reshape(-1, 2))

    def look_again(self, components: Components, joined: Iterable[Pair]) -> dict[Pair, Refusal]:
        """Match the pairs that the index gave no chance and that now lie over each other, or were
        joined by their components; those that by themselves want to lie elsewhere are refused."""
        prepared = self.matcher.prepared
        if len(self.found) == pairs_of(len(prepared)):
            return {}
        over = {*lying_over(components, [m.z for m in prepared]), *joined}
        fresh = sorted(p for p in over if p not in self.found)
        self.look_at(np.array(fresh, np.int64).reshape(-1, 2))
        out = {}
        for i, j in fresh:
            view = self.opinions.get((i, j))
            if view is None or view.verdict is not Verdict.MERGED or view.best is None:
                continue
            if not agrees(view.best, components.relative(i, j), prepared[j]):
                out[i, j] = ELSEWHERE
        return out


def wanted_pairs(matcher: Pairwise, locked: Iterable[Pair] = ()) -> IntArray:
    """(k, 2) pairs to be matched: all of a small batch; of a large one those that have a chance,
    and those that a person spoke of."""
    likely = pairs_to_match(matcher.prepared, matcher.settings, matcher.digests, matcher.means.kept)
    asked = np.array(sorted(locked), np.int64).reshape(-1, 2)
    return np.unique(np.concatenate([likely, asked]), axis=0)


def match_shard(
    maps: Sequence[TopoMap], settings: RobustSettings, share: tuple[int, int], means: Means
) -> int:
    """Match the i-th of n shares of the pairs, i from 1 on, for the store alone; how many."""
    matcher = Pairwise(sorted(maps, key=lambda m: m.run), settings, means)
    wanted = in_tiles(wanted_pairs(matcher))
    mine = np.array_split(wanted, share[1])[share[0] - 1]
    matcher.pairs(mine)
    return len(mine)
