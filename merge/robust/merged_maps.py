"""The merged maps of components, prepared for matching; each is fused and matched once."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from itertools import combinations

import numpy as np

from ...topology.columns import joined, take
from ...topology.topomap import RunNoise, TopoMap
from ...topology.views import NO_VIEWS, Views
from ..component_map import component_map
from ..fusion.fuse import component_digest, fuse
from ..kept import Kept, Kind
from ..result import (
    Alignment,
    Component,
    FusedMap,
    MergeResult,
    PairVerdict,
    Verdict,
    fused_confidence,
    site_views,
)
from .alignment import Candidate, match
from .mirror import mirrored
from .pairing import Pair, candidates_of, image_bits_of, image_result_of, result_of
from .prepare import Prepared, prepare
from .settings import RobustSettings

Runs = tuple[int, ...]


class MergedMap:
    """The merged map of some runs, made on first access. inside: the verdicts that join them."""

    def __init__(
        self, runs: Runs, own: Sequence[TopoMap], inside: Sequence[PairVerdict], kept: Kept
    ) -> None:
        self.runs = runs
        self.maps = dict(zip(runs, own, strict=True))
        self._inside = inside
        self._kept = kept

    @property
    def names(self) -> tuple[str, ...]:
        """The names of its runs."""
        return tuple(m.run for m in self.maps.values())

    @cached_property
    def digest(self) -> bytes:
        """Digest of all that it follows from."""
        return component_digest(list(self.maps.values()), self._inside, self._kept)

    @cached_property
    def _fused(self) -> tuple[Component, FusedMap]:
        """The runs as one component, and their fused map."""
        (component,), fused = fuse(list(self.maps.values()), self._inside, kept=self._kept)
        return component, fused

    @cached_property
    def members(self) -> Sequence[Mapping[str, tuple[int, ...]]]:
        """For each vertex, the vertices of the runs behind it."""
        if len(self.runs) > 1:
            return self._fused[1].members
        (alone,) = self.maps.values()
        return tuple({alone.run: (v,)} for v in range(len(alone)))

    @cached_property
    def as_map(self) -> TopoMap:
        """As the map of one run that saw everything."""
        own = list(self.maps.values())
        return own[0] if len(own) == 1 else _as_map(*self._fused, own)

    @cached_property
    def prepared(self) -> Prepared:
        """Prepared for matching."""
        return prepare(self.as_map)


class MergedMaps:
    """The merged maps of groups of runs, and their matches. kept: results of earlier merges;
    prepared: the maps, if they are."""

    def __init__(
        self, maps: Sequence[TopoMap], kept: Kept, prepared: Sequence[Prepared] = ()
    ) -> None:
        self._maps = maps
        self._prepared = prepared
        self._kept = kept
        self._made: dict[Runs, MergedMap] = {}
        self._matched: dict[tuple[MergedMap, MergedMap], tuple[Candidate, ...]] = {}

    def of(self, runs: Runs, accepted: Mapping[Pair, Alignment]) -> MergedMap:
        """The merged map of some runs, sorted, by the accepted alignments between them, which stay
        the same as long as the runs do."""
        if runs not in self._made:
            maps, inside = self._maps, []
            for i, j in _inside(runs, accepted):
                best = accepted[i, j]
                bits, names = float(len(best.matched)), (maps[i].run, maps[j].run)
                inside.append(PairVerdict(*names, Verdict.MERGED, True, bits, "", best=best))
            made = MergedMap(runs, [maps[i] for i in runs], inside, self._kept)
            if len(runs) == 1 and self._prepared:
                made.prepared = self._prepared[runs[0]]
            self._made[runs] = made
        return self._made[runs]

    def matched(
        self, one: MergedMap, two: MergedMap, settings: RobustSettings
    ) -> tuple[Candidate, ...]:
        """The candidates of two of them that are beyond chance."""
        if (one, two) not in self._matched:

            def found() -> bytes:
                return result_of(match(one.prepared, two.prepared, settings, rivals=True), settings)

            data = self._kept.result(Kind.RIVALS, (one.digest, two.digest), found)
            self._matched[one, two] = candidates_of(data)
        return self._matched[one, two]

    def image_bits(self, one: MergedMap, two: MergedMap, settings: RobustSettings) -> float:
        """Evidence of the best alignment of the first with the mirror image of the second
        [bits]."""

        def found() -> bytes:
            image = prepare(mirrored(two.as_map))
            return image_result_of(match(one.prepared, image, settings))

        return image_bits_of(self._kept.result(Kind.IMAGE, (one.digest, two.digest), found))


def _inside(runs: Runs, accepted: Mapping[Pair, Alignment]) -> Iterator[Pair]:
    """The accepted pairs of some sorted runs, in order, by the shorter of two searches."""
    if len(runs) ** 2 < len(accepted):
        return (pair for pair in combinations(runs, 2) if pair in accepted)
    those = set(runs)
    return (pair for pair in sorted(accepted) if those.issuperset(pair))


def _as_map(component: Component, fused: FusedMap, own: Sequence[TopoMap]) -> TopoMap:
    """A fused map as the map of one run that saw everything, with the noise of the worst run."""
    maps = {m.run: m for m in own}
    fields = RunNoise.__dataclass_fields__
    noise = RunNoise(**{name: max(getattr(m.noise, name) for m in own) for name in fields})
    whole = component_map(MergeResult((component,), fused, ()), component.id, "+".join(maps))
    return replace(
        whole,
        noise=noise,
        shows_bends=any(m.shows_bends for m in own),
        confidence=fused_confidence(fused.members, maps),
        views=_thinned(site_views(fused, component, maps)),
    )


VIEWS_APART_M = 2.0
"""Views of a merged map are as far apart at least: those of a run are 3 m apart, so that what one
run has left out another may fill in, and no place counts for each of its runs."""


def _thinned(views: Sequence[Views]) -> Views:
    """Views of several runs as those of one: each is `VIEWS_APART_M` from all before it that are
    kept."""
    if not views:
        return NO_VIEWS
    every = joined(views)
    xy = every.pose[:, :2]
    kept = np.zeros(len(xy), np.bool_)
    for k, at in enumerate(xy):
        kept[k] = not np.any(np.hypot(*(xy[:k][kept[:k]] - at).T) < VIEWS_APART_M)
    return take(every, kept)
