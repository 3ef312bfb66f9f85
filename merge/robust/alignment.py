"""Candidate alignments of a pair of maps, with their evidence."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import pairwise, tee
from typing import NamedTuple, TypeVar

import numpy as np

from ...topology.arrays import BoolArray, ComplexArray, FloatArray, IntArray
from ...topology.columns import take
from ...topology.digits import BITS
from ...topology.se2 import apply, compose, fit_groups, fit_rigid, inverse, wrap
from .atlas import Atlas, Lanes, cuts
from .conflicts import NO_CONFLICTS, Conflicts, conflicts
from .growth import Grown, grow, ungrown
from .links import Seed, candidate_links, seeds
from .mirror import mirrored
from .prepare import Prepared, as_points, prepare
from .settings import MATCH, RobustSettings
from .support import NO_SUPPORT, Support, supports
from .view_evidence import (
    BEND_SLACK_M,
    JUDGE_PAIRS,
    NO_VIEW_EVIDENCE,
    Overlap,
    ViewEvidence,
    overlaps,
    refine,
    repeats,
    revisits,
    view_evidence,
    worth_judging,
)
from .view_search import CACHED_MAPS, Picture, pictured, placements

T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class Candidate:
    """A candidate alignment of b with a.

    transform: (3,) T_a_b; a, b: (k,) matched vertices; turn: (k,) local rotation b → a at each, as
    unit numbers; support, conflicts: evidence for and against; tested_bits: log2 of the number of
    hypotheses tested; bits: log2 odds against chance, by support, conflicts, tested_bits and views;
    rmse_m: of the matched junctions; searched: whether contradictions were looked for, which is
    done where the support is beyond chance or both maps have views; views: evidence of the views;
    by_views: whether views proposed it.
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
    searched: bool = True
    views: ViewEvidence = NO_VIEW_EVIDENCE
    by_views: bool = False

    def __len__(self) -> int:
        return len(self.a)

    @property
    def witnesses(self) -> float:
        """Number of matched junctions, plus what the agreeing parts of the views are worth."""
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
        against, by_views = self.contradicting_bits, self.views.total + self.views.against
        agreement = self.bits + against - by_views
        return min(agreement, MATCH.junction_bits * len(self)) + by_views - against

    def exchanged(self) -> Candidate:
        """The same with a and b exchanged."""
        return replace(
            self,
            transform=inverse(self.transform),
            a=self.b,
            b=self.a,
            turn=self.turn.conj(),
            support=replace(self.support, corridors=self.corridors[:, ::-1]),
            conflicts=self.conflicts.exchanged(),
            views=self.views.exchanged(),
        )

    def move(self, z: complex) -> complex:
        """Position in a of a point x + iy of b."""
        return complex(moved(self.transform, z))


def moved(pose: FloatArray, z: ComplexArray | complex) -> ComplexArray:
    """Points z, x + iy [m], moved by a pose (3,)."""
    x, y, theta = pose.tolist()
    return np.asarray(np.exp(1j * theta) * z + (x + 1j * y))


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


class Hypotheses(NamedTuple):
    """Two maps, hypotheses of their alignment, and the number of links these were chosen from."""

    a: Prepared
    b: Prepared
    seeds: Sequence[Seed]
    tested: int


def match(a: Prepared, b: Prepared, settings: RobustSettings) -> tuple[Candidate, ...]:
    """Candidate alignments of two maps, best first, without duplicates of one placement. Pure.

    The steps of the paper with certainty replaced by odds: compatible corridors (§2.1), connected
    hypotheses (§2.3), transforms (§3.1), clusters grown again geometrically (§5).
    """
    return next(match_all([(a, b)], settings))


def match_all(
    pairs: Iterable[tuple[Prepared, Prepared]], settings: RobustSettings
) -> Iterator[tuple[Candidate, ...]]:
    """`match` for many pairs, each as if it were alone.

    The map whose content sorts first is searched in: neither the names of runs nor the order of two
    maps change what is found.
    """
    given, ordered = tee((a, _by_content(a, b)) for a, b in pairs)
    cases, to_evaluate = tee(_best_hypotheses(*both, settings) for _, both in ordered)
    found = evaluate_all(to_evaluate, settings)
    for (a, (first, _)), case, by_junctions in zip(given, cases, found, strict=True):
        candidates = _with_views(case.a, case.b, by_junctions, settings)
        yield candidates if first is a else tuple(c.exchanged() for c in candidates)


def image_bits(
    pairs: Iterable[tuple[Prepared, Prepared]], settings: RobustSettings
) -> Iterator[float]:
    """For each pair of maps the evidence of the best alignment of one with the mirror image of the
    other; -inf without one."""
    ordered = (_by_content(a, b) for a, b in pairs)
    cases = (_best_hypotheses(a, _image(b), settings) for a, b in ordered)
    for found in evaluate_all(cases, settings):
        yield max((c.bits for c in found), default=-np.inf)


def _by_content(a: Prepared, b: Prepared) -> tuple[Prepared, Prepared]:
    """Two maps, that with the lesser content first."""
    content_a, content_b = (
        (m.z.tobytes(), m.length.tobytes(), m.views.pose.tobytes()) for m in (a, b)
    )
    return (a, b) if content_a <= content_b else (b, a)


def _best_hypotheses(a: Prepared, b: Prepared, settings: RobustSettings) -> Hypotheses:
    links = candidate_links(a, b)
    return Hypotheses(a, b, seeds(a, b, links, settings.hypotheses), len(links))


@lru_cache(maxsize=CACHED_MAPS)
def _image(m: Prepared) -> Prepared:
    """The mirror image of a map, without views."""
    return prepare(mirrored(m.topomap))


def _both_have_views(a: Prepared, b: Prepared) -> bool:
    return len(a.views) > 0 and len(b.views) > 0


def _batches(items: Iterable[T], size: Callable[[T], int], most: int) -> Iterator[list[T]]:
    """The items in lists, each as soon as it reaches a size, and the rest."""
    batch: list[T] = []
    total = 0
    for item in items:
        batch.append(item)
        total += size(item)
        if total >= most:
            yield batch
            batch, total = [], 0
    yield batch


def evaluate_all(
    cases: Iterable[Hypotheses], settings: RobustSettings
) -> Iterator[tuple[Candidate, ...]]:
    """The candidates of many pairs of maps: their hypotheses, grown in batches that fit the
    cache."""
    for batch in _batches(cases, lambda case: len(case.b) * len(case.seeds), MATCH.at_once):
        yield from _evaluate_batch(batch, settings)


def _evaluate_batch(
    cases: Sequence[Hypotheses], settings: RobustSettings
) -> Iterator[tuple[Candidate, ...]]:
    found: list[list[Candidate]] = [[] for _ in cases]
    if any(case.seeds for case in cases):
        all_seeds = [seed for case in cases for seed in case.seeds]
        grown = grow(_lanes(cases), all_seeds, settings)
        owner = np.arange(len(cases)).repeat([len(case.seeds) for case in cases])
        tested_bits = np.log2(np.array([case.tested for case in cases]) + 1.0)
        have_views = np.array([_both_have_views(case.a, case.b) for case in cases])
        candidates = _candidates(grown, tested_bits[owner], search=have_views[owner])
        for k, candidate in zip(owner.tolist(), candidates, strict=True):
            if candidate is not None:
                found[k].append(candidate)
    for case, candidates_of_case in zip(cases, found, strict=True):
        yield _distinct(candidates_of_case, case.b)


def _distinct(candidates: Iterable[Candidate], b: Prepared) -> tuple[Candidate, ...]:
    """The best candidate for each placement, best first."""
    kept: list[Candidate] = []
    for candidate in sorted(candidates, key=_rank):
        if not any(same_placement(candidate, other, b) for other in kept):
            kept.append(candidate)
    return tuple(kept)


def _rank(c: Candidate) -> tuple[float, list[float]]:
    return -round(c.bits, BITS), c.transform.tolist()


def _lanes(cases: Sequence[Hypotheses]) -> Lanes:
    """A lane for every hypothesis."""
    pairs = [(case.a, case.b) for case in cases for _ in case.seeds]
    atlas, rows = Atlas.of_pairs(pairs)
    return Lanes.of(atlas, atlas, *rows.T)


def ungrown_candidates(case: Hypotheses) -> list[Candidate]:
    """Hypotheses of two junctions or more as candidates, without growth."""
    tested_bits = np.full(len(case.seeds), np.log2(case.tested + 1.0))
    candidates = _candidates(ungrown(_lanes([case]), case.seeds), tested_bits, search=False)
    return [candidate for candidate in candidates if candidate is not None]


def _candidates(
    grown: Grown, tested_bits: FloatArray, *, search: BoolArray | bool
) -> list[Candidate | None]:
    """The candidate of each lane with its evidence; None where nothing is matched. search: lanes
    whose contradictions are looked for also if nothing is beyond chance."""
    lanes = grown.lanes
    if not len(grown.row):
        return [None] * len(lanes)
    support = supports(grown)
    bits = np.array([s.bits for s in support]) - tested_bits
    first = cuts(grown.lane, len(lanes))
    searched = (bits > MATCH.lead_bits) | search
    against = conflicts(grown, searched)
    a = grown.a - lanes.a.vertex[lanes.of_a[grown.lane]]
    b = grown.b - lanes.b.vertex[lanes.of_b[grown.lane]]
    turn = grown.turn[grown.row]
    transform, rmse = _fit_lanes(grown)
    candidates: list[Candidate | None] = [None] * len(lanes)
    for k, (start, stop) in enumerate(pairwise(first)):
        if stop > start:
            candidates[k] = Candidate(
                transform=transform[k],
                a=a[start:stop],
                b=b[start:stop],
                turn=turn[start:stop],
                support=support[k],
                conflicts=against[k],
                tested_bits=float(tested_bits[k]),
                bits=float(bits[k] - against[k].bits),
                rmse_m=float(rmse[k]),
                searched=bool(searched[k]),
            )
    return candidates


def _fit_lanes(grown: Grown) -> tuple[FloatArray, FloatArray]:
    """`fit_matches` of every lane, (l, 3) and (l,); zeros for lanes without a match."""
    lanes, count = grown.lanes, len(grown.lanes)
    transform, rmse = np.zeros((count, 3)), np.zeros(count)
    pa, pb = as_points(lanes.a.whole.z[grown.a]), as_points(lanes.b.whole.z[grown.b])
    matched, group = np.unique(grown.lane, return_inverse=True)
    transform[matched] = fit_groups(pa, pb, group, np.ones(len(group)))
    residual = pa - apply(transform[grown.lane], pb)
    squared = np.bincount(group, (residual * residual).sum(axis=1))
    rmse[matched] = np.sqrt(squared / np.bincount(group))
    return transform, rmse


# --- views ----------------------------------------------------------------------------------------


def _with_views(
    a: Prepared, b: Prepared, candidates: tuple[Candidate, ...], settings: RobustSettings
) -> tuple[Candidate, ...]:
    """The candidates of two maps with the evidence of their views, and those that the views
    propose; unchanged for maps without views."""
    if not _both_have_views(a, b):
        return candidates
    seen_a, seen_b = pictured(a.views), pictured(b.views)
    refined = refine(seen_a, seen_b, placements(seen_a, seen_b))
    likely = [T for T, overlap in refined if worth_judging(overlap)][: settings.hypotheses]
    poses = [_bent_poses(c, a, b, seen_b) for c in candidates]
    chosen = {k for k, c in enumerate(candidates) if c.bits > MATCH.lead_bits}
    proposed = []
    for T in likely:
        placed_alike = [k for k, p in enumerate(poses) if _alike(p, compose(T, seen_b.pose))]
        chosen.update(placed_alike[:1])
        proposed += [] if placed_alike else [T]
    if not proposed and not chosen:
        return candidates
    rows = sorted(chosen)
    judged = overlaps(seen_a, seen_b, [poses[k] for k in rows], JUDGE_PAIRS)
    cases = [(candidates[k], poses[k], overlap) for k, overlap in zip(rows, judged, strict=True)]
    cases += _proposed_by_views(a, b, proposed, settings)
    placed = [(compose(T, seen_b.pose), overlap) for T, overlap in refined]
    placed += [(compose(c.transform, seen_b.pose), overlap) for c, _, overlap in cases]
    revisit_z = np.concatenate([revisits(a.views), revisits(b.views)])
    repeats_of_both = repeats(a.views), repeats(b.views)
    out = [c for k, c in enumerate(candidates) if k not in chosen]
    for c, pose, overlap in cases:
        others = [other for other_pose, other in placed if not _alike(pose, other_pose)]
        evidence = view_evidence(overlap, others, repeats_of_both, revisit_z)
        away_a = np.abs(a.z[:, None] - seen_a.place[evidence.first])
        away_b = np.abs(b.z[:, None] - seen_b.place[evidence.second])
        out.append(_with_evidence(c, evidence, away_a, away_b))
    return _distinct(out, b)


def _bent_poses(c: Candidate, a: Prepared, b: Prepared, seen_b: Picture) -> FloatArray:
    """(n, 3) poses of the views of b in the frame of a, by the local rotation and shift of the
    nearest matched junction of a candidate."""
    nearest = np.abs(seen_b.place[:, None] - b.z[c.b]).argmin(axis=1)
    junction, turn = b.z[c.b][nearest], c.turn[nearest]
    placed = a.z[c.a][nearest] + turn * (seen_b.place - junction)
    return np.column_stack([placed.real, placed.imag, seen_b.pose[:, 2] + np.angle(turn)])


def _alike(poses: FloatArray, others: FloatArray) -> bool:
    """Whether two placements lay some of the views alike. poses, others: (n, 3) of all views."""
    near = np.hypot(*(poses - others)[:, :2].T) < MATCH.place_m
    return bool(np.any(near & (np.abs(wrap(poses[:, 2] - others[:, 2])) < MATCH.turn_rad)))


def _proposed_by_views(
    a: Prepared, b: Prepared, proposed: Sequence[FloatArray], settings: RobustSettings
) -> list[tuple[Candidate, FloatArray, Overlap]]:
    """The candidates at placements T_a_b (3,), each corrected by registration of views; with each
    the poses (n, 3) of b's views in a, bent as drift has bent the maps, and their overlap."""
    seen_a, seen_b = pictured(a.views), pictured(b.views)
    poses = [compose(T, seen_b.pose) for T in proposed]
    found = overlaps(seen_a, seen_b, poses, JUDGE_PAIRS)
    proposed = [overlap.corrected(T) for T, overlap in zip(proposed, found, strict=True)]
    for slack_m in BEND_SLACK_M:
        poses = [overlap.bent(pose) for pose, overlap in zip(poses, found, strict=True)]
        found = overlaps(seen_a, seen_b, poses, JUDGE_PAIRS, slack_m)
    cases = []
    for T, pose, overlap in zip(proposed, poses, found, strict=True):
        candidate = _candidate_at(a, b, T, settings)
        if candidate is not None:
            cases.append((candidate, pose, overlap))
    return cases


def _with_evidence(
    c: Candidate, evidence: ViewEvidence, away_a: FloatArray, away_b: FloatArray
) -> Candidate:
    """A candidate with the evidence of views, which also bounds what junctions count against it.

    away_a, away_b: (n, k) distances [m] of the junctions of either map from each pair of views.
    """
    bound_a, bound_b = evidence.penalty_bound(away_a), evidence.penalty_bound(away_b)
    in_a, in_b = c.conflicts.in_a.vertex, c.conflicts.in_b.vertex  # of b inside a, and the reverse
    against = c.conflicts.bounded(bound_b[in_a], bound_a[in_b])
    support = c.support.bounded(bound_a[c.a])
    bits = c.bits + evidence.total + c.conflicts.bits - against.bits
    bits += support.bits - c.support.bits
    return replace(c, bits=bits, support=support, conflicts=against, views=evidence)


def _candidate_at(
    a: Prepared, b: Prepared, T_a_b: FloatArray, settings: RobustSettings
) -> Candidate | None:
    """The candidate of a placement that views propose: with the junctions that it lays over each
    other, grown if they grow, or without any; None if their branches contradict it.

    No bits are deducted for tested hypotheses: the null of `view_evidence` takes the choice among
    many placements into account, and junctions had no choice.
    """
    x, y, theta = T_a_b.tolist()
    gap = np.abs(a.z[:, None] - moved(T_a_b, b.z))
    nearest_a, nearest_b = gap.argmin(axis=0), gap.argmin(axis=1)
    mutual = nearest_b[nearest_a] == np.arange(len(b))
    pairs = np.flatnonzero(mutual & (gap.min(axis=0) < MATCH.gate_m + MATCH.crossing_m))
    if not len(pairs):
        return replace(NO_JUNCTIONS, transform=T_a_b)
    seed = Seed(nearest_a[pairs], pairs, theta, x + 1j * y, 0.0)
    lanes = _lanes([Hypotheses(a, b, [seed], 0)])
    (candidate,) = _candidates(grow(lanes, [seed], settings), np.zeros(1), search=True)
    if candidate is None:
        # Junctions that lie near each other but look different are not matched.
        alike = np.flatnonzero(ungrown(lanes, [seed]).branch >= 0)
        if not len(alike):
            return replace(NO_JUNCTIONS, transform=T_a_b)
        seed = replace(seed, a=seed.a[alike], b=seed.b[alike])
        (candidate,) = _candidates(ungrown(lanes, [seed]), np.zeros(1), search=True)
    if candidate is None:
        return None
    return replace(candidate, transform=T_a_b, by_views=True)


def fit_matches(xy_a: FloatArray, xy_b: FloatArray) -> tuple[FloatArray, float]:
    """T_a_b that aligns matched junctions (§3.1), and their root mean square distance [m]. xy_a,
    xy_b: (k, 2) [m]."""
    transform = fit_rigid(xy_a, xy_b)
    residual = xy_a - apply(transform, xy_b)
    return transform, float(np.sqrt((residual * residual).sum() / len(residual)))


def same_placement(x: Candidate, y: Candidate, b: Prepared) -> bool:
    """Whether two candidates place b alike: by half of the junctions of b that both match, or, if
    there are none, at the centroids of the junctions of b that either matches."""
    if abs(float(wrap(x.transform[2] - y.transform[2]))) > MATCH.turn_rad:
        return False
    partner = np.full(len(b), -1)
    partner[x.b] = x.a
    by_x = partner[y.b]
    both = np.count_nonzero(by_x >= 0)
    if both:
        return bool(np.count_nonzero(by_x == y.a) >= 0.5 * both)
    middle_x, middle_y = (complex(b.z[c.b if len(c) else slice(None)].mean()) for c in (x, y))
    slack = MATCH.place_m + MATCH.drift_per_m * abs(middle_x - middle_y)
    return all(abs(x.move(z) - y.move(z)) < slack for z in (middle_x, middle_y))


def same_matches(x: Candidate, y: Candidate) -> bool:
    """Whether two candidates match the same vertices."""
    pairs_x, pairs_y = (set(zip(c.a.tolist(), c.b.tolist(), strict=True)) for c in (x, y))
    return pairs_x == pairs_y


def self_matches(
    maps: Iterable[Prepared], settings: RobustSettings
) -> Iterator[tuple[Candidate, ...]]:
    """Alignments of each map with other parts of itself: how far the building repeats itself."""
    for candidates in evaluate_all((_self_hypotheses(m, settings) for m in maps), settings):
        yield tuple(c for c in candidates if np.count_nonzero(c.a == c.b) < 0.5 * len(c))


def _self_hypotheses(m: Prepared, settings: RobustSettings) -> Hypotheses:
    """Hypotheses of alignments of a map with other parts of itself."""
    links = candidate_links(m, m)
    apart_m = np.abs(m.middle[links.a_row] - m.middle[links.b_row])
    away = (np.abs(links.theta) >= MATCH.turn_rad) | (apart_m >= MATCH.place_m)
    links = take(links, away)
    return Hypotheses(m, m, seeds(m, m, links, settings.hypotheses), len(links))
