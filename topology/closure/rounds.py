"""The full closure: greedy rounds of the most certain identifications.

A run is at hand as a whole, so certainty is collected first and spent later: identify what is
sure, lay the walk out again, look again with the smaller uncertainty that this leaves.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.spatial import cKDTree

from .evidence import (
    EvidenceSettings,
    align,
    background,
    best_position_odds,
    position_odds,
    rarity,
)
from .gated import Identification
from .growth import GrowthSettings, Scene, grow
from .layout import Layout, LayoutSettings, lay_out
from .places import NOWHERE, Places, tabulate
from .rates import RateSettings, measured_rates
from .rectilinear import RectilinearSettings, grid_headings
from .walk import Walk, dead_reckoning_covariance, louder

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


_FAR_M = 80.0
"""Longest way that `nearby_variance` looks at."""
_STRIP = 256
_MOST_TABLED = 1_000_000
"""Pairs of places in one table: some 200 MB."""
_MOST_STRANGERS = 3000
"""Pairs of places known to be two that are asked what they have in common."""


@dataclass(frozen=True, slots=True)
class RoundSettings:
    """When an identification is certain enough, round by round."""

    thresholds: tuple[float, ...] = (9.0, 7.0, 5.5, 4.5)
    """Log odds asked of an identification; the next one is used when no more is found."""
    lead: float = 3.0
    """Log odds that it must have over every rival that it excludes."""
    gate: float = 14.0
    """Largest squared Mahalanobis distance (2 d.o.f.)."""
    reach_m: float = 20.0
    """Places farther apart than this in the layout are not asked about."""
    most_pairs: int = 5000
    """In long runs no more pairs are looked at in one round, the nearest (or six per place)."""
    least_hope: float = 0.0
    """Candidates that could not reach these log odds wherever they lay are not looked at."""
    strangers: float = 1.5
    """Places this many times farther apart than the gate allows are certainly two."""
    support_cap: float = 12.0
    """Most that growth may add."""
    conflict_price: float = 0.2
    """Added to the threshold for each unit of disagreement."""
    most_rounds: int = 40
    loud: float = 1.5
    """Mean squared error, in units of what the noise allows, at which the noise is raised …"""
    loudest: float = 4.0
    """… to at most this many times what was estimated."""
    low: float = 0.35
    """Mean squared error at which the noise is lowered …"""
    lowest: float = 0.35
    """… to at least this share of what was estimated."""
    strain: float = 30.0
    """Squared error [3 d.o.f.] of a sighting from which its identification is taken back."""
    evidence: EvidenceSettings = field(default_factory=EvidenceSettings)
    rates: RateSettings = field(default_factory=RateSettings)
    growth: GrowthSettings = field(default_factory=GrowthSettings)
    layout: LayoutSettings = field(default_factory=LayoutSettings)
    grid: RectilinearSettings = field(default_factory=RectilinearSettings)


@dataclass(frozen=True, slots=True, eq=False)
class Closed:
    """place: (p,) of each pass, numbered by first visit; layout: of these places; asked: evidence
    for every identification made, and for those refused that had some; walk: the one given, its
    noise raised if the layout asked for it."""

    walk: Walk
    place: IntArray
    layout: Layout
    asked: list[Identification]


@dataclass(frozen=True, slots=True, eq=False)
class Candidates:
    """Pairs of places a < b that may be one, with what speaks for and against (log odds)."""

    a: IntArray
    b: IntArray
    position: FloatArray
    branches: FloatArray
    support: FloatArray
    conflict: FloatArray
    commonness: FloatArray
    """What is taken off because places that are certainly two look as much alike."""
    turn: FloatArray
    """Added to the branches of b to meet those of a [rad]."""

    @property
    def total(self) -> FloatArray:
        """(k,) all evidence."""
        alike = self.branches + self.support - self.conflict - self.commonness
        out: FloatArray = self.position + alike
        return out


def full_closure(walk: Walk, settings: RoundSettings = RoundSettings()) -> Closed:
    """Identify the passes of a walk."""
    quiet, loudness = walk, 1.0
    grid = grid_headings(walk, settings.grid)
    links: list[Identification] = []
    strikes: Counter[tuple[int, int]] = Counter()
    place = np.arange(len(walk), dtype=np.int64)
    layout = lay_out(walk, place, grid=grid, settings=settings.layout)
    stage, found, exact = 0, _no_candidates(), False
    for _ in range(settings.most_rounds):
        places = tabulate(walk, place, layout.pose[:, 2], settings.layout.slot_gap_rad)
        noise = measured_rates(places, walk.noise, settings.rates)
        common = background(walk, noise, settings.evidence)
        rare = rarity(places, common, settings.evidence)
        scene = Scene(walk, places, layout.xy, common, rare)
        found = _candidates(scene, place, layout, settings, exact=exact)
        new: list[Identification] = []
        while not new and stage < len(settings.thresholds):
            barred = _barred(strikes, stage, place)
            new = _certain(places, found, settings.thresholds[stage], barred, settings)
            stage += not new
        if not new and exact:
            break
        if not exact:
            # The first round takes what is plain; the rest is easier once that is settled.
            exact, stage = True, 0
        if not new:
            continue
        links += new
        turn = layout.pose[:, 2] + _turns(place, new)
        place = _partition(len(walk), links)
        layout = lay_out(walk, place, layout.pose, turn=turn, grid=grid, settings=settings.layout)
        better = _loudness(loudness, layout.misfit, settings)
        if better != loudness:
            # The noise is not what it seemed before anything was identified.
            loudness, walk = better, louder(quiet, better)
            layout = lay_out(walk, place, layout.pose, grid=grid, settings=settings.layout)
        bad = _strained(place, layout, links, settings)
        if bad:
            strikes.update((q.first, q.second) for q in bad)
            links = [q for q in links if q not in bad]
            place = _partition(len(walk), links)
            layout = lay_out(walk, place, layout.pose, grid=grid, settings=settings.layout)
    return Closed(walk, place, layout, links + _refused(walk, place, found))


def _loudness(now: float, misfit: float, settings: RoundSettings) -> float:
    """Factor on the estimated noise: raised to fit, lowered with reserve."""
    if misfit > settings.loud:
        return min(now * float(np.sqrt(misfit)), settings.loudest)
    if misfit < settings.low:
        return max(now * float(np.sqrt(1.5 * misfit)), settings.lowest)
    return now


def _no_candidates() -> Candidates:
    none, zero = np.zeros(0, np.int64), np.zeros(0)
    return Candidates(none, none, zero, zero, zero, zero, zero, zero)


def _barred(strikes: Counter[tuple[int, int]], stage: int, place: IntArray) -> set[frozenset[int]]:
    """Pairs of places whose identification was taken back more often than stages have passed."""
    return {
        frozenset((int(place[i]), int(place[j])))
        for (i, j), count in strikes.items()
        if count > stage
    }


def _partition(count: int, links: list[Identification]) -> IntArray:
    """(p,) places by the links, numbered by first visit."""
    i = np.array([q.first for q in links], np.int64)
    j = np.array([q.second for q in links], np.int64)
    graph = coo_matrix((np.ones(len(i)), (i, j)), shape=(count, count))
    label = connected_components(graph, directed=False)[1]
    _, first, inverse = np.unique(label, return_index=True, return_inverse=True)
    rank = np.empty(len(first), np.int64)
    rank[np.argsort(first)] = np.arange(len(first))
    out: IntArray = rank[inverse]
    return out


def _turns(place: IntArray, new: list[Identification]) -> FloatArray:
    """(p,) turns that bring the branches of newly joined places into agreement.

    place: (p,) before they were joined. Turns are handed on from place to place along the links.
    """
    beside: dict[int, list[tuple[int, float]]] = {}
    for q in new:
        a, b = int(place[q.first]), int(place[q.second])
        beside.setdefault(a, []).append((b, q.turn_rad))
        beside.setdefault(b, []).append((a, -q.turn_rad))
    turn = np.zeros(int(place.max(initial=-1)) + 1)
    known: set[int] = set()
    for root in sorted(beside):
        if root in known:
            continue
        known.add(root)
        front = [root]
        while front:
            a = front.pop()
            for b, more in beside[a]:
                if b not in known:
                    known.add(b)
                    turn[b] = turn[a] + more
                    front.append(b)
    out: FloatArray = turn[place]
    return out


def _candidates(
    scene: Scene, place: IntArray, layout: Layout, settings: RoundSettings, *, exact: bool
) -> Candidates:
    """All pairs of places that position and branches allow, with their evidence.

    Bounds that are cheap come first: dead reckoning, the shortest known way, then what branches and
    corridors could make of the best position. Only what is left needs covariances of the solved
    graph (`exact`); the bounds stand for them otherwise.
    """
    walk, places, common = scene.walk, scene.places, scene.common
    pairs = _pairs_within(layout.xy, settings.reach_m)
    a, b = pairs.T
    i, j = _nearest_in_time(places, place, a, b)
    same = walk.chain[i] == walk.chain[j]
    a, b, i, j = a[same], b[same], i[same], j[same]
    # What dead reckoning alone excludes stays excluded: closures only make it more certain.
    cov = dead_reckoning_covariance(walk, i, j)
    sigma2 = 2 * common.centre_sigma**2
    shift = layout.xy[a] - layout.xy[b]
    far2 = (shift**2).sum(axis=1)
    cov = _tighter(cov, *known_way_variance(walk, places, a, b))
    strangers = _strangers(scene, a, b, cov, shift, settings)
    near = far2 < settings.gate * (cov[:, 0, 0] + cov[:, 1, 1] + 2 * sigma2)
    a, b, cov, shift = a[near], b[near], cov[near], shift[near]
    a, b, cov, shift = _nearest(a, b, cov, shift, max(settings.most_pairs, 6 * len(places)))
    if exact:
        best = best_position_odds(common, shift, settings.evidence)
        hopeful = best + _surroundings(scene, a, b, cov, settings).sum() > settings.least_hope
        a, b, shift = a[hopeful], b[hopeful], shift[hopeful]
        cov = _exact_covariance(layout, a, b)
    s = cov[:, :2, :2] + sigma2 * np.eye(2)
    odds, d2 = position_odds(common, shift, s, settings.evidence)
    fine = (d2 < settings.gate) & (odds > (-6.0 if exact else 0.0))
    a, b, odds, cov = a[fine], b[fine], odds[fine], cov[fine]
    found = _surroundings(scene, a, b, cov, settings)
    alike = found.sum()
    common_ = np.maximum(alike - _likeness_odds(alike, strangers), 0.0)
    return Candidates(
        a, b, odds, found.branches, found.support, found.conflict, common_, found.turn
    )


def _strangers(
    scene: Scene,
    a: IntArray,
    b: IntArray,
    cov: FloatArray,
    shift: FloatArray,
    settings: RoundSettings,
) -> FloatArray:
    """(m,) sorted: what branches and corridors say (log odds) of places that are certainly two.

    Rows of corridors side by side, of one length because a grid is behind them, look like each
    other more often than independent lengths would: this run tells how often.
    """
    s = cov[:, :2, :2] + 2 * scene.common.centre_sigma**2 * np.eye(2)
    d2 = position_odds(scene.common, shift, s, settings.evidence)[1]
    apart = np.hypot(*shift.T) > scene.common.core_m
    rows = np.flatnonzero((d2 > settings.strangers * settings.gate) & apart)
    rows = rows[:: -(-len(rows) // _MOST_STRANGERS) or 1]
    return np.sort(_surroundings(scene, a[rows], b[rows], cov[rows], settings).sum())


def _likeness_odds(alike: FloatArray, strangers: FloatArray) -> FloatArray:
    """(k,) log odds that `alike` is worth, by the share of strangers that are as much alike.

    Beyond all strangers the odds grow as the model says: they are not known to be wrong there.
    """
    if len(strangers) == 0:
        return alike
    as_much = len(strangers) - np.searchsorted(strangers, alike)
    beyond = np.maximum(alike - strangers[-1], 0.0)
    out: FloatArray = np.log1p(len(strangers)) - np.log1p(as_much) + beyond
    return out


def _pairs_within(xy: FloatArray, reach_m: float) -> IntArray:
    """(k, 2) pairs a < b of points that near, sorted; nearer ones only where that are too many."""
    tree = cKDTree(xy)
    while int(tree.count_neighbors(tree, reach_m)) > 2 * _MOST_TABLED:
        reach_m *= 0.7
    pairs = tree.query_pairs(reach_m, output_type="ndarray").astype(np.int64)
    out: IntArray = pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]
    return out


def _nearest(
    a: IntArray, b: IntArray, cov: FloatArray, shift: FloatArray, most: int
) -> tuple[IntArray, IntArray, FloatArray, FloatArray]:
    """The pairs that lie nearest to each other: the others' turn comes when these are settled."""
    if len(a) <= most:
        return a, b, cov, shift
    rows = np.sort(np.argsort((shift**2).sum(axis=1), kind="stable")[:most])
    return a[rows], b[rows], cov[rows], shift[rows]


@dataclass(frozen=True, slots=True, eq=False)
class _Surroundings:
    """Evidence of branches and corridors (log odds)."""

    branches: FloatArray
    support: FloatArray
    conflict: FloatArray
    turn: FloatArray

    def sum(self) -> FloatArray:
        out: FloatArray = self.branches + self.support - self.conflict
        return out


def _surroundings(
    scene: Scene, a: IntArray, b: IntArray, cov: FloatArray, settings: RoundSettings
) -> _Surroundings:
    turn_sigma = np.sqrt(np.maximum(cov[:, 2, 2], 0.0)) + 0.02
    aligned = align(scene.places, scene.common, a, b, turn_sigma=turn_sigma)
    branches = aligned.score - np.maximum(scene.rare[a], scene.rare[b])
    grown = grow(scene, a, b, aligned, settings.growth)
    gain = np.minimum(grown.gain, settings.support_cap)
    return _Surroundings(branches, gain, grown.loss, aligned.turn)


def _tighter(cov: FloatArray, position: FloatArray, turn: FloatArray) -> FloatArray:
    """`cov` (k, 3, 3), or the round one of the given variances where that is smaller."""
    other = np.zeros_like(cov)
    other[:, 0, 0] = other[:, 1, 1] = np.where(np.isfinite(position), 0.5 * position, 0.0)
    other[:, 2, 2] = np.where(np.isfinite(turn), turn, 0.0)
    better = position < cov[:, 0, 0] + cov[:, 1, 1]
    out: FloatArray = np.where(better[:, None, None], other, cov)
    return out


def known_way_variance(
    walk: Walk, places: Places, a: IntArray, b: IntArray
) -> tuple[FloatArray, FloatArray]:
    """(k,) bounds on the squared error [m²] and turn [rad²] of b seen from a.

    Those of dead reckoning along the shortest known way: corridors bound the error of a solved
    graph from above, and cheaply, by one Dijkstra over all places, in strips. Ways longer than
    `_FAR_M` bound nothing (inf).
    """
    source, slot = np.nonzero(places.next_place != NOWHERE)
    n = len(places)
    way = np.maximum(places.length[source, slot], 0.1)
    graph = csr_matrix((way, (source, places.next_place[source, slot])), shape=(n, n))
    length = np.full(len(a), np.inf)
    order = np.argsort(a, kind="stable")
    heads = np.unique(a)
    cuts = np.searchsorted(a[order], np.append(heads, n))
    for begin in range(0, len(heads), _STRIP):
        end = min(begin + _STRIP, len(heads))
        rows = order[cuts[begin] : cuts[end]]
        reach = dijkstra(graph, directed=False, indices=heads[begin:end], limit=_FAR_M)
        length[rows] = reach[np.searchsorted(heads[begin:end], a[rows]), b[rows]]
    noise, extra = walk.noise, walk.systematic
    # As if every metre of the way lay as far off as the middle of it, with a corner every 4 m.
    corners = np.pi / 2 * (1.0 + length / 4.0)
    turn = noise.heading_rad_per_sqrt_m**2 * length + noise.heading_rad_per_sqrt_rad**2 * corners
    turn = turn + (extra.turn_rad_per_m * length) ** 2 + (extra.turn_rad_per_rad * corners) ** 2
    position = 2 * noise.along_m_per_sqrt_m**2 * length + turn * (0.5 * length) ** 2
    return 2.0 * position, 2.0 * turn


def _nearest_in_time(
    places: Places, place: IntArray, a: IntArray, b: IntArray
) -> tuple[IntArray, IntArray]:
    """A pass of each of two places, near in time: the later one's first, the other's one before."""
    early, late = np.where(places.first[a] < places.first[b], [a, b], [b, a])
    count = len(place)
    key = np.sort(place * count + np.arange(count))
    j = places.first[late]
    i = key[np.searchsorted(key, early * count + j) - 1] % count
    return i, j


def _exact_covariance(layout: Layout, a: IntArray, b: IntArray) -> FloatArray:
    """(k, 3, 3) of place b seen from place a, in map axes, from the solved graph."""
    if len(a) == 0:
        return np.zeros((0, 3, 3))
    na, nb = layout.node[a], layout.node[b]
    cov = layout.relative_covariance(na, nb)
    theta = layout.solution.pose[na, 2]
    c, s = np.cos(theta), np.sin(theta)
    R = np.zeros((len(a), 3, 3))
    R[:, 0, 0], R[:, 0, 1], R[:, 1, 0], R[:, 1, 1], R[:, 2, 2] = c, -s, s, c, 1.0
    out: FloatArray = R @ cov @ R.transpose(0, 2, 1)
    return out


def _certain(
    places: Places,
    found: Candidates,
    threshold: float,
    barred: set[frozenset[int]],
    settings: RoundSettings,
) -> list[Identification]:
    """The candidates that are sure and have no rival, best first."""
    total = found.total
    # Rivals of a candidate share one of its places and put it somewhere else.
    by_place: dict[int, list[int]] = {}
    serious = np.flatnonzero(total > threshold - settings.lead - 2.0)
    known = {(int(found.a[k]), int(found.b[k])): float(total[k]) for k in serious}
    for k in serious:
        by_place.setdefault(int(found.a[k]), []).append(int(k))
        by_place.setdefault(int(found.b[k]), []).append(int(k))
    out = []
    asked = threshold + settings.conflict_price * found.conflict
    for k in serious[np.argsort(-total[serious], kind="stable")]:
        a, b = int(found.a[k]), int(found.b[k])
        if total[k] < asked[k] or frozenset((a, b)) in barred:
            continue
        rival = -np.inf
        for mine, other in ((a, b), (b, a)):
            for r in by_place[mine]:
                third = int(found.a[r] + found.b[r]) - mine
                if third == other:
                    continue
                pair = (min(other, third), max(other, third))
                if known.get(pair, -np.inf) < 0.0:
                    rival = max(rival, total[r])
        if total[k] - rival < settings.lead:
            continue
        i, j, turn = int(places.first[a]), int(places.first[b]), float(found.turn[k])
        if i > j:
            i, j, turn = j, i, -turn
        bits = float(total[k] / np.log(2))
        out.append(Identification(i, j, True, bits, "position, branches and corridors agree", turn))
    return out


def _strained(
    place: IntArray, layout: Layout, links: list[Identification], settings: RoundSettings
) -> list[Identification]:
    """The weakest link of every place that a pass is torn away from."""
    bad = np.unique(place[layout.sighting[layout.sighting_chi2 > settings.strain]])
    if len(bad) == 0:
        return []
    weakest: dict[int, Identification] = {}
    for q in links:
        p = int(place[q.first])
        if p not in weakest or q.bits < weakest[p].bits:
            weakest[p] = q
    return [weakest[p] for p in bad.tolist() if p in weakest]


def _refused(walk: Walk, place: IntArray, found: Candidates) -> list[Identification]:
    """Candidates of the last round that had something for them."""
    first = np.full(len(walk), len(walk), np.int64)
    np.minimum.at(first, place, np.arange(len(walk)))
    out = []
    for k in np.flatnonzero(found.position + found.branches > 0):
        i, j = sorted((int(first[found.a[k]]), int(first[found.b[k]])))
        reason = "corridors disagree" if found.conflict[k] > 2 else "not sure enough"
        out.append(Identification(i, j, False, float(found.total[k] / np.log(2)), reason))
    return out
