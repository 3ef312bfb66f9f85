"""Tables of places: branches, visits and corridors, given which passes were by one place."""

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
"""Hops over corridors that are the surroundings of a place. Hypotheses grow over so many. Pairs of
places that are compared, and neighbours (`lattice.py`), are at most so many typical legs apart."""


@dataclass(frozen=True, slots=True, eq=False)
class Places:
    """`n` places with up to `s` branches ("slots") each; empty slots hold NaN.

    heading: (n, s) [rad] in the map frame; share: (n, s) share of the place's passes that reported
    the branch, 0 for one known from the track alone; visits: (n,) number of passes; confidence:
    (n,) mean over its passes; first: (n,) its first pass. next_place, next_slot: (n, s) other end
    of the corridor of the slot, NOWHERE if it was not driven; length: (n, s) of that leg [m];
    driven: (n, s) number of legs to this end; tried: (n, s) number of legs to any end.
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
    no_entry = np.flatnonzero((passes.entry == NO_BRANCH) & np.isfinite(reckoning.arriving))
    no_exit = np.flatnonzero((passes.exit == NO_BRANCH) & np.isfinite(reckoning.leaving))
    owner = np.concatenate([branches.owner, no_entry, no_exit])
    headings = branches.values, reckoning.arriving[no_entry], reckoning.leaving[no_exit]
    angle = np.concatenate(headings) + turn[owner]
    reported = np.arange(len(owner)) < len(branches.owner)
    place_of_branch = place[owner]
    inside = place_of_branch >= 0
    clusters = cluster_angles(angle[inside], place_of_branch[inside], ONE_WAY_RAD)
    n = int(place.max(initial=-1)) + 1
    start = np.searchsorted(clusters.owner, np.arange(n + 1))
    width = int(np.diff(start).max(initial=1))
    slot = np.full(len(owner), NO_BRANCH, np.int64)
    slot[inside] = clusters.of - start[place_of_branch[inside]]
    cells = clusters.owner, np.arange(len(clusters)) - start[clusters.owner]
    placed = np.flatnonzero(place >= 0)
    visits = np.bincount(place[placed], minlength=n)
    heading, share = np.full((n, width), np.nan), np.zeros((n, width))
    heading[cells] = clusters.mean
    share[cells] = clusters.votes(owner[inside], reported[inside])
    share /= np.maximum(visits, 1)[:, None]
    confidence = np.bincount(place[placed], passes.confidence[placed], n) / np.maximum(visits, 1)
    first = np.full(n, len(reckoning), np.int64)
    np.minimum.at(first, place[placed], placed)
    entry, exit_ = np.full((2, len(reckoning)), NO_BRANCH)
    for ends, local in ((entry, passes.entry), (exit_, passes.exit)):
        known = np.flatnonzero(local != NO_BRANCH)
        ends[known] = slot[branches.offsets[known] + local[known]]
    entry[no_entry], exit_[no_exit] = np.split(slot[len(branches.owner) :], [len(no_entry)])
    ways = _ways(reckoning, place, entry, exit_, (n, width))
    return Places(heading, share, visits, confidence, first, *ways)


def _ways(
    reckoning: DeadReckoning,
    place: IntArray,
    entry: IntArray,
    exit_: IntArray,
    shape: tuple[int, int],
) -> tuple[IntArray, IntArray, FloatArray, IntArray, IntArray]:
    """Five (n, s) columns of `Places`, from next_place to tried. Of several ends of a slot the one
    reached most often counts, then the nearest."""
    size, width = shape[0] * shape[1], shape[1]
    legs = np.flatnonzero(np.isfinite(reckoning.leg))
    p, q = place[legs], place[legs + 1]
    a, b = exit_[legs], entry[legs + 1]
    usable = (p >= 0) & (q >= 0) & (a >= 0) & (b >= 0) & ~((p == q) & (a == b))
    p, q, a, b, leg = p[usable], q[usable], a[usable], b[usable], reckoning.leg[legs[usable]]
    from_slot = np.concatenate([p * width + a, q * width + b])
    to_slot = np.concatenate([q * width + b, p * width + a])
    length_m = np.concatenate([leg, leg])
    order = np.argsort(length_m, kind="stable")
    pairs = from_slot[order] * size + to_slot[order]
    pair, group, count = np.unique(pairs, return_inverse=True, return_counts=True)
    head, tail = np.divmod(pair, size)
    mean = np.bincount(group, length_m[order]) / count
    best = np.lexsort((mean, -count, head))
    chosen = best[np.diff(head[best], prepend=-1) > 0]
    slots = head[chosen]
    next_place, next_slot = np.full((2, size), NOWHERE)
    length, driven = np.full(size, np.nan), np.zeros(size, np.int64)
    next_place[slots], next_slot[slots] = np.divmod(tail[chosen], width)
    length[slots], driven[slots] = mean[chosen], count[chosen]
    tried = np.bincount(from_slot, minlength=size)
    return (
        next_place.reshape(shape),
        next_slot.reshape(shape),
        length.reshape(shape),
        driven.reshape(shape),
        tried.reshape(shape),
    )
