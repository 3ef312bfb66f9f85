"""What views say of candidate placements.

Views are registered where a placement lays them over each other. Their agreement z is averaged over
parts of the overlap, and over the parts of a placement: neighbours err together. The mean is
compared with what false placements reach, for the two questions of robust merging: of different
buildings (chance), and of the same two maps and of either with itself (copies).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import pairwise

import numpy as np

from ...topology.arrays import BoolArray, FloatArray, IntArray
from ...topology.matching.likelihood import BIT
from ...topology.matching.views import LEAST_SAME, Registered, register
from ...topology.se2 import apply, between, compose, fit_rigid, rigid_from_sums
from ...topology.views import Views
from ..wording import AGREES_BITS
from .settings import MATCH
from .view_search import KEPT, Picture, pictured, placements

NEAR_M = 2.5
"""Views as near to each other as this are laid over each other: they share most of what they show.
With 4 m the tail below is that of one part fewer; two pairs of runs in a hall gain 3 and 5 bits by
it, others lose 1 to 5, and no verdict changes.
"""
SLACK_M, SLACK_RAD = 0.8, 0.12
"""How far a placement may be off at a view: 2 sigma of the drift within a map."""
TURNS = np.linspace(-SLACK_RAD, SLACK_RAD, 5)
CELL_M = 8.0
"""Views within as much tell the same: they count once (of places that agree by one false seed, 6 to
43 % of others nearer than that exceed the null's 99 %, 0 to 28 % beyond)."""
FEW, MOST = 6, 24
"""Pairs of views that are registered to find the best placements, and to judge one."""
LEAST_Z = 1.5
"""Pairs that agree less do not place one map in the other: of other places 99 % stay below it in
five real buildings."""
PASSES_M = 20.0
"""Way between two passes that do not share scans."""
AT_HAND_M = 1.5
"""Passes of one run by one place lie within as much."""


@dataclass(frozen=True, slots=True, eq=False)
class ViewEvidence:
    """Views of two maps that a placement lays over each other.

    first, second: (k,) views of a and b; transform, information: of their registration, as in
    `Registered`, (k, 3) and (k, 3, 3); z: (k,) `Registered.z`; cell: (k,) the part of the overlap
    that each is in; bits: (c,) evidence of every part against chance, positive for the placement;
    copies: evidence that it is no copy [bits]; repeated: 0 to 1, how likely it is a copy by its
    size; null: (2,) middle and spread of z at the placements of copies.
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
        """The evidence for the placement, less that against it [bits]."""
        return float(self.bits.sum())

    @property
    def against(self) -> float:
        """The evidence against the placement, positive [bits]."""
        return -float(self.bits[self.bits < 0].sum())

    @property
    def agreeing(self) -> int:
        """Parts of the overlap that speak for the placement."""
        return int(np.count_nonzero(self.bits > AGREES_BITS))

    @property
    def junctions(self) -> float:
        """As how many junctions the parts weigh that speak for the placement: each as its bits, of
        which `MATCH.junction_bits` are one, at least one and at most two. Where maps repeat
        themselves, what repeats is no witness."""
        weight = np.clip(self.bits / MATCH.junction_bits, 1.0, 2.0)
        return float(weight[self.bits > AGREES_BITS].sum()) * (1.0 - self.alike)

    @property
    def alike(self) -> float:
        """0 to 1: how far the buildings repeat themselves, by the z of copies; 1 without views."""
        return _alike(*self.null) if len(self) else 1.0

    def off_m(self, a: Views, b: Views) -> float:
        """Root mean square distance of the parts that agree, as they are registered in the first
        map, from where one rigid motion of the second lays them [m]; inf for fewer than
        `MATCH.fewest`. The views of both maps are given."""
        good = self.z > LEAST_Z
        cell = np.unique(self.cell[good], return_inverse=True)[1]
        there = compose(a.pose[self.first[good]], self.transform[good])
        one, two = (
            np.stack([_means(cell, pose[:, k]) for k in (0, 1)], axis=1)
            for pose in (there, b.pose[self.second[good]])
        )
        if len(one) < MATCH.fewest:
            return np.inf
        off = one - apply(fit_rigid(one, two), two)
        return float(np.sqrt((off**2).sum(axis=1).mean()))

    def most_against(self, away_m: FloatArray) -> FloatArray:
        """(n,) upper bound of what each of n junctions tells against the placement [bits], by the
        walls around it. away_m: (n, k) its distance [m] from every pair of views.

        A junction tells against it if only one run detected it, or if its branches or corridors
        differ. Where the walls agree, the detector saw the same place in two ways (`UNSEEN_BITS`).
        Where a building repeats itself, walls of its copies agree as well, and the bound is higher.
        """
        if not len(self) or not len(away_m):
            return np.full(len(away_m), np.inf)
        nearest = away_m.argmin(axis=1)
        part = _means(self.cell, self.z)[self.cell[nearest]]
        agree = np.clip((part - UNSEEN_Z[0]) / (UNSEEN_Z[1] - UNSEEN_Z[0]), 0.0, 1.0)
        agree *= 1.0 - self.alike
        most = MATCH.most_bits + agree * (UNSEEN_BITS - MATCH.most_bits)
        return np.where(away_m.min(axis=1) < CELL_M / 2, most, np.inf)


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
"""Of maps without views, and where none lie over each other."""


@dataclass(frozen=True, eq=False)
class Laid:
    """Views of two maps laid over each other, and registered.

    first, second: (k,) rows; predicted: (k, 3) poses of the second in the frame of the first map;
    there: the same by registration; found: their registration.
    """

    first: IntArray
    second: IntArray
    predicted: FloatArray
    there: FloatArray
    found: Registered

    def __len__(self) -> int:
        return len(self.first)

    def some(self, rows: slice) -> Laid:
        """These pairs of views."""
        return Laid(
            self.first[rows],
            self.second[rows],
            self.predicted[rows],
            self.there[rows],
            self.found.some(rows),
        )

    @cached_property
    def cell(self) -> IntArray:
        """(k,) the part of the overlap that each pair of views is in."""
        spot = np.floor(self.predicted[:, :2] / CELL_M).astype(np.int64)
        return np.unique(spot, axis=0, return_inverse=True)[1].reshape(-1)

    @cached_property
    def parts(self) -> FloatArray:
        """(c,) mean z of every part of the overlap."""
        return _means(self.cell, self.found.z)

    @cached_property
    def telling(self) -> FloatArray:
        """(k,) z as far as it tells (`DETAIL`): a bare wall agrees with many."""
        most = np.log(np.maximum(self.found.detail, 1.0)) - DETAIL
        return np.minimum(self.found.z, np.clip(most, *DETAILED_Z))

    @cached_property
    def telling_parts(self) -> FloatArray:
        """(c,) mean of `telling` of every part of the overlap."""
        return _means(self.cell, self.telling)

    def parts_of(self, some: BoolArray) -> FloatArray:
        """`telling_parts` by some of the pairs of views (k,)."""
        return _means(self.cell[some], self.telling[some])

    @cached_property
    def correction(self) -> FloatArray:
        """(3,) what moves the predicted poses to the registered ones best; zeros if none agrees."""
        weight = np.clip(self.found.z - LEAST_Z, 0.0, 2.0)
        total = weight.sum()
        if total <= 0:
            return np.zeros(3)
        za, zb = (pose[:, 0] + 1j * pose[:, 1] for pose in (self.there, self.predicted))
        turned = np.exp(1j * (self.there[:, 2] - self.predicted[:, 2]))
        lever = MATCH.place_m**2 * (weight * turned).sum()
        sum_a, sum_b, sum_ab = ((weight * z).sum() for z in (za, zb, za * zb.conj()))
        unit, ma, mb = rigid_from_sums(total, sum_a, sum_b, sum_ab, lever)
        shift = ma - unit * mb
        return np.array([shift.real, shift.imag, float(np.angle(unit))])

    def better(self, T_a_b: FloatArray) -> FloatArray:
        """The placement (3,) that led to the predicted poses, corrected."""
        return compose(self.correction, T_a_b)

    @cached_property
    def consistency(self) -> FloatArray:
        """(c,) how far every part of the overlap agrees with the others on one placement: by the
        mean distance of registered from corrected poses, 1 within `CONSISTENT_M`, 0 at twice that,
        -1 from thrice on; less the share that the placement was fitted to."""
        off = self.there[:, :2] - compose(self.correction, self.predicted)[:, :2]
        apart_m = _means(self.cell, np.hypot(*off.T))
        known = (min(len(apart_m), MOST_PARTS) - 1) / len(apart_m)
        return known * (1.0 - np.clip(apart_m / CONSISTENT_M - 1.0, 0.0, 2.0))

    @property
    def consistent_parts(self) -> float:
        """As how many parts agree on the placement; 0 of too few to tell."""
        return float(self.consistency.sum()) if len(self.parts) >= MATCH.fewest else 0.0


def _means(cell: IntArray, values: FloatArray) -> FloatArray:
    """(c,) mean of the values (k,) in every cell that has any."""
    count = np.bincount(cell)
    return np.asarray(np.bincount(cell, values)[count > 0] / count[count > 0])


def laid(
    a: Picture, b: Picture, placed: Sequence[FloatArray], most: int, slack_m: float = SLACK_M
) -> list[Laid]:
    """Of each placement up to `most` views of b registered with the nearest views of a. placed: of
    each (n, 3) poses of all views of b in the frame of a."""
    if not len(placed):
        return []
    rows = [_near(a, poses, most) for poses in placed]
    first, second = (np.concatenate(column) for column in zip(*rows, strict=True))
    predicted = np.concatenate([poses[near] for poses, (_, near) in zip(placed, rows, strict=True)])
    relative = between(a.pose[first], predicted)
    turns = relative[:, 2, None] + TURNS
    found = register(
        a.index, b.index, first, second, turns, reach_m=slack_m, centre=relative[:, :2]
    )
    there = compose(a.pose[first], found.transform)
    every = Laid(first, second, predicted, there, found)
    ends = np.cumsum([len(near) for _, near in rows]).tolist()
    return [every.some(slice(begin, end)) for begin, end in pairwise([0, *ends])]


def _near(a: Picture, poses: FloatArray, most: int) -> tuple[IntArray, IntArray]:
    """Up to `most` views of a, and those of b that lie nearest to them, at poses (n, 3)."""
    gap, closest = a.nearest.query(poses[:, :2])
    near = np.flatnonzero(gap < NEAR_M)
    few = np.linspace(0, len(near) - 1, min(len(near), most))
    second = near[np.unique(np.rint(few).astype(np.int64))]
    return np.asarray(closest, np.int64)[second], second


def refined(
    a: Picture, b: Picture, proposed: FloatArray, most: int = FEW
) -> list[tuple[FloatArray, Laid]]:
    """Proposed placements (p, 3) corrected by up to `most` of the views that they lay over each
    other, those that agree best first."""
    every = laid(a, b, [compose(T, b.pose) for T in proposed], most, 2 * SLACK_M)
    out = [(some.better(T), some) for T, some in zip(proposed, every, strict=True)]
    return sorted(out, key=lambda case: -_agreement(case[1]))


def _agreement(some: Laid) -> float:
    return float(np.maximum(some.telling - LEAST_Z, 0.0).sum())


def worth_judging(some: Laid) -> bool:
    """Whether a placement has a chance: half of its views agree more than those of other places,
    or more parts agree on it than by chance."""
    if not len(some):
        return False
    agree = float(np.median(some.found.z)) > LEAST_Z
    return agree or some.consistent_parts > CHANCE_PARTS


def judged(
    here: Laid, elsewhere: Sequence[Laid], selves: Sequence[Repeats], same: FloatArray
) -> ViewEvidence:
    """The evidence of views. elsewhere: other placements of the two maps; selves: of either map
    on other parts of itself; same: z of the runs' revisits."""
    if not len(here):
        return NO_VIEW_EVIDENCE
    part = here.parts
    null = _level(
        [own.z for own in selves], [other.telling_parts for other in elsewhere if len(other)]
    )
    true = _true(same)
    telling = here.telling_parts
    mean = float(telling.mean())
    total = _against_chance(mean, len(part), null, true)
    # Every part contributes its share, more or less as its z lies above or below the mean.
    slope = (_against_chance(mean + SLOPE_Z, len(part), null, true) - total) / SLOPE_Z
    bits = (total + slope * (telling - mean)) / len(part)
    copied = [own.consistent_parts for own in selves]
    copied += [other.consistent_parts for other in elsewhere]
    bits += _consistent(here, max(copied), null)
    size = max(own.size for own in selves)
    repeated = min(max(2.0 - _size(telling) / size, 0.0), 1.0) if size > 0 else 0.0
    # If none of n others is as good, the next one is at a rate of .5 / (n + 1) (Jeffreys' prior).
    unseen = float(np.log2(2 * (null.count + 1)))
    copies = min(_odds(mean, null, true), unseen)
    found = here.found
    return ViewEvidence(
        here.first,
        here.second,
        found.transform,
        found.information,
        found.z,
        here.cell,
        bits,
        copies,
        repeated,
        np.array([null.mean, null.sigma]),
    )


@dataclass(frozen=True, slots=True)
class Level:
    """A normal distribution of the mean z of placements, known from `count` of them."""

    mean: float
    sigma: float
    count: int = 0


USUAL, USUAL_COUNT = Level(1.4, 0.5), 5
"""The mean z of false placements with `MATCH.fewest` parts and more, in five real buildings: the
prior of two maps; of the mean if there are fewer placements, of the spread with the weight of so
many. Placements with fewer parts tell nothing of the level of others: their mean scatters more."""
LEAST_SIGMA = 0.3
"""Lower bound of its spread: mazes and organic ways have .2 to .3."""
TRUE, TRUE_OF_RUN = Level(3.3, 0.9), 0.5
"""The mean z of true placements: over saved maps and runs, and its spread where revisits of the two
runs tell the mean."""
LESS_Z = 0.4
"""By so much it is lower between runs than at revisits of one, in the median of 45 true pairs."""
TRUE_Z = (2.5, 5.2)
"""Range of the means of runs."""
DETAIL, DETAILED_Z = 2.7, (2.5, 4.5)
"""Views of one map lie by chance on a bare wall or corridor of another building and agree perfectly
there: z counts as far as the logarithm of the detail (`Registered.detail`, 430 in the median of
false placements, 1,160 of true ones), less the first, within the others; 2.5 is no evidence. Of 588
false placements with 4 or 5 parts the mean z exceeds 3.1 in a hundredth, 2.5 by this; of true ones
it stays 3.4 in the median."""
CHANGED = Level(TRUE.mean, 0.6)
"""`TRUE` by this z, at most: recordings of different days agree less than revisits of one. Held to
the run's own revisits, simulated runs in two real offices, furnished anew for each of them, lost 7
to 10 bits a pair."""
TAIL_Z, TAIL_LESS, LEAST_TAIL_Z = 2.7, 0.15, 2.3
RATE, RATE_MORE = 3.0, 0.7
MOST_PARTS = 8
"""The tail of the mean z of false placements, 2,783 of 924 pairs of maps of different buildings
(four recorded with a laser, two simulated in saved maps, three of saved maps, offices, tunnels): a
tenth lies above 2.7 with one part, less with more; from there on the density falls by exp(-3 z)
with one part, faster with more. Of 1,784 pairs of different buildings .8 % exceed 4 bits by it,
.4 % 6, .2 % 8 (6, 1.6 and .4 % may); of placements with five witnesses none exceeds 0."""
CONSISTENT_BITS, CONSISTENT_M = 1.5, 0.2
"""What a part tells that lies within the second of where the others put it; nothing at twice that,
and as much against the placement from .6 m on. Of 134 true placements the parts are .19 m apart in
the median, of 1,344 false ones with four parts .5 m, with eight and more .75 m. With these bits 1.6
% of 1,568 pairs of different kinds of building exceed 4 bits by their views, .7 % 6, .3 % 8 and
none 9.6; without them 1.5, .5, .1 and none. The true ones gain 4 bits in the median."""
PART_BITS, CHANCE_PARTS = 3.0, 3.0
"""What every further part tells, where more parts agree on one placement than the second, and than
on any copy: on another placement of the two maps, or of either on itself. Rooms of one size, desks
or columns in rows agree there as well. Of 1,763 false placements of 252 pairs of buildings 24 have
more than three parts that agree, 2 more than their copies; true ones have four in the median of
recordings of one floor, seven where furniture was moved. With `CONSISTENT_BITS` a part tells 3.2
bits at most: within `CONSISTENT_M` lie .74 of the parts of true and .07 of those of false ones."""
UNSEEN_BITS, UNSEEN_Z = 0.7, (2.0, 3.0)
"""Upper bound of what a junction tells against a placement, where the mean z of its part of the
overlap reaches the second value; none up to the first. Of the junctions that only one of two
runs detected, or both, in 60 pairs of one place, 102 of 442 were missed, by one building 2 of 5;
they cost up to 18 bits a pair. In false placements about half are missed, and 3 of 100 parts agree
as much."""
SLOPE_Z = 0.05
"""Step of a derivative."""


def _level(selves: Sequence[FloatArray], others: Sequence[FloatArray]) -> Level:
    """The level of copies: of repetitions within the maps and of other placements of the two."""
    own = [float(part.mean()) for part in others if len(part) >= MATCH.fewest]
    z = np.concatenate([*selves, own])
    unknown = max(USUAL_COUNT - len(z), 0)
    mean = float(z.sum() + unknown * USUAL.mean) / (len(z) + unknown)
    squares = float(((z - mean) ** 2).sum()) + USUAL_COUNT * USUAL.sigma**2
    sigma = max(float(np.sqrt(squares / (len(z) + USUAL_COUNT))), LEAST_SIGMA)
    return Level(mean, sigma, max(len(z), USUAL_COUNT))


def _true(same: FloatArray) -> Level:
    if len(same) < LEAST_SAME:
        return TRUE
    return Level(float(np.clip(np.median(same) - LESS_Z, *TRUE_Z)), TRUE_OF_RUN)


def _against_chance(mean: float, parts: int, null: Level, true: Level) -> float:
    """Evidence of a mean z of some parts against a placement of different buildings [bits]. Where a
    building repeats itself others of its kind are alike, too, and where nothing in it is alike
    others are not either: a level of copies that is high or low shifts the tail, a low one that of
    placements with `MATCH.fewest` parts and more, which it is known from. By one or two parts false
    placements in halls would reach 8.7 and 13 bits (1,600 pairs of buildings), 6.6 without."""
    more = min(parts, MOST_PARTS) - 1
    rate = RATE + RATE_MORE * more
    tail = max(TAIL_Z - TAIL_LESS * more, LEAST_TAIL_Z)
    level = null.mean - null.sigma
    tail += max(level - USUAL.mean, 0.0)
    if parts >= MATCH.fewest:
        tail += min(level - USUAL.mean + USUAL.sigma, 0.0)
    changed = Level(min(true.mean, CHANGED.mean), CHANGED.sigma)
    chance = float(np.log(0.1 * rate)) - rate * max(mean - tail, 0.0)
    return _ratio(_log_true(mean, changed), chance)


def _consistent(here: Laid, copied: float, null: Level) -> FloatArray:
    """(c,) evidence that the parts of the overlap agree on one placement, against chance [bits]:
    parts laid over another building move on their own. copied: the most parts that agree on the
    placement of a copy (`Laid.consistent_parts`).

    Where a building repeats itself, so that the level of copies is high, parts of others of its
    kind agree as well, and that they do is no evidence."""
    bits = CONSISTENT_BITS * here.consistency
    share = np.maximum(here.consistency, 0.0)
    beyond = max(here.consistent_parts - max(copied, CHANCE_PARTS), 0.0)
    bits += PART_BITS * beyond * share / max(float(share.sum()), 1.0)
    return np.where(bits > 0, bits * (1.0 - _alike(null.mean, null.sigma)), bits)


def _alike(mean: float, sigma: float) -> float:
    """0 to 1: how far the buildings repeat themselves, by the middle and spread of the z of
    copies."""
    return min(max((mean - sigma - USUAL.mean) / USUAL.sigma, 0.0), 1.0)


def _odds(mean: float, null: Level, true: Level) -> float:
    """Evidence of a mean z against a copy [bits]."""
    far = max((mean - null.mean) / null.sigma, 0.0)
    # Tails of normal distributions are exponential from some standard deviations on.
    beyond = max(far - MATCH.length_sigmas, 0.0)
    fall = 0.5 * (far - beyond) ** 2 + MATCH.length_sigmas * beyond
    return _ratio(_log_true(mean, true), -fall - float(np.log(null.sigma * NORMAL)))


def _log_true(mean: float, true: Level) -> float:
    """Log density of a true placement; one that agrees more than usual counts as usual."""
    short = max(true.mean - mean, 0.0) / true.sigma
    return -0.5 * short**2 - float(np.log(true.sigma * NORMAL))


NORMAL = float(np.sqrt(2 * np.pi))


def _ratio(true: float, false: float) -> float:
    """Log likelihood ratio [bits] of log densities, with a share `fault_floor` of the false
    one: furniture was moved, doors were shut."""
    missed = MATCH.fault_floor
    return float(np.logaddexp(np.log(1 - missed) + true - false, np.log(missed))) / BIT


@dataclass(frozen=True, slots=True)
class Repeats:
    """How a map repeats itself. z: (r,) mean z of its placements on other parts of itself; size:
    the size of the largest (`_size`); consistent_parts: the most of any (`Laid`)."""

    z: FloatArray
    size: float
    consistent_parts: float


@lru_cache(maxsize=KEPT)
def repeats(views: Views) -> Repeats:
    """The placements of a map on other parts of itself, that views propose. A room that looks the
    same turned is no other part: what a placement turns on its spot does not count."""
    a = pictured(views)
    moved, consistent_parts = [], 0.0
    asked = refined(a, a, placements(a, a), MOST)
    # As placements of two maps are judged: laid where the first registration put them.
    again = laid(a, a, [compose(T, a.pose) for T, _ in asked], MOST)
    for (T, some), judged_at in zip(asked, again, strict=True):
        away = np.abs(a.place[some.first] - a.place[some.second])
        turned = abs(T[2]) >= MATCH.turn_rad
        if turned or np.hypot(T[0], T[1]) >= MATCH.place_m:
            moved.append(some.parts_of(away >= (CELL_M if turned else 0.0)))
            consistent_parts = max(consistent_parts, judged_at.consistent_parts)
    moved = [part for part in moved if len(part)]
    level = np.array([part.mean() for part in moved if len(part) >= MATCH.fewest])
    return Repeats(level, max(map(_size, moved), default=0.0), consistent_parts)


def _size(part: FloatArray) -> float:
    """How much of two maps agrees at a placement: its parts, times how far their mean z exceeds
    what parallel walls reach."""
    return len(part) * max(float(part.mean()) - PARALLEL_Z, 0.0)


PARALLEL_Z = 2.0
"""Mean z of places along the same corridor that are laid over each other."""


@lru_cache(maxsize=KEPT)
def revisits(views: Views) -> FloatArray:
    """z of views of a map with others of the same place, of another pass."""
    a = pictured(views)
    way = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(a.place)))])
    near = a.nearest.query_pairs(AT_HAND_M, output_type="ndarray")
    near = np.sort(near[np.abs(np.diff(way[near], axis=1)[:, 0]) > PASSES_M], axis=1)
    first, second = near[np.lexsort((near[:, 1], near[:, 0]))].T
    few = np.unique(np.rint(np.linspace(0, len(first) - 1, min(len(first), MOST))))
    first, second = first[few.astype(np.int64)], second[few.astype(np.int64)]
    relative = between(a.pose[first], a.pose[second])
    turns = relative[:, 2, None] + TURNS
    centre = relative[:, :2]
    return register(a.index, a.index, first, second, turns, reach_m=SLACK_M, centre=centre).z
