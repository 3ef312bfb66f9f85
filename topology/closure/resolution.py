"""Places nearer to each other than the detector's resolution.

A junction seen only in part, or a crossing that appears as two forks on one drive-by and as one
crossing on another, gives places with different branches, which closure does not identify. Scans
show junctions nearer to each other than their resolution as one. Places that are probably nearer,
and that no drive-by reported as two, are joined; the one seen best keeps its branches.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial import cKDTree
from scipy.special import log_ndtr

from ..arrays import BoolArray, FloatArray, IntArray
from ..matching.likelihood import BIT
from .answers import Identification
from .dead_reckoning import DeadReckoning
from .estimate import Estimate

SURE_SIGMAS = 1.0
"""Standard deviations by which the distance of two places must be below the resolution for joining.
Distinct ones that are a little farther apart and never reported together are rare. In simulated
runs through two real offices 30 places are double with 3, 17 with 2, 12 with 1; no join is
wrong."""

REASON = "nearer than scans can tell two junctions apart"


@dataclass(frozen=True, slots=True, eq=False)
class JoinedPlaces:
    """Places after joining.

    place: (n,) the place that each one was joined to, mostly itself; xy: (n, 2) [m] weighted mean
    position of the joined places; identifications: made by joining.
    """

    place: IntArray
    xy: FloatArray
    identifications: list[Identification] = field(default_factory=list)


def join_below_resolution(
    reckoning: DeadReckoning, place: IntArray, estimate: Estimate, resolution_m: float
) -> JoinedPlaces:
    """The places of an estimate, with those below the resolution joined.

    place: (p,) of each pass, none negative; resolution_m: least distance of junctions that show as
    two [m]; 0 for detectors that separate all.
    """
    target = np.arange(len(estimate.xy), dtype=np.int64)
    if resolution_m <= 0 or len(target) < 2:
        return JoinedPlaces(target, estimate.xy)
    close = cKDTree(estimate.xy).query_pairs(resolution_m, output_type="ndarray").astype(np.int64)
    apart = _reported_apart(reckoning, place, resolution_m)
    allowed = [k for k, pair in enumerate(close.tolist()) if frozenset(pair) not in apart]
    a, b = close[allowed].T
    if len(a) == 0:
        return JoinedPlaces(target, estimate.xy)
    # Of each pair the one seen better first, and the pairs of the best first; ties by number.
    weight_of_pass = reckoning.passes.messages * reckoning.passes.confidence
    weight = np.asarray(np.bincount(place, weight_of_pass, len(target)), np.float64)
    swap = weight[b] > weight[a]
    a, b = np.where(swap, b, a), np.where(swap, a, b)
    order = np.lexsort((b, a, -weight[b], -weight[a]))
    a, b = a[order], b[order]
    sigmas = _sigmas_within(reckoning, estimate, a, b, resolution_m)

    def is_sure(u: int, v: int, sigmas_below: float) -> bool:
        return sigmas_below > SURE_SIGMAS

    def are_forks(u: int, v: int, sigmas_below: float) -> bool:
        """Whether v and a part of u, which one drive-by reported, are two forks of one crossing."""
        return any(frozenset((v, part)) in apart for part in np.flatnonzero(target == u).tolist())

    pairs = list(zip(a.tolist(), b.tolist(), sigmas.tolist(), strict=True))
    identifications = []
    for rule in (is_sure, are_forks):
        for u, v, sigmas_below in pairs:
            if target[u] == u and target[v] == v and rule(u, v, sigmas_below):
                target[v] = u
                identifications.append(_identified(reckoning, place, (u, v), sigmas_below))
    return JoinedPlaces(target, _mean_positions(estimate.xy, target, weight), identifications)


def _mean_positions(xy: FloatArray, target: IntArray, weight: FloatArray) -> FloatArray:
    """(n, 2) weighted mean positions of joined places (those with the same `target`)."""
    total = np.bincount(target, weight, len(target))
    mean = [np.bincount(target, weight * x, len(target)) / np.maximum(total, 1e-9) for x in xy.T]
    is_joined = np.bincount(target, minlength=len(target)) > 1
    return np.where(is_joined[:, None], np.column_stack(mean), xy)


def _reported_apart(
    reckoning: DeadReckoning, place: IntArray, resolution_m: float
) -> set[frozenset[int]]:
    """Pairs of places that one drive-by reported."""
    both = np.stack([place[:-1], place[1:]], axis=1)[one_drive_by(reckoning, resolution_m)]
    return {frozenset(pair) for pair in both.tolist()}


def _sigmas_within(
    reckoning: DeadReckoning, estimate: Estimate, a: IntArray, b: IntArray, resolution_m: float
) -> FloatArray:
    """(k,) resolution minus distance of places a and b, in standard deviations."""
    cov = estimate.relative_covariance(estimate.node[a], estimate.node[b])[:, :2, :2]
    variance = np.linalg.eigvalsh(cov)[:, 1] + 2 * reckoning.noise.centre_m**2
    distance = np.hypot(*(estimate.xy[a] - estimate.xy[b]).T)
    return np.asarray((resolution_m - distance) / np.sqrt(variance))


def _identified(
    reckoning: DeadReckoning, place: IntArray, pair: tuple[int, int], sigmas: float
) -> Identification:
    """The identification of two places. Its evidence is against the more likely alternative: they
    are farther apart, or each pass by the one missed the other."""
    first = [int(np.flatnonzero(place == v)[0]) for v in pair]
    missed = int(np.isin(place, pair).sum()) * float(np.log(reckoning.noise.miss_rate))
    bits = -max(float(log_ndtr(-sigmas)), missed) / BIT
    return Identification(min(first), max(first), True, bits, REASON)


def one_drive_by(reckoning: DeadReckoning, resolution_m: float) -> BoolArray:
    """(p - 1,) whether a pass and the next belong to one drive-by: the leg between them is no
    longer than twice the resolution."""
    return np.asarray(reckoning.leg < 2 * resolution_m)
