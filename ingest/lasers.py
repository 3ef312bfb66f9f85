"""The lasers, or clouds, of a log that are used, and their mounting."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from ..topology.arrays import BoolArray
from ..topology.errors import LogError
from .frames import NOWHERE_ELSE
from .junction_source import JunctionSource, namespace
from .logs.lasers import RawScans
from .logs.poses import Poses
from .logs.topics import JUNCTIONS, Choice
from .mounting import KnownMounting, known_mounting
from .scans.detection import sectors
from .scans.stream import Mounting, ScanStream
from .survey import LogRead
from .topic_poses import TopicPoses

FURTHER = 3
"""Directions that a laser must add to what another one in its frame sees: filters of scans cut off
directions and add none; two are left for the rounding of both ends."""

FIRST_SCANS = 50
"""Number of scans read to find out their frames and clock."""

ANYWHERE = Mounting(otherwise=lambda _: NOWHERE_ELSE)


@dataclass(frozen=True, slots=True)
class Laser:
    """A topic; the directions that its first scans look in, by frame (`directions`), and their
    times."""

    choice: Choice
    views: Mapping[str, BoolArray]
    times: TopicPoses

    @property
    def topic(self) -> str:
        """Its name."""
        return self.choice.topic

    @property
    def frames(self) -> frozenset[str]:
        """Of its first scans."""
        return frozenset(self.views)

    @classmethod
    def of(cls, read: LogRead, choice: Choice) -> Laser:
        """Read the first scans; LogError if none can be decoded."""
        stream = ScanStream(read.recording, choice.topic, ANYWHERE)
        views: dict[str, BoolArray] = {}
        stamp_ns, log_ns, scans = [], [], 0
        for raw in stream.raw():
            frame, view = raw.geometry.frame, directions(raw)
            views[frame] = view | views.get(frame, view)
            stamp_ns.append(raw.stamp_ns)
            log_ns.append(raw.log_ns)
            scans += len(raw.log_ns)
            if scans >= FIRST_SCANS:
                break
        if not views:
            why = "; ".join(stream.tally.warnings(choice.topic)) or "it holds no scan"
            raise LogError(f"{read.log}: nothing can be made of {choice.topic}: {why}")
        none = np.zeros(scans, np.int64)
        stamps, logged = (np.concatenate(t) if t else none for t in (stamp_ns, log_ns))
        columns = Poses(none, none, logged, stamps, none, np.zeros((scans, 3)))
        return cls(choice, views, TopicPoses(columns, (), messages=scans))


@dataclass(frozen=True, slots=True)
class Lasers:
    """used: the main one first; where: the log's transforms; left_out: why others are not used, by
    topic; warnings: one for each that might be."""

    used: tuple[Laser, ...]
    where: KnownMounting
    left_out: Mapping[str, str] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()

    def widest(self) -> Lasers:
        """The one with the widest view alone: without odometry, each scan is matched to the one
        before, of the same laser."""
        first = max(self.used, key=_width)
        others = {laser.topic: ONE_ALONE for laser in self.used if laser is not first}
        return replace(self, used=(first,), left_out={**self.left_out, **others})


ONE_ALONE = "without odometry, the scans of one laser are matched with each other"


def lasers(read: LogRead, source: JunctionSource, body: str | None) -> Lasers:
    """The lasers, or clouds, with a known mounting, or one of them if none is known, with those in
    its frame.

    body: the robot's frame, None without odometry. Topics that show no further directions in the
    frame of another one (e.g. `/scan_filtered`) are left out. LogError if the first one has no
    scans.
    """
    first = Laser.of(read, source.choice)
    left_out: dict[str, str] = {}
    warnings: list[str] = []
    every = [first, *_others(read, source, left_out, warnings.append)]
    own, usual = namespace(read.counts, read.settings, read.log), JUNCTIONS[source.way].usual
    ranked = sorted(every, key=lambda laser: _rank(laser, own, usual))
    found = _distinct(ranked, left_out)
    frames = frozenset().union(*(laser.frames for laser in found))
    if read.settings.laser_pose is not None:
        where = KnownMounting({}, body or "")
    else:
        where = known_mounting(read.recording, frames, body)
    known = [laser for laser in found if where.knows(laser.frames)]
    used = known or [laser for laser in found if laser.frames <= found[0].frames]
    for laser in (laser for laser in found if laser not in used):
        named = ", ".join(map(repr, sorted(laser.frames)[:5]))
        unknown = f"the log does not say where its frame {named} is on the robot ({where.body!r})"
        if read.settings.laser_pose is not None:
            unknown = f"its frame is {named}, and --laser-pose places that of {used[0].topic}"
        left_out[laser.topic] = unknown
        warnings.append(
            f"{laser.topic}: {unknown}; left out; with /tf_static it is used, too, with "
            f"--scan-topic {laser.topic} --laser-pose x,y,yaw instead of {used[0].topic}"
        )
    return Lasers(tuple(used), where, left_out, tuple(warnings))


def _others(
    read: LogRead, source: JunctionSource, left_out: dict[str, str], warn: Callable[[str], object]
) -> list[Laser]:
    """The further lasers, or clouds, that can be decoded."""
    found = []
    for choice in source.beside if source.way in ("scan", "cloud") else ():
        try:
            found.append(Laser.of(read, choice))
        except LogError as error:
            warn(f"one {'laser' if source.way == 'scan' else 'cloud'} less: {error}")
            left_out[choice.topic] = "nothing can be made of it"
    return found


def _rank(laser: Laser, own: str, usual: str) -> tuple[bool, bool, int, list[list[bool]]]:
    """Sorts lasers by which is used, if one has to be: of the odometry's robot, of the usual name,
    with the widest view; of two as wide by where they look, so that names do not count."""
    where = sorted(view.tolist() for view in laser.views.values())
    return not laser.topic.startswith(own), laser.topic != usual, -_width(laser), where


def _width(laser: Laser) -> int:
    return sum(int(view.sum()) for view in laser.views.values())


def _distinct(ranked: list[Laser], left_out: dict[str, str]) -> list[Laser]:
    """The lasers without those that see what one before sees in the same frame: they are made of
    its scans, or claim its place."""
    kept: list[Laser] = []
    for laser in ranked:
        above = [other for other in kept if not _adds(laser, other)]
        if above:
            left_out[laser.topic] = f"{above[0].topic} sees all of its directions in the same frame"
        else:
            kept.append(laser)
    return kept


def _adds(laser: Laser, other: Laser) -> bool:
    """Whether a laser sees directions that another one does not see in the same frame."""
    return any(
        frame not in other.views or int((view & ~other.views[frame]).sum()) >= FURTHER
        for frame, view in laser.views.items()
    )


def directions(scans: RawScans) -> BoolArray:
    """(SECTORS,) directions of the frame that scans look in: of all beams or, in slices of a cloud,
    which have beams all around, of those with a return."""
    geometry, beams = scans.geometry, scans.ranges_m.shape[1]
    with np.errstate(invalid="ignore", over="ignore"):  # a message may hold any numbers
        angles = geometry.angle_min + geometry.angle_increment * np.arange(beams) + geometry.pose[2]
    if scans.blind:
        angles = angles[np.isfinite(scans.ranges_m).any(axis=0)]
    return sectors(angles[np.abs(angles) < 1e6])  # others are no angles
