"""Evidence of views for and against candidate placements of two maps.

Views are registered where a placement lays them over each other. Their agreement z (`Registered.z`)
is averaged over parts of the overlap first, because neighbouring views err together, and then over
all parts. The mean is compared with the means of false placements, for the two questions of robust
merging: is it chance (null: placements of different buildings), and is it a copy (null: other
placements of the two maps, and of each map on itself)?
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import pairwise

import numpy as np

from ...topology.arrays import BoolArray, ComplexArray, FloatArray, IntArray
from ...topology.columns import take
from ...topology.matching.likelihood import BIT
from ...topology.matching.views import LEAST_SAME, Registered, register
from ...topology.se2 import (
    apply,
    between,
    compose,
    fit_rigid,
    inverse,
    rigid_from_sums,
    turned_axes,
    xy_as_complex,
)
from ...topology.views import Views
from ..wording import AGREES_BITS
from .settings import MATCH
from .view_search import CACHED_MAPS, SAME_PER_M, Picture, evenly_spread, pictured, placements

NEAR_M = 2.5
"""Largest distance of two views that are registered with each other: they share most of what they
show. With 4 m the tail below is that of one part fewer; two pairs of runs in a hall gain 3 and 5
bits, others lose 1 to 5, and no verdict changes."""
SLACK_M, SLACK_RAD = 0.8, 0.12
"""Largest error of a placement at a view: 2 sigma of the drift within a map."""
TURNS = np.linspace(-SLACK_RAD, SLACK_RAD, 5)
BEND_M = SLACK_M / SAME_PER_M
"""Distance within which drift stays below `SLACK_M`."""
BEND_SLACK_M = (3 * SLACK_M, 2 * SLACK_M, SLACK_M)
"""Largest shift in each round of bending: the first bring parts that drift has moved away within
reach of the last. Of 16 pairs of runs in a building of long corridors, 130 m each, with scans 1 m
apart, 8 merge; with the last round alone 5. False placements gain nothing (2,000 pairs)."""
CELL_M = 8.0
"""Side of the parts of an overlap, each of which counts once. Of places that agree by one false
seed, 6 to 43 % of others within this distance exceed the null's 99 %, 0 to 28 % beyond."""
PLACE_M = CELL_M / 2
"""Side of the squares by whose number the mean z of false placements falls: of 9,000 of them those
of one part with pairs in two, three and four squares have tails as those of as many parts."""
SEARCH_PAIRS, JUDGE_PAIRS = 6, 24
"""Pairs of views that are registered to find the best placements, and to judge one."""
LEAST_Z = 1.5
"""Least z of a pair of views of one place: 99 % of other pairs are below, in five buildings."""
PASSES_M = 20.0
"""Least way between two passes that share no scans."""
REVISIT_M = 1.5
"""Largest distance of two passes of one run by one place."""


@dataclass(frozen=True, slots=True, eq=False)
class ViewEvidence:
    """Evidence of the k pairs of views that a placement lays over each other, in c parts.

    first, second: (k,) views of a and b; transform, information: (k, 3) and (k, 3, 3) of their
    registration, as in `Registered`; z: (k,) `Registered.z`; cell: (k,) part of the overlap of each
    pair; bits: (c,) evidence of every part against chance, positive for the placement; copies:
    evidence that it is no copy [bits]; repeated: 0 to 1, how likely it is a copy by its size; null:
    (2,) mean and standard deviation of z at the placements of copies.
    """

    first: IntArray
    second: IntArray
    transform: FloatArray
    information: FloatArray
    z: FloatArray
    cell: IntArray
    bits: FloatArray
    copies: float
    repeated: float
    null: FloatArray

    def __len__(self) -> int:
        return len(self.first)

    @property
    def total(self) -> float:
        """Evidence for the placement, minus evidence against it [bits]."""
        return float(self.bits.sum())

    @property
    def against(self) -> float:
        """Evidence against the placement, positive [bits]."""
        return -float(self.bits[self.bits < 0].sum())

    @property
    def agreeing(self) -> int:
        """Number of parts that support the placement."""
        return int(np.count_nonzero(self.bits > AGREES_BITS))

    @property
    def junctions(self) -> float:
        """Number of junctions that the supporting parts are worth: each its bits divided by
        `MATCH.junction_bits`, between one and two; fewer where the buildings repeat themselves."""
        weight = np.clip(self.bits / MATCH.junction_bits, 1.0, 2.0)
        return float(weight[self.bits > AGREES_BITS].sum()) * (1.0 - self.self_similarity)

    @property
    def self_similarity(self) -> float:
        """0 to 1: how far the buildings repeat themselves, by the z of copies; 1 without views."""
        return _self_similarity(float(self.null[0])) if len(self) else 1.0

    def exchanged(self) -> ViewEvidence:
        """The same with a and b exchanged."""
        jacobian = -turned_axes(self.transform[:, 2])  # of the transform by its inverse
        jacobian[:, 0, 2], jacobian[:, 1, 2] = self.transform[:, 1], -self.transform[:, 0]
        return replace(
            self,
            first=self.second,
            second=self.first,
            transform=inverse(self.transform),
            information=jacobian.swapaxes(1, 2) @ self.information @ jacobian,
        )

    def residual_m(self, a: Views, b: Views) -> float:
        """Root mean square residual [m] of one rigid motion of b fitted to the registered
        positions of the parts that agree; inf for fewer parts than `MATCH.fewest`."""
        agrees = self.z > LEAST_Z
        part = np.unique(self.cell[agrees], return_inverse=True)[1]
        registered = compose(a.pose[self.first[agrees]], self.transform[agrees])
        xy_a, xy_b = (
            np.stack([_cell_means(part, pose[:, k]) for k in (0, 1)], axis=1)
            for pose in (registered, b.pose[self.second[agrees]])
        )
        if len(xy_a) < MATCH.fewest:
            return np.inf
        residual = xy_a - apply(fit_rigid(xy_a, xy_b), xy_b)
        return float(np.sqrt((residual**2).sum(axis=1).mean()))

    def penalty_bound(self, distance_m: FloatArray) -> FloatArray:
        """(n,) upper bound of the evidence of each of n junctions against the placement [bits], by
        the walls around the junction. distance_m: (n, k) of junctions from pairs of views [m].

        A junction counts against a placement if only one run detected it, or if its branches or
        corridors differ. Where the walls agree, the detector failed (`UNSEEN_BITS`). Where a
        building repeats itself, walls of copies agree as well, and the bound is higher.
        """
        if not len(self) or not len(distance_m):
            return np.full(len(distance_m), np.inf)
        nearest = distance_m.argmin(axis=1)
        part_z = _cell_means(self.cell, self.z)[self.cell[nearest]]
        agreement = np.clip((part_z - UNSEEN_Z[0]) / (UNSEEN_Z[1] - UNSEEN_Z[0]), 0.0, 1.0)
        agreement *= 1.0 - self.self_similarity
        bound = MATCH.most_bits + agreement * (UNSEEN_BITS - MATCH.most_bits)
        return np.where(distance_m.min(axis=1) < CELL_M / 2, bound, np.inf)


NO_VIEW_EVIDENCE = ViewEvidence(
    *(np.zeros(0, np.int64),) * 2,
    np.zeros((0, 3)),
    np.zeros((0, 3, 3)),
    np.zeros(0),
    np.zeros(0, np.int64),
    np.zeros(0),
    0.0,
    0.0,
    np.zeros(2),
)
"""Evidence of a placement that lays no views over each other."""


@dataclass(frozen=True, eq=False)
class Overlap:
    """Views of two maps that a placement lays over each other: k pairs, in c parts.

    first, second: (k,) rows of the views; predicted: (k, 3) poses of the second views in the frame
    of the first map, by the placement; registered: (k, 3) the same by registration; registration:
    of the pairs.
    """

    first: IntArray
    second: IntArray
    predicted: FloatArray
    registered: FloatArray
    registration: Registered

    def __len__(self) -> int:
        return len(self.first)

    @cached_property
    def cell(self) -> IntArray:
        """(k,) part of the overlap that each pair is in."""
        square = np.floor(self.predicted[:, :2] / CELL_M).astype(np.int64)
        return np.unique(square, axis=0, return_inverse=True)[1].reshape(-1)

    @cached_property
    def places(self) -> int:
        """Number of squares of `PLACE_M` with pairs."""
        return len(np.unique(np.floor(self.predicted[:, :2] / PLACE_M), axis=0))

    @cached_property
    def part_z(self) -> FloatArray:
        """(c,) mean z of every part."""
        return _cell_means(self.cell, self.registration.z)

    @cached_property
    def informative_z(self) -> FloatArray:
        """(k,) z, bounded by the detail of the walls (`DETAIL`): a bare wall agrees with many."""
        bound = np.log(np.maximum(self.registration.detail, 1.0)) - DETAIL
        return np.minimum(self.registration.z, np.clip(bound, *DETAILED_Z))

    @cached_property
    def informative_part_z(self) -> FloatArray:
        """(c,) mean of `informative_z` of every part."""
        return _cell_means(self.cell, self.informative_z)

    def informative_part_z_of(self, chosen: BoolArray) -> FloatArray:
        """`informative_part_z` of the chosen pairs (k,) alone, without empty parts."""
        return _cell_means(self.cell[chosen], self.informative_z[chosen])

    @cached_property
    def agreement(self) -> FloatArray:
        """(k,) weight of every registered pose in a rigid fit: 0 for those that do not agree."""
        return np.clip(self.registration.z - LEAST_Z, 0.0, 2.0)

    @cached_property
    def correction(self) -> FloatArray:
        """(3,) rigid motion from predicted to registered poses that agree; zeros if none do."""
        if not self.agreement.any():
            return np.zeros(3)
        unit, centre_a, centre_b = self._motion(self.agreement[None])
        shift = centre_a - unit * centre_b
        return np.concatenate([shift.real, shift.imag, np.angle(unit)])

    def corrected(self, T_a_b: FloatArray) -> FloatArray:
        """The placement (3,) that gave the predicted poses, moved by `correction`."""
        return compose(self.correction, T_a_b)

    def bent(self, poses: FloatArray) -> FloatArray:
        """The predicted poses (n, 3) of all views, each moved as the registered ones near it are:
        where drift bends the maps, no rigid motion fits everywhere."""
        if not self.agreement.any():
            return poses
        at = xy_as_complex(poses)
        away_m = np.abs(at[:, None] - xy_as_complex(self.predicted))
        away_m -= away_m.min(axis=1, keepdims=True)  # no underflow
        unit, centre_a, centre_b = self._motion(self.agreement * np.exp(-away_m / BEND_M))
        moved = centre_a + unit * (at - centre_b)
        return np.column_stack([moved.real, moved.imag, poses[:, 2] + np.angle(unit)])

    def _motion(self, weight: FloatArray) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        """`rigid_from_sums` from predicted to registered poses, for each row of weights (n, k)."""
        za, zb = xy_as_complex(self.registered), xy_as_complex(self.predicted)
        rotation = np.exp(1j * (self.registered[:, 2] - self.predicted[:, 2]))
        sums = (weight @ z for z in (za, zb, za * zb.conj(), MATCH.place_m**2 * rotation))
        return rigid_from_sums(weight.sum(axis=1), *sums)

    @cached_property
    def consistency(self) -> FloatArray:
        """(c,) how far every part agrees with the others on one placement, by the mean distance of
        registered from corrected poses: 1 within `CONSISTENT_M`, 0 at twice that, -1 from thrice
        on; times the share of the parts that the correction was not fitted to."""
        residual = self.registered[:, :2] - compose(self.correction, self.predicted)[:, :2]
        residual_m = _cell_means(self.cell, np.hypot(*residual.T))
        unfitted = (min(len(residual_m), MOST_PARTS) - 1) / len(residual_m)
        return unfitted * (1.0 - np.clip(residual_m / CONSISTENT_M - 1.0, 0.0, 2.0))

    @property
    def consistent_parts(self) -> float:
        """Number of parts that agree on the placement; 0 with fewer parts than `MATCH.fewest`."""
        return float(self.consistency.sum()) if len(self.part_z) >= MATCH.fewest else 0.0


def _cell_means(cell: IntArray, values: FloatArray) -> FloatArray:
    """(c,) mean of the values (k,) in every cell that has any."""
    count = np.bincount(cell)
    return np.asarray(np.bincount(cell, values)[count > 0] / count[count > 0])


def overlaps(
    a: Picture, b: Picture, placed: Sequence[FloatArray], most: int, slack_m: float = SLACK_M
) -> list[Overlap]:
    """The overlap of each placement: up to `most` views of b, registered with the nearest of a.

    placed: for each placement (n, 3) poses of all views of b in the frame of a; slack_m: largest
    shift of the registration [m].
    """
    if not len(placed):
        return []
    rows = [_nearest_views(a, poses, most) for poses in placed]
    first, second = (np.concatenate(column) for column in zip(*rows, strict=True))
    predicted = np.concatenate([poses[near] for poses, (_, near) in zip(placed, rows, strict=True)])
    expected = between(a.pose[first], predicted)
    registration = _registered(a, b, (first, second), expected, slack_m)
    registered = compose(a.pose[first], registration.transform)
    concatenated = Overlap(first, second, predicted, registered, registration)
    ends = np.cumsum([len(near) for _, near in rows]).tolist()
    return [take(concatenated, slice(begin, end)) for begin, end in pairwise([0, *ends])]


def _registered(
    a: Picture, b: Picture, pairs: tuple[IntArray, IntArray], expected: FloatArray, slack_m: float
) -> Registered:
    """Pairs of views of a and b registered around the expected poses (k, 3)."""
    turns, centre = expected[:, 2, None] + TURNS, expected[:, :2]
    return register(a.index, b.index, *pairs, turns, reach_m=slack_m, centre=centre)


def _nearest_views(a: Picture, poses: FloatArray, most: int) -> tuple[IntArray, IntArray]:
    """Up to `most` pairs of views within `NEAR_M`: rows of a, and of b at poses (n, 3)."""
    gap, closest = a.nearest.query(poses[:, :2])
    near = np.flatnonzero(gap < NEAR_M)
    second = near[evenly_spread(len(near), most)]
    return np.asarray(closest, np.int64)[second], second


def refine(
    a: Picture, b: Picture, proposed: FloatArray, most: int = SEARCH_PAIRS
) -> list[tuple[FloatArray, Overlap]]:
    """Proposed placements (p, 3), each corrected by up to `most` pairs of views, with the overlap
    before the correction; those that agree best first."""
    found = overlaps(a, b, [compose(T, b.pose) for T in proposed], most, 2 * SLACK_M)
    refined = [(overlap.corrected(T), overlap) for T, overlap in zip(proposed, found, strict=True)]
    return sorted(refined, key=lambda item: -_agreement(item[1]))


def _agreement(overlap: Overlap) -> float:
    return float(np.maximum(overlap.informative_z - LEAST_Z, 0.0).sum())


def worth_judging(overlap: Overlap) -> bool:
    """Whether a placement may be right: half of its pairs of views agree more than pairs of other
    places do, or more parts are consistent than by chance."""
    if not len(overlap):
        return False
    agrees = float(np.median(overlap.registration.z)) > LEAST_Z
    return agrees or overlap.consistent_parts > CHANCE_PARTS


def view_evidence(
    overlap: Overlap,
    others: Sequence[Overlap],
    repeats_of_both: Sequence[Repeats],
    revisit_z: FloatArray,
) -> ViewEvidence:
    """The evidence of views for a placement, by its overlap.

    others: overlaps of other placements of the two maps; repeats_of_both: of either map on itself;
    revisit_z: z of the revisits of both runs.
    """
    if not len(overlap):
        return NO_VIEW_EVIDENCE
    null = _copy_level(
        [repeats.z for repeats in repeats_of_both],
        [other.informative_part_z for other in others if len(other)],
    )
    true = _true_level(revisit_z)
    part_z = overlap.informative_part_z
    mean = float(part_z.mean())
    total = _chance_bits(mean, overlap, null, true)
    # Every part contributes its share, more or less as its z lies above or below the mean.
    slope = (_chance_bits(mean + SLOPE_Z, overlap, null, true) - total) / SLOPE_Z
    bits = (total + slope * (part_z - mean)) / len(part_z)
    bits += _consistency_bits(overlap, null)
    largest = max(repeats.size for repeats in repeats_of_both)
    repeated = min(max(2.0 - _agreeing_size(part_z) / largest, 0.0), 1.0) if largest > 0 else 0.0
    # If none of n others is as good, the next one is at a rate of .5 / (n + 1) (Jeffreys' prior).
    most_bits = float(np.log2(2 * (null.count + 1)))
    return ViewEvidence(
        overlap.first,
        overlap.second,
        overlap.registration.transform,
        overlap.registration.information,
        overlap.registration.z,
        overlap.cell,
        bits,
        min(_copy_bits(mean, null, true), most_bits),
        repeated,
        np.array([null.mean, null.sigma]),
    )


@dataclass(frozen=True, slots=True)
class Level:
    """A normal distribution of the mean z of placements, estimated from `count` of them."""

    mean: float
    sigma: float
    count: int = 0


FALSE, FALSE_COUNT = Level(1.4, 0.5), 5
"""Prior of the mean z of false placements of two maps, from placements with `MATCH.fewest` parts
and more in five real buildings. It stands in for the placements that are fewer than the count; the
spread has it with this weight. Placements with fewer parts scatter more and are not used."""
REPEATED_Z = FALSE.mean + FALSE.sigma
"""Mean z of copies from which on buildings repeat themselves."""
LEAST_SIGMA = 0.3
"""Lower bound of its spread: mazes and organic ways have .2 to .3."""
TRUE, TRUE_OF_RUN = Level(3.3, 0.9), 0.5
"""The mean z of true placements, from saved maps and runs; its spread where revisits of the two
runs give the mean."""
BETWEEN_RUNS_Z = 0.4
"""By so much z is lower between runs than at revisits of one: median of 45 true pairs."""
TRUE_Z = (2.5, 5.2)
"""Range of the mean z of true placements, of all runs."""
DETAIL, DETAILED_Z = 2.7, (2.5, 4.5)
"""z is bounded by ln(detail) - DETAIL, clipped to DETAILED_Z; 2.5 is no evidence. Views of one map
lie by chance on a bare wall or corridor of another building and agree perfectly there. The detail
(`Registered.detail`) is 430 in the median of false placements, 1,160 of true ones. Of 588 false
placements with 4 or 5 parts the mean z exceeds 3.1 in a hundredth, 2.5 by this; of true ones it
stays 3.4 in the median."""
TRUE_LATER = Level(TRUE.mean, 0.6)
"""Upper bound of the mean z of true placements, against chance: recordings of different days agree
less than revisits of one run. Held to the run's own revisits, simulated runs in two real offices,
furnished anew for each of them, lost 7 to 10 bits a pair."""
TAIL_Z, TAIL_LESS, LEAST_TAIL_Z = 2.7, 0.15, 2.0
RATE, RATE_MORE = 3.0, 0.7
MOST_PARTS = 12
"""The tail of the mean z of false placements of different buildings. A tenth lies above 2.7 with
pairs in one square of `PLACE_M`, less with more; from there on the density falls by exp(-3 z) with
one, faster with more, up to MOST_PARTS. From 9,000 placements of 1,360 pairs of maps (four
buildings recorded with a laser, saved maps of three, 40 random homes, runs in drawn floors of ten
kinds). Of 3,500 other pairs 1.4 % exceed 4 bits by their views, .8 % 6, .3 % 8 (6, 1.6 and .4 %
may). With 8 for MOST_PARTS 23 instead of 29 of 42 true pairs in drawn floors reach 20 bits."""
CONSISTENT_BITS, CONSISTENT_M = 1.5, 0.2
"""Evidence of a part within the distance of where the others put it: none at twice the distance,
and as much against the placement from .6 m on. Of 134 true placements the parts are .19 m apart in
the median, of 1,344 false ones with four parts .5 m, with eight and more .75 m. With these bits 1.6
% of 1,568 pairs of different kinds of building exceed 4 bits by their views, .7 % 6, .3 % 8 and
none 9.6; without them 1.5, .5, .1 and none. The true ones gain 4 bits in the median."""
CHANCE_PARTS = 3.0
"""Number of consistent parts that false placements reach by chance: of 1,763 of 252 pairs of
buildings 24 have more; true ones have four in the median of recordings of one floor."""
UNSEEN_BITS, UNSEEN_Z = 0.7, (2.0, 3.0)
"""Upper bound of the evidence of a junction against a placement, where the mean z of its part of
the overlap reaches the second z; unbounded up to the first. Of the junctions that only one of two
runs detected, or both, in 60 pairs of one place, 102 of 442 were missed, by one building 2 of 5;
they cost up to 18 bits a pair. In false placements about half are missed, and 3 of 100 parts agree
as much."""
SLOPE_Z = 0.05
"""Step of a numerical derivative."""


def _copy_level(repeat_z: Sequence[FloatArray], other_part_z: Sequence[FloatArray]) -> Level:
    """The mean z of copies: of repeats within the maps, and of other placements, by their parts."""
    other_z = [float(part_z.mean()) for part_z in other_part_z if len(part_z) >= MATCH.fewest]
    z = np.concatenate([*repeat_z, other_z])
    lacking = max(FALSE_COUNT - len(z), 0)
    mean = float(z.sum() + lacking * FALSE.mean) / (len(z) + lacking)
    squares = float(((z - mean) ** 2).sum()) + FALSE_COUNT * FALSE.sigma**2
    sigma = max(float(np.sqrt(squares / (len(z) + FALSE_COUNT))), LEAST_SIGMA)
    return Level(mean, sigma, max(len(z), FALSE_COUNT))


def _true_level(revisit_z: FloatArray) -> Level:
    """The mean z of true placements of two runs, by z of their revisits."""
    if len(revisit_z) < LEAST_SAME:
        return TRUE
    return Level(float(np.clip(np.median(revisit_z) - BETWEEN_RUNS_Z, *TRUE_Z)), TRUE_OF_RUN)


def _chance_bits(mean: float, overlap: Overlap, null: Level, true: Level) -> float:
    """Evidence of the mean z of an overlap against a placement of different buildings [bits].

    False placements agree as much as other placements of the two maps do: the tail shifts with the
    level of copies. A low level shifts it in full from four places on, by half with three, and not
    with fewer, which scatter more than the placements that the level is estimated from: in 2,000
    false pairs 10 would reach 8 bits, 5 do.
    """
    further_places = min(overlap.places, MOST_PARTS) - 1
    rate = RATE + RATE_MORE * further_places
    tail = max(TAIL_Z - TAIL_LESS * further_places, LEAST_TAIL_Z)
    shift = null.mean - REPEATED_Z
    tail += max(shift, 0.0) + min(shift, 0.0) * min(max((overlap.places - 2) / 2, 0.0), 1.0)
    later = Level(min(true.mean, TRUE_LATER.mean), TRUE_LATER.sigma)
    chance = float(np.log(0.1 * rate)) - rate * max(mean - tail, 0.0)
    return _ratio_bits(_true_log_density(mean, later), chance)


def _consistency_bits(overlap: Overlap, null: Level) -> FloatArray:
    """(c,) evidence that the parts agree on one placement, against chance [bits]: parts laid over
    another building move independently.

    Where the buildings repeat themselves, parts of others of their kind agree as well, and
    agreement is no evidence.
    """
    bits = CONSISTENT_BITS * overlap.consistency
    return np.where(bits > 0, bits * (1.0 - _self_similarity(null.mean)), bits)


def _self_similarity(mean: float) -> float:
    """0 to 1: how far buildings repeat themselves, by the mean z of copies."""
    return min(max((mean - REPEATED_Z) / FALSE.sigma, 0.0), 1.0)


def _copy_bits(mean: float, null: Level, true: Level) -> float:
    """Evidence of a mean z against a copy [bits]."""
    far = max((mean - null.mean) / null.sigma, 0.0)
    # Tails of normal distributions are exponential from some standard deviations on.
    beyond = max(far - MATCH.length_sigmas, 0.0)
    fall = 0.5 * (far - beyond) ** 2 + MATCH.length_sigmas * beyond
    return _ratio_bits(_true_log_density(mean, true), -fall - float(np.log(null.sigma * NORMAL)))


def _true_log_density(mean: float, true: Level) -> float:
    """Log density of the mean z of a true placement; more than the expected z counts as that."""
    short = max(true.mean - mean, 0.0) / true.sigma
    return -0.5 * short**2 - float(np.log(true.sigma * NORMAL))


NORMAL = float(np.sqrt(2 * np.pi))


def _ratio_bits(true: float, false: float) -> float:
    """Log likelihood ratio [bits] of two log densities. A share `fault_floor` of true placements
    follows the false density: furniture was moved, doors were shut."""
    missed = MATCH.fault_floor
    return float(np.logaddexp(np.log(1 - missed) + true - false, np.log(missed))) / BIT


@dataclass(frozen=True, slots=True)
class Repeats:
    """How a map repeats itself. z: (r,) mean z of its placements on other parts of itself; size:
    the largest `_agreeing_size` of any."""

    z: FloatArray
    size: float


@lru_cache(maxsize=CACHED_MAPS)
def repeats(views: Views) -> Repeats:
    """The placements of a map on other parts of itself that its views propose. Views that a
    rotation leaves within their own part do not count: a room may look the same rotated."""
    a = pictured(views)
    moved = []
    for T, overlap in refine(a, a, placements(a, a), JUDGE_PAIRS):
        away = np.abs(a.place[overlap.first] - a.place[overlap.second])
        turned = abs(T[2]) >= MATCH.turn_rad
        if turned or np.hypot(T[0], T[1]) >= MATCH.place_m:
            moved.append(overlap.informative_part_z_of(away >= (CELL_M if turned else 0.0)))
    moved = [part_z for part_z in moved if len(part_z)]
    z = np.array([part_z.mean() for part_z in moved if len(part_z) >= MATCH.fewest])
    return Repeats(z, max(map(_agreeing_size, moved), default=0.0))


def _agreeing_size(part_z: FloatArray) -> float:
    """Extent of the agreement: the number of parts, times mean z beyond that of parallel walls."""
    return len(part_z) * max(float(part_z.mean()) - PARALLEL_Z, 0.0)


PARALLEL_Z = 2.0
"""Mean z of places along the same corridor that are laid over each other."""


@lru_cache(maxsize=CACHED_MAPS)
def revisits(views: Views) -> FloatArray:
    """z of pairs of views of one run, of the same place on different passes."""
    a = pictured(views)
    near = a.nearest.query_pairs(REVISIT_M, output_type="ndarray")
    near = np.sort(near[np.abs(np.diff(a.arc_m[near], axis=1)[:, 0]) > PASSES_M], axis=1)
    pairs = near[np.lexsort((near[:, 1], near[:, 0]))]
    first, second = pairs[evenly_spread(len(pairs), JUDGE_PAIRS)].T
    expected = between(a.pose[first], a.pose[second])
    return _registered(a, a, (first, second), expected, SLACK_M).z
