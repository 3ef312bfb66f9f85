"""Matching the merged maps of components: the evidence of many runs, every junction counted once.

Two components with an undecided pair of runs across them are joined if their merged maps say so.
The threshold is that of the pairs of runs not joined yet: as long as nothing was merged wrongly, a
wrong merge can only be one of these (Holm's procedure: Scandinavian Journal of Statistics 6, 1979;
without implied pairs, Shaffer: JASA 81, 1986).
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ...topology.columns import joined, take
from ...topology.topomap import RunNoise, TopoMap
from ...topology.views import NO_VIEWS, Views
from ...topology.wording import listed
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
    pairs_of,
    site_views,
)
from .alignment import Candidate, fit_matches, match
from .components import Components
from .pairing import Pair, Pairwise, candidates_of, result_of
from .prepare import Prepared, prepare
from .thresholds import ThresholdOf
from .verdict import Assessment, Threshold, assess_all
from .wording import describe_evidence

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
    """The merged maps of groups of runs of a batch, and what matching them finds."""

    def __init__(self, matcher: Pairwise) -> None:
        self._matcher = matcher
        self._kept = matcher.means.kept
        self._made: dict[Runs, MergedMap] = {}

    def of(self, runs: Runs, accepted: Mapping[Pair, Alignment]) -> MergedMap:
        """The merged map of some runs, sorted, by the accepted alignments between them, which stay
        the same as long as the runs do."""
        if runs not in self._made:
            maps, inside, those = self._matcher.maps, [], set(runs)
            for i, j in sorted(pair for pair in accepted if those.issuperset(pair)):
                best = accepted[i, j]
                bits, names = float(len(best.matched)), (maps[i].run, maps[j].run)
                inside.append(PairVerdict(*names, Verdict.MERGED, True, bits, "", best=best))
            made = MergedMap(runs, [maps[i] for i in runs], inside, self._kept)
            if len(runs) == 1:
                made.prepared = self._matcher.prepared[runs[0]]
            self._made[runs] = made
        return self._made[runs]

    def candidates(self, one: MergedMap, two: MergedMap) -> tuple[Candidate, ...]:
        """The candidates of two of them that are beyond chance."""
        settings = self._matcher.settings

        def found() -> bytes:
            every = match(one.prepared, two.prepared, settings, thorough=True)
            return result_of(every, settings)

        return candidates_of(self._kept.result(Kind.THOROUGH, (one.digest, two.digest), found))


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
    """Two components that their evidence joins, and the alignments of pairs of their runs that
    follow, the strongest first."""

    one: MergedMap
    two: MergedMap
    assessment: Assessment
    links: Mapping[Pair, Alignment]

    def of_pairs(self) -> Iterator[tuple[Pair, ComponentMatch]]:
        """What it says of pairs of runs."""
        known, best = {**self.one.maps, **self.two.maps}, self.assessment
        for pair, alignment in self.links.items():
            others = sorted(m.run for k, m in known.items() if k not in pair)
            reason = f"together with {listed(others, 4)}: {describe_evidence(best)}"
            yield pair, ComponentMatch(alignment, reason, best, (self.one.names, self.two.names))


@dataclass(slots=True, eq=False)
class Rematcher:
    """Matches the fused maps of components with open pairs between them, until nothing joins.

    Changes `components`. The strongest union of each round is carried out and its component fused
    again, so that every decision uses all that is known. undecided: pairs with a placement better
    than chance; threshold: for some runs in a batch of so many pairs; unmet: the junctions that
    locks name as one place, of the pairs that no alignment of their own joins so.
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
        """The pairs joined by their components; joined: the alignments of the pairs joined
        before."""
        accepted = dict(joined)
        matches: dict[Pair, ComponentMatch] = {}
        while found := self._unions(accepted):
            strongest = max(found, key=lambda m: (m.assessment.bits, m.one.runs, m.two.runs))
            accepted.update(strongest.links)
            matches.update(strongest.of_pairs())
            (i, j), first = next(iter(strongest.links.items()))
            self.components.join(i, j, first.transform)
        return matches

    def _open(self) -> list[Sides]:
        """Pairs of components with an undecided pair across them that are not both single runs, and
        that neither a lock nor a discarded match, which would be found again, keeps apart."""
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
        """The unions of components whose evidence suffices. That of two by a threshold is computed
        once for all rounds.

        The threshold against chance is shared by the remaining pairs, after Holm. The threshold
        against copies could be as well: as long as nothing was merged wrongly, a wrong merge can
        only be a pair across components. But then pairs that only merged maps show to be beyond
        chance would have to be counted, too. Tried: of 338 pairs of three batches of 72 runs in
        tunnels 5 more are merged, none wrongly; but the count would have to be kept in the document
        for `explain`.
        """
        members = self.components.members.values()
        left = pairs_of(len(self.matcher.maps)) - sum(pairs_of(len(runs)) for runs in members)
        open_ = [((x, y), self.threshold((*x, *y), left)) for x, y in self._open()]
        fresh = [key for key in open_ if key not in self._known]
        cases = []
        for (x, y), threshold in fresh:
            one, two = self._merged.of(x, accepted), self._merged.of(y, accepted)
            cases.append((one, two, self._merged.candidates(one, two), threshold))
        assessed = assess_all([(one.prepared, two.prepared, c, t) for one, two, c, t in cases])
        for key, (one, two, *_), assessment in zip(fresh, cases, assessed, strict=True):
            self._known[key] = self._union(one, two, assessment)
        return [union for key in open_ if (union := self._known[key]) is not None]

    def _union(self, one: MergedMap, two: MergedMap, assessment: Assessment) -> _Union | None:
        """The union of two components; None if there is too little evidence for it, or if it does
        not honour a lock."""
        if assessment.verdict is not Verdict.MERGED or assessment.best is None:
            return None
        links = _links(one, two, assessment)
        if not links:
            return None
        for (i, j), at in self.unmet.items():
            across = (i in one.runs and j in two.runs) or (j in one.runs and i in two.runs)
            if across and not ((i, j) in links and np.all(links[i, j].matched == at, axis=1).any()):
                return None
        return _Union(one, two, assessment, links)


def _links(one: MergedMap, two: MergedMap, found: Assessment) -> dict[Pair, Alignment]:
    """The alignments of pairs of runs that a match of two fused maps implies, the pairs with most
    common junctions first.

    A pair is linked by the matched places that both its runs saw; pairs with fewer than three are
    left out, unless there are no others: then the best one with at least two counts.
    """
    best = found.best
    assert best is not None
    known = {**one.maps, **two.maps}
    number = {m.run: k for k, m in known.items()}
    shared: dict[Pair, list[tuple[int, int]]] = defaultdict(list)
    for p, q in zip(best.a.tolist(), best.b.tolist(), strict=True):
        for run_i, vertices_i in sorted(one.members[p].items()):
            for run_j, vertices_j in sorted(two.members[q].items()):
                ends = (number[run_i], vertices_i[0]), (number[run_j], vertices_j[0])
                (i, u), (j, v) = sorted(ends)
                shared[i, j].append((u, v))
    ranked = sorted(shared.items(), key=lambda item: (-len(item[1]), item[0]))
    strong = [item for item in ranked if len(item[1]) >= 3]
    out = {}
    for (i, j), pairs in strong or [item for item in ranked[:1] if len(item[1]) >= 2]:
        matched = np.array(sorted(pairs), np.int64)
        transform, rmse = fit_matches(known[i].xy[matched[:, 0]], known[j].xy[matched[:, 1]])
        corridors, asked = len(best.corridors), found.copy_test
        out[i, j] = Alignment(transform, found.bits, matched, rmse, corridors, copy_test=asked)
    return out
