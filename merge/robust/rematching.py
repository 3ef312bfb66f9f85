"""Merged maps matched again: the evidence of many runs, every physical thing counted once."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from ...topology.se2 import fit_rigid
from ...topology.topomap import RunNoise, TopoMap
from ..fusion.fuse import fuse
from ..result import Alignment, FusedMap, PairVerdict, Verdict, graph_part
from .alignment import Candidate, match
from .components import Components
from .mirror import image_fits_better, mirrored
from .prepare import Prepared, prepare
from .settings import RobustSettings
from .verdict import ODD_BITS, Bar, Opinion, opinion
from .wording import summary

Pair = tuple[int, int]
Runs = tuple[int, ...]

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
class _Fused:
    """The merged map of a component, also prepared, with the vertices of its runs behind each
    vertex."""

    runs: tuple[int, ...]
    as_map: TopoMap
    prepared: Prepared
    members: tuple[Mapping[str, tuple[int, ...]], ...]
    maps: Mapping[int, TopoMap]

    @property
    def names(self) -> tuple[str, ...]:
        """Its runs by name."""
        return tuple(self.maps[i].run for i in self.runs)


@dataclass(slots=True, eq=False)
class Rematcher:
    """Matches the fused maps of components with open pairs between them, until nothing joins.

    Changes `components`. The strongest reunion of each round is carried out, then its component
    is fused anew, so that every decision uses all that is known.
    """

    maps: Sequence[TopoMap]
    components: Components
    opinions: Mapping[Pair, Opinion]
    levels: Mapping[Pair, Bar]
    settings: RobustSettings
    _cache: dict[Runs, _Fused] = field(default_factory=dict)
    _failed: set[tuple[Runs, Runs]] = field(default_factory=set)

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
    ) -> tuple[_Fused, _Fused, Opinion] | None:
        """The best-founded reunion of two components; those that fail are not tried again."""
        found: list[tuple[_Fused, _Fused, Opinion]] = []
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
    ) -> tuple[_Fused, _Fused, Opinion] | None:
        if self.components.forbidden(x[0], y[0]) is not None:
            return None
        one, two = (_fused(runs, self.maps, accepted, self._cache) for runs in (x, y))
        across = [self.levels[min(i, j), max(i, j)] for i in x for j in y]
        level = max(across, key=lambda bar: (bar.need_bits, bar.repetition))
        candidates = match(one.prepared, two.prepared, self.settings)
        view = opinion(one.prepared, two.prepared, candidates, level)
        if view.verdict is not Verdict.MERGED or view.best is None or not _links(one, two, view):
            return None
        image = prepare(mirrored(two.as_map))
        copied = image_fits_better(one.prepared, image, view.best, self.settings)
        return None if copied else (one, two, view)

    def _open(self) -> list[tuple[Runs, Runs]]:
        """Pairs of components, not both single runs, with an undecided pair across them."""
        pairs = set()
        for (i, j), view in self.opinions.items():
            if self.components.together(i, j) or view.bits <= OPEN_BITS or view.best is None:
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
) -> tuple[_Fused, _Fused, Opinion]:
    """What the merged maps of two components say of each other. sides: the runs of each, sorted;
    accepted: the alignments by which each was joined."""
    cache: dict[Runs, _Fused] = {}
    one, two = (_fused(runs, maps, accepted, cache) for runs in sides)
    candidates = match(one.prepared, two.prepared, settings)
    return one, two, opinion(one.prepared, two.prepared, candidates, level)


def _fused(
    runs: Runs,
    maps: Sequence[TopoMap],
    accepted: Mapping[Pair, Alignment],
    cache: dict[Runs, _Fused],
) -> _Fused:
    """The merged map of some runs, ready to be matched."""
    if runs not in cache:
        own = [maps[i] for i in runs]
        inside = [
            PairVerdict(maps[i].run, maps[j].run, Verdict.MERGED, True, a.evidence_bits, "", best=a)
            for (i, j), a in sorted(accepted.items())
            if i in runs and j in runs
        ]
        _, fused = fuse(own, inside)
        members = fused.members
        as_map = own[0] if len(own) == 1 else _as_map(fused, own)
        cache[runs] = _Fused(runs, as_map, prepare(as_map), members, {i: maps[i] for i in runs})
    return cache[runs]


def _as_map(fused: FusedMap, own: Sequence[TopoMap]) -> TopoMap:
    """A fused map as the map of one run that saw everything; its noise that of the worst run."""
    looks = np.array([len(seen) for seen in fused.observations])
    times = np.arange(int(looks.sum()), dtype=np.int64)
    fields = RunNoise.__dataclass_fields__
    noise = RunNoise(**{name: max(getattr(m.noise, name) for m in own) for name in fields})
    return TopoMap(
        run="+".join(m.run for m in own),
        frame="component",
        observation_vertex=np.repeat(np.arange(len(looks)), looks),
        observation_time_ns=times,
        noise=noise,
        **graph_part(fused, np.ones(len(fused), np.bool_)),
    )


def _links(one: _Fused, two: _Fused, view: Opinion) -> dict[Pair, Alignment]:
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


def _reason(pair: Pair, one: _Fused, two: _Fused, view: Opinion, maps: Sequence[TopoMap]) -> str:
    assert view.best is not None
    names = sorted(maps[i].run for i in (*one.runs, *two.runs) if i not in pair)
    shown = ", ".join(names[:4]) + (f" and {len(names) - 4} more" if len(names) > 4 else "")
    return f"together with {shown}: {summary(view.best, view.bits, view.need_bits, view.margin)}"
