"""The cost of reading a remote log, by its index alone."""

from __future__ import annotations

from collections.abc import Callable

from ..topology.errors import LogError
from .channels import acceptance
from .junction_source import JunctionSource, junction_source
from .logs.chunks import ChunkedLog
from .logs.messages import UNWANTED, Channel
from .logs.recording import Recording, recording_at
from .logs.topics import TRANSFORM_KINDS
from .read_settings import ReadSettings
from .remote.path import RemotePath
from .remote.source import HELD_BYTES
from .survey import surveyed

Accept = Callable[[Channel], bool]


def read_cost(path: RemotePath, settings: ReadSettings) -> int:
    """Number of bytes still to be fetched to read a log; 0 for one that will be refused.

    A log with scans is read once for its odometry, once for its transforms, and once for the scans
    of every laser. What fits into memory is fetched once, otherwise every time.
    """
    recording, index = surveyed(recording_at(path))
    if index is None:
        return recording.bytes if path.allow_scan else 0
    log = str(path)
    accept = acceptance(index.counts, settings, log)
    source = junction_source(index.counts, settings, log)
    passes = [accept, *_further_passes(source, settings)]
    together = _cost(recording, lambda channel: any(each(channel) for each in passes))
    if together <= HELD_BYTES:
        return together
    return sum(_cost(recording, each) for each in passes)


def _further_passes(source: JunctionSource, settings: ReadSettings) -> list[Accept]:
    """What is read in addition to odometry and detections, pass by pass."""
    if source.way == "topic":
        return []
    choices = [source.choice, *(source.beside if source.way == "scan" else ())]
    sensors = [_of_topic(choice.topic) for choice in choices]
    if source.way == "grid" or settings.laser_pose is not None:
        return sensors
    return [*sensors, lambda channel: channel.type_name in TRANSFORM_KINDS]


def _of_topic(topic: str) -> Accept:
    return lambda channel: channel.topic == topic


def _cost(recording: Recording, accept: Accept) -> int:
    total = 0
    for file in recording.files:
        log = file.container
        if not isinstance(log, ChunkedLog):
            raise LogError(f"{file.path}: can only be read as a whole")
        total += log.cost(lambda channel: 0 if accept(channel) else UNWANTED)
    return total
