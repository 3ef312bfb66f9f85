"""Tables of all known about each place, given which passes were by the same place."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray, IntArray
from ..circular import cluster_angles
from ..passes import NO_BRANCH, ONE_WAY_RAD
from .dead_reckoning import DeadReckoning

NOWHERE = NO_BRANCH
"""Index of an unknown place."""

HOPS = 4
"""Corridors around a place that are its surroundings: hypotheses grow over so many, and the pairs
of places compared, and the neighbours of a place (`lattice.py`), are no more typical legs apart."""


@dataclass(frozen=True, slots=True, eq=False)
class Places:
    """`n` places with up to `s` branches ("slots") each; empty slots hold NaN.

    heading: (n, s) [rad] in the map frame; share: (n, s) share of the place's passes that reported
    the branch, 0 for one known from the track alone; visits: (n,) number of passes; confidence:
    (n,) mean over its passes; first: (n,) its first pass. next_place, next_slot: (n, s) where the
    corridor of the slot leads, NOWHERE if it was not driven; length: (n, s) of that leg [m];
    driven: (n, s) times driven there; tried: (n, s) times driven, wherever it led. entry: (p,) slot
    by which each pass arrived.
    """

    heading: FloatArray
    share: FloatArray
    visits: IntArray
    confidence: FloatArray
    first: IntArray
    next_place: IntArray
    next_slot: IntArray
    length: FloatArray
    driven: IntArray
    tried: IntArray
    entry: IntArray

    def __len__(self) -> int:
        return len(self.visits)


def tabulate(reckoning: DeadReckoning, place: IntArray, turn: FloatArray) -> Places:
    """The places of a partition of the passes.

    place: (p,) numbered from 0, every number in use; negative: none. turn: (p,) from the odometry
    frame to the map frame [rad]. All places at once: one clustering of all readings, then tables by
    fancy indexing.
    """
    passes, branches = reckoning.passes, reckoning.passes.branches
    # Branches that the track shows and the detector did not report.
    came = np.flatnonzero((passes.entry == NO_BRANCH) & np.isfinite(reckoning.arriving))
    went = np.flatnonzero((passes.exit == NO_BRANCH) & np.isfinite(reckoning.leaving))
    by = np.concatenate([branches.owner, came, went])
    headings = branches.values, reckoning.arriving[came], reckoning.leaving[went]
    angle = np.concatenate(headings) + turn[by]
    reported = np.arange(len(by)) < len(branches.owner)
    home = place[by]
    inside = home >= 0
    clusters = cluster_angles(angle[inside], home[inside], ONE_WAY_RAD)
    n = int(place.max(initial=-1)) + 1
    start = np.searchsorted(clusters.owner, np.arange(n + 1))
    width = int(np.diff(start).max(initial=1))
    slot = np.full(len(by), NO_BRANCH, np.int64)
    slot[inside] = clusters.of - start[home[inside]]
    at = clusters.owner, np.arange(len(clusters)) - start[clusters.owner]
    member = np.flatnonzero(place >= 0)
    visits = np.bincount(place[member], minlength=n)
    heading, share = np.full((n, width), np.nan), np.zeros((n, width))
    heading[at] = clusters.mean
    share[at] = clusters.votes(by[inside], reported[inside])
    share /= np.maximum(visits, 1)[:, None]
    confidence = np.bincount(place[member], passes.confidence[member], n) / np.maximum(visits, 1)
    first = np.full(n, len(reckoning), np.int64)
    np.minimum.at(first, place[member], member)
    entry, exit_ = np.full((2, len(reckoning)), NO_BRANCH)
    for ends, local in ((entry, passes.entry), (exit_, passes.exit)):
        known = np.flatnonzero(local != NO_BRANCH)
        ends[known] = slot[branches.offsets[known] + local[known]]
    entry[came], exit_[went] = np.split(slot[len(branches.owner) :], [len(came)])
    ways = _ways(reckoning, place, entry, exit_, (n, width))
    return Places(heading, share, visits, confidence, first, *ways, entry)


def _ways(
    reckoning: DeadReckoning,
    place: IntArray,
    entry: IntArray,
    exit_: IntArray,
    shape: tuple[int, int],
) -> tuple[IntArray, IntArray, FloatArray, IntArray, IntArray]:
    """Where each slot leads: of several ends the one reached most often, then the nearest. Five (n,
    s) columns of `Places`, from next_place to tried."""
    size, width = shape[0] * shape[1], shape[1]
    legs = np.flatnonzero(np.isfinite(reckoning.leg))
    p, q = place[legs], place[legs + 1]
    a, b = exit_[legs], entry[legs + 1]
    fine = (p >= 0) & (q >= 0) & (a >= 0) & (b >= 0) & ~((p == q) & (a == b))
    p, q, a, b, leg = p[fine], q[fine], a[fine], b[fine], reckoning.leg[legs[fine]]
    here = np.concatenate([p * width + a, q * width + b])
    there = np.concatenate([q * width + b, p * width + a])
    far = np.concatenate([leg, leg])
    order = np.argsort(far, kind="stable")
    pairs = here[order] * size + there[order]
    pair, group, count = np.unique(pairs, return_inverse=True, return_counts=True)
    head, tail = np.divmod(pair, size)
    mean = np.bincount(group, far[order]) / count
    best = np.lexsort((mean, -count, head))
    chosen = best[np.diff(head[best], prepend=-1) > 0]
    at = head[chosen]
    next_place, next_slot = np.full((2, size), NOWHERE)
    length, driven = np.full(size, np.nan), np.zeros(size, np.int64)
    next_place[at], next_slot[at] = np.divmod(tail[chosen], width)
    length[at], driven[at] = mean[chosen], count[chosen]
    tried = np.bincount(here, minlength=size)
    return (
        next_place.reshape(shape),
        next_slot.reshape(shape),
        length.reshape(shape),
        driven.reshape(shape),
        tried.reshape(shape),
    )
