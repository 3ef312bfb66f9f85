"""The lasers, or clouds, of a log that are used, and their mounting."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..topology.errors import LogError
from .frames import NOWHERE_ELSE
from .junction_source import JunctionSource
from .logs.intake import PoseColumns
from .logs.topics import Choice
from .mounting import Joined, joined
from .scans.stream import Mounting, ScanStream
from .survey import LogRead
from .topic_poses import TopicPoses

FIRST_SCANS = 50
"""Number of scans read to find out their frames and clock."""

ANYWHERE = Mounting(otherwise=lambda _: np.array(NOWHERE_ELSE))


@dataclass(frozen=True, slots=True)
class Laser:
    """A topic; the frames of its first scans, and their times."""

    choice: Choice
    frames: frozenset[str]
    times: TopicPoses

    @property
    def topic(self) -> str:
        """Its name."""
        return self.choice.topic

    @classmethod
    def of(cls, read: LogRead, choice: Choice) -> Laser:
        """Read the first scans; LogError if none can be decoded."""
        stream = ScanStream(read.recording, choice.topic, ANYWHERE, on_walked=read.faults.add)
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
            why = "; ".join(stream.tally.warnings(choice.topic)) or "it holds no scan"
            raise LogError(f"{read.log}: nothing can be made of {choice.topic}: {why}")
        none = np.zeros(scans, np.int64)
        stamps, logged = (np.concatenate(t) if t else none for t in (stamp_ns, log_ns))
        columns = PoseColumns(none, none, logged, stamps, none, np.zeros((scans, 3)))
        return cls(choice, frozenset(frames), TopicPoses(columns, (), messages=scans))


@dataclass(frozen=True, slots=True)
class Lasers:
    """used: the main one first; where: the log's transforms; warnings: one for each laser that is
    left out, and on contradictory transforms."""

    used: tuple[Laser, ...]
    where: Joined
    warnings: tuple[str, ...]


def lasers(read: LogRead, source: JunctionSource, body: str | None) -> Lasers:
    """The lasers with a known mounting, or the first one if none is known.

    body: the robot's frame, None without odometry. Topics with scans in the frame of another one
    (e.g. `/scan_filtered`) are passed over. LogError if the first one has no scans.
    """
    first = Laser.of(read, source.choice)
    if read.settings.laser_pose is not None:
        return Lasers((first,), Joined({}, body or ""), ())
    warnings: list[str] = []
    found = [first, *_others(read, source, first, warnings.append)]
    frames = frozenset().union(*(laser.frames for laser in found))
    where = joined(read.recording, frames, body, read.faults.add)
    if where.fixed is not None:
        warnings += where.fixed.contradictions(where.body)
    found.sort(key=lambda laser: not where.knows(laser.frames))
    used = [laser for laser in found if laser is found[0] or where.knows(laser.frames)]
    for laser in found[len(used) :]:
        named = ", ".join(map(repr, sorted(laser.frames)[:5]))
        warnings.append(
            f"{laser.topic}: the log does not say where its frame {named} is on the robot "
            f"({where.body!r}); left out; with /tf_static it is used, too, with --scan-topic "
            f"{laser.topic} --laser-pose x,y,yaw instead of {used[0].topic}"
        )
    return Lasers(tuple(used), where, tuple(warnings))


def _others(
    read: LogRead, source: JunctionSource, first: Laser, warn: Callable[[str], object]
) -> list[Laser]:
    """Further lasers, in frames of their own."""
    if source.way != "scan":
        return []
    found, frames = [], first.frames
    for choice in source.beside:
        try:
            laser = Laser.of(read, choice)
        except LogError as error:
            warn(f"one laser less: {error}")
            continue
        if not laser.frames & frames:
            found.append(laser)
            frames |= laser.frames
    return found
