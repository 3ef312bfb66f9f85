"""Reads a run whose junctions are found in scans or clouds of points."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from ..topology.errors import DataError, LogError
from ..topology.ragged import Ragged
from ..topology.run import Detections, Run, Scanned
from .frames import NOWHERE_ELSE
from .junction_source import JunctionSource
from .logs.intake import PoseColumns
from .mounting import mounting
from .odometry.reading import OdometryTopic, described, driven, odometry_topic
from .scans.detection import detect
from .scans.mount_yaw import MountYaw, mount_yaw
from .scans.scan import ScanStatistics
from .scans.stream import InterleavedScans, Mounting, ScanStream
from .sources import Clock, Source, choose_clock, clock_without_jumps
from .survey import LogRead

FIRST_SCANS = 50
"""So many scans tell in which frames they are, and whether their clock is the odometry's."""


def with_scans(read: LogRead, source: JunctionSource) -> Run:
    """The run of a log with scans or clouds: its odometry corrected by them, and the junctions.

    Without odometry the scans are matched with each other alone. Raises LogError if no scan can be
    used, DataError if nothing can be made of them.
    """
    warnings = list(read.warnings)
    odometry = _odometry_if_any(read)
    first = _First.of(read, source.choice.topic)
    clock = _clock(odometry, first, read, warnings)
    about: dict[str, Any] = {"junctions": {"from": source.way, **_about(source)}, "time": clock}
    if odometry is not None:
        about["odometry"] = described(odometry.choice, odometry.source)
    way = driven(odometry, clock, read.settings, read.log) if odometry is not None else None
    lasers = [first, *_others(read, source, first, warnings)]
    frames = set().union(*(laser.frames for laser in lasers))
    recorded = way.recorded if way else None

    def scans_of(
        laser: _First, mounts: Mounting, on_bytes: Callable[[int], None] | None = None
    ) -> ScanStream:
        return ScanStream(
            read.recording,
            laser.topic,
            mounts,
            clock=clock,
            stamp=read.settings.scan_stamp,
            slices=read.settings.slices,
            on_bytes=on_bytes,
        )

    def yaw_of(frame: str) -> MountYaw | None:
        if recorded is None or first.frames != {frame}:
            return None
        return mount_yaw(recorded, scans_of(first, ANYWHERE))

    mounts, told = mounting(read.recording, frames, recorded, read.settings, yaw_of)
    warnings += [*(way.warnings if way else ()), *told]
    used = [laser for laser in lasers if laser is first or laser.frames <= set(mounts.known)]
    # Every laser's stream walks through all of the log: one tells how far it is.
    stream = InterleavedScans(
        [scans_of(laser, mounts, read.progress if laser is first else None) for laser in used]
    )
    try:
        found = detect(way.odometry if way else None, stream)
    except DataError as error:
        named = ", ".join(laser.topic for laser in used)
        raise DataError("; ".join((f"{read.log}: {named}: {error}", *stream.warnings))) from error
    warnings += [*stream.warnings, *found.warnings]
    about["junctions"] |= {"messages": stream.messages, **_told(found.statistics)}
    if len(used) > 1:
        about["junctions"]["lasers"] = [laser.topic for laser in used]
    return Run(
        read.run,
        found.odometry,
        NO_DETECTIONS,
        about,
        tuple(warnings),
        scanned=Scanned(found.passes, found.noise, found.picture),
    )


ANYWHERE = Mounting(otherwise=lambda _: np.array(NOWHERE_ELSE))

NO_DETECTIONS = Detections(
    np.zeros(0, np.int64), np.zeros((0, 2)), Ragged(np.zeros(1, np.int64), np.zeros(0))
)


def _odometry_if_any(read: LogRead) -> OdometryTopic | None:
    """The odometry's topic; LogError if the one that was named cannot be used."""
    try:
        return odometry_topic(read.intake, read.counts, read.settings, read.log)
    except LogError:
        if read.settings.odometry_topic is not None:
            raise
        return None


@dataclass(frozen=True, slots=True)
class _First:
    """Of the first scans of a topic: names of their frames, and their times as a source's."""

    topic: str
    frames: frozenset[str]
    times: Source

    @classmethod
    def of(cls, read: LogRead, topic: str) -> _First:
        """LogError if the topic holds nothing that can be decoded."""
        stream = ScanStream(read.recording, topic, ANYWHERE)
        frames: set[str] = set()
        stamp_ns, log_ns, scans = [], [], 0
        for timed in stream.raw():
            frames.add(timed.scans.geometry.frame)
            stamp_ns.append(timed.scans.stamp_ns)
            log_ns.append(timed.log_ns)
            scans += len(timed.log_ns)
            if scans >= FIRST_SCANS:
                break
        if not frames:
            why = "; ".join(stream.tally.warnings(topic)) or "it holds no scan"
            raise LogError(f"{read.log}: nothing can be made of {topic}: {why}")
        none = np.zeros(scans, np.int64)
        stamps, logged = (np.concatenate(t) if t else none for t in (stamp_ns, log_ns))
        columns = PoseColumns(none, none, logged, stamps, none, np.zeros((scans, 3)))
        times = Source(
            columns,
            (),
            "",
            messages=scans,
            failed=0,
            not_finite=0,
            zero_quaternion=0,
            empty=0,
        )
        return cls(topic, frozenset(frames), times)


def _others(
    read: LogRead, source: JunctionSource, first: _First, warnings: list[str]
) -> list[_First]:
    """Further lasers: in frames of their own, where the first one's scans are not shown again."""
    if source.way != "scan" or read.settings.laser_pose is not None:
        return []
    found, frames = [], first.frames
    for choice in source.beside:
        try:
            laser = _First.of(read, choice.topic)
        except LogError as error:
            warnings.append(f"one laser less: {error}")
            continue
        if not laser.frames & frames:
            found.append(laser)
            frames |= laser.frames
    return found


def _clock(
    odometry: OdometryTopic | None, first: _First, read: LogRead, warnings: list[str]
) -> Clock:
    wanted = read.settings.time
    if odometry is None:
        return choose_clock(first.times, first.times, wanted, warnings, "scan")
    clock = choose_clock(odometry.source, first.times, wanted, warnings, "scan")
    return clock_without_jumps(odometry.source, clock, read.settings.track.backward_min_s, warnings)


def _about(source: JunctionSource) -> dict[str, Any]:
    about: dict[str, Any] = {"topic": source.choice.topic, "type": source.choice.type_name}
    return about | ({"passed_over": list(source.passed_over)} if source.passed_over else {})


def _told(statistics: ScanStatistics) -> dict[str, Any]:
    """What matching the scans has brought, for the document; what is not known is null."""
    told = asdict(statistics)
    for name, value in told.items():
        if isinstance(value, float):
            told[name] = round(value, 4) if np.isfinite(value) else None
    return told
