"""Pairs of places that may be one, with the evidence for and against."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from ..arrays import BoolArray, FloatArray, IntArray
from ..columns import take
from ..matching.likelihood import LIKELIHOOD
from ..se2 import turned_axes
from .branches import align
from .dead_reckoning import relative_covariance
from .estimate import Estimate
from .evidence import EVIDENCE, Background, among_neighbours, position_odds
from .growth import MapState, grow
from .negative_information import DrivenGround, driven_ground
from .places import HOPS, Places


@dataclass(frozen=True, slots=True)
class CandidateSettings:
    """Which pairs of places are considered."""

    most_pairs: int = 10
    """Pairs per place that are considered in one round, the nearest of all; bounds the time
    (`benchmarks/closure.py --growth`)."""
    most_tabled: int = 1_000_000
    """Pairs of places in one table: about 200 MB."""
    most_null_pairs: int = 3000
    """Size of the sample of null pairs: it estimates a tail probability of 1/100 to a fifth."""


CANDIDATES = CandidateSettings()


@dataclass(frozen=True, slots=True, eq=False)
class Surroundings:
    """Evidence [nats] that k pairs of places are one each, by their branches and corridors.

    branches: (k,) log odds; support, conflict: (k,) by the corridors around that agree and that
    disagree, both positive; turn: (k,) rotation of the branches of the second place that aligns
    them with those of the first [rad].
    """

    branches: FloatArray
    support: FloatArray
    conflict: FloatArray
    turn: FloatArray

    @property
    def odds(self) -> FloatArray:
        """(k,) all of it [nats]."""
        return np.asarray(self.branches + self.support - self.conflict)


@dataclass(frozen=True, slots=True, eq=False)
class Candidates:
    """Pairs of places a < b that may be one place, with the terms of their log odds [nats], (k,)
    each."""

    a: IntArray
    b: IntArray
    position: FloatArray
    around: Surroundings
    aliasing_penalty: FloatArray
    """Deducted because null pairs have as much evidence."""
    ground: DrivenGround
    fits: BoolArray
    """Whether their distance passes the gate. The others are not identified. They are nearer to
    each other than two junctions usually are, so that they exclude no other identification."""

    def __len__(self) -> int:
        return len(self.a)

    @property
    def alike(self) -> FloatArray:
        """(k,) all evidence but that of position [nats]."""
        return np.asarray(self.around.odds - self.aliasing_penalty)

    @property
    def total(self) -> FloatArray:
        """(k,) all evidence [nats]."""
        return np.asarray(self.position + self.alike)


@dataclass(frozen=True, slots=True, eq=False)
class _Pairs:
    """Pairs of places a < b: shift (k, 2) from b to a [m], cov (k, 3, 3) of it and of the
    rotation."""

    a: IntArray
    b: IntArray
    shift: FloatArray
    cov: FloatArray

    def __len__(self) -> int:
        return len(self.a)

    def shift_covariance(self, common: Background) -> FloatArray:
        """(k, 2, 2) covariance of the shift, including the noise of both centres."""
        return np.asarray(self.cov[:, :2, :2] + 2 * common.centre_sigma**2 * np.eye(2))


def candidates(state: MapState, place: IntArray, estimate: Estimate, *, exact: bool) -> Candidates:
    """All pairs of places that position and branches allow, with the terms of their evidence.

    Dead reckoning bounds the covariances first. If `exact`, the pairs that it does not exclude get
    the covariances of the solved pose graph instead of the bounds.
    """
    common = state.common
    pairs = _possible_pairs(state, place, estimate)
    null_pairs = _null_pairs(state, pairs)
    trace = pairs.cov[:, 0, 0] + pairs.cov[:, 1, 1] + 4 * common.centre_sigma**2
    pairs = take(pairs, (pairs.shift**2).sum(axis=1) < LIKELIHOOD.gate_chi2(2) * trace)
    pairs = _nearest_pairs(pairs, CANDIDATES.most_pairs * len(state.places))
    if exact:
        pairs = replace(pairs, cov=_exact_covariance(estimate, pairs.a, pairs.b))
    # Without exact covariances only clear cases are kept: they make the others easier.
    least = -np.inf if exact else 0.0
    odds, d2 = position_odds(common, pairs.shift, pairs.shift_covariance(common))
    fits = d2 < LIKELIHOOD.gate_chi2(2)
    possible = odds > np.where(fits, least, 0.0)
    pairs, fits = take(pairs, possible), fits[possible]
    cov = pairs.shift_covariance(common)
    ground = driven_ground(state.places, state.xy, pairs.a, pairs.b, common.reach_m)
    odds, _ = position_odds(common, pairs.shift, cov, ground)
    odds = among_neighbours(common, odds, pairs.shift, cov)
    around = _surroundings(state, pairs)
    penalty = np.maximum(around.odds - calibrated_odds(around.odds, null_pairs), 0.0)
    found = Candidates(pairs.a, pairs.b, odds, around, penalty, ground, fits)
    # Without a rotation within reach that aligns their branches, two places are different.
    return take(found, (odds > least) & (around.branches > -np.inf))


def _possible_pairs(state: MapState, place: IntArray, estimate: Estimate) -> _Pairs:
    """Pairs of places within reach, in one piece of odometry, with bounds of covariances.

    Pairs excluded by dead reckoning alone stay excluded: closures only reduce the uncertainty.
    """
    reckoning, places = state.reckoning, state.places
    reach_m = HOPS * state.common.leg_m
    a, b = pairs_within(estimate.xy, reach_m, CANDIDATES.most_tabled).T
    i, j = _nearest_in_time(places, place, a, b)
    same = reckoning.piece[i] == reckoning.piece[j]
    a, b = a[same], b[same]
    i, j = i[same], j[same]
    turn = 0.5 * (estimate.pose[i, 2] + estimate.pose[j, 2])
    cov = _rotated(relative_covariance(reckoning, i, j), turn)
    return _Pairs(a, b, estimate.xy[a] - estimate.xy[b], cov)


def _null_pairs(state: MapState, pairs: _Pairs) -> FloatArray:
    """(m,) log odds [nats] of the surroundings of null pairs, ascending. A null pair is one that
    position excludes.

    Different places look more alike in rows of equal corridors than with independent lengths. These
    odds show how much so in this run (`calibrated_odds`). At most `most_null_pairs` are sampled.
    """
    _, d2 = position_odds(state.common, pairs.shift, pairs.shift_covariance(state.common))
    apart = np.hypot(*pairs.shift.T) > state.common.core_m
    rows = np.flatnonzero((d2 > LIKELIHOOD.gate_chi2(2)) & apart)
    rows = rows[:: -(-len(rows) // CANDIDATES.most_null_pairs) or 1]
    return np.sort(_surroundings(state, take(pairs, rows)).odds)


def calibrated_odds(around: FloatArray, null_pairs: FloatArray) -> FloatArray:
    """(k,) log odds [nats] of the surroundings, calibrated on null pairs.

    around: (k,) log odds by the model; null_pairs: (m,) those of pairs of different places,
    ascending. Odds that a share q of null pairs reaches become -ln q; beyond all null pairs they
    grow as in the model.
    """
    if len(null_pairs) == 0:
        return around
    at_least = len(null_pairs) - np.searchsorted(null_pairs, around)
    beyond = np.maximum(around - null_pairs[-1], 0.0)
    return np.asarray(np.log1p(len(null_pairs)) - np.log1p(at_least) + beyond)


def pairs_within(xy: FloatArray, reach_m: float, most: int) -> IntArray:
    """(k, 2) pairs a < b of points within `reach_m`, or less if more than `most`; sorted."""
    tree = cKDTree(xy)
    while (count := int(tree.count_neighbors(tree, reach_m))) > 2 * most + len(xy):
        # The number of pairs (here both directions) grows with the square of the reach.
        reach_m *= float(np.sqrt(most / count))
    pairs = tree.query_pairs(reach_m, output_type="ndarray").astype(np.int64)
    return np.asarray(pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))])


def _nearest_pairs(pairs: _Pairs, most: int) -> _Pairs:
    """The `most` pairs with the smallest shifts; the others are left to later rounds."""
    if len(pairs) <= most:
        return pairs
    near = np.argsort((pairs.shift**2).sum(axis=1), kind="stable")[:most]
    return take(pairs, np.sort(near))


def _surroundings(state: MapState, pairs: _Pairs) -> Surroundings:
    a, b = pairs.a, pairs.b
    turn_sigma = np.sqrt(np.maximum(pairs.cov[:, 2, 2], 0.0))
    aligned = align(state.branches, a, b, turn_sigma=turn_sigma)
    # Adjacent legs are not independent: each hop counts `lead` at most.
    gain, loss = (np.minimum(x, HOPS * EVIDENCE.lead) for x in grow(state, a, b, aligned))
    return Surroundings(aligned.odds, gain, loss, aligned.turn)


def _nearest_in_time(
    places: Places, place: IntArray, a: IntArray, b: IntArray
) -> tuple[IntArray, IntArray]:
    """A pass of each of two places, close in time: the first of the later place, and the last
    before it."""
    earlier, later = np.where(places.first[a] < places.first[b], [a, b], [b, a])
    count = len(place)
    pass_of_place = np.sort(place * count + np.arange(count))
    j = places.first[later]
    i = pass_of_place[np.searchsorted(pass_of_place, earlier * count + j) - 1] % count
    return i, j


def _exact_covariance(estimate: Estimate, a: IntArray, b: IntArray) -> FloatArray:
    """(k, 3, 3) of place b relative to place a, in map axes, from the solved graph."""
    if len(a) == 0:
        return np.zeros((0, 3, 3))
    na, nb = estimate.node[a], estimate.node[b]
    cov = estimate.relative_covariance(na, nb)
    return _rotated(cov, estimate.solution.pose[na, 2])


def _rotated(cov: FloatArray, turn: FloatArray) -> FloatArray:
    """Covariances (k, 3, 3) of x, y and heading in axes rotated by `turn` (k,) [rad]."""
    R = turned_axes(turn)
    return np.asarray(R @ cov @ R.transpose(0, 2, 1))
