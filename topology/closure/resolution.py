"""Places nearer to each other than the detector's resolution.

A junction seen only in part, or a crossing that appears as two forks on one drive-by and as one
crossing on another, gives places with different branches, which closure does not identify. Scans
show junctions nearer to each other than their resolution as one. So places that are probably
nearer than that, and that no single drive-by reported as two, are joined; the one seen best
provides the branches.
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
"""By how many standard deviations the distance of two places is below the resolution where they are
joined: distinct ones a little farther apart and never seen side by side are rare. In simulated runs
through two real offices 30 places stand twice with 3, 17 with 2, 12 with 1; no join is wrong."""

REASON = "nearer than scans can tell two junctions apart"


@dataclass(frozen=True, slots=True, eq=False)
class Blurred:
    """Places after joining.

    place: (n,) the place that each one became part of, mostly itself; xy: (n, 2) [m] weighted mean
    position of the joined places; identifications: the identifications made.
    """

    place: IntArray
    xy: FloatArray
    identifications: list[Identification] = field(default_factory=list)


def blurred(
    reckoning: DeadReckoning, place: IntArray, estimate: Estimate, resolution_m: float
) -> Blurred:
    """The places of an estimate, those below the resolution joined. place: (p,) of each pass, none
    negative.

    resolution_m: junctions nearer than this show as one [m]; 0 for detectors that separate all.
    """
    of = np.arange(len(estimate.xy), dtype=np.int64)
    if resolution_m <= 0 or len(of) < 2:
        return Blurred(of, estimate.xy)
    near = cKDTree(estimate.xy).query_pairs(resolution_m, output_type="ndarray").astype(np.int64)
    apart = _seen_apart(reckoning, place, resolution_m)
    open_ = [k for k, pair in enumerate(near.tolist()) if frozenset(pair) not in apart]
    a, b = near[open_].T
    if len(a) == 0:
        return Blurred(of, estimate.xy)
    # Of each pair the one seen better first, and the pairs of the best first; ties by number.
    windows = reckoning.passes.messages * reckoning.passes.confidence
    seen = np.asarray(np.bincount(place, windows, len(of)), np.float64)
    swap = seen[b] > seen[a]
    a, b = np.where(swap, b, a), np.where(swap, a, b)
    order = np.lexsort((b, a, -seen[b], -seen[a]))
    a, b = a[order], b[order]
    sigmas = _sigmas_within(reckoning, estimate, a, b, resolution_m)
    identifications = []
    for u, v, sure in zip(a.tolist(), b.tolist(), sigmas.tolist(), strict=True):
        if sure > SURE_SIGMAS and of[u] == u and of[v] == v:
            of[v] = u
            identifications.append(_identified(reckoning, place, (u, v), sure))
    # Two places that one drive-by showed side by side may be the two forks of one crossing.
    for u, v, sure in zip(a.tolist(), b.tolist(), sigmas.tolist(), strict=True):
        parts = np.flatnonzero(of == u).tolist()
        if of[u] == u and of[v] == v and any({v, part} in apart for part in parts if part != u):
            of[v] = u
            identifications.append(_identified(reckoning, place, (u, v), sure))
    return Blurred(of, _amid(estimate.xy, of, seen), identifications)


def _amid(xy: FloatArray, of: IntArray, seen: FloatArray) -> FloatArray:
    """(n, 2) weighted mean positions of joined places; weights `seen` (n,)."""
    out, alone = xy.copy(), np.bincount(of, minlength=len(of)) < 2
    total = np.bincount(of, seen, len(of))
    mean = [np.bincount(of, seen * column, len(of)) / np.maximum(total, 1e-9) for column in xy.T]
    out[~alone] = np.column_stack(mean)[~alone]
    return out


def _seen_apart(
    reckoning: DeadReckoning, place: IntArray, resolution_m: float
) -> set[frozenset[int]]:
    """Pairs of places that one drive-by showed both of."""
    both = np.stack([place[:-1], place[1:]], axis=1)[one_drive_by(reckoning, resolution_m)]
    return {frozenset(pair) for pair in both.tolist()}


def _sigmas_within(
    reckoning: DeadReckoning, estimate: Estimate, a: IntArray, b: IntArray, resolution_m: float
) -> FloatArray:
    """(k,) by how many standard deviations the distance of places is below the resolution."""
    cov = estimate.relative_covariance(estimate.node[a], estimate.node[b])[:, :2, :2]
    variance = np.linalg.eigvalsh(cov)[:, 1] + 2 * reckoning.noise.centre_m**2
    distance = np.hypot(*(estimate.xy[a] - estimate.xy[b]).T)
    return np.asarray((resolution_m - distance) / np.sqrt(variance))


def _identified(
    reckoning: DeadReckoning, place: IntArray, pair: tuple[int, int], sigmas: float
) -> Identification:
    """The identification of two places, with the evidence of the more likely alternative: that they
    are not so near, or that each pass by the one missed the other."""
    first = [int(np.flatnonzero(place == v)[0]) for v in pair]
    missed = int(np.isin(place, pair).sum()) * float(np.log(reckoning.noise.miss_rate))
    bits = -max(float(log_ndtr(-sigmas)), missed) / BIT
    return Identification(min(first), max(first), True, bits, REASON)


def one_drive_by(reckoning: DeadReckoning, resolution_m: float) -> BoolArray:
    """(p - 1,) whether a pass and the next belong to one drive-by: the leg between them is no
    longer than twice the resolution."""
    way: BoolArray = reckoning.leg < 2 * resolution_m
    return way
