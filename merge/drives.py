"""What to record next: drives that would join sites, ranked by expected bits per metre.

A robot that drives through places of two sites joins them, if it passes enough of each: every
junction brings as much evidence as the site's pairs have for each of theirs, about `junction_bits`,
less where the building repeats itself. So a drive is the shortest walk found through both maps, one
laid over the other by the best placement of an open pair, by as many junctions of each as merging
needs. Where no pair is open, a drive leads into the unknown, by a branch that nobody drove; it is
shown as far as a corridor of usual length, as nobody knows what comes behind that. Either is
expected to bring, for every junction of another site, as much evidence as the site's pairs have for
each of theirs, times the probability that it gets there: that the placement is right, or that the
branch leads to a site. A building that repeats itself has more to tell that a place is no copy; a
drive that would not reach it, by as much as its pairs have for each junction, is not proposed, nor
one that is expected to bring hardly any evidence.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise
from types import MappingProxyType
from typing import Any

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from ..topology.arrays import BoolArray, FloatArray, IntArray
from ..topology.digits import METRES, rounded
from ..topology.driven_branches import driven_branches
from ..topology.se2 import apply, compose, inverse
from .drive import Drive, Stop, Undriven
from .result import Component, FusedMap, MergeResult, PairVerdict, Standing, fused_of, pairs_of
from .robust.settings import MATCH


@dataclass(frozen=True, slots=True)
class DriveSettings:
    """How drives are planned."""

    spare_junctions: int = 3
    """Junctions beyond those that merging needs, as some are missed. Of 19 drives to join mazes,
    cities and organic ways 18 do, of 83 m; with 0 it is 17, of 42 m, and who has to drive once more
    loses more than that (`benchmarks/next.py --spare`)."""
    most_junctions: int = 24
    """Junctions of each site that a drive passes at most: where a building repeats itself a
    junction brings a fraction of a bit, and no drive is long enough."""
    beyond: float = 2.0
    """Corridors driven beyond a branch never driven for every junction that merging needs: other
    sites do not begin at once behind the last junction known. Of 13 such drives 8 join a site, with
    1.0 it is 5. Known corridors up to twice as far straight on count as in its way."""
    least_bits: float = 1.0
    """Evidence that a drive is expected to bring at least: less does not even make a match twice as
    likely."""
    most_planned: int = 30
    """Pairs of sites, those with the likeliest placements, for which a drive is planned: each takes
    some 50 ms, and few are listed."""


DRIVES = DriveSettings()


def drives(result: MergeResult, most: int = 5, component: int | None = None) -> tuple[Drive, ...]:
    """The best `most` drives, by decreasing expected bits per metre; component: only those that
    begin at it or join it.

    One for every two sites with an open pair, `most_planned` of these, and one into the unknown for
    every site. O(pairs + junctions) for each of them.
    """
    components, junction = {c.id: c for c in result.components}, ~result.fused.is_turned
    site = cache(lambda k: _Site(result.fused, components[k], junction))
    wanted = {c.id for c in result.components} if component is None else {component}
    found = [*_joining(result, site, wanted), *_exploring(result, site, wanted)]
    found = [d for d in found if d.bits >= DRIVES.least_bits]
    found.sort(key=lambda d: (-d.bits_per_m, d.length_m, d.site, d.onto or ""))
    return tuple(found[:most])


def never_driven(result: MergeResult) -> list[Undriven]:
    """The branches that nobody drove, by the numbers of their junctions in the document."""
    fused, names = result.fused, {c.id: c.name for c in result.components}
    free = ~driven_branches(fused) & ~fused.is_turned[fused.branches.owner]
    return [
        Undriven(names[int(fused.component[v])], v, xy, heading)
        for v, xy, heading in zip(
            fused.branches.owner[free].tolist(),
            fused.xy[fused.branches.owner[free]],
            fused.branches.values[free].tolist(),
            strict=True,
        )
    ]


def _needed_junctions(result: MergeResult, per_junction: float) -> int:
    """Junctions of a site by which a run is merged with it, if each brings so much evidence."""
    bits = result.threshold_bits or 5 * MATCH.junction_bits
    enough = int(np.ceil(bits / max(per_junction, bits / DRIVES.most_junctions)))
    return min(enough + DRIVES.spare_junctions, DRIVES.most_junctions)


class _Site:
    """A component's junctions and the corridors between them. ids: (n,) rows of the fused map;
    ways: for every two ends the shortest corridor (length, path from the first)."""

    def __init__(self, fused: FusedMap, component: Component, junction: BoolArray) -> None:
        self.component, self.name = component.id, component.name
        self.runs = sorted(component.poses)
        own = junction & (fused.component == component.id)
        self.ids: IntArray = np.flatnonzero(own)
        row = {v: k for k, v in enumerate(self.ids.tolist())}
        self.row = row
        self.xy: FloatArray = fused.xy[self.ids]
        self.ways: dict[tuple[int, int], tuple[float, FloatArray]] = {}
        for k in np.flatnonzero(own[fused.source] & own[fused.target]).tolist():
            u, v = int(fused.source[k]), int(fused.target[k])
            if u == v:
                continue
            length, path = float(fused.length[k]), fused.paths[k]
            for a, b, way in ((u, v, path), (v, u, path[::-1])):
                known = self.ways.get((row[a], row[b]))
                if known is None or length < known[0]:
                    self.ways[row[a], row[b]] = (length, way)

    @property
    def usual_m(self) -> float:
        """Median length of its corridors."""
        lengths = [length for length, _ in self.ways.values()]
        return float(np.median(lengths)) if lengths else 0.0


SiteOf = Callable[[int], _Site]
"""The site of a component, made once."""


# Joining two sites.


def _joining(result: MergeResult, site: SiteOf, wanted: Collection[int]) -> Iterator[Drive]:
    """For every two sites with an open pair of runs, and none locked apart, the drive that would
    join them; `wanted`: the components of which one is to be among the two."""
    home = result.component_of
    never = [v for v in result.verdicts if v.locked == "never"]
    apart = {frozenset((home[v.a].id, home[v.b].id)) for v in never}
    between: dict[tuple[int, int], list[PairVerdict]] = {}
    for pair in result.verdicts:
        one, two = home[pair.a], home[pair.b]
        ends = frozenset((one.id, two.id))
        if one is two or ends in apart or ends.isdisjoint(wanted) or not _is_open(pair):
            continue
        key = sorted((one, two), key=lambda c: (-len(c.poses), c.id))
        between.setdefault((key[0].id, key[1].id), []).append(pair)
    members, placed = fused_of(result.fused.members), _placed(result)
    likely = {key: max((_right(p), p.evidence_bits) for p in own) for key, own in between.items()}
    order = sorted(between, key=lambda key: (-likely[key][0], -likely[key][1], key))
    for s, t in order[: DRIVES.most_planned]:
        if not (_tells_copies(placed[s]) and _tells_copies(placed[t])):
            continue
        pairs = between[s, t]
        drive = _joining_drive(site(s), site(t), pairs, home, members=members, result=result)
        if drive is not None:
            yield drive


def _is_open(pair: PairVerdict) -> bool:
    """Whether a drive could settle a pair: it is open, has a placement, and no person decided."""
    is_open = pair.standing is Standing.AMBIGUOUS
    return is_open and pair.best is not None and pair.locked is None


def _right(pair: PairVerdict) -> float:
    """Probability that the best placement is right: against the next best one and none, and where
    that was asked, against a copy of the place."""
    assert pair.best is not None
    best, others = pair.best.evidence_bits, -np.inf
    if pair.runner_up is not None:
        others = pair.runner_up.evidence_bits
    placed = best - np.logaddexp2(np.logaddexp2(0.0, best), others)
    return float(2.0 ** (placed - np.logaddexp2(0.0, -pair.same_place_bits)))


def _placed(result: MergeResult) -> dict[int, list[PairVerdict]]:
    """The pairs with a placement of the runs of each component."""
    home = result.home
    out: dict[int, list[PairVerdict]] = {c.id: [] for c in result.components}
    for pair in result.verdicts:
        if pair.best is not None:
            for c in {home[pair.a], home[pair.b]}:
                out[c].append(pair)
    return out


def _tells_copies(known: Iterable[PairVerdict]) -> bool:
    """Whether a run by `most_junctions`, without the spare ones, would tell its place from a copy,
    with as much evidence for each as all known pairs of a site together have; True where that is no
    question."""
    bits, junctions, needed = 0.0, 0, 0.0
    for pair in known:
        if pair.best is not None and (test := pair.best.copy_test) is not None:
            bits, junctions = bits + max(test.bits, 0.0), junctions + len(pair.best.matched)
            needed = max(needed, test.needed_bits)
    return bits * (DRIVES.most_junctions - DRIVES.spare_junctions) >= needed * junctions


def _per_junction(pairs: Iterable[PairVerdict]) -> float:
    """Evidence for each junction that two runs have in common [bits]: the median of the pairs with
    a placement, of either question that was asked, at most `junction_bits`, which it is without
    any."""
    found = [
        np.clip(_evidence(pair) / len(pair.best.matched), 0.0, MATCH.junction_bits)
        for pair in pairs
        if pair.best is not None and len(pair.best.matched)
    ]
    return float(np.median(found)) if found else MATCH.junction_bits


def _evidence(pair: PairVerdict) -> float:
    """Evidence for a placement: that it is one at all, and that it is no copy of the place."""
    return min(pair.evidence_bits, pair.same_place_bits)


def _joining_drive(
    site: _Site,
    other: _Site,
    pairs: Sequence[PairVerdict],
    home: dict[str, Component],
    *,
    members: dict[tuple[str, int], int],
    result: MergeResult,
) -> Drive | None:
    """The shortest walk found by as many junctions of both as merging needs; None if their maps
    have none in common."""
    best = max(pairs, key=lambda p: (_right(p), p.evidence_bits, p.a, p.b))
    T_site_other = _placement(best, site, home)
    partner: dict[int, int] = {}
    for here, there in _identified(best, site, other, members):
        if here not in partner.values() and there not in partner:
            partner[there] = here
    both = _Ground(site, other, partner, T_site_other)
    per_junction = _per_junction([best])
    need = _needed_junctions(result, per_junction)
    places, length_m = both.walk(sorted(partner.values()), need)
    if len(places) < 2:
        return None
    reached = min(need, int(both.in_other[list({*places})].sum()))
    return both.drive(
        places,
        length_m=length_m,
        onto=other.name,
        pairs=tuple(sorted((p.a, p.b) for p in pairs)),
        bits=_right(best) * per_junction * reached,
    )


def _placement(pair: PairVerdict, site: _Site, home: dict[str, Component]) -> FloatArray:
    """(3,) T_site_other by the best placement of a pair of runs."""
    assert pair.best is not None
    pose_a, pose_b = home[pair.a].poses[pair.a], home[pair.b].poses[pair.b]
    T_a_b = compose(compose(pose_a, pair.best.transform), inverse(pose_b))
    return T_a_b if home[pair.a].id == site.component else inverse(T_a_b)


def _identified(
    pair: PairVerdict, site: _Site, other: _Site, members: dict[tuple[str, int], int]
) -> Iterator[tuple[int, int]]:
    """Rows of both sites that a pair of runs identifies."""
    assert pair.best is not None
    for a, b in pair.best.matched.tolist():
        one, two = members.get((pair.a, a)), members.get((pair.b, b))
        if pair.a not in site.runs:
            one, two = two, one
        if one in site.row and two in other.row:
            yield site.row[one], other.row[two]


Reach = Callable[[int], tuple[Any, Any]]
"""(n,) lengths of the shortest ways from a place to all others, and the place before each."""


class _Ground:
    """A site, or two of them, one laid over the other. Places are numbered: those of the first
    site, then those of the other that are not identified with one of it (`partner`, of rows of the
    other). ways: for two places the corridor (length, path)."""

    def __init__(
        self,
        site: _Site,
        other: _Site | None = None,
        partner: Mapping[int, int] = MappingProxyType({}),
        T_site_other: FloatArray | None = None,
    ) -> None:
        n = len(site.ids)
        self.site = site
        self.ways = dict(site.ways)
        xy, names = [site.xy], [(site.name, k) for k in site.ids.tolist()]
        self.in_site: BoolArray = np.ones(n, bool)
        self.in_other: BoolArray = np.zeros(n, bool)
        if other is not None and T_site_other is not None:
            rest = [k for k in range(len(other.ids)) if k not in partner]
            place = {**partner, **{k: n + i for i, k in enumerate(rest)}}
            xy.append(apply(T_site_other, other.xy[rest]).reshape(-1, 2))
            names += [(other.name, k) for k in other.ids[rest].tolist()]
            self.in_site = np.arange(len(names)) < n
            self.in_other = np.zeros(len(names), bool)
            self.in_other[[*place.values()]] = True
            for (u, v), (length, path) in other.ways.items():
                ends = (place[u], place[v])
                if ends not in self.ways and ends[0] != ends[1]:
                    self.ways[ends] = (length, apply(T_site_other, path))
        self.xy: FloatArray = np.concatenate(xy)
        at = rounded(self.xy, METRES)
        self.stops = [Stop(*name, (x, y)) for name, (x, y) in zip(names, at, strict=True)]

    def walk(self, shared: Sequence[int], need: int) -> tuple[tuple[int, ...], float]:
        """The shortest walk found by `need` places of each site, or by all that it has, and its
        length [m]; one by more of these places comes before shorter ones. shared: the places of
        both, where walks cross from one to the other; without any there is no walk."""
        if not shared:
            return (), 0.0
        in_site, in_other = self.reach(self.in_site), self.reach(self.in_other)

        def tried(pivot: int) -> tuple[int, float, tuple[int, ...]]:
            """The walk from a place of both, through the other site, then on in the first one for
            what is still missing: minus the places that count, its length, its places."""
            seen = {pivot}
            there, two = _tour(in_other, pivot, seen, need - 1)
            have = int(self.in_site[list(seen)].sum())
            here, one = _tour(in_site, pivot, seen, max(0, need - have))
            places = (*reversed(here), *there[1:])
            own = list({*places})
            known = (min(int(mask[own].sum()), need) for mask in (self.in_site, self.in_other))
            return -sum(known) if len(places) > 1 else 0, one + two, places

        _, length_m, places = min(map(tried, shared))
        return places, length_m

    def reach(self, inside: BoolArray) -> Reach:
        """The shortest ways within one of the sites."""
        rows = [(u, v, w) for (u, v), (w, _) in self.ways.items() if inside[u] and inside[v]]
        u, v, length = np.array(rows, np.float64).reshape(-1, 3).T
        ends = (u.astype(np.int64), v.astype(np.int64))
        graph = coo_array((length, ends), shape=(len(inside), len(inside))).tocsr()
        found: Reach = cache(lambda here: dijkstra(graph, indices=here, return_predecessors=True))
        return found

    def drive(self, places: Sequence[int], **about: Any) -> Drive:
        """A walk as a drive, which starts in the first site."""
        steps = list(pairwise(places))
        return Drive(
            component=self.site.component,
            site=self.site.name,
            stops=tuple(self.stops[k] for k in places),
            path=np.concatenate([np.zeros((0, 2)), *(self.ways[step][1] for step in steps)]),
            known_m=sum(self.ways[s][0] for s in steps if s in self.site.ways),
            **about,
        )


def _tour(reach: Reach, start: int, seen: set[int], wanted: int) -> tuple[list[int], float]:
    """From `start` by `wanted` places that were not seen, always to the nearest: all places on the
    way, and its length; adds them to `seen`. The shortest way by as many is 2 % shorter (105 drives
    of 13 merges)."""
    here, out, length = start, [start], 0.0
    for _ in range(wanted):
        away, before = reach(here)
        away = away.copy()
        away[[*seen]] = np.inf
        goal = int(away.argmin())
        if not np.isfinite(away[goal]):
            break
        way = [goal]
        while before[way[-1]] != here:
            way.append(int(before[way[-1]]))
        out += reversed(way)
        seen.update(way)
        length += float(away[goal])
        here = goal
    return out, length


# Into the unknown.


def _exploring(result: MergeResult, site_of: SiteOf, wanted: Collection[int]) -> Iterator[Drive]:
    """For every wanted site the drive by the branch never driven that leads farthest from what is
    known."""
    share = _overlapping_share(result)
    need = _needed_junctions(result, MATCH.junction_bits)
    pairs = _placed(result)
    branches: dict[str, list[Undriven]] = {}
    for branch in never_driven(result) if wanted else ():
        branches.setdefault(branch.site, []).append(branch)
    for site in map(site_of, sorted(wanted)):
        known, free = pairs[site.component], branches.get(site.name)
        if free and site.ways and _tells_copies(known):
            open_ = _unobstructed(free, site)
            k = int(open_.argmax())
            bits = share * _per_junction(known) * need * float(open_[k])
            yield _exploring_drive(site, free[k], need, bits)


def _overlapping_share(result: MergeResult) -> float:
    """How likely a branch never driven leads to another site: the share of pairs of runs of two
    sites that are open (Laplace's rule of succession, so that none of few says little); 0 where
    there is no other site."""
    home = result.home
    open_ = sum(_is_open(p) and home[p.a] != home[p.b] for p in result.verdicts)
    across = pairs_of(len(home)) - sum(pairs_of(len(c.poses)) for c in result.components)
    return (open_ + 1) / (across + 2) if across else 0.0


def _unobstructed(branches: Sequence[Undriven], site: _Site) -> FloatArray:
    """(k,) share of the way straight on from each branch, from one corridor of usual length on,
    that has no known corridor near."""
    from scipy.spatial import cKDTree

    near_m = site.usual_m / 2
    steps = near_m * np.arange(2, 4 * DRIVES.beyond + 1)
    heading = np.array([b.heading_rad for b in branches])
    ray = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    points = np.stack([b.xy for b in branches])[:, None] + steps[None, :, None] * ray[:, None]
    corridors = np.concatenate([path for _, path in site.ways.values()])
    away, _ = cKDTree(corridors).query(points.reshape(-1, 2))
    free: FloatArray = np.asarray(away > near_m).reshape(len(branches), -1).mean(axis=1)
    return free


def _exploring_drive(site: _Site, branch: Undriven, need: int, bits: float) -> Drive:
    """The drive that leaves a site by a branch that nobody drove: by up to `need` known junctions
    to it, so that the new log can be merged, then on for `DRIVES.beyond` corridors for each, of
    which the path shows the first."""
    place, heading = site.row[branch.junction], branch.heading_rad
    ground = _Ground(site)
    places, known_m = _tour(ground.reach(ground.in_site), place, {place}, need - 1)
    end = site.xy[place] + site.usual_m * np.array([np.cos(heading), np.sin(heading)])
    x, y = rounded(end, METRES)
    known = ground.drive(
        places[::-1],
        length_m=known_m + DRIVES.beyond * need * site.usual_m,
        onto=None,
        pairs=(),
        bits=bits,
        heading_rad=heading,
    )
    return replace(
        known,
        stops=(*known.stops, Stop(site.name, None, (x, y))),
        path=np.concatenate([known.path, [site.xy[place], end]]),
    )
