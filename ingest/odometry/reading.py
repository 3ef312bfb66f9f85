"""The odometry of a log: which topic it is, and a track out of what that topic gave."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from ...topology.errors import LogError
from ...topology.odometry import Odometry
from ..logs.intake import Intake, no_columns
from ..logs.messages import Channel
from ..logs.topics import ODOMETRY_KINDS, Choice, choose_odometry, decoded_alike, listing
from ..read_settings import ReadSettings
from ..sources import (
    Clock,
    Source,
    other_odometries,
    pair_of_poses,
    pair_of_transforms,
    told_pairs,
)
from .jumps import without_jumps
from .plausible import check_plausible
from .track import Track, sane_track


@dataclass(frozen=True, slots=True)
class OdometryTopic:
    """The topic of the odometry, what it gave, and its frames (parent, child)."""

    choice: Choice
    source: Source
    frames: tuple[str, str]


@dataclass(frozen=True, slots=True)
class Driven:
    """recorded: the track as it is in the log; odometry: the same over its jumps; warnings: one
    sentence per thing found wrong."""

    recorded: Odometry
    odometry: Odometry
    warnings: tuple[str, ...] = ()


def odometry_topic(
    intake: Intake, counts: Mapping[Channel, int], settings: ReadSettings, log: str
) -> OdometryTopic:
    """The first choice whose content serves: its poses between one pair of frames.

    Raises LogError if there is none, UsageError if a topic must be named.
    """
    base = settings.base_frame.lstrip("/") if settings.base_frame else None
    reasons = []
    for choice in choose_odometry(counts, settings.odometry_topic, log):
        source = source_of(intake, counts, choice, log)
        transforms = ODOMETRY_KINDS[choice.type_name][1] == "transforms"
        find = pair_of_transforms if transforms else pair_of_poses
        pair = find(source, base)
        if pair is not None:
            chosen = source.columns.frame == pair
            if transforms:
                source.rivals = other_odometries(source, pair)
            else:
                source.elsewhere = int((~chosen).sum())
            source.keep(chosen)
            parent, child = source.frames[pair]
            return OdometryTopic(choice, source, (parent, child or base or ""))
        lack = "no transform from an odom frame" if transforms else "no usable pose"
        if base is not None and len(source):
            lack += f" to {base} (--base-frame); it has {told_pairs(source.frames)}"
        reasons.append(f"{choice.topic} holds {lack}" + because(source, choice.topic))
    raise LogError(f"{log}: no odometry: {', '.join(reasons)}; {listing(counts)}")


def driven(topic: OdometryTopic, clock: Clock, settings: ReadSettings, log: str) -> Driven:
    """The way driven, by one clock; the topic's columns are empty afterwards.

    Raises LogError if no robot can have moved like that.
    """
    track = _track(topic.choice, topic.source, frames=topic.frames, clock=clock, settings=settings)
    odometry = without_jumps(track.odometry, track.jumps)
    # As recorded, but drive by drive: a reset may lead anywhere.
    resets = odometry.breaks
    drives = replace(track.odometry, breaks=resets) if len(resets) else track.odometry
    check_plausible(drives, track.bounds, topic.choice.topic, log)
    return Driven(track.odometry, odometry, track.warnings)


def source_of(intake: Intake, counts: Mapping[Channel, int], choice: Choice, log: str) -> Source:
    """What a topic gave; messages of its channels that have no decoder count as failed ones."""
    topic = choice.topic
    intake.check(topic, log)
    sinks = intake.of_topic(topic)
    alike = [sink for sink in sinks if decoded_alike(sink.channel.type_name, choice.type_name)]
    source = Source.of(alike)
    source.foreign = sum(sink.messages for sink in sinks) - source.messages
    refused = sum(counts.get(c, 0) for c in intake.refused if c.topic == topic)
    source.messages += refused
    source.failed += refused
    return source


def because(source: Source, topic: str) -> str:
    """What was wrong with the messages of a topic, in brackets."""
    reasons = source.warnings(topic)
    return f" ({'; '.join(reasons)})" if reasons else ""


def described(choice: Choice, source: Source) -> dict[str, Any]:
    """What the map document says about a topic: nothing that depends on the container."""
    return {"topic": choice.topic, "type": choice.type_name, "messages": source.messages}


def _track(
    choice: Choice,
    source: Source,
    *,
    frames: tuple[str, str],
    clock: Clock,
    settings: ReadSettings,
) -> Track:
    warnings = source.warnings(choice.topic)
    time_ns = source.time_ns(clock)
    if clock == "header" and not time_ns.all():
        zero = int((time_ns == 0).sum())
        warnings.append(f"{choice.topic}: {zero} messages carry no header time; left out")
        source.keep(time_ns != 0)
        time_ns = source.time_ns(clock)
    pose = source.columns.pose
    # Nothing else is needed of the columns: with a million poses they take 48 MB.
    source.columns = no_columns()
    track = sane_track(time_ns, pose, frames[0] or "odom", frames[1] or "base_link", settings.track)
    return replace(track, warnings=(*warnings, *track.warnings))
