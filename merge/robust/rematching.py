"""Matching the merged maps of components: the evidence of many runs, every junction counted once.

Two components with an undecided pair of runs across them are joined if their merged maps say so.
The threshold is that of the pairs of runs not joined yet: as long as nothing was merged wrongly, a
wrong merge can only be one of these (Holm's procedure: Scandinavian Journal of Statistics 6, 1979;
without implied pairs, Shaffer: JASA 81, 1986).
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from ...topology.topomap import TopoMap
from ..kept import Kept
from ..result import Alignment, Verdict, pairs_of
from .alignment import Candidate, laid_over
from .components import Components
from .merged_maps import MergedMap, MergedMaps, Runs
from .mirror import fits_as_well
from .prepare import Prepared
from .settings import RobustSettings
from .verdict import Assessment, Threshold, assess_all
from .wording import summary

Pair = tuple[int, int]


@dataclass(frozen=True, slots=True, eq=False)
class Reunion:
    """A pair of runs joined by a match of their components.

    view: the assessment of the two components; sides: the runs of each.
    """

    alignment: Alignment
    reason: str
    view: Assessment
    sides: tuple[tuple[str, ...], tuple[str, ...]]


Sides = tuple[Runs, Runs]
"""Two components, each by its sorted runs."""

Asked = tuple[MergedMap, MergedMap]

Said = tuple[MergedMap, MergedMap, Assessment]


@dataclass(slots=True, eq=False)
class Rematcher:
    """Matches the fused maps of components with open pairs between them, until nothing joins.

    Changes `components`. The strongest match of each round is carried out and its component fused
    again, so that every decision uses all that is known. threshold: for some runs in a batch of so
    many pairs; dishonoured: the junctions that locks name as one place, of the pairs that no
    alignment of their own joins so. The result for two merged maps and a threshold is computed once
    for all rounds; None stands for too little evidence.
    """

    maps: Sequence[TopoMap]
    prepared: Sequence[Prepared]
    components: Components
    undecided: Sequence[Pair]
    threshold: Callable[[Sequence[int], int], Threshold]
    settings: RobustSettings
    discarded: frozenset[Pair] = frozenset()
    dishonoured: Mapping[Pair, tuple[int, int]] = field(default_factory=dict)
    kept: Kept = field(default_factory=Kept)
    _merged: MergedMaps = field(init=False)
    _told: dict[tuple[MergedMap, MergedMap, Threshold], Assessment | None] = field(
        default_factory=dict
    )

    def __post_init__(self) -> None:
        self._merged = MergedMaps(self.maps, self.kept, self.prepared)

    def run(self, joined: Mapping[Pair, Alignment]) -> dict[Pair, Reunion]:
        """The pairs joined by their components; joined: the alignments of the pairs joined
        before."""
        accepted = dict(joined)
        reunions: dict[Pair, Reunion] = {}
        open_ = self._open()
        near: dict[Runs, set[Runs]] = defaultdict(set)
        for x, y in open_:
            near[x].add(y)
            near[y].add(x)
        asked = self._asked(open_, accepted)
        while found := self._said(asked):
            one, two, view = max(found, key=_strength)
            links = _links(one, two, view)
            for pair, alignment in links.items():
                accepted[pair] = alignment
                reason = _reason(pair, one, two, view, self.maps)
                sides = (one.names, two.names)
                reunions[pair] = Reunion(alignment, reason, view, sides)
            (i, j), first = next(iter(links.items()))
            self.components.join(i, j, first.transform)
            # Results between other components stay valid.
            gone = {one.runs, two.runs}
            whole = tuple(sorted((*one.runs, *two.runs)))
            others = near[whole] = (near.pop(one.runs) | near.pop(two.runs)) - gone
            for side in others:
                near[side] -= gone
                near[side].add(whole)
            asked = {sides: maps for sides, maps in asked.items() if not gone & {*sides}}
            asked |= self._asked({(min(whole, x), max(whole, x)) for x in others}, accepted)
        return reunions

    def _open(self) -> set[Sides]:
        """Pairs of components with an undecided pair across them."""
        members, head = self.components.members, self.components.head
        across = {(head[i], head[j]) for i, j in self.undecided if head[i] != head[j]}
        runs = {k: tuple(sorted(members[k])) for pair in across for k in pair}
        return {(min(runs[x], runs[y]), max(runs[x], runs[y])) for x, y in across}

    def _asked(
        self, open_: Iterable[Sides], accepted: Mapping[Pair, Alignment]
    ) -> dict[Sides, Asked]:
        """The merged maps of the pairs of components to match: those with open pairs between them
        that are not both single runs, and that neither a lock nor a discarded match keeps apart."""
        return {
            (x, y): (self._merged.of(x, accepted), self._merged.of(y, accepted))
            for x, y in sorted(open_)
            if len(x) + len(y) > 2 and not self._apart(x, y)
        }

    def _said(self, asked: Mapping[Sides, Asked]) -> list[Said]:
        """The pairs of components whose evidence suffices to merge them, with their assessments.

        The threshold against chance is shared by the remaining pairs, after Holm. The threshold
        against copies could be as well: as long as nothing was merged wrongly, a wrong merge can
        only be a pair across components. But then pairs that only merged maps show to be beyond
        chance would have to be counted, too. Tried: of 338 pairs of three batches of 72 runs in
        tunnels 5 more are merged, none wrongly; but the count would have to be kept in the document
        for `explain`.
        """
        members = self.components.members.values()
        left = pairs_of(len(self.maps)) - sum(pairs_of(len(runs)) for runs in members)
        wanted = [(a, b, self.threshold((*a.runs, *b.runs), left)) for a, b in asked.values()]
        fresh, cases = [], []
        for one, two, threshold in wanted:
            key = one, two, threshold
            if key in self._told:
                continue
            self._told[key] = None
            candidates = self._merged.matched(one, two, self.settings)
            if candidates:
                fresh.append(key)
                cases.append((one.prepared, two.prepared, candidates, threshold))
        for key, view in zip(fresh, assess_all(cases), strict=True):
            if self._joins(*key[:2], view):
                self._told[key] = view
        told = ((one, two, self._told[one, two, threshold]) for one, two, threshold in wanted)
        joined = [(one, two, view) for one, two, view in told if view is not None]
        return [said for said in joined if self._honours_locks(*said)]

    def _apart(self, x: Runs, y: Runs) -> bool:
        """Whether a lock forbids joining two components, or a match between them was discarded,
        which would be found again."""
        if self.components.forbidden(x[0], y[0]) is not None:
            return True
        return any((min(i, j), max(i, j)) in self.discarded for i in x for j in y)

    def _joins(self, one: MergedMap, two: MergedMap, view: Assessment) -> bool:
        if view.verdict is not Verdict.MERGED or view.best is None or not _links(one, two, view):
            return False
        image = self._merged.image_bits(one, two, self.settings)
        return not fits_as_well(image, view.best)

    def _honours_locks(self, one: MergedMap, two: MergedMap, view: Assessment) -> bool:
        """Whether a match of two components matches all that locks name as one place."""
        asked = {
            (i, j): at
            for (i, j), at in self.dishonoured.items()
            if (i in one.runs and j in two.runs) or (j in one.runs and i in two.runs)
        }
        links = _links(one, two, view) if asked else {}
        return all(
            pair in links and bool(np.all(links[pair].matched == at, axis=1).any())
            for pair, at in asked.items()
        )


def _strength(said: Said) -> tuple[float, Runs, Runs]:
    one, two, view = said
    return view.bits, one.runs, two.runs


def matches_of_components(
    maps: Sequence[TopoMap],
    sides: tuple[Runs, Runs],
    accepted: Mapping[Pair, Alignment],
    settings: RobustSettings,
    kept: Kept,
) -> tuple[MergedMap, MergedMap, tuple[Candidate, ...]]:
    """The merged maps of two components, and how these can be matched. sides: the runs of each,
    sorted; accepted: the alignments by which each was joined; kept: results of earlier merges."""
    merged = MergedMaps(maps, kept)
    one, two = (merged.of(runs, accepted) for runs in sides)
    return one, two, merged.matched(one, two, settings)


def _links(one: MergedMap, two: MergedMap, view: Assessment) -> dict[Pair, Alignment]:
    """The alignments of pairs of runs that a match of two fused maps implies, the strongest
    first."""
    assert view.best is not None
    known = {**one.maps, **two.maps}
    out = {}
    for (i, j), pairs in linked_junctions(one, two, view.best).items():
        matched = np.array(pairs, np.int64)
        pa, pb = known[i].xy[matched[:, 0]], known[j].xy[matched[:, 1]]
        transform, rmse = laid_over(pa, pb)
        corridors, tested = len(view.best.corridors), view.answers[0].copy_test
        out[i, j] = Alignment(transform, view.bits, matched, rmse, corridors, copy_test=tested)
    return out


def linked_junctions(
    one: MergedMap, two: MergedMap, best: Candidate
) -> dict[Pair, list[tuple[int, int]]]:
    """The junctions of pairs of runs, sorted, that a match of two fused maps makes one; the pairs
    with most first.

    A pair is linked by the matched places that both its runs saw; pairs with fewer than three are
    left out, unless there are no others: then the best one with at least two counts.
    """
    shared: dict[Pair, list[tuple[int, int]]] = defaultdict(list)
    run_of_one = {m.run: i for i, m in one.maps.items()}
    run_of_two = {m.run: j for j, m in two.maps.items()}
    for p, q in zip(best.a.tolist(), best.b.tolist(), strict=True):
        for run_i, vertices_i in sorted(one.members[p].items()):
            for run_j, vertices_j in sorted(two.members[q].items()):
                i, j = run_of_one[run_i], run_of_two[run_j]
                u, v = vertices_i[0], vertices_j[0]
                shared[(i, j) if i < j else (j, i)].append((u, v) if i < j else (v, u))
    ranked = sorted(shared.items(), key=lambda item: (-len(item[1]), item[0]))
    strong = [item for item in ranked if len(item[1]) >= 3]
    some = strong or [item for item in ranked[:1] if len(item[1]) >= 2]
    return {pair: sorted(pairs) for pair, pairs in some}


def _reason(
    pair: Pair, one: MergedMap, two: MergedMap, view: Assessment, maps: Sequence[TopoMap]
) -> str:
    assert view.best is not None
    names = sorted(maps[i].run for i in (*one.runs, *two.runs) if i not in pair)
    shown = ", ".join(names[:4]) + (f" and {len(names) - 4} more" if len(names) > 4 else "")
    return f"together with {shown}: {summary(view.best, view.bits, view.need_bits, view.margin)}"
