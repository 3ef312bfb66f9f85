"""Correction of the odometry by scan matching, in sliding windows."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, fields, replace
from math import cos, sin
from typing import NamedTuple

import numpy as np

from ...topology.arrays import BoolArray, FloatArray, IntArray
from ...topology.columns import take
from ...topology.odometry import Odometry
from ...topology.se2 import between, compose, inverse, wrap
from ...topology.track import piece_of
from .alignment import ALIGNMENT, Steps, align, match_steps
from .association import Swept
from .keyframes import Keyframes, Posed, in_order, join, keyframes
from .scan import ScanBatch
from .scatter import STRETCH, Aligned
from .step_errors import LOOSE_M, SpanErrors, StepErrors, span_errors


@dataclass(frozen=True, slots=True)
class MatchingSettings:
    """Settings of the sliding windows."""

    window: int = 400
    """Keyframes solved for at once: much more than the widest pair, little memory."""
    lag: int = 60
    """Last keyframes of each laser in a window that are solved for again with the next one: the
    widest pair."""
    outside_s: float = 0.5
    """Largest time of a scan beyond the odometry's ends."""


MATCHING = MatchingSettings()


@dataclass(frozen=True, slots=True, eq=False)
class Placed(Keyframes):
    """Keyframes with poses.

    pose: (k, 3) of the laser in the corrected frame; fit: (k,) share of the points that fit the
    previous keyframe; searched: (k,) whether found by searching; loose_m: (k,) as in `PairMotion`,
    from the previous keyframe.
    """

    pose: FloatArray
    fit: FloatArray
    searched: BoolArray
    loose_m: FloatArray

    @property
    def body(self) -> FloatArray:
        """(k, 3) pose of the robot in the corrected frame."""
        return compose(self.pose, inverse(self.mount))


class Matched(NamedTuple):
    """Keyframes with final poses; spans: uncertainty of the poses; errors: the learned model of the
    odometry's errors."""

    keyframes: Placed
    spans: SpanErrors
    errors: StepErrors


def posed(odometry: Odometry, batches: Iterable[ScanBatch]) -> Iterator[Posed]:
    """The scans with the robot's pose, motion in the sweep, and turning rate, by the odometry."""
    at = odometry.interpolator()
    for batch in batches:
        if len(batch) == 0:
            continue
        half = np.int64(0.5e9 * batch.sweep_s)
        half_window = np.int64(1e8)
        t = batch.times_ns
        turned = wrap(at(t + half_window)[:, 2] - at(t - half_window)[:, 2])
        outside = np.int64(MATCHING.outside_s * 1e9)
        first, last = odometry.time_ns[[0, -1]] + np.array([-outside, outside])
        yield Posed(
            batch,
            at(t),
            between(at(t - half), at(t + half)),
            turned / (2e-9 * half_window),
            (t >= first) & (t <= last),
            piece_of(odometry, t),
        )


def matched(posed_scans: Iterable[Posed]) -> Iterator[Matched]:
    """The keyframes of a run with their corrected poses. Memory: one window.

    Every window begins with keyframes whose poses are final, and ends with some that are solved for
    again in the next one.
    """
    window: tuple[Placed, Aligned] | None = None
    final, errors = 0, StepErrors()
    for fresh in in_order(keyframes(posed_scans), MATCHING.window):
        frames, known = _unplaced(fresh), 0
        if window is not None:
            held, _ = window
            lag = MATCHING.lag * _lasers(held)
            upto = max(len(held) - lag, final)
            if upto > final:
                yield _finished(*window, slice(final, upto), errors)
            keep = max(upto - lag, 0)
            held, final = take(held, slice(keep, None)), upto - keep
            frames, known = join([held, frames]), len(held)
        frames, aligned, errors = _solve(frames, known, final, errors)
        window = frames, aligned
    if window is not None:
        yield _finished(*window, slice(final, len(window[0])), errors)


def _unplaced(frames: Keyframes) -> Placed:
    """Keyframes of which nothing is known yet."""
    n = len(frames)
    columns = {column.name: getattr(frames, column.name) for column in fields(frames)}
    return Placed(
        **columns,
        pose=np.zeros((n, 3)),
        fit=np.ones(n),
        searched=np.zeros(n, bool),
        loose_m=np.zeros(n),
    )


def _solve(
    held: Placed, known: int, final: int, errors: StepErrors
) -> tuple[Placed, Aligned, StepErrors]:
    """Solve for all keyframes held; the first `known` ones were solved before, `final` of them
    finally."""
    scans = Swept.of(held)
    n, least_fit = len(held), ALIGNMENT.lost_fit
    before = _before(held)
    fresh = np.flatnonzero((before >= 0) & (np.arange(n) >= known))
    pairs = fresh, before[fresh]
    found = match_steps(scans, pairs, errors.steps(held, *pairs))
    sure = found.fit > least_fit
    errors = errors.learned(held, pairs, (found.motion, sure, sure & (found.loose_m < LOOSE_M)))
    fit, searched, loose_m = held.fit.copy(), held.searched.copy(), held.loose_m.copy()
    fit[fresh], searched[fresh], loose_m[fresh] = found.fit, found.searched, found.loose_m
    consecutive = np.arange(1, n), np.arange(n - 1)
    raw = errors.steps(held, *consecutive)
    guess = _guess(held, known, (fresh, before, found.motion), raw)
    earlier = _earlier(before, ALIGNMENT.offsets)
    stretch = STRETCH * _lasers(held)
    aligned = align(scans, guess, raw, fixed=final, earlier=earlier, stretch=stretch)
    placed = replace(held, pose=aligned.pose, fit=fit, searched=searched, loose_m=loose_m)
    return placed, aligned, errors


def _lasers(held: Keyframes) -> int:
    """Number of lasers, whose keyframes come in turns."""
    return len(np.unique(held.laser))


def _before(held: Keyframes) -> IntArray:
    """(n,) the previous keyframe of the same laser in the same piece of odometry; else -1."""
    key = np.column_stack([held.laser, held.piece])
    kind = np.unique(key, axis=0, return_inverse=True)[1].ravel()
    order = np.argsort(kind, kind="stable")
    out = np.full(len(held), -1, np.int64)
    same = np.diff(kind[order]) == 0
    out[order[1:][same]] = order[:-1][same]
    return out


def _earlier(before: IntArray, offsets: tuple[int, ...]) -> list[IntArray]:
    """For each offset, the keyframe of the same laser that many before each; -1 where there is
    none."""
    out, at, gone = [], np.arange(len(before)), 0
    for offset in offsets:
        while gone < offset:
            at = np.where(at >= 0, before[at], -1)
            gone += 1
        out.append(at)
    return out


def _guess(
    held: Placed, known: int, matched_to: tuple[IntArray, IntArray, FloatArray], raw: Steps
) -> FloatArray:
    """(n, 3) initial poses: the known ones, then dead reckoning by pairwise matches or the
    odometry."""
    fresh, before, motion = matched_to
    came_from, step = np.arange(len(held)) - 1, np.concatenate([np.zeros((1, 3)), raw.motion])
    came_from[fresh], step[fresh] = before[fresh], motion
    pose = held.pose[:known].tolist() or [tuple(held.odometry[0])]
    ahead = zip(came_from[len(pose) :].tolist(), step[len(pose) :].tolist(), strict=True)
    for row, (x, y, turn) in ahead:
        x0, y0, theta = pose[row]
        c, s = cos(theta), sin(theta)
        pose.append((x0 + c * x - s * y, y0 + s * x + c * y, theta + turn))
    out = np.array(pose)
    out[:, 2] = wrap(out[:, 2])
    return out


def _finished(held: Placed, aligned: Aligned, rows: slice, errors: StepErrors) -> Matched:
    return Matched(take(held, rows), span_errors(aligned, rows, _lasers(held)), errors)
