"""What views say of candidate placements: they are registered where a placement lays them over each
other, and what they tell is measured against the other placements of the same two maps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from ...topology.arrays import FloatArray, IntArray
from ...topology.matching.likelihood import BIT
from ...topology.matching.views import LEAST_NULL, LEAST_SPREAD, Registered, ViewNull, register
from ...topology.se2 import between, compose, wrap
from .view_search import KEPT, Picture

NEAR_M = 2.5
"""Views as near to each other as this are laid over each other: they share most of what they show.
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
LEVER_M = 3.0
"""Lever of the turn of one view: half of the way from its middle to where its walls are."""
APART_M = 20.0
"""Way between two passes that do not share scans."""
AT_HAND_M = 1.5
"""Passes of one run by one place lie within as much."""
LEAST_BITS = 2.0
"""A cell with more speaks for a placement: odds of 4 to 1."""


@dataclass(frozen=True, slots=True, eq=False)
class ViewEvidence:
    """Views of two maps that a placement lays over each other.

    first, second: (k,) views of a and b; z: (k,) `Registered.z`; cell: (k,) the part of the overlap
    that each is in; bits: (c,) evidence of every part, positive for the placement; null: (2,)
    middle and spread of z at other placements.
    """

    first: IntArray
    second: IntArray
    z: FloatArray
    cell: IntArray
    bits: FloatArray
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
        """Independent parts that speak for the placement."""
        return int(np.count_nonzero(self.bits > LEAST_BITS))


NO_VIEW_EVIDENCE = ViewEvidence(
    np.zeros(0, np.int64),
    np.zeros(0, np.int64),
    np.zeros(0),
    np.zeros(0, np.int64),
    np.zeros(0),
    np.zeros(2),
)
"""Of maps without views, and where none lie over each other."""


@dataclass(frozen=True, slots=True, eq=False)
class Laid:
    """Views of two maps laid over each other, and registered.

    first, second: (k,) rows; predicted: (k, 3) pose of the second in the frame of the first map;
    found: their registration.
    """

    first: IntArray
    second: IntArray
    predicted: FloatArray
    found: Registered

    def __len__(self) -> int:
        return len(self.first)

    def better(self, a: Picture, b: Picture, T_a_b: FloatArray) -> FloatArray:
        """The placement that fits the registrations best, (3,); unchanged if none agrees."""
        weight = np.clip(self.found.z - LEAST_Z, 0.0, 2.0)
        total = weight.sum()
        if total <= 0:
            return T_a_b
        there = compose(a.pose[self.first], self.found.transform)
        za, zb = there[:, 0] + 1j * there[:, 1], b.place[self.second]
        ma, mb = (weight * za).sum() / total, (weight * zb).sum() / total
        turned = np.exp(1j * (there[:, 2] - b.pose[self.second, 2]))
        cross = (weight * (za - ma) * np.conj(zb - mb)).sum()
        cross += LEVER_M**2 * (weight * turned).sum()
        unit = cross / abs(cross)
        shift = ma - unit * mb
        return np.array([shift.real, shift.imag, float(np.angle(unit))])


def laid(
    a: Picture, b: Picture, predicted: FloatArray, most: int, slack_m: float = SLACK_M
) -> Laid:
    """Register up to `most` views of b with the nearest views of a. predicted: (n, 3) poses of all
    views of b in the frame of a."""
    gap, closest = a.nearest.query(predicted[:, :2])
    nearest = np.asarray(closest, np.int64)
    near = np.flatnonzero(gap < NEAR_M)
    few = np.linspace(0, len(near) - 1, min(len(near), most))
    second = near[np.unique(np.rint(few).astype(np.int64))]
    first = nearest[second]
    relative = between(a.pose[first], predicted[second])
    turns = relative[:, 2, None] + TURNS
    found = register(
        a.index, b.index, first, second, turns, reach_m=slack_m, centre=relative[:, :2]
    )
    return Laid(first, second, predicted[second], found)


def refined(a: Picture, b: Picture, placements: FloatArray) -> list[tuple[FloatArray, Laid]]:
    """Placements (p, 3) corrected by some of the views that they lay over each other, those that
    agree best first."""
    out = []
    for T in placements:
        some = laid(a, b, compose(T, b.pose), FEW, 2 * SLACK_M)
        out.append((some.better(a, b, T), some))
    order = sorted(range(len(out)), key=lambda k: -_agreement(out[k][1]))
    return [out[k] for k in order]


def _agreement(some: Laid) -> float:
    return float(np.maximum(some.found.z - LEAST_Z, 0.0).sum())


def worth_judging(some: Laid) -> bool:
    """Whether a placement has a chance: half of its views agree more than those of other places."""
    return len(some) > 0 and float(np.median(some.found.z)) > LEAST_Z


def judged(here: Laid, elsewhere: Sequence[FloatArray], same: FloatArray) -> ViewEvidence:
    """The evidence of views. elsewhere: z at other placements; same: of the runs' revisits."""
    if not len(here):
        return NO_VIEW_EVIDENCE
    null = _null(np.concatenate([np.zeros(0), *elsewhere]), same)
    bits = null.odds(here.found.z) / BIT
    spot = np.floor(here.predicted[:, :2] / CELL_M).astype(np.int64)
    _, cell = np.unique(spot, axis=0, return_inverse=True)
    cell = cell.reshape(-1)
    mean = np.bincount(cell, bits) / np.bincount(cell)
    told = np.array([null.middle, null.spread])
    return ViewEvidence(here.first, here.second, here.found.z, cell, mean, told)


def _null(elsewhere: FloatArray, same: FloatArray) -> ViewNull:
    """The distributions that z is compared with. Unlike closure, which asks of thousands of pairs
    of places, merging has some dozens: their upper tenth tells the spread."""
    usual = ViewNull.of(elsewhere, same)
    if len(elsewhere) < LEAST_NULL:
        return usual
    tail = float(np.quantile(elsewhere, 0.9)) - usual.middle
    return replace(usual, spread=max(tail / TENTH_SIGMAS, LEAST_SPREAD))


TENTH_SIGMAS = 1.28
"""A tenth of a normal distribution lies above so many standard deviations."""


STRIDE = 7919
"""A prime, by which views are picked all over a map."""


def apart(a: Picture, b: Picture, T_a_b: FloatArray) -> FloatArray:
    """z of pairs of views that a placement keeps apart, turned as it says, evenly picked."""
    at = compose(T_a_b, b.pose)
    k = np.arange(8 * LEAST_NULL)  # more than enough: most are far apart
    first, second = k * STRIDE % len(a.pose), k * len(b.pose) // len(k)
    far = np.hypot(*(a.pose[first, :2] - at[second, :2]).T) > 2 * NEAR_M
    first, second = first[far][::8], second[far][::8]
    turns = wrap(at[second, 2] - a.pose[first, 2])[:, None] + TURNS
    return register(a.index, b.index, first, second, turns, reach_m=SLACK_M).z


@lru_cache(maxsize=KEPT)
def revisits(a: Picture) -> FloatArray:
    """z of views of a map with others of the same place, of another pass."""
    way = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(a.place)))])
    near = a.nearest.query_pairs(AT_HAND_M, output_type="ndarray")
    near = np.sort(near[np.abs(np.diff(way[near], axis=1)[:, 0]) > APART_M], axis=1)
    first, second = near[np.lexsort((near[:, 1], near[:, 0]))].T
    few = np.unique(np.rint(np.linspace(0, len(first) - 1, min(len(first), MOST))))
    first, second = first[few.astype(np.int64)], second[few.astype(np.int64)]
    relative = between(a.pose[first], a.pose[second])
    turns = relative[:, 2, None] + TURNS
    centre = relative[:, :2]
    return register(a.index, a.index, first, second, turns, reach_m=SLACK_M, centre=centre).z
