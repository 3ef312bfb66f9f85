"""The maps of a batch matched with each other: which pairs, and what they say by themselves."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ...topology.topomap import TopoMap
from ..result import Verdict, pairs_of
from .components import ELSEWHERE, Components, Refusal, agrees, lying_over
from .mirror import doubt_mirrored
from .pairing import Means, Pair, Pairwise, in_tiles
from .prepare import FloatArray, IntArray
from .records import Found
from .screening import pairs_to_match
from .settings import RobustSettings
from .verdict import Bar, Opinion, PairCount, needed_bits, opinions


@dataclass(eq=False)
class Batch:
    """What was found between the maps of a batch, and what the two maps of each pair say alone."""

    matcher: Pairwise
    bar_of: Callable[[Sequence[int], PairCount], Bar]
    found: dict[Pair, Found] = field(default_factory=dict)
    opinions: dict[Pair, Opinion] = field(default_factory=dict)
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
        settings = self.matcher.settings
        return np.array([found.against_chance(settings) for found in self.found.values()])

    def look_at(self, wanted: IntArray, gone: Iterable[Pair] = ()) -> None:
        """Match (k, 2) pairs; what is found between some is taken back."""
        prepared = self.matcher.prepared
        found = self.matcher.pairs(wanted) | {pair: Found() for pair in gone}
        self.found.update(found)
        cases = [
            (prepared[i], prepared[j], both.candidates, self.level((i, j)))
            for (i, j), both in found.items()
        ]
        fresh = {
            pair: view if both.faint is None else replace(view, faint=both.faint)
            for (pair, both), view in zip(found.items(), opinions(cases), strict=True)
        }
        fresh |= {pair: replace(fresh[pair], discarded=True) for pair in gone}
        self.opinions.update(doubt_mirrored(fresh, self._image_bits, self.matcher.settings))

    def _image_bits(self, pairs: list[Pair]) -> dict[Pair, float]:
        return self.matcher.image_bits(np.array(pairs, np.int64).reshape(-1, 2))

    def look_again(self, components: Components, joined: Iterable[Pair]) -> dict[Pair, Refusal]:
        """Match the pairs that the index gave no chance and that now lie over each other, or were
        joined by their components; those that by themselves want to lie elsewhere are refused."""
        prepared = self.matcher.prepared
        if len(self.opinions) == pairs_of(len(prepared)):
            return {}
        over = {*lying_over(components, [m.z for m in prepared]), *joined}
        fresh = sorted(p for p in over if p not in self.opinions)
        self.look_at(np.array(fresh, np.int64).reshape(-1, 2))
        out = {}
        for i, j in fresh:
            view = self.opinions[i, j]
            if view.verdict is not Verdict.MERGED or view.best is None:
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
