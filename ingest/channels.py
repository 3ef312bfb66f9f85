"""Selection of a log's channels, their decoders, and early checks of both."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from ..topology.errors import LogError, UsageError
from .junction_source import junction_source
from .logs.fields import JunctionFields, fields_decoder
from .logs.intake import Intake, decoder_for
from .logs.messages import Channel
from .logs.poses import PoseDecoder
from .logs.recording import Recording
from .logs.topics import JUNCTION_KINDS, ODOMETRY_KINDS, choose_odometry
from .read_settings import ReadSettings
from .topic_poses import TopicPoses

TRIED = 100
"""Number of messages tried before all are read."""


def acceptance(
    counts: Mapping[Channel, int] | None, settings: ReadSettings, log: str
) -> Callable[[Channel], bool]:
    """Which channels to keep: the chosen ones if the index lists them, else all candidates."""
    named = {
        f"/{name.strip('/')}"
        for name in (settings.odometry_topic, settings.junction_topic)
        if name is not None
    }
    if settings.junction_fields is not None:
        named.add("/junctions")
    types = {*ODOMETRY_KINDS, *JUNCTION_KINDS}
    if counts is None:
        return lambda channel: channel.topic in named or channel.type_name in types
    listed = {channel.topic for channel in counts}
    chosen = _chosen(counts, settings, log)
    # A topic that the index forgot is kept as well: the choice is made again at the end.
    return lambda channel: (
        channel.topic in chosen or (channel.topic not in listed and channel.type_name in types)
    )


def _chosen(counts: Mapping[Channel, int], settings: ReadSettings, log: str) -> set[str]:
    """Topics of odometry and detections; scans are read separately, and need neither."""
    source = junction_source(counts, settings, log)
    detections = {source.choice.topic} if source.way == "topic" else set()
    if source.way == "grid":
        return set()
    try:
        return {c.topic for c in choose_odometry(counts, settings.odometry_topic, log)} | detections
    except LogError:
        if detections or settings.odometry_topic is not None:
            raise
        return set()


def decoders(settings: ReadSettings, log: str) -> Callable[[Channel], PoseDecoder]:
    """The decoder of each channel: by its type, or for junctions by the fields that are named."""
    if settings.junction_fields is None:
        return decoder_for
    fields = JunctionFields.parse(settings.junction_fields)
    named = settings.mapped_topic

    def by_topic(channel: Channel) -> PoseDecoder:
        if channel.topic != named:
            return decoder_for(channel)
        return fields_decoder(channel, fields, log)

    return by_topic


def kept_whole(settings: ReadSettings) -> Callable[[Channel], bool]:
    """Channels of detections, kept in three dimensions: their sensor's mounting is only known in
    the end."""
    return lambda channel: (
        channel.topic == settings.mapped_topic or channel.type_name in JUNCTION_KINDS
    )


def try_mapping(
    recording: Recording, counts: Mapping[Channel, int] | None, settings: ReadSettings
) -> None:
    """UsageError if none of the first messages of the mapped topic can be decoded, before all of
    the log is read. counts: what it holds, if that is known.

    Several messages are tried, because a single one that fails proves nothing.
    """
    known = None if counts is None else {c.topic for c, count in counts.items() if count}
    if settings.mapped_topic is None or (known is not None and settings.mapped_topic not in known):
        return
    topic, log = settings.mapped_topic, str(recording.path)
    intake = Intake(
        lambda channel: channel.topic == topic, decoders(settings, log), kept_whole(settings)
    )
    found = TopicPoses.of(())
    for block in recording.blocks(intake.want):
        intake.take(block.rows(slice(TRIED)))
        found = TopicPoses.of(intake.of_topic(topic))
        if found.failed < found.messages:
            return
        if found.messages >= TRIED:
            break
    if found.messages:
        raise UsageError(f"{log}: {topic}: --junction-fields: {found.reason}")
