"""Odometry corrected by scan matching, window by window as the scans come in."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ...topology.odometry import Odometry
from ...topology.se2 import between, wrap
from ...topology.track import chain_of
from .alignment import Aligned, AlignmentSettings, Steps, align, chained, match_steps
from .association import Swept
from .keyframes import Keyframes, KeyframeSettings, Posed, join, keyframes
from .scan import ScanBatch
from .step_errors import SpanErrors, StepErrors, span_errors
from .surfaces import SurfaceSettings, surfaces

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class MatchingSettings:
    """How odometry is corrected by scans."""

    keyframes: KeyframeSettings = field(default_factory=KeyframeSettings)
    surfaces: SurfaceSettings = field(default_factory=SurfaceSettings)
    alignment: AlignmentSettings = field(default_factory=AlignmentSettings)
    window: int = 400
    """Keyframes solved for at once: much more than the widest pair, little memory."""
    lag: int = 60
    """The last ones of a window are solved for again with those that follow: the widest pair."""
    outside_s: float = 0.5
    """How far beyond the odometry's ends a scan may lie."""


@dataclass(frozen=True, slots=True, eq=False)
class Matched:
    """Keyframes whose poses are final. pose: (k, 3) of the laser in the corrected frame; fit: (k,)
    share of the points that lie on what the keyframe before saw; searched: (k,) found by search;
    spans: how well the poses are known."""

    keyframes: Keyframes
    pose: FloatArray
    fit: FloatArray
    searched: NDArray[np.bool_]
    spans: SpanErrors
    errors: StepErrors


def posed(
    odometry: Odometry, batches: Iterable[ScanBatch], settings: MatchingSettings
) -> Iterator[Posed]:
    """The robot's pose at every scan, by the odometry."""
    for batch in batches:
        if len(batch) == 0:
            continue
        half = np.int64(0.5e9 * batch.sweep_s)
        around = np.int64(1e8)
        t = batch.times_ns
        turned = wrap(odometry.at(t + around)[:, 2] - odometry.at(t - around)[:, 2])
        outside = np.int64(settings.outside_s * 1e9)
        first, last = odometry.time_ns[[0, -1]] + np.array([-outside, outside])
        yield Posed(
            batch,
            odometry.at(t),
            between(odometry.at(t - half), odometry.at(t + half)),
            turned / (2e-9 * around),
            (t >= first) & (t <= last),
            chain_of(odometry, t),
        )


def matched(
    posed_scans: Iterable[Posed], settings: MatchingSettings = MatchingSettings()
) -> Iterator[Matched]:
    """The keyframes of a run with their corrected poses. Memory: one window.

    Every window begins with keyframes whose poses are final and stay, and ends with some that are
    solved for again in the next one.
    """
    held: Keyframes | None = None
    pose = np.zeros((0, 3))
    final = 0
    errors = StepErrors()
    fresh: list[Keyframes] = []
    for part in keyframes(posed_scans, settings.keyframes):
        fresh.append(part)
        if sum(map(len, fresh)) >= settings.window:
            held = join([*([held] if held is not None else []), *fresh])
            fresh = []
            pose, done, errors = _solve(held, pose, final, errors, settings)
            upto = len(held) - settings.lag
            yield _finished(held, pose, done, slice(final, upto), errors)
            keep = max(upto - settings.lag, 0)
            held, pose, final = held.take(slice(keep, None)), pose[keep:], upto - keep
    if fresh or held is not None:
        held = join([*([held] if held is not None else []), *fresh])
        pose, done, errors = _solve(held, pose, final, errors, settings)
        yield _finished(held, pose, done, slice(final, len(held)), errors)


@dataclass(frozen=True, slots=True, eq=False)
class _Done:
    aligned: Aligned
    searched: NDArray[np.bool_]


def _solve(
    held: Keyframes,
    known: FloatArray,
    final: int,
    errors: StepErrors,
    settings: MatchingSettings,
) -> tuple[FloatArray, _Done, StepErrors]:
    """Poses of all keyframes held, of which the first `len(known)` were solved for before."""
    scans = Swept(
        held.xy,
        held.start,
        held.increment,
        surfaces(held.xy, held.increment, settings.surfaces),
    )
    raw = Steps(*errors.steps(held))
    joined = np.diff(held.piece) == 0
    motion = raw.motion
    n, searched = len(held), np.zeros(len(held), bool)
    begin = max(len(known) - 1, 0)
    if n - begin > 1:
        rows = slice(begin, n)
        tail = held.take(rows)
        part = Swept(
            scans.xy[rows], scans.start[rows], scans.increment[rows], scans.surfaces.take(rows)
        )
        found = match_steps(
            part, Steps(raw.motion[begin:], raw.information[begin:]), settings.alignment
        )
        errors = errors.learned(tail, found.motion, found.fit > settings.alignment.lost_fit)
        raw = Steps(*errors.steps(held))
        motion = np.concatenate([raw.motion[:begin], found.motion])
        broken = begin + np.flatnonzero(~joined[begin:])
        motion[broken] = raw.motion[broken]
        searched[begin + 1 :] = found.searched
    start = known[-1] if len(known) else held.odometry[0]
    guess = np.concatenate([known if len(known) else start[None], chained(start, motion[begin:])])
    aligned = align(scans, guess, raw, fixed=final, joined=joined, settings=settings.alignment)
    return aligned.pose, _Done(aligned, searched), errors


def _finished(
    held: Keyframes, pose: FloatArray, done: _Done, rows: slice, errors: StepErrors
) -> Matched:
    fit = np.concatenate([[1.0], done.aligned.fit])
    spans = span_errors(pose, done.aligned.information, rows, done.aligned.residual_m)
    return Matched(held.take(rows), pose[rows], fit[rows], done.searched[rows], spans, errors)
