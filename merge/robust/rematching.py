"""Merged maps matched again: the evidence of many runs, every physical thing counted once.

Two components with an open pair across them are joined where their merged maps say so.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from ...topology.se2 import fit_rigid
from ...topology.topomap import TopoMap
from ..packs import Kept
from ..result import Alignment, Verdict
from .alignment import Candidate, match
from .components import Components
from .merged_maps import MergedMap, MergedMaps, Runs
from .mirror import fits_as_well
from .prepare import Prepared
from .settings import RobustSettings
from .verdict import ODD_BITS, Bar, Opinion, opinion
from .wording import summary

Pair = tuple[int, int]

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
        while (found := self._strongest(accepted)) is not None:
            one, two, view = found
            links = _links(one, two, view)
            for pair, alignment in links.items():
                accepted[pair] = alignment
                reason = _reason(pair, one, two, view, self.maps)
                reunions[pair] = Reunion(alignment, reason, view.margin, (one.names, two.names))
            (i, j), first = next(iter(links.items()))
            self.components.join(i, j, first.transform)
        return reunions

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
        level = max(across, key=lambda bar: (bar.need_bits, bar.copied))
        candidates = self._merged.matched(one, two, self.settings)
        if not candidates:
            return None
        view = opinion(one.prepared, two.prepared, candidates, level)
        if view.verdict is not Verdict.MERGED or view.best is None or not _links(one, two, view):
            return None
        image = self._merged.image_bits(one, two, self.settings)
        return None if fits_as_well(image, view.best, self.settings) else (one, two, view)

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
