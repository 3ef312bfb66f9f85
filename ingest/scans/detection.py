"""From odometry and scans to corrected odometry and junctions."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from ...topology.arrays import BoolArray, FloatArray, IntArray
from ...topology.columns import joined
from ...topology.errors import DataError
from ...topology.odometry import Odometry
from ...topology.run import Scanned
from ...topology.se2 import compose, inverse
from ...topology.views import REACH_M
from .junctions import Driven, junction_passes, pass_midway
from .keyframes import Keyframes, join
from .matching import Matched, matched, posed
from .noise import expected_drift, matched_noise, recorded_drift
from .scan import ScanBatch, ScanResult, ScanStatistics
from .scan_odometry import scan_odometry
from .step_errors import SpanErrors
from .turns import LaggingError, MirroredError, Turns, clock_lag
from .views import chosen_views, closed_by_views
from .windows import Seen, windows

LEAST_COVERED = 0.5
"""Least share of the way along which scans match each other, without a warning."""
LEAST_WAY_M = 2 * REACH_M
"""Least way for a map without a junction: the width of a view."""
LEAST_FIT = 0.5
"""Least fit to the previous keyframe at which a keyframe counts as matched."""


def detect(
    odometry: Odometry | None,
    scans: Iterable[ScanBatch],
    *,
    may_lag: bool = True,
    on_keyframes: Callable[[Keyframes], object] | None = None,
) -> ScanResult:
    """Correct a run's odometry by its scans and find the junctions it passed.

    scans: in the order of time, several lasers interleaved; may_lag: whether they may be stamped by
    another clock than the odometry. The odometry of the result has a row per keyframe. Memory
    follows the keyframes' poses, not the scans. With `on_keyframes`, which takes all keyframes, the
    scans are matched and no more: there are no junctions and no views. Raises MirroredError as soon
    as the scans turn against the odometry, LaggingError as soon as they turn earlier or later than
    it does, DataError where nothing can be made of them.
    """
    counted = _Counted(scans)
    track = _Track()
    if odometry is not None and len(odometry) > 0:
        poses = posed(odometry, counted)
        if may_lag:
            track = _Track(lag=partial(clock_lag, odometry))
    else:
        odometry, poses = None, scan_odometry(counted)
    parts = track.passing(matched(poses))
    if on_keyframes is None:
        return _result(odometry, counted, track, list(windows(parts)))
    keyframes = [part.keyframes for part in parts]
    result = _result(odometry, counted, track, [])
    on_keyframes(join(keyframes))
    return result


SECTORS = 36
"""Number of directions in which the field of view is recorded: 10 degrees each, wider than the
spacing of any scanner's beams."""
NARROW_DEG = 120
"""A smaller field of view gives a warning: with 120 degrees all junctions of a simulated maze are
found, with 90 three of four, with 60 degrees and 4 m hardly any."""


def sectors(angles_rad: FloatArray) -> BoolArray:
    """(SECTORS,) whether any of the directions (k,) lies in each sector."""
    out = np.zeros(SECTORS, np.bool_)
    out[np.floor(angles_rad / (2 * np.pi) * SECTORS).astype(np.int64) % SECTORS] = True
    return out


@dataclass(slots=True, eq=False)
class _Counted:
    """Counts scans as they pass: scans; echoing: those with a return; seen: (SECTORS,) whether
    there was any return from that direction of the robot."""

    batches: Iterable[ScanBatch]
    scans: int = 0
    echoing: int = 0
    seen: BoolArray = field(default_factory=lambda: np.zeros(SECTORS, np.bool_))

    def __iter__(self) -> Iterator[ScanBatch]:
        for batch in self.batches:
            self.scans += len(batch)
            echo = np.isfinite(batch.ranges_m)
            self.echoing += int(echo.any(axis=1).sum())
            turn = (batch.angles_rad + batch.T_body_laser[2])[echo.any(axis=0)]
            self.seen |= sectors(turn)
            yield batch

    def warnings(self) -> list[str]:
        """A warning if the field of view is narrow."""
        degrees = round(int(self.seen.sum()) * 360 / SECTORS)
        if degrees >= NARROW_DEG or not self.echoing:
            return []
        return [
            f"the scans see some {degrees} degrees of what is around the robot: junctions that "
            "they do not see both sides of are missed"
        ]


@dataclass(frozen=True, slots=True, eq=False)
class _Rows:
    """Keyframes that passed: time, pose (k, 3) of the robot, corrected and as recorded; piece, fit,
    loose_m, laser: as of `Placed`."""

    time_ns: IntArray
    pose: FloatArray
    recorded: FloatArray
    piece: IntArray
    fit: FloatArray
    loose_m: FloatArray
    laser: IntArray

    def driven(self) -> Driven:
        """The track, its distance as in `windows`."""
        step = np.hypot(*np.diff(self.pose[:, :2], axis=0).T)
        step[np.diff(self.piece) != 0] = 0.0
        return Driven(self.time_ns, self.pose, np.concatenate([[0.0], np.cumsum(step)]))


@dataclass(slots=True, eq=False)
class _Track:
    """Data kept of processed keyframes."""

    rows: list[_Rows] = field(default_factory=list)
    spans: list[SpanErrors] = field(default_factory=list)
    searched: int = 0
    bias_rad_per_m: float = 0.0
    turns: Turns = field(default_factory=Turns)
    lag: Callable[[IntArray, FloatArray, IntArray], float] | None = None
    """Estimates the lag of the scans, called once, after enough rotation."""

    def passing(self, parts: Iterable[Matched]) -> Iterator[Matched]:
        """The parts as they pass, after recording what is needed of them."""
        for part in parts:
            frames, body = part.keyframes, part.keyframes.body
            recorded = compose(frames.odometry, inverse(frames.mount))
            about = frames.piece, frames.fit, frames.loose_m, frames.laser
            self.rows.append(_Rows(frames.time_ns, body, recorded, *about))
            self.spans.append(part.spans)
            self.searched += int(frames.searched.sum())
            self.bias_rad_per_m = float(part.errors.terms[0])
            self.turns = self.turns.more(recorded, body, frames.piece)
            if self.turns.mirrored:
                raise MirroredError(f"the scans turn {self.turns}")
            if self.lag is not None and self.turns.enough:
                so_far = joined(self.rows)
                lag_s = self.lag(so_far.time_ns, so_far.pose, so_far.piece)
                if lag_s:
                    raise LaggingError(lag_s)
                self.lag = None
            yield part


def _result(
    recorded: Odometry | None, counted: _Counted, track: _Track, seen: list[Seen]
) -> ScanResult:
    if not track.rows:
        raise DataError(_nothing(counted))
    rows = joined(track.rows)
    driven, good = rows.driven(), rows.fit >= LEAST_FIT
    covered = _covered(driven, good, rows.laser)
    passes, warnings = junction_passes(seen, driven), counted.warnings()
    if seen and not len(passes) and covered >= LEAST_COVERED and driven.way[-1] >= LEAST_WAY_M:
        passes = pass_midway(driven)
        warnings.append(
            "no junction shows in the scans: the middle of the way stands for one, and only the "
            "walls along it can place the run in others"
        )
    if recorded is None:
        warnings.append(_alone(driven, rows.loose_m))
    noise = matched_noise(track.spans, passes, alone=recorded is None)
    statistics = ScanStatistics(
        scans=counted.scans,
        matched=int(good.sum()),
        drift_before_m=recorded_drift(rows.recorded, driven.pose, driven.way, DRIFT_M),
        drift_after_m=expected_drift(noise, driven.pose, driven.way, DRIFT_M),
        bias_rad_per_m=track.bias_rad_per_m,
        covered=covered,
        searched=track.searched,
        odometry=recorded is not None,
    )
    # Two lasers at one time make one row.
    keep = np.concatenate([[True], np.diff(driven.time_ns) > 0])
    odometry = Odometry(
        driven.time_ns[keep],
        driven.pose[keep],
        np.flatnonzero(np.diff(rows.piece[keep])) + 1,
        recorded.frame if recorded is not None else "odom",
        recorded.child_frame if recorded is not None else "base_link",
    )
    views = chosen_views(seen, passes, driven)
    odometry, views, loops = closed_by_views(odometry, views, noise)
    scanned = Scanned(passes, noise, views, loops)
    return ScanResult(odometry, scanned, statistics, (*warnings, *_warnings(statistics)))


BARE_M = 0.1
"""1 sigma of the distance between two keyframes, above which scans alone do not tell it: in `aces`
the corrected path is 65 m long there, that by the scans 49 m; elsewhere 260 and 257 m."""
MOST_STRETCHES = 3
"""Stretches that a warning lists."""


def _alone(driven: Driven, loose_m: FloatArray) -> str:
    """A warning that there is no odometry, and where the scans do not tell the distance driven."""
    text = "no odometry beside the scans: each scan was matched to the one before"
    step = np.diff(driven.way)
    bare = loose_m[1:] > BARE_M
    begin, end = np.flatnonzero(np.diff(bare, prepend=False, append=False)).reshape(-1, 2).T
    way = driven.way[end] - driven.way[begin]
    if not (way > 0).any():
        return text
    longest = np.sort(np.argsort(-way, kind="stable")[:MOST_STRETCHES])
    after_s = (driven.time_ns[begin] - driven.time_ns[0]) * 1e-9
    where = ", ".join(f"{way[k]:.0f} m at {after_s[k]:.0f} s" for k in longest)
    return (
        f"{text}; along {step[bare].sum():.0f} of {driven.way[-1]:.0f} m only bare walls are in "
        f"sight, which leave the distance open; the longest of them: {where} of the log"
    )


def _warnings(statistics: ScanStatistics) -> tuple[str, ...]:
    out = []
    if statistics.covered < LEAST_COVERED and statistics.scans > 1:
        out.append(
            f"along {100 - 100 * statistics.covered:.0f} % of the way scans show too few surfaces "
            "to be matched with each other; there the odometry stands as it was recorded"
        )
    if statistics.searched:
        guide = "odometry" if statistics.odometry else "scan before"
        out.append(
            f"at {statistics.searched} of {statistics.scans} scans the {guide} led astray; the "
            "way on was found by searching"
        )
    return tuple(out)


DRIFT_M = 20.0
"""Distance after which drift is stated."""


def _nothing(counted: _Counted) -> str:
    """Why no scan could be used."""
    if counted.scans == 0:
        return "the scan topic holds no usable scan"
    if counted.echoing == 0:
        return f"none of the {counted.scans} scans has an echo"
    return (
        f"none of the {counted.echoing} scans with an echo lies within the time of the odometry; "
        "check the clocks of the two topics; --time log takes the times of recording"
    )


def _covered(driven: Driven, good: BoolArray, laser: IntArray) -> float:
    """Share of the distance driven between consecutive keyframes of any laser (k,) that fit each
    other."""
    step = np.diff(driven.way)
    total = float(step.sum())
    covered = np.zeros(len(step), np.bool_)
    for number in np.unique(laser):
        own = np.flatnonzero(laser == number)
        # The step to a row is covered if the laser's next keyframe fits its last one.
        following = np.searchsorted(own, np.arange(1, len(laser)))
        inside = (following > 0) & (following < len(own))
        covered[inside] |= good[own[following[inside]]]
    return float(step[covered].sum()) / total if total > 0 else 0.0
