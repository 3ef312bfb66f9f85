"""Candidate alignments of a pair of maps, with their evidence."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import compress, pairwise
from typing import TypeVar

import numpy as np

from ...topology.arrays import BoolArray, ComplexArray, FloatArray, IntArray
from ...topology.digits import BITS
from ...topology.se2 import apply, compose, fit_groups, fit_rigid, wrap
from .atlas import Atlas, Lanes, cuts
from .conflicts import NO_CONFLICTS, Conflicts, conflicts
from .growth import Grown, grow, ungrown
from .links import Links, Seed, candidate_links, seeds
from .mirror import mirrored
from .prepare import Prepared, prepare
from .settings import MATCH, RobustSettings
from .support import NO_SUPPORT, Support, supports
from .view_evidence import (
    MOST,
    NO_VIEW_EVIDENCE,
    ViewEvidence,
    judged,
    laid,
    refined,
    repeats,
    revisits,
    worth_judging,
)
from .view_search import KEPT, Picture, pictured, placements

T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class Candidate:
    """A candidate alignment of b with a.

    transform: (3,) T_a_b; a, b: (k,) matched vertices; turn: (k,) local rotation b → a at each, as
    unit numbers; support, conflicts: evidence for and against; tested_bits: log2 of the number of
    hypotheses tested; bits: log2 odds against chance, the first minus the other two; rmse_m: of the
    matched junctions; rival: whether it grew from a hypothesis that is not to be merged (`Seed`);
    searched: whether contradictions were looked for, which is done where the rest is beyond chance
    and where views may make it so; views: what the views of both say, which is part of `bits`;
    by_views: whether they proposed it; image_bits: evidence of the best alignment of a with the
    mirror image of b, -inf without one or if it was not looked for.
    """

    transform: FloatArray
    a: IntArray
    b: IntArray
    turn: ComplexArray
    support: Support
    conflicts: Conflicts
    tested_bits: float
    bits: float
    rmse_m: float
    rival: bool = False
    searched: bool = True
    views: ViewEvidence = NO_VIEW_EVIDENCE
    by_views: bool = False
    image_bits: float = -np.inf

    def __len__(self) -> int:
        return len(self.a)

    @property
    def witnesses(self) -> float:
        """Matched junctions, and as how many the parts of the overlap weigh where views agree."""
        return len(self.a) + self.views.junctions

    @property
    def corridors(self) -> IntArray:
        """(c, 2) directed rows of the matched corridors."""
        return self.support.corridors

    @cached_property
    def contradicting_bits(self) -> float:
        """All evidence against it, positive: contradictions, corridors of different length, matched
        junctions with different branches, and views."""
        links, branches = self.support.links, self.support.branches
        misfit = float(links[links < 0].sum() + branches[branches < 0].sum())
        return self.conflicts.bits - misfit + self.views.against

    @property
    def counted_bits(self) -> float:
        """The evidence against chance: agreement, bounded by the number of junctions, plus that of
        views, minus all contradictions.

        Agreeing terms are not independent (a room of standard form brings its junctions, corridors
        and angles together), so that their sum overstates the evidence; every contradiction needs a
        fault of its own, so that each counts in full.
        """
        against, seen = self.contradicting_bits, self.views.total + self.views.against
        told = self.bits + against - seen
        return min(told, MATCH.junction_bits * len(self)) + seen - against

    def move(self, z: complex) -> complex:
        """Position in a of a point x + iy of b."""
        x, y, theta = self.transform.tolist()
        return complex(x + 1j * y + np.exp(1j * theta) * z)


NO_JUNCTIONS = Candidate(
    np.zeros(3),
    np.zeros(0, np.int64),
    np.zeros(0, np.int64),
    np.zeros(0, np.complex128),
    NO_SUPPORT,
    NO_CONFLICTS,
    0.0,
    0.0,
    0.0,
    by_views=True,
)
"""A placement that views propose and that lays no junctions over each other."""

Hypothesised = tuple[Prepared, Prepared, Sequence[Seed], int]
"""Two maps, hypotheses of their alignment, and the number of links that these were chosen from."""


def match(
    a: Prepared, b: Prepared, settings: RobustSettings, *, thorough: bool = False
) -> tuple[Candidate, ...]:
    """Candidate alignments of two maps, best first, without duplicates of one placement. Pure.

    The steps of the paper with certainty replaced by odds: compatible corridors (§2.1), connected
    hypotheses (§2.3), transforms (§3.1), clusters grown again geometrically (§5).

    Where copies abound, many hypotheses are beyond chance before they are grown. Only the best few
    can be merged. The others take time, and are grown as rivals where these yield nothing.
    thorough: as before two maps are merged: rivals are grown, and the mirror image of b is matched.
    """
    return next(match_all([(a, b)], settings, thorough=thorough))


def match_all(
    pairs: Iterable[tuple[Prepared, Prepared]], settings: RobustSettings, *, thorough: bool = False
) -> Iterator[tuple[Candidate, ...]]:
    """`match` for many pairs, each as if it were alone, in batches of `most_pairs` links."""
    sown = (_sown(a, b, settings) for a, b in pairs)
    for some in _batches(sown, lambda case: len(case[1]), MATCH.most_pairs):
        yield from _match_some(some, settings, thorough=thorough)


def _sown(a: Prepared, b: Prepared, settings: RobustSettings) -> tuple[Hypothesised, Links]:
    """Two maps with their best hypotheses, and the links that these were chosen from."""
    links = candidate_links(a, b)
    return (a, b, seeds(a, b, links, settings.hypotheses), len(links)), links


def _batches(items: Iterable[T], size: Callable[[T], int], most: int) -> Iterator[list[T]]:
    """The items in lists, each as soon as it reaches a size, and the rest."""
    some: list[T] = []
    total = 0
    for item in items:
        some.append(item)
        total += size(item)
        if total >= most:
            yield some
            some, total = [], 0
    yield some


def _match_some(
    some: Sequence[tuple[Hypothesised, Links]], settings: RobustSettings, *, thorough: bool
) -> Iterator[tuple[Candidate, ...]]:
    pairs = [case[:2] for case, _ in some]
    best = list(best_of_all((case for case, _ in some), settings))
    wanted = [thorough or not any(c.bits > MATCH.lead_bits for c in own) for own in best]
    asked = (_rivals(case, links, settings) for case, links in compress(some, wanted))
    others = best_of_all(asked, settings)
    turned = (_sown(a, _image(b), settings)[0] for a, b in pairs if thorough)
    images = best_of_all(turned, settings)
    for (a, b), own, more in zip(pairs, best, wanted, strict=True):
        found = _with_views(a, b, _apart([*own, *next(others)], b) if more else own, settings)
        if thorough:
            bits = max((c.bits for c in next(images)), default=-np.inf)
            found = tuple(replace(c, image_bits=bits) for c in found)
        yield found


@lru_cache(maxsize=KEPT)
def _image(m: Prepared) -> Prepared:
    """The mirror image of a map, without views."""
    return prepare(mirrored(m.topomap))


def _both_seen(a: Prepared, b: Prepared) -> bool:
    return len(a.views) > 0 and len(b.views) > 0


def _rivals(case: Hypothesised, links: Links, settings: RobustSettings) -> Hypothesised:
    """The other hypotheses beyond chance. They are not merged: of so many, one fits too easily."""
    a, b, first, tested = case
    beyond = float(np.log2(tested + 1.0)) + MATCH.lead_bits
    every = seeds(a, b, links, settings.hypotheses, rival_bits=beyond, first=first)
    return a, b, [seed for seed in every if seed.rival], tested


def best_of_all(
    cases: Iterable[Hypothesised], settings: RobustSettings
) -> Iterator[tuple[Candidate, ...]]:
    """Hypotheses of many pairs of maps grown and evaluated, in batches that fit the processor's
    cache."""
    for some in _batches(cases, lambda case: len(case[1]) * len(case[2]), MATCH.at_once):
        yield from _best_of_some(some, settings)


def _best_of_some(
    cases: Sequence[Hypothesised], settings: RobustSettings
) -> Iterator[tuple[Candidate, ...]]:
    found: list[list[Candidate]] = [[] for _ in cases]
    if any(case[2] for case in cases):
        sown = [seed for case in cases for seed in case[2]]
        grown = grow(_lanes(cases), sown, settings)
        of = np.arange(len(cases)).repeat([len(case[2]) for case in cases])
        tested_bits = np.log2(np.array([case[3] for case in cases]) + 1.0)
        seen = np.array([_both_seen(a, b) for a, b, _, _ in cases])
        judged = _judged(grown, tested_bits[of], search=seen[of])
        for case, seed, candidate in zip(of.tolist(), sown, judged, strict=True):
            if candidate is not None:
                found[case].append(replace(candidate, rival=seed.rival))
    for (_, b, _, _), several in zip(cases, found, strict=True):
        yield _apart(several, b)


def _apart(found: list[Candidate], b: Prepared) -> tuple[Candidate, ...]:
    """Candidates, best first, keeping of each placement the best one that is not a rival."""
    kept: list[Candidate] = []
    for candidate in sorted(found, key=lambda c: (c.rival, _rank(c))):
        if not any(same_placement(candidate, other, b) for other in kept):
            kept.append(candidate)
    return tuple(sorted(kept, key=_rank))


def _rank(c: Candidate) -> tuple[float, list[float]]:
    return -round(c.bits, BITS), c.transform.tolist()


def _lanes(cases: Sequence[Hypothesised]) -> Lanes:
    """A lane for every hypothesis."""
    growing = [case for case in cases if case[2]]
    each = [(a, b) for a, b, found, _ in growing for _ in found]
    number: dict[int, int] = {}
    rows = [[number.setdefault(id(m), len(number)) for m in pair] for pair in each]
    maps = {id(m): m for pair in each for m in pair}
    whole = Atlas.of([maps[key] for key in number])
    of_a, of_b = np.array(rows).T
    return Lanes.of(whole, whole, of_a, of_b)


def as_sown(case: Hypothesised) -> list[Candidate]:
    """Hypotheses of two junctions or more as candidates, without growth."""
    _, _, hypotheses, tested = case
    tested_bits = np.full(len(hypotheses), np.log2(tested + 1.0))
    told = _judged(ungrown(_lanes([case]), hypotheses), tested_bits, search=False)
    return [candidate for candidate in told if candidate is not None]


def _judged(
    grown: Grown, tested_bits: FloatArray, *, search: BoolArray | bool
) -> list[Candidate | None]:
    """The candidate of each lane with its evidence; None where nothing is matched. search: lanes
    whose contradictions are looked for also if nothing is beyond chance."""
    lanes = grown.lanes
    if not len(grown.row):
        return [None] * len(lanes)
    agree = supports(grown)
    bits = np.array([s.bits for s in agree]) - tested_bits
    first = cuts(grown.lane, len(lanes))
    searched = (bits > MATCH.lead_bits) | search
    against = conflicts(grown, searched)
    a = grown.a - lanes.a.vertex[lanes.of_a[grown.lane]]
    b = grown.b - lanes.b.vertex[lanes.of_b[grown.lane]]
    turn = grown.turn[grown.row]
    transform, rmse = _laid_over_each(grown)
    out: list[Candidate | None] = [None] * len(lanes)
    for k, (start, stop) in enumerate(pairwise(first)):
        if stop > start:
            out[k] = Candidate(
                transform=transform[k],
                a=a[start:stop],
                b=b[start:stop],
                turn=turn[start:stop],
                support=agree[k],
                conflicts=against[k],
                tested_bits=float(tested_bits[k]),
                bits=float(bits[k] - against[k].bits),
                rmse_m=float(rmse[k]),
                searched=bool(searched[k]),
            )
    return out


def _laid_over_each(grown: Grown) -> tuple[FloatArray, FloatArray]:
    """`laid_over` of every lane; zeros for lanes without a match."""
    lanes, count = grown.lanes, len(grown.lanes)
    transform, rmse = np.zeros((count, 3)), np.zeros(count)
    pa, pb = _points(lanes.a.whole.z[grown.a]), _points(lanes.b.whole.z[grown.b])
    some, group = np.unique(grown.lane, return_inverse=True)
    transform[some] = fit_groups(pa, pb, group, np.ones(len(group)))
    off = pa - apply(transform[grown.lane], pb)
    squared = np.bincount(group, (off * off).sum(axis=1))
    rmse[some] = np.sqrt(squared / np.bincount(group))
    return transform, rmse


# --- views ----------------------------------------------------------------------------------------


def _with_views(
    a: Prepared, b: Prepared, found: tuple[Candidate, ...], settings: RobustSettings
) -> tuple[Candidate, ...]:
    """The candidates of two maps with what their views say of them, and those that the views
    propose; as they are for maps without views."""
    if not _both_seen(a, b):
        return found
    one, two = pictured(a.views), pictured(b.views)
    asked = refined(one, two, placements(one, two))
    likely = [T for T, some in asked if worth_judging(some)][: settings.hypotheses]
    told = [_told_of(c, a, b, two) for c in found]
    chosen = {k for k, c in enumerate(found) if c.bits > MATCH.lead_bits}
    fresh = []
    for T in likely:
        known = [k for k, pose in enumerate(told) if _same_poses(pose, compose(T, two.pose))]
        chosen.update(known[:1])
        fresh += [] if known else [T]
    if not fresh and not chosen:
        return found
    rows = sorted(chosen)
    every = laid(one, two, [told[k] for k in rows], MOST)
    cases = [(found[k], told[k], here) for k, here in zip(rows, every, strict=True)]
    for _ in range(2):
        every = laid(one, two, [compose(T, two.pose) for T in fresh], MOST)
        fresh = [here.better(T) for T, here in zip(fresh, every, strict=True)]
    for T, here in zip(fresh, every, strict=True):
        proposed = _placed(a, b, T, settings)
        if proposed is not None:
            cases.append((proposed, compose(proposed.transform, two.pose), here))
    placed = [(compose(T, two.pose), some) for T, some in asked]
    placed += [(compose(c.transform, two.pose), here) for c, _, here in cases]
    same = np.concatenate([revisits(a.views), revisits(b.views)])
    selves = repeats(a.views), repeats(b.views)
    out = [c for k, c in enumerate(found) if k not in chosen]
    for c, pose, here in cases:
        elsewhere = [other for there, other in placed if not _same_poses(pose, there)]
        said = judged(here, elsewhere, selves, same)
        of_a, of_b = (
            said.most_against(np.abs(m.z[:, None] - picture.place[rows]))
            for m, picture, rows in ((a, one, said.first), (b, two, said.second))
        )
        against = c.conflicts.at_most(of_b[c.conflicts.in_a.vertex], of_a[c.conflicts.in_b.vertex])
        support = c.support.at_most_against(of_a[c.a])
        bits = c.bits + said.total + c.conflicts.bits - against.bits
        bits += support.bits - c.support.bits
        out.append(replace(c, bits=bits, support=support, conflicts=against, views=said))
    return _apart(out, b)


def _told_of(c: Candidate, a: Prepared, b: Prepared, two: Picture) -> FloatArray:
    """(n, 3) poses of the views of b in the frame of a, bent as the junctions are that led to the
    candidate."""
    nearest = np.abs(two.place[:, None] - b.z[c.b]).argmin(axis=1)
    mine, turn = b.z[c.b][nearest], c.turn[nearest]
    at = a.z[c.a][nearest] + turn * (two.place - mine)
    return np.column_stack([at.real, at.imag, two.pose[:, 2] + np.angle(turn)])


def _same_poses(one: FloatArray, two: FloatArray) -> bool:
    """Whether two placements lay some of the views (n, 3) alike."""
    near = np.hypot(*(one - two)[:, :2].T) < MATCH.place_m
    return bool(np.any(near & (np.abs(wrap(one[:, 2] - two[:, 2])) < MATCH.turn_rad)))


def _placed(
    a: Prepared, b: Prepared, T_a_b: FloatArray, settings: RobustSettings
) -> Candidate | None:
    """The candidate of a placement: junctions that it lays over each other, grown if they grow, or
    none; None if they contradict it. That views chose it from many is part of what theirs is held
    against (`judged`); the junctions had no choice."""
    x, y, theta = T_a_b.tolist()
    there = np.exp(1j * theta) * b.z + (x + 1j * y)
    gap = np.abs(a.z[:, None] - there)
    first, second = gap.argmin(axis=0), gap.argmin(axis=1)
    pairs = np.flatnonzero(
        (second[first] == np.arange(len(b))) & (gap.min(axis=0) < MATCH.gate_m + MATCH.crossing_m)
    )
    if not len(pairs):
        return replace(NO_JUNCTIONS, transform=T_a_b)
    seed = Seed(first[pairs], pairs, theta, x + 1j * y, 0.0)
    lanes = _lanes([(a, b, [seed], 0)])
    (candidate,) = _judged(grow(lanes, [seed], settings), np.zeros(1), search=True)
    if candidate is None:
        # Junctions that lie near each other but look different are not taken for one place.
        alike = np.flatnonzero(ungrown(lanes, [seed]).branch >= 0)
        if not len(alike):
            return replace(NO_JUNCTIONS, transform=T_a_b)
        seed = replace(seed, a=seed.a[alike], b=seed.b[alike])
        (candidate,) = _judged(ungrown(lanes, [seed]), np.zeros(1), search=True)
    if candidate is None:
        return None
    return replace(candidate, transform=T_a_b, by_views=True)


def laid_over(xy_a: FloatArray, xy_b: FloatArray) -> tuple[FloatArray, float]:
    """T_a_b that aligns matched junctions (§3.1), and their root mean square distance [m]. xy_a,
    xy_b: (k, 2) [m]."""
    transform = fit_rigid(xy_a, xy_b)
    off = xy_a - apply(transform, xy_b)
    return transform, float(np.sqrt((off * off).sum() / len(off)))


def _points(z: ComplexArray) -> FloatArray:
    return z.view(np.float64).reshape(-1, 2)


def same_placement(x: Candidate, y: Candidate, b: Prepared) -> bool:
    """Whether two candidates place b alike, as seen from where each of them matches, if it does."""
    if abs(float(wrap(x.transform[2] - y.transform[2]))) > MATCH.turn_rad:
        return False
    partner = np.full(len(b), -1)
    partner[x.b] = x.a
    mine = partner[y.b]
    both = np.count_nonzero(mine >= 0)
    if both:
        return bool(np.count_nonzero(mine == y.a) >= 0.5 * both)
    one, two = (complex(b.z[c.b if len(c) else slice(None)].mean()) for c in (x, y))
    slack = MATCH.place_m + MATCH.drift_per_m * abs(one - two)
    return abs(x.move(one) - y.move(one)) < slack and abs(x.move(two) - y.move(two)) < slack


def same_matches(x: Candidate, y: Candidate) -> bool:
    """Whether two candidates match the same vertices, as one that was found again does."""
    return set(zip(x.a.tolist(), x.b.tolist(), strict=True)) == set(
        zip(y.a.tolist(), y.b.tolist(), strict=True)
    )


def self_matches(
    maps: Iterable[Prepared], settings: RobustSettings
) -> Iterator[tuple[Candidate, ...]]:
    """Alignments of each map with other parts of itself: how far the building repeats itself."""
    for found in best_of_all((_elsewhere(m, settings) for m in maps), settings):
        yield tuple(c for c in found if np.count_nonzero(c.a == c.b) < 0.5 * len(c))


def _elsewhere(m: Prepared, settings: RobustSettings) -> Hypothesised:
    links = candidate_links(m, m)
    one, two = m.middle[links.a_row], m.middle[links.b_row]
    here = (np.abs(links.theta) < MATCH.turn_rad) & (np.abs(one - two) < MATCH.place_m)
    away = Links(links.a_row[~here], links.b_row[~here], links.theta[~here], links.bits[~here])
    return m, m, seeds(m, m, away, settings.hypotheses), len(away)
