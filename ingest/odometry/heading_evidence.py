"""Evidence on the odometry's heading error, before any place is recognised.

The odometry's heading θ is wrong by β·s + κ·θ + δ·ω (distance driven, angle turned, turning rate: a
bias per metre, a scale of turns, a time lag). Two kinds of evidence need no place recognition:

* *pass*: while the robot passes a junction and turns, a branch keeps its direction;
* *grid*: the branches of neighbouring junctions are mostly parallel or perpendicular, were it only
  because most corridors between them are straight.

Both are rows y + a·x ≈ 0 with x = (β, κ, δ) and a = (s, θ, ω) or a difference of two such.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...topology.arrays import BoolArray, FloatArray, IntArray
from ...topology.odometry import Odometry
from ...topology.passes import ONE_WAY_RAD, Passes
from ...topology.ragged import numbered
from ...topology.run import Detections
from ...topology.se2 import wrap
from ...topology.track import stretch_of

TERMS = 3
"""Unknowns: bias per metre, scale of turns, lag."""


@dataclass(frozen=True, slots=True)
class EvidenceSettings:
    """Which detections are compared."""

    interpolated_rad: float = 0.03
    """Readings at more than this angle from the nearest row of the odometry are ignored."""
    rate_window_s: float = 0.25
    """Half the time over which the turning rate is measured."""
    grid_reach: int = 3
    """Branches are compared with those of so many passes before."""
    grid_reach_m: float = 40.0
    """They are not compared with passes farther back than this along the track."""


EVIDENCE = EvidenceSettings()

PARTS = 6
"""Parts of a pass whose means are compared: by fewer, a junction that jumps as it is passed cannot
be told from one that moves along. Passes with fewer messages do not show how the robot moved."""


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """Rows y + a·x ≈ 0: y (r,) [rad], a (r, 3); owner: (r,) groups alternatives for one quantity.

    share: (r,) weights that sum to 1 within an owner; visit: (r,) pass of the row: rows of one
    visit share its errors.
    """

    y: FloatArray
    a: FloatArray
    owner: IntArray
    share: FloatArray
    visit: IntArray

    @property
    def owners(self) -> int:
        """Number of groups."""
        return int(self.owner[-1]) + 1 if len(self.owner) else 0

    @property
    def visits(self) -> int:
        """One more than the last visit."""
        return int(self.visit.max(initial=-1)) + 1


@dataclass(frozen=True, slots=True, eq=False)
class HeadingEvidence:
    """Both kinds of evidence of one run."""

    passes: Rows
    grid: Rows


@dataclass(frozen=True, slots=True, eq=False)
class _Observed:
    """Every branch of every pass: mean heading (b,) [rad], mean regressors (b, 3), pass (b,), and
    whether it has readings (b,)."""

    heading: FloatArray
    regressor: FloatArray
    owner: IntArray
    seen: BoolArray


def heading_evidence(
    odometry: Odometry, nominal: Odometry, detections: Detections, passes: Passes
) -> HeadingEvidence:
    """The evidence from the detections of a run.

    odometry: the track as corrected so far, in which headings are compared and `passes` are given;
    nominal: the same rows and times uncorrected, for the regressors. O(readings + branches ·
    grid_reach).
    """
    reading = assign_readings(odometry, detections, passes, EVIDENCE.interpolated_rad)
    time_ns = detections.time_ns[detections.branches.owner[reading.row]]
    regressor = _regressors(nominal, time_ns)
    count = len(passes.branches.values)
    n = np.bincount(reading.branch, minlength=count)
    off = wrap(reading.heading - passes.branches.values[reading.branch])
    mean_off = _mean(reading.branch, off, n)
    mean_regressor = np.column_stack(
        [_mean(reading.branch, regressor[:, k], n) for k in range(TERMS)]
    )
    observed = _Observed(
        np.asarray(wrap(passes.branches.values + mean_off)),
        mean_regressor,
        passes.branches.owner,
        n > 0,
    )
    within = _within(
        observed,
        reading.branch,
        off - mean_off[reading.branch],
        regressor - mean_regressor[reading.branch],
    )
    stretch = stretch_of(odometry, passes.time_ns)
    return HeadingEvidence(within, _grid(observed, stretch))


def _within(observed: _Observed, branch: IntArray, y: FloatArray, a: FloatArray) -> Rows:
    """Rows of kind *pass*: y and a averaged over `PARTS` equal parts of each branch's readings.

    branch: (m,) of each reading; y, a: heading and regressors minus their means over the branch.
    """
    order = np.argsort(branch, kind="stable")
    n = np.bincount(branch, minlength=len(observed.heading))
    owner, nth = numbered(n)
    part = nth * PARTS // np.maximum(n[owner], PARTS)
    group = np.cumsum(np.diff(owner * PARTS + part, prepend=-1) != 0) - 1
    size = np.bincount(group)
    mean = [_mean(group, column[order], size) for column in (y, *a.T)]
    owner = owner[np.flatnonzero(np.diff(group, prepend=-1))]
    return Rows(mean[0], np.column_stack(mean[1:]), owner, size / n[owner], observed.owner[owner])


def _regressors(odometry: Odometry, time_ns: IntArray) -> FloatArray:
    """(m, 3) distance driven [m], angle turned [rad] and turning rate [rad/s] at times (m,)."""
    origin = odometry.time_ns[0]
    t = (odometry.time_ns - origin) * 1e-9
    q = (np.asarray(time_ns, np.int64) - origin) * 1e-9
    way, turned = np.cumsum(odometry.step_m), np.cumsum(odometry.turn_rad)
    before, after = (
        np.maximum(q - EVIDENCE.rate_window_s, t[0]),
        np.minimum(q + EVIDENCE.rate_window_s, t[-1]),
    )
    rise = np.interp(after, t, turned) - np.interp(before, t, turned)
    rate = rise / np.maximum(after - before, 1e-3)
    return np.column_stack([np.interp(q, t, way), np.interp(q, t, turned), rate])


@dataclass(frozen=True, slots=True, eq=False)
class Readings:
    """Branch readings assigned to a fused branch: row (into the flat readings), branch (flat
    index), heading [rad, odometry frame]."""

    row: IntArray
    branch: IntArray
    heading: FloatArray


def assign_readings(
    odometry: Odometry, detections: Detections, passes: Passes, interpolated_rad: float = np.inf
) -> Readings:
    """The nearest fused branch (flat index) of every reading, where it is within `ONE_WAY_RAD`.

    Readings whose heading would be interpolated over more than `interpolated_rad` are left out.
    Vectorised: each reading is paired with every branch of its pass, and the nearest pair kept.
    """
    message = detections.branches.owner
    time_ns = detections.time_ns[message]
    heading = detections.branches.values + odometry.at(time_ns)[:, 2]
    home = pass_at(passes, time_ns)
    inside = home >= 0
    if np.isfinite(interpolated_rad):
        inside &= _interpolated(odometry, time_ns) <= interpolated_rad
    rows = np.flatnonzero(inside)
    counts = passes.branches.counts[home[rows]]
    rows, counts = rows[counts > 0], counts[counts > 0]
    if len(rows) == 0:
        none = np.zeros(0, np.int64)
        return Readings(none, none, np.zeros(0))
    of, local = numbered(counts)
    candidate = passes.branches.offsets[home[rows]][of] + local
    off = np.abs(wrap(heading[rows[of]] - passes.branches.values[candidate]))
    # Index of the minimum of each contiguous block; backwards, so that the first of equals stays.
    hit = np.flatnonzero(off == np.minimum.reduceat(off, np.flatnonzero(local == 0))[of])[::-1]
    nearest = np.empty(len(rows), np.int64)
    nearest[of[hit]] = hit
    near = off[nearest] <= ONE_WAY_RAD
    return Readings(rows[near], candidate[nearest[near]], heading[rows[near]])


def pass_at(passes: Passes, time_ns: IntArray) -> IntArray:
    """(k,) pass that the robot made at each time, -1 for none."""
    home = np.searchsorted(passes.start_ns, time_ns, side="right") - 1
    inside = (home >= 0) & (time_ns <= passes.end_ns[np.maximum(home, 0)])
    return np.where(inside, home, -1)


def _interpolated(odometry: Odometry, time_ns: IntArray) -> FloatArray:
    """(m,) angle turned [rad] between each time and the nearer one of the rows around it.

    Motion between two rows is unknown: a turn within one second is not uniform. Taken for uniform,
    it would look like a wrong scale of turns.
    """
    after = np.clip(np.searchsorted(odometry.time_ns, time_ns), 1, len(odometry) - 1)
    t0, t1 = odometry.time_ns[after - 1], odometry.time_ns[after]
    share = np.clip((time_ns - t0) / np.maximum(t1 - t0, 1), 0.0, 1.0)
    return np.asarray(np.minimum(share, 1 - share) * np.abs(odometry.turn_rad[after]))


def _mean(group: IntArray, values: FloatArray, n: IntArray) -> FloatArray:
    """(g,) mean of `values` by group, 0 for empty ones; n: (g,) size of each group."""
    return np.asarray(np.bincount(group, values, len(n)) / np.maximum(n, 1))


def _grid(observed: _Observed, stretch: IntArray) -> Rows:
    """Every branch paired with those of a few passes before: alternatives that may be
    perpendicular."""
    first = np.searchsorted(observed.owner, np.arange(len(stretch) + 1))
    begin = first[np.maximum(observed.owner - EVIDENCE.grid_reach, 0)]
    here, nth = numbered(first[observed.owner] - begin)
    there = begin[here] + nth
    a = observed.regressor[here] - observed.regressor[there]
    keep = (
        observed.seen[here]
        & observed.seen[there]
        & (stretch[observed.owner[here]] == stretch[observed.owner[there]])
        & (np.abs(a[:, 0]) <= EVIDENCE.grid_reach_m)
    )
    here, there, a = here[keep], there[keep], a[keep]
    owner = np.cumsum(np.diff(here, prepend=here[:1]) != 0)
    size = np.bincount(owner) if len(owner) else np.zeros(0, np.int64)
    y = np.asarray(wrap(observed.heading[here] - observed.heading[there]))
    return Rows(y, a, owner, 1.0 / size[owner], observed.owner[here])
