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
    frame to the map frame [rad]. All places at once: one clustering
    of all readings, then tables by fancy indexing.
    """
    branches = reckoning.passes.branches
    owner = branches.owner
    passes = reckoning.passes
    rows = np.arange(len(reckoning))
    # Branches that the track shows and the detector did not report.
    came = np.flatnonzero((passes.entry == NO_BRANCH) & np.isfinite(reckoning.arriving))
    went = np.flatnonzero((passes.exit == NO_BRANCH) & np.isfinite(reckoning.leaving))
    by = np.concatenate([owner, came, went])
    angle = (
        np.concatenate([branches.values, reckoning.arriving[came], reckoning.leaving[went]])
        + turn[by]
    )
    reported = np.arange(len(by)) < len(owner)
    home = place[by]
    inside = home >= 0
    clusters = cluster_angles(angle[inside], home[inside], ONE_WAY_RAD)
    n = int(place.max(initial=-1)) + 1
    start = np.searchsorted(clusters.owner, np.arange(n + 1))
    width = int(np.diff(start).max(initial=1))
    slot = np.full(len(by), NO_BRANCH, np.int64)
    slot[inside] = clusters.of - start[home[inside]]
    heading, share = np.full((n, width), np.nan), np.zeros((n, width))
    local = np.arange(len(clusters)) - start[clusters.owner]
    heading[clusters.owner, local] = clusters.mean
    visits = np.bincount(place[place >= 0], minlength=n)
    share[clusters.owner, local] = clusters.votes(by[inside], reported[inside])
    share /= np.maximum(visits, 1)[:, None]
    entry, exit_ = np.full(len(reckoning), NO_BRANCH), np.full(len(reckoning), NO_BRANCH)
    for ends, local_branch, extra in ((entry, passes.entry, 0), (exit_, passes.exit, len(came))):
        has = np.flatnonzero(local_branch != NO_BRANCH)
        ends[has] = slot[branches.offsets[has] + local_branch[has]]
        missing = came if extra == 0 else went
        ends[missing] = slot[len(owner) + extra + np.arange(len(missing))]
    first = np.full(n, len(reckoning), np.int64)
    member = rows[place >= 0]
    np.minimum.at(first, place[member], member)
    ways = _ways(reckoning, place, entry, exit_, (n, width))
    sure = np.bincount(place[member], passes.confidence[member], n) / np.maximum(visits, 1)
    return Places(heading, share, visits, sure, first, *ways, entry)


def _ways(
    reckoning: DeadReckoning,
    place: IntArray,
    entry: IntArray,
    exit_: IntArray,
    shape: tuple[int, int],
) -> tuple[IntArray, IntArray, FloatArray, IntArray, IntArray]:
    """Where each slot leads: of several ends the one reached most often, then the nearest. Five (n,
    s) columns of `Places`, from next_place to tried."""
    n, width = shape
    legs = np.flatnonzero(np.isfinite(reckoning.leg))
    p, q = place[legs], place[legs + 1]
    a, b = exit_[legs], entry[legs + 1]
    fine = (p >= 0) & (q >= 0) & (a >= 0) & (b >= 0) & ~((p == q) & (a == b))
    p, q, a, b, leg = p[fine], q[fine], a[fine], b[fine], reckoning.leg[legs[fine]]
    here = np.concatenate([p * width + a, q * width + b])
    there = np.concatenate([q * width + b, p * width + a])
    far = np.concatenate([leg, leg])
    next_place, next_slot = np.full(n * width, NOWHERE), np.full(n * width, NOWHERE)
    length, driven = np.full(n * width, np.nan), np.zeros(n * width, np.int64)
    tried = np.bincount(here, minlength=n * width)
    if len(here):
        order = np.lexsort((far, there, here))
        here, there, far = here[order], there[order], far[order]
        new = np.concatenate([[True], (np.diff(here) != 0) | (np.diff(there) != 0)])
        group = np.cumsum(new) - 1
        count = np.bincount(group)
        mean = np.bincount(group, far) / count
        head, tail = here[new], there[new]
        best = np.lexsort((mean, -count, head))
        chosen = best[np.concatenate([[True], np.diff(head[best]) != 0])]
        at = head[chosen]
        next_place[at], next_slot[at] = tail[chosen] // width, tail[chosen] % width
        length[at], driven[at] = mean[chosen], count[chosen]
    return (
        next_place.reshape(shape),
        next_slot.reshape(shape),
        length.reshape(shape),
        driven.reshape(shape),
        tried.reshape(shape),
    )
