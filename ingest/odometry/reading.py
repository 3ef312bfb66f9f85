"""The odometry of a log: choice of the topic, and the track from its messages."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...topology.errors import LogError
from ...topology.odometry import Odometry
from ..logs.messages import several_that
from ..logs.poses import no_poses
from ..logs.topics import ODOMETRY_KINDS, Choice, choose_odometry, decoded_alike, listing
from ..survey import LogRead
from ..topic_poses import (
    ELSEWHERE,
    FOREIGN,
    Clock,
    TopicPoses,
    listed_pairs,
    other_odometries,
    pair_of_poses,
    pair_of_transforms,
)
from .track import Track, sane_track


@dataclass(frozen=True, slots=True)
class OdometryTopic:
    """The topic of the odometry, its messages, and its frames (parent, child)."""

    choice: Choice
    poses: TopicPoses
    frames: tuple[str, str]


def odometry_topic(read: LogRead) -> OdometryTopic:
    """The first candidate with usable content: its poses between one pair of frames.

    Raises LogError if there is none, UsageError if a topic must be named.
    """
    settings = read.settings
    base = settings.base_frame.lstrip("/") if settings.base_frame else None
    reasons = []
    for choice in choose_odometry(read.counts, settings.odometry_topic, read.log):
        poses = poses_of(read, choice)
        transforms = ODOMETRY_KINDS[choice.type_name][1] == "transforms"
        find = pair_of_transforms if transforms else pair_of_poses
        pair = find(poses, base)
        if pair is not None:
            chosen = poses.columns.frame == pair
            if transforms:
                poses.rivals = other_odometries(poses, pair)
            else:
                poses.unusable[ELSEWHERE] = int((~chosen).sum())
            poses.keep(chosen)
            parent, child = poses.frames[pair]
            return OdometryTopic(choice, poses, (parent, child or base or ""))
        lack = "no transform from an odom frame" if transforms else "no usable pose"
        if base is not None and len(poses):
            lack += f" to {base} (--base-frame); it has {listed_pairs(poses.frames)}"
        reasons.append(f"{choice.topic} holds {lack}" + because(poses, choice.topic))
    raise LogError(f"{read.log}: no odometry: {', '.join(reasons)}; {listing(read.counts)}")


def driven(topic: OdometryTopic, clock: Clock, read: LogRead) -> Track:
    """The track, by one clock; the topic's columns are released.

    Raises LogError if no robot can have moved like that.
    """
    track = _track(topic, clock)
    # As recorded, but drive by drive: a reset may lead anywhere.
    drives = replace(track.recorded, breaks=track.odometry.breaks)
    doubt = check_plausible(drives, topic.choice.topic, read.log)
    return replace(track, warnings=(*track.warnings, doubt)) if doubt else track


def poses_of(read: LogRead, choice: Choice) -> TopicPoses:
    """The poses of a topic; messages of its channels without a decoder count as failed ones."""
    topic, intake = choice.topic, read.intake
    intake.check(topic, read.log)
    sinks = intake.of_topic(topic)
    alike = [sink for sink in sinks if decoded_alike(sink.channel.type_name, choice.type_name)]
    poses = TopicPoses.of(alike)
    poses.unusable[FOREIGN] = sum(sink.messages for sink in sinks) - poses.messages
    refused = sum(read.counts.get(c, 0) for c in intake.refused if c.topic == topic)
    poses.messages += refused
    poses.failed += refused
    return poses


def because(poses: TopicPoses, topic: str) -> str:
    """The faults of a topic's messages, in brackets."""
    reasons = poses.warnings(topic)
    return f" ({'; '.join(reasons)})" if reasons else ""


def described(choice: Choice, poses: TopicPoses) -> dict[str, Any]:
    """A topic for the map document, independent of the container."""
    return {"topic": choice.topic, "type": choice.type_name, "messages": poses.messages}


def _track(topic: OdometryTopic, clock: Clock) -> Track:
    poses, (frame, child) = topic.poses, topic.frames
    warnings = poses.warnings(topic.choice.topic)
    time_ns = poses.time_ns(clock)
    if clock == "header" and not time_ns.all():
        zero = int((time_ns == 0).sum())
        untimed = several_that(zero, "message", "carry no header time")
        warnings.append(f"{topic.choice.topic}: {untimed}; left out")
        poses.keep(time_ns != 0)
        time_ns = poses.time_ns(clock)
    pose = poses.columns.pose
    # Nothing else is needed of the columns: with a million poses they take 48 MB.
    poses.columns = no_poses()
    track = sane_track(time_ns, pose, frame or "odom", child or "base_link")
    return replace(track, warnings=(*warnings, *track.warnings))


LONGEST_M = 1e6
"""Largest extent of a drive without a break, 1000 km, to bound memory."""

FASTEST_M_PER_S = 100.0
"""No ground robot is usually faster: autonomous race cars reach 80 m/s."""

DOUBTED_M_PER_S = 25.0
"""90 km/h: only cars are usually faster; robots in centimetres taken for metres seem to be."""

ELSE = "else stamps are in another unit than seconds and nanoseconds, or two robots share the topic"


def check_plausible(odometry: Odometry, topic: str, log: str) -> str:
    """Raise LogError if a drive is too wide or, in half of its steps, too fast; return a warning if
    these are as fast as a car's, else "". O(n).
    """
    position = odometry.pose[:, :2]
    if len(position) < 2:
        return ""
    starts = np.concatenate([[0], odometry.breaks]).astype(np.int64)
    extent = np.maximum.reduceat(position, starts) - np.minimum.reduceat(position, starts)
    widest = float(extent.max())
    if widest > LONGEST_M:
        raise LogError(
            f"{log}: {topic} spans {widest / 1000:.0f} km, more than {LONGEST_M / 1000:.0f} km; "
            "positions are expected in metres"
        )
    way = np.hypot(*np.diff(position, axis=0).T)
    way[odometry.breaks - 1] = 0
    duration = np.diff(odometry.time_ns) / 1e9
    moves = int((way > 0).sum())

    def usual_speed(beyond: float) -> float | None:
        """The median of the speeds beyond one that half of the steps exceed."""
        fast = way > beyond * duration
        return float(np.median(way[fast] / duration[fast])) if 2 * int(fast.sum()) > moves else None

    if (speed := usual_speed(FASTEST_M_PER_S)) is not None:
        raise LogError(
            f"{log}: {topic} moves at {speed:.0f} m/s, more than {FASTEST_M_PER_S:.0f} m/s; "
            f"positions are expected in metres; {ELSE}"
        )
    if (speed := usual_speed(DOUBTED_M_PER_S)) is not None:
        return (
            f"{topic} moves at {speed:.0f} m/s, as fast as a car: if it is none, are its positions "
            f"in centimetres? Expected: metres; {ELSE}"
        )
    return ""
