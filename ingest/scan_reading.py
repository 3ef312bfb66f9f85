"""Reading of a run with junctions to be found in scans or point clouds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from ..topology.arrays import FloatArray
from ..topology.errors import DataError, LogError
from ..topology.odometry import Odometry
from ..topology.run import NO_DETECTIONS, Run
from ..topology.se2 import between
from ..topology.views import Views
from .junction_source import JunctionSource
from .lasers import ANYWHERE, Laser, Lasers, lasers
from .mounting import mounting
from .odometry.reading import OdometryTopic, described, driven, odometry_topic
from .odometry.track import Track
from .scans.detection import detect
from .scans.mount_yaw import mount_yaw
from .scans.scan import ScanResult
from .scans.stream import InterleavedScans, Mounting, ScanStream
from .scans.turns import LaggingError, MirroredError, OtherClockError
from .survey import LogRead
from .topic_poses import Clock, choose_clock


def with_scans(read: LogRead, source: JunctionSource) -> Run:
    """The run of a log with scans or clouds: its odometry corrected by them, and the junctions.

    Without odometry, or with one that never moves beside scans that do, the scans are matched with
    each other alone. Raises LogError if no scan can be used, DataError if the scans cannot be
    processed.
    """
    odometry = _odometry_if_any(read)
    body = (odometry.frames[1] or "base_link") if odometry else None
    if odometry is not None and _extent_m(odometry.poses.columns.pose) < STANDS_M:
        topic, still = odometry.choice.topic, "never moves, but the scans do"
        try:
            run = _run(read, source, None, body)
        except DataError:
            run = None  # the error is told of the odometry, below
        if run is not None and _extent_m(run.odometry.pose) > MOVES_M:
            without = f"{topic}: {still}; left out: each scan was matched to the one before"
            left_out = {topic: still, **run.source.get("left_out", {})}
            about = {**run.source, "left_out": left_out}
            return replace(run, source=about, warnings=(without, *run.warnings))
    return _run(read, source, odometry, body)


STANDS_M = 0.1
"""Extent of an odometry that never moves: noise of standing wheels, and of filters, is less."""
MOVES_M = 2.0
"""Least extent of the track by scans alone that shows motion: people who walk by a standing robot
are matched for some decimetres."""


def _extent_m(pose: FloatArray) -> float:
    """The diagonal of the rectangle that holds all positions [m]."""
    return float(np.hypot(*np.ptp(pose[:, :2], axis=0))) if len(pose) else 0.0


def _run(
    read: LogRead, source: JunctionSource, odometry: OdometryTopic | None, body: str | None
) -> Run:
    """The run by scans and this odometry, if any; body: the robot's frame, if it is known."""
    warnings = list(read.warnings)
    found = lasers(read, source, body)
    if odometry is None:
        found = found.widest()
    first = found.used[0]
    poses = odometry.poses if odometry is not None else None
    clock = choose_clock(poses, first.times, read.settings.time, warnings, "scan")
    about: dict[str, Any] = {"junctions": {"from": source.way, **_about(source, first)}}
    about["time"] = clock
    if odometry is not None:
        about["odometry"] = described(odometry.choice, odometry.poses)
    way = driven(odometry, clock, read) if odometry is not None else None
    warnings += [*(way.warnings if way else ()), *found.warnings]
    scans = _Scans(read, found, clock, way.recorded if way else None)
    try:
        result, stream, of_scans = _detected(scans, way.odometry if way else None)
    except DataError as error:
        named = ", ".join(laser.topic for laser in found.used)
        alone = f"; --scan-topic {first.topic} uses one alone" if len(found.used) > 1 else ""
        raise DataError(f"{read.log}: {named}: {error}{alone}") from error
    warnings += [*of_scans, *stream.warnings, *result.warnings]
    statistics = asdict(result.statistics)
    for name, value in statistics.items():
        if isinstance(value, float):  # unknown values are None
            statistics[name] = round(value, 4) if np.isfinite(value) else None
    about["junctions"] |= {"messages": stream.messages, **statistics}
    if len(found.used) > 1:
        about["junctions"]["lasers"] = [laser.topic for laser in found.used]
    if found.left_out:
        about["left_out"] = dict(found.left_out)
    return Run(
        read.run, result.odometry, NO_DETECTIONS, about, tuple(warnings), scanned=result.scanned
    )


def views_beside(
    read: LogRead, source: JunctionSource, body: str, clock: Clock, track: Track
) -> tuple[Views, dict[str, Any], list[str]]:
    """What the lasers of a run with detections saw around places, posed in the robot's frame of
    their time; the source for its document, and warnings.

    body: the robot's frame. Raises LogError or DataError if the scans cannot be used.
    """
    found = lasers(read, source, body)
    scans = _Scans(read, found, clock, track.recorded)
    result, stream, warnings = _detected(scans, track.odometry)
    views = result.scanned.views
    body_pose = result.odometry.at(views.time_ns)
    views = replace(views, pose=between(body_pose, views.pose))
    first = found.used[0]
    about = {"from": source.way, "topic": first.topic, "type": first.choice.type_name}
    return views, about, [*found.warnings, *warnings, *stream.warnings, *result.warnings]


@dataclass(frozen=True, slots=True)
class _Scans:
    """Access to the scans of a log. recorded: the odometry, None if there is none."""

    read: LogRead
    lasers: Lasers
    clock: Clock
    recorded: Odometry | None

    def stream(self, overturned: bool) -> tuple[InterleavedScans, list[str]]:
        """The scans of all lasers in the order of time, and warnings on assumptions about their
        mounting.

        overturned: whether all lasers are mounted upside down relative to the log's transforms.
        """

        first, recorded = self.lasers.used[0], self.recorded

        def yaw_of(odometry: Odometry, frame: str) -> float | None:
            if first.frames != {frame}:
                return None
            return mount_yaw(
                odometry, self._stream_of(first, replace(ANYWHERE, overturned=overturned))
            )

        ask = partial(yaw_of, recorded) if recorded is not None else None
        mounts, warnings = mounting(self.lasers.where, first.frames, self.read.settings, ask)
        mounts = replace(mounts, overturned=overturned)
        # Every laser's stream reads all of the log: one reports the progress.
        streams = [
            self._stream_of(laser, mounts, self.read.progress if laser is first else None)
            for laser in self.lasers.used
        ]
        return InterleavedScans(streams), warnings

    def _stream_of(
        self, laser: Laser, mounts: Mounting, on_bytes: Callable[[int], None] | None = None
    ) -> ScanStream:
        return ScanStream(
            self.read.recording,
            laser.topic,
            mounts,
            clock=self.clock,
            stamp=self.read.settings.scan_stamp,
            slices=self.read.settings.slices,
            on_bytes=on_bytes,
        )


def _detected(
    scans: _Scans, odometry: Odometry | None
) -> tuple[ScanResult, InterleavedScans, list[str]]:
    """The detection result, its stream, and warnings.

    Repeated with mirrored scans or with a delayed odometry where the first attempt shows that this
    is needed.
    """
    may_lag, overturned, found = True, False, list[str]()
    while True:
        stream, warnings = scans.stream(overturned)
        try:
            result = detect(odometry, stream, may_lag=may_lag, on_keyframes=scans.read.on_keyframes)
            return result, stream, warnings + found
        except MirroredError as error:
            if overturned:
                raise DataError(f"turned over {error}: it fits neither way up") from error
            overturned = True
            found.append(
                f"{error}, as those of a laser upside down do; taken to be mounted so, which the "
                "log does not say"
            )
        except OtherClockError as error:
            way_out = (
                "--time log takes the times of recording in place of the header's"
                if scans.clock == "header"
                else "without --time log, or with other stamps, they may fit"
            )
            why = f"{error}: they are of another drive, or the two topics' clocks differ; {way_out}"
            raise DataError("; ".join((why, *stream.warnings))) from error
        except LaggingError as error:
            assert odometry is not None
            may_lag = False
            odometry = odometry.delayed(error.lag_s)
            found.append(f"{error}: the odometry was taken by the scans' clock")
        except DataError as error:
            raise DataError("; ".join((str(error), *stream.warnings))) from error


def _odometry_if_any(read: LogRead) -> OdometryTopic | None:
    """The odometry's topic; LogError if it, or the robot's frame, was named and cannot be used."""
    try:
        return odometry_topic(read)
    except LogError:
        settings = read.settings
        if settings.odometry_topic is not None or settings.base_frame is not None:
            raise
        return None


def _about(source: JunctionSource, first: Laser) -> dict[str, Any]:
    about: dict[str, Any] = {"topic": first.topic, "type": first.choice.type_name}
    return about | ({"passed_over": list(source.passed_over)} if source.passed_over else {})
