"""Merged maps matched again: the evidence of many runs, every physical thing counted once.

Two components with an open pair across them are joined where their merged maps say so. Where many
pairs lack only that they be told from copies, no first pair of them may ever be certain, though all
together are: such runs are taken to belong together for trial, and their group stands if each of
its two parts, however it is cut in two, is joined by what the merged map of the one says of that of
the other. A group is as sure as its weakest cut; where that fails, it falls into the two parts.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.cluster.hierarchy import DisjointSet

from ...topology.se2 import fit_rigid
from ...topology.topomap import TopoMap
from ..packs import Kept
from ..result import Alignment, Verdict
from .alignment import Candidate, match
from .components import Components, agrees, join_all
from .merged_maps import MergedMap, MergedMaps, Runs
from .mirror import fits_better
from .prepare import Prepared
from .settings import RobustSettings
from .verdict import ODD_BITS, Bar, Opinion, opinion
from .wording import summary

Pair = tuple[int, int]

MOST_CUT = 5
"""Groups of up to so many components are tried at every cut (15 at most)."""

MOST_TRIED = 12
"""Of groups of more components those that are tied weakly are left out beforehand. If more stay,
they are not tried: so many runs that lack nothing but this are copies."""

OPEN_BITS = ODD_BITS
"""Components are matched again where some pair across them has more evidence than this."""


@dataclass(frozen=True, slots=True, eq=False)
class Reunion:
    """A pair of runs joined by what their components say together. margin: the lead of this
    placement over the next best one of the two components, None if there was none; sides: the runs
    of the two components."""

    alignment: Alignment
    reason: str
    margin: float | None
    sides: tuple[tuple[str, ...], tuple[str, ...]]


@dataclass(frozen=True, slots=True, eq=False)
class _Cut:
    """A group of runs in two parts, and what their merged maps say of each other."""

    one: MergedMap
    two: MergedMap
    view: Opinion

    @property
    def runs(self) -> Runs:
        """All runs of the group."""
        return (*self.one.runs, *self.two.runs)

    def parts(self, i: int, j: int) -> bool:
        """Whether two runs are on different sides."""
        return (i in self.one.runs) != (j in self.one.runs)

    def reunion(self, pair: Pair, link: Alignment, maps: Sequence[TopoMap]) -> Reunion:
        """A pair of the group, as sure as this cut."""
        alignment = replace(link, evidence_bits=self.view.bits)
        reason = _reason(pair, self.one, self.two, self.view, maps)
        return Reunion(alignment, reason, self.view.margin, (self.one.names, self.two.names))


@dataclass(slots=True, eq=False)
class Rematcher:
    """Matches the fused maps of components with open pairs between them, until nothing joins.

    Changes `components`. The strongest reunion of each round is carried out, then its component
    is fused anew, so that every decision uses all that is known.
    """

    maps: Sequence[TopoMap]
    prepared: Sequence[Prepared]
    components: Components
    opinions: Mapping[Pair, Opinion]
    level: Callable[[Pair], Bar]
    settings: RobustSettings
    discarded: frozenset[Pair] = frozenset()
    kept: Kept | None = None
    _merged: MergedMaps = field(init=False)
    _failed: set[tuple[Runs, Runs]] = field(default_factory=set)
    _undecided: list[Pair] = field(init=False)

    def __post_init__(self) -> None:
        views = self.opinions.items()
        self._merged = MergedMaps(self.maps, self.prepared, self.kept)
        self._undecided = [p for p, v in views if v.bits > OPEN_BITS and v.best is not None]

    def run(self, joined: Mapping[Pair, Candidate]) -> dict[Pair, Reunion]:
        """The pairs that components say belong together; `joined` are those that already do."""
        accepted = {pair: _plain(c) for pair, c in joined.items()}
        reunions: dict[Pair, Reunion] = {}
        self._join_strongest(accepted, reunions)
        while self._join_groups(accepted, reunions):
            self._join_strongest(accepted, reunions)
        return reunions

    def _join_strongest(
        self, accepted: dict[Pair, Alignment], reunions: dict[Pair, Reunion]
    ) -> None:
        while (found := self._strongest(accepted)) is not None:
            one, two, view = found
            links = _links(one, two, view)
            for pair, alignment in links.items():
                accepted[pair] = alignment
                reason = _reason(pair, one, two, view, self.maps)
                reunions[pair] = Reunion(alignment, reason, view.margin, (one.names, two.names))
            (i, j), first = next(iter(links.items()))
            self.components.join(i, j, first.transform)

    def _join_groups(self, accepted: dict[Pair, Alignment], reunions: dict[Pair, Reunion]) -> bool:
        """Join the groups of components that stand at every cut. Whether there was any."""
        best = {
            (i, j): view.best
            for (i, j), view in self.opinions.items()
            if view.maybe_copy and view.best is not None and not self.components.together(i, j)
            if view.margin is None or view.margin >= self.settings.lead_bits
        }
        order = sorted(best, key=lambda pair: (-self.opinions[pair].answers[0].carried, pair))
        trial = self.components.copy()
        refused = join_all(trial, order, best, self.prepared, [m.run for m in self.maps])
        links = {pair: _plain(c) for pair, c in best.items() if pair not in refused}
        found = False
        for runs in sorted(trial.members.values()):
            parts = {tuple(sorted(self.components.members[self.components.head[i]])) for i in runs}
            groups = self._strongly_tied(sorted(parts), links)
            known = {**accepted, **links}
            for cuts in (c for g in groups for c in self._standing(g, known, links, trial)):
                inside = {i for cut in cuts for i in cut.runs}
                for i, j in sorted(p for p in links if inside.issuperset(p)):
                    cut = min(cuts, key=lambda c: (not c.parts(i, j), c.view.bits))
                    reunions[i, j] = cut.reunion((i, j), links[i, j], self.maps)
                    accepted[i, j] = links[i, j]
                    if not self.components.together(i, j):
                        self.components.join(i, j, links[i, j].transform)
                found = True
        return found

    def _strongly_tied(
        self, parts: Sequence[Runs], links: Mapping[Pair, Alignment]
    ) -> list[list[Runs]]:
        """Groups of components to be tried: all, if they are few; else those that hang together
        without the ones whose pairs with all others tell too little to join them (`_may_stand`),
        without the ones that then tell too little, and so on."""
        if len(parts) <= MOST_TRIED:
            return [list(parts)]
        of = {run: k for k, part in enumerate(parts) for run in part}
        inside = [(i, j) for i, j in links if i in of and j in of]
        pairs = np.array([(of[i], of[j]) for i, j in inside], np.int64).reshape(-1, 2)
        told = [self.opinions[pair] for pair in inside]
        same = np.array([max(view.same_bits or 0.0, 0.0) for view in told])
        need = np.array([view.answers[0].need_same for view in told])
        alive = np.ones(len(parts), np.bool_)
        while True:
            both = alive[pairs].all(axis=1)
            bits, most = np.zeros(len(parts)), np.full(len(parts), -np.inf)  # of no pair: weak
            for k in (0, 1):
                np.add.at(bits, pairs[both, k], same[both])
                np.maximum.at(most, pairs[both, k], need[both])
            weak = alive & ((2 * bits < most) | np.isneginf(most))
            if not weak.any():
                break
            alive &= ~weak
        tied = DisjointSet(np.flatnonzero(alive).tolist())
        for i, j in pairs[both].tolist():
            tied.merge(i, j)
        groups = sorted(sorted(group) for group in tied.subsets())
        return [[parts[k] for k in group] for group in groups if len(group) <= MOST_TRIED]

    def _standing(
        self,
        parts: Sequence[Runs],
        accepted: Mapping[Pair, Alignment],
        links: Mapping[Pair, Alignment],
        trial: Components,
    ) -> list[list[_Cut]]:
        """The groups among some components, tied by `links`, that stand; each with its cuts."""
        if len(parts) < 2 or sum(map(len, parts)) < 3:
            return []
        same = {pair: max(self.opinions[pair].same_bits or 0.0, 0.0) for pair in links}
        cuts = []
        for x, y in _two_parts(parts, same):
            cut = self._cut(x, y, accepted, trial) if self._may_stand(x, y, same) else None
            if cut is None:
                return [
                    group
                    for side in (x, y)
                    for group in self._standing(side, accepted, links, trial)
                ]
            cuts.append(cut)
        return [cuts]

    def _may_stand(self, x: Sequence[Runs], y: Sequence[Runs], same: Mapping[Pair, float]) -> bool:
        """Whether the pairs across a cut tell so much that merged maps may tell enough.

        Merged maps, more exact than their runs, told up to 1.4 times what the pairs told together.
        """
        one, two = ({i for part in side for i in part} for side in (x, y))
        across = [p for p in same if len(one.intersection(p)) == len(two.intersection(p)) == 1]
        need = max(self.opinions[pair].answers[0].need_same for pair in across)
        return 2 * sum(same[pair] for pair in across) >= need

    def _cut(
        self,
        x: Sequence[Runs],
        y: Sequence[Runs],
        accepted: Mapping[Pair, Alignment],
        trial: Components,
    ) -> _Cut | None:
        """What the two sides of a cut say of each other, if that joins them as in `trial`."""
        first, second = (tuple(sorted(i for part in side for i in part)) for side in (x, y))
        found = self._reunion(first, second, accepted)
        if found is None:
            return None
        one, two, view = found
        T_one_two = trial.relative(one.runs[0], two.runs[0])
        if view.best is None or not agrees(view.best, T_one_two, two.prepared):
            return None
        return _Cut(one, two, view)

    def _strongest(
        self, accepted: Mapping[Pair, Alignment]
    ) -> tuple[MergedMap, MergedMap, Opinion] | None:
        """The best-founded reunion of two components; those that fail are not tried again."""
        found: list[tuple[MergedMap, MergedMap, Opinion]] = []
        for x, y in self._open():
            if (x, y) in self._failed:
                continue
            reunion = self._reunion(x, y, accepted)
            if reunion is None:
                self._failed.add((x, y))
            else:
                found.append(reunion)
        return max(found, key=lambda f: (f[2].bits, f[0].runs, f[1].runs), default=None)

    def _reunion(
        self, x: Runs, y: Runs, accepted: Mapping[Pair, Alignment]
    ) -> tuple[MergedMap, MergedMap, Opinion] | None:
        if self.components.forbidden(x[0], y[0]) is not None:
            return None
        if any((min(i, j), max(i, j)) in self.discarded for i in x for j in y):
            return None  # what was taken back would be found again
        one, two = (self._merged.of(runs, accepted) for runs in (x, y))
        across = [self.level((min(i, j), max(i, j))) for i in x for j in y]
        level = max(across, key=lambda bar: (bar.need_bits, bar.repetition, bar.copied))
        candidates = self._merged.matched(one, two, self.settings)
        if not candidates:
            return None
        view = opinion(one.prepared, two.prepared, candidates, level)
        if view.verdict is not Verdict.MERGED or view.best is None or not _links(one, two, view):
            return None
        image = self._merged.image_bits(one, two, self.settings)
        return None if fits_better(image, view.best, self.settings) else (one, two, view)

    def _open(self) -> list[tuple[Runs, Runs]]:
        """Pairs of components, not both single runs, with an undecided pair across them."""
        pairs = set()
        for i, j in self._undecided:
            if self.components.together(i, j):
                continue
            heads = (self.components.head[i], self.components.head[j])
            x, y = sorted(tuple(sorted(self.components.members[h])) for h in heads)
            if len(x) + len(y) > 2:
                pairs.add((x, y))
        return sorted(pairs)


def _two_parts(
    parts: Sequence[Runs], links: Mapping[Pair, float]
) -> list[tuple[list[Runs], list[Runs]]]:
    """The ways to cut components tied by links in two, both sides tied in themselves.

    links: pairs of runs with their bits. The cuts through the fewest bits come first. Of many
    components only those through the fewest between any two of them (Gomory & Hu), and those that
    cut a single one off.
    """
    n = len(parts)
    of = {run: k for k, part in enumerate(parts) for run in part}
    tied: dict[Pair, float] = defaultdict(float)
    for (i, j), bits in links.items():
        if i in of and j in of and of[i] != of[j]:
            tied[min(of[i], of[j]), max(of[i], of[j])] += bits
    everyone = frozenset(range(n))
    if n <= MOST_CUT:
        rows = range(2 ** (n - 1) - 1)
        ones = [frozenset({0, *(k for k in range(1, n) if row >> (k - 1) & 1)}) for row in rows]
    else:
        ones = sorted({*_least_cuts(n, tied), *(frozenset({k}) for k in range(n))}, key=sorted)
    out = []
    for one in ones:
        sides = (sorted(one), sorted(everyone - one))
        if all(_connected(side, tied) for side in sides):
            a, b = ([parts[k] for k in side] for side in sides)
            through = sum(bits for pair, bits in tied.items() if len(one.intersection(pair)) == 1)
            out.append((through, a, b))
    return [(a, b) for _, a, b in sorted(out, key=lambda cut: cut[:2])]


def _least_cuts(n: int, tied: Mapping[Pair, float]) -> list[frozenset[int]]:
    """One side of the least cut between any two of n nodes."""
    import networkx

    graph = networkx.Graph()
    graph.add_nodes_from(range(n))
    graph.add_edges_from((i, j, {"capacity": bits}) for (i, j), bits in sorted(tied.items()))
    tree = networkx.gomory_hu_tree(graph)
    cuts = []
    for i, j in sorted(tree.edges):
        rest = networkx.restricted_view(tree, [], [(i, j)])
        cuts.append(frozenset(networkx.node_connected_component(rest, 0)))
    return cuts


def _connected(nodes: Sequence[int], tied: Iterable[Pair]) -> bool:
    joined = DisjointSet(nodes)
    for i, j in tied:
        if i in joined and j in joined:
            joined.merge(i, j)
    return joined.n_subsets == 1


def view_of_components(
    maps: Sequence[TopoMap],
    sides: tuple[Runs, Runs],
    accepted: Mapping[Pair, Alignment],
    level: Bar,
    settings: RobustSettings,
) -> tuple[MergedMap, MergedMap, Opinion]:
    """What the merged maps of two components say of each other. sides: the runs of each, sorted;
    accepted: the alignments by which each was joined."""
    merged = MergedMaps(maps)
    one, two = (merged.of(runs, accepted) for runs in sides)
    candidates = match(one.prepared, two.prepared, settings)
    return one, two, opinion(one.prepared, two.prepared, candidates, level)


def _links(one: MergedMap, two: MergedMap, view: Opinion) -> dict[Pair, Alignment]:
    """What a match of two fused maps says of pairs of their runs, the strongest pair first.

    A pair is linked by the matched places that both its runs saw; of pairs with fewer than three
    only the best one counts, and only if no pair has more.
    """
    assert view.best is not None
    shared: dict[Pair, list[tuple[int, int]]] = defaultdict(list)
    run_of_one = {m.run: i for i, m in one.maps.items()}
    run_of_two = {m.run: j for j, m in two.maps.items()}
    for p, q in zip(view.best.a.tolist(), view.best.b.tolist(), strict=True):
        for run_i, vertices_i in sorted(one.members[p].items()):
            for run_j, vertices_j in sorted(two.members[q].items()):
                i, j = run_of_one[run_i], run_of_two[run_j]
                u, v = vertices_i[0], vertices_j[0]
                shared[(i, j) if i < j else (j, i)].append((u, v) if i < j else (v, u))
    ranked = sorted(shared.items(), key=lambda item: (-len(item[1]), item[0]))
    strong = [item for item in ranked if len(item[1]) >= 3]
    known = {**one.maps, **two.maps}
    out = {}
    for (i, j), pairs in strong or [item for item in ranked[:1] if len(item[1]) >= 2]:
        matched = np.array(sorted(pairs), np.int64)
        pa, pb = known[i].xy[matched[:, 0]], known[j].xy[matched[:, 1]]
        transform = fit_rigid(pa, pb)
        unit = np.exp(1j * transform[2])
        moved = unit * (pb @ np.array([1, 1j])) + transform[0] + 1j * transform[1]
        rmse = float(np.sqrt(np.mean(np.abs(pa @ np.array([1, 1j]) - moved) ** 2)))
        out[i, j] = Alignment(transform, view.bits, matched, rmse)
    return out


def _plain(c: Candidate) -> Alignment:
    return Alignment(c.transform, c.bits, np.column_stack([c.a, c.b]), c.rmse_m)


def _reason(
    pair: Pair, one: MergedMap, two: MergedMap, view: Opinion, maps: Sequence[TopoMap]
) -> str:
    assert view.best is not None
    names = sorted(maps[i].run for i in (*one.runs, *two.runs) if i not in pair)
    shown = ", ".join(names[:4]) + (f" and {len(names) - 4} more" if len(names) > 4 else "")
    return f"together with {shown}: {summary(view.best, view.bits, view.need_bits, view.margin)}"
