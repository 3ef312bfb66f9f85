"""Matching the merged maps of components: the evidence of many runs, every junction counted once.

Two components with an undecided pair of runs between them are joined if their merged maps match.
The threshold is that of the pairs of runs not joined yet: as long as nothing was merged wrongly, a
wrong merge can only be one of these (Holm's procedure: Scandinavian Journal of Statistics 6, 1979;
without implied pairs, Shaffer: JASA 81, 1986).
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import product

import numpy as np

from ...topology.columns import joined, take
from ...topology.topomap import RunNoise, TopoMap
from ...topology.views import NO_VIEWS, Views
from ...topology.wording import listed
from ..component_map import component_map
from ..fusion.fuse import component_digest, fused_once
from ..kept import Kept, Kind
from ..result import (
    Alignment,
    Component,
    FusedMap,
    MergeResult,
    PairVerdict,
    Verdict,
    fused_confidence,
    pairs_of,
    site_views,
)
from .alignment import Candidate, fit_matches
from .components import Components
from .pairing import Pair, Pairwise, candidates_of, image_bits_of, results_of
from .prepare import Prepared, prepare
from .thresholds import ThresholdOf
from .verdict import Assessment, Matched, Threshold, assess_all, held_against_image
from .wording import describe_evidence

Runs = tuple[int, ...]


class MergedMap:
    """The merged map of some runs, made on first access. Their names do not change it.

    runs: rows in the batch, sorted; maps: theirs; inside: the verdicts that join them.
    """

    def __init__(
        self, runs: Runs, maps: Sequence[TopoMap], inside: Sequence[PairVerdict], kept: Kept
    ) -> None:
        self.runs = runs
        self.maps = dict(zip(runs, maps, strict=True))
        self._inside = inside
        self._kept = kept
        self._by_content = sorted(maps, key=kept.digest)

    @property
    def names(self) -> tuple[str, ...]:
        """The names of its runs."""
        return tuple(m.run for m in self.maps.values())

    @cached_property
    def digest(self) -> bytes:
        """Digest of the maps and verdicts that it is made of."""
        return component_digest(self._by_content, self._inside, self._kept)

    @property
    def order(self) -> tuple[int, list[bytes]]:
        """By which merged maps are ordered: their size, and the digests of their maps."""
        return len(self.runs), [self._kept.digest(m) for m in self._by_content]

    @cached_property
    def _fused(self) -> tuple[Component, FusedMap]:
        """The runs as one component, and their fused map."""
        return fused_once(self._by_content, self._inside, sigmas=False, kept=self._kept)

    @cached_property
    def members(self) -> Sequence[Mapping[str, tuple[int, ...]]]:
        """For each vertex, the vertices of its runs that were fused into it, by run."""
        if len(self.runs) > 1:
            return self._fused[1].members
        (alone,) = self.maps.values()
        return tuple({alone.run: (v,)} for v in range(len(alone)))

    @cached_property
    def as_map(self) -> TopoMap:
        """The same as the map of one run that saw everything."""
        maps = self._by_content
        return maps[0] if len(maps) == 1 else _as_single_run(*self._fused, maps)

    @cached_property
    def prepared(self) -> Prepared:
        """The same, prepared for matching."""
        return prepare(self.as_map)


class MergedMaps:
    """The merged maps of groups of runs of a batch, and their matches."""

    def __init__(self, matcher: Pairwise) -> None:
        self._matcher = matcher
        self._kept = matcher.means.kept
        self._made: dict[Runs, MergedMap] = {}

    def of(self, runs: Runs, accepted: Mapping[Pair, Alignment]) -> MergedMap:
        """The merged map of some runs, sorted, by the accepted alignments between them."""
        if runs not in self._made:
            maps, inside = self._matcher.maps, []
            for i, j in sorted(pair for pair in accepted if set(runs).issuperset(pair)):
                best = accepted[i, j]
                bits, names = float(len(best.matched)), (maps[i].run, maps[j].run)
                inside.append(PairVerdict(*names, Verdict.MERGED, True, bits, "", best=best))
            merged = MergedMap(runs, [maps[i] for i in runs], inside, self._kept)
            if len(runs) == 1:
                merged.prepared = self._matcher.prepared[runs[0]]
            self._made[runs] = merged
        return self._made[runs]

    def candidates(self, a: MergedMap, b: MergedMap) -> tuple[Candidate, ...]:
        """The candidates of two merged maps that are beyond chance."""
        return candidates_of(self._result(Kind.PAIR, a, b))

    def image_bits(self, a: MergedMap, b: MergedMap) -> float:
        """The evidence for the mirror image of two merged maps."""
        return image_bits_of(self._result(Kind.MIRRORED, a, b))

    def _result(self, kind: Kind, a: MergedMap, b: MergedMap) -> bytes:
        def result() -> bytes:
            (of_pair,) = results_of(kind, [(a.prepared, b.prepared)], self._matcher.settings)
            return of_pair

        return self._kept.result(kind, (a.digest, b.digest), result)


def _as_single_run(component: Component, fused: FusedMap, topomaps: Sequence[TopoMap]) -> TopoMap:
    """A fused map as the map of one run that saw everything; each noise term is the largest of the
    runs'."""
    by_name = {m.run: m for m in topomaps}
    fields = RunNoise.__dataclass_fields__
    noise = RunNoise(**{name: max(getattr(m.noise, name) for m in topomaps) for name in fields})
    whole = component_map(MergeResult((component,), fused, ()), component.id, "+".join(by_name))
    return replace(
        whole,
        noise=noise,
        shows_bends=any(m.shows_bends for m in topomaps),
        confidence=fused_confidence(fused.members, by_name),
        views=_thin(site_views(fused, component, by_name)),
    )


VIEWS_APART_M = 2.0
"""Least distance of the views of a merged map, so that no place counts once for each run. Those of
a run are 3 m apart, so that views of another run may fill its gaps."""


def _thin(views: Sequence[Views]) -> Views:
    """Views of several runs as those of one: each `VIEWS_APART_M` from those before it."""
    if not views:
        return NO_VIEWS
    concatenated = joined(views)
    xy = concatenated.pose[:, :2]
    kept = np.zeros(len(xy), np.bool_)
    for k, position in enumerate(xy):
        kept[k] = not np.any(np.hypot(*(xy[:k][kept[:k]] - position).T) < VIEWS_APART_M)
    return take(concatenated, kept)


@dataclass(frozen=True, slots=True, eq=False)
class ComponentMatch:
    """A pair of runs joined by a match of their components.

    assessment: of the two components; sides: the runs of each.
    """

    alignment: Alignment
    reason: str
    assessment: Assessment
    sides: tuple[tuple[str, ...], tuple[str, ...]]


Sides = tuple[Runs, Runs]
"""Two components, each by its sorted runs."""


@dataclass(frozen=True, slots=True, eq=False)
class _Union:
    """Two components that their evidence joins, and the alignments of pairs of their runs that the
    match implies, the strongest first."""

    a: MergedMap
    b: MergedMap
    assessment: Assessment
    implied: Mapping[Pair, Alignment]

    def pair_matches(self) -> Iterator[tuple[Pair, ComponentMatch]]:
        """The match of each pair of runs."""
        first, second = sorted((self.a, self.b), key=lambda m: m.runs)
        maps, sides = {**first.maps, **second.maps}, (first.names, second.names)
        for pair, alignment in self.implied.items():
            others = sorted(m.run for k, m in maps.items() if k not in pair)
            reason = f"together with {listed(others, 4)}: {describe_evidence(self.assessment)}"
            yield pair, ComponentMatch(alignment, reason, self.assessment, sides)


@dataclass(slots=True, eq=False)
class Rematcher:
    """Matches the fused maps of components with open pairs between them, until nothing joins.

    Changes `components`. The strongest union of each round is carried out and its component fused
    again, so that every decision uses all that is known. undecided: pairs with a placement better
    than chance; threshold: for some runs in a batch of so many pairs; discarded: pairs whose match
    the user discarded; unmet: for locked pairs without an alignment that satisfies the lock, the
    junctions that it names.
    """

    matcher: Pairwise
    components: Components
    undecided: Sequence[Pair]
    threshold: ThresholdOf
    discarded: Collection[Pair] = ()
    unmet: Mapping[Pair, tuple[int, int]] = field(default_factory=dict)
    _merged: MergedMaps = field(init=False)
    _known: dict[tuple[Sides, Threshold], _Union | None] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._merged = MergedMaps(self.matcher)

    def run(self, joined: Mapping[Pair, Alignment]) -> dict[Pair, ComponentMatch]:
        """The pairs joined by their components. joined: alignments of the pairs joined before."""
        accepted = dict(joined)
        matches: dict[Pair, ComponentMatch] = {}
        while unions := self._unions(accepted):
            strongest = max(unions, key=lambda u: (u.assessment.bits, u.a.runs, u.b.runs))
            accepted.update(strongest.implied)
            matches.update(strongest.pair_matches())
            (i, j), alignment = next(iter(strongest.implied.items()))
            self.components.join(i, j, alignment.transform)
        return matches

    def _open_components(self) -> list[Sides]:
        """Pairs of components with an undecided pair of runs between them. Left out are pairs of
        single runs, and those that a lock or a discarded match keeps apart."""
        members, head = self.components.members, self.components.head
        self.undecided = [(i, j) for i, j in self.undecided if head[i] != head[j]]
        across = {(head[i], head[j]) for i, j in self.undecided}
        discarded = {frozenset((head[i], head[j])) for i, j in self.discarded}
        runs = {k: tuple(sorted(members[k])) for pair in across for k in pair}
        return sorted(
            {
                (min(runs[x], runs[y]), max(runs[x], runs[y]))
                for x, y in across
                if len(runs[x]) + len(runs[y]) > 2
                and frozenset((x, y)) not in discarded
                and self.components.forbidden(x, y) is None
            }
        )

    def _unions(self, accepted: Mapping[Pair, Alignment]) -> list[_Union]:
        """The unions of components with sufficient evidence. That of two components by one
        threshold is computed once for all rounds.

        The threshold against chance is shared by the remaining pairs, after Holm. The threshold
        against copies could be as well: as long as nothing was merged wrongly, a wrong merge can
        only be a pair across components. But then pairs that only merged maps show to be beyond
        chance would have to be counted, too. Tried: of 338 pairs of three batches of 72 runs in
        tunnels 5 more are merged, none wrongly; but the count would have to be kept in the document
        for `explain`.
        """
        members = self.components.members.values()
        remaining = pairs_of(len(self.matcher.maps)) - sum(pairs_of(len(runs)) for runs in members)
        sides = self._open_components()
        keys = [((a, b), self.threshold((*a, *b), remaining)) for a, b in sides]
        unknown = [key for key in keys if key not in self._known]
        merged = [
            sorted((self._merged.of(runs, accepted) for runs in sides), key=lambda m: m.order)
            for sides, _ in unknown
        ]
        assessments = assess_all(
            [
                Matched(a.prepared, b.prepared, self._merged.candidates(a, b), threshold)
                for (a, b), (_, threshold) in zip(merged, unknown, strict=True)
            ]
        )
        for key, (a, b), assessment in zip(unknown, merged, assessments, strict=True):
            self._known[key] = self._union(a, b, assessment)
        return [union for key in keys if (union := self._known[key]) is not None]

    def _union(self, a: MergedMap, b: MergedMap, assessment: Assessment) -> _Union | None:
        """The union of two components; None without the evidence, or if a lock is not satisfied."""
        if assessment.verdict is Verdict.MERGED:
            assessment = held_against_image(assessment, self._merged.image_bits(a, b))
        if assessment.verdict is not Verdict.MERGED:
            return None
        implied = _implied_alignments(a, b, assessment)
        if not implied:
            return None
        for pair, at in self.unmet.items():
            i, j = pair
            across = (i in a.runs and j in b.runs) or (j in a.runs and i in b.runs)
            honoured = pair in implied and np.all(implied[pair].matched == at, axis=1).any()
            if across and not honoured:
                return None
        return _Union(a, b, assessment, implied)


def _implied_alignments(
    a: MergedMap, b: MergedMap, assessment: Assessment
) -> dict[Pair, Alignment]:
    """The alignments of pairs of runs that a match of two fused maps implies, the pairs with most
    common junctions first.

    A pair is aligned by the matched junctions that both its runs saw. Pairs with fewer than three
    are left out, unless there are no others: then the best one with at least two counts.
    """
    best = assessment.best
    assert best is not None
    maps = {**a.maps, **b.maps}
    number = {m.run: k for k, m in maps.items()}
    shared: dict[Pair, list[tuple[int, int]]] = defaultdict(list)
    for vertex_a, vertex_b in zip(best.a.tolist(), best.b.tolist(), strict=True):
        seen_a, seen_b = sorted(a.members[vertex_a].items()), sorted(b.members[vertex_b].items())
        for (run_a, of_a), (run_b, of_b) in product(seen_a, seen_b):
            (i, u), (j, v) = sorted([(number[run_a], of_a[0]), (number[run_b], of_b[0])])
            shared[i, j].append((u, v))
    ranked = sorted(shared.items(), key=lambda item: (-len(item[1]), item[0]))
    strong = [item for item in ranked if len(item[1]) >= 3]
    implied = {}
    for (i, j), pairs in strong or [item for item in ranked[:1] if len(item[1]) >= 2]:
        matched = np.array(sorted(pairs), np.int64)
        transform, rmse = fit_matches(maps[i].xy[matched[:, 0]], maps[j].xy[matched[:, 1]])
        corridors, test = len(best.corridors), assessment.copy_test
        implied[i, j] = Alignment(
            transform, assessment.bits, matched, rmse, corridors, copy_test=test
        )
    return implied
