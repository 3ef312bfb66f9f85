"""The source of a run's junctions: a topic of detections, scans, clouds, or a grid."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass

from ..topology.errors import LogError, UsageError
from .logs.messages import Channel
from .logs.topics import (
    JUNCTIONS,
    Choice,
    Way,
    choose_junctions,
    choose_odometry,
    choose_sensors,
    listing,
)
from .read_settings import ReadSettings

SENSORS: tuple[Way, ...] = ("scan", "cloud", "grid")
"""Every kind of source but detections."""


@dataclass(frozen=True, slots=True)
class JunctionSource:
    """The kind of source, its topic, and topics of other kinds that were passed over.

    beside: further topics of the same kind, e.g. of other lasers.
    """

    way: Way
    choice: Choice
    passed_over: tuple[str, ...] = ()
    beside: tuple[Choice, ...] = ()


def junction_source(
    counts: Mapping[Channel, int], settings: ReadSettings, log: str
) -> JunctionSource:
    """The first kind of source that the log has: detections, scans, clouds, grids.

    If a kind is asked for, no other is tried. Raises LogError if there is none, UsageError if a
    topic must be named.
    """
    ways = _ways_to_try(counts, settings)
    found = _first(ways, counts, settings, log)
    if found is not None:
        return found
    if len(ways) == 1:
        _choices(ways[0], counts, settings, log)  # raises why not
    types = {way: role.named for way, role in JUNCTIONS.items()}
    raise LogError(
        f"{log}: no junction detections found ({types['topic']}), and nothing to find them in: "
        f"no scans ({types['scan']}), no clouds ({types['cloud']}), no grid ({types['grid']}); "
        f"{listing(counts)}; if one of them holds junctions, name it by --junction-topic and its "
        "fields by --junction-fields"
    )


def source_to_read(
    counts: Mapping[Channel, int], settings: ReadSettings, log: str
) -> JunctionSource:
    """`junction_source`; a UsageError names the topics of odometry as well, if there are several to
    choose from."""
    try:
        return junction_source(counts, settings, log)
    except UsageError as error:
        try:
            choose_odometry(counts, settings.odometry_topic, log)
        except UsageError as other:
            raise UsageError(f"{error}; {str(other).removeprefix(f'{log}: ')}") from error
        raise


def views_source(
    counts: Mapping[Channel, int], settings: ReadSettings, log: str
) -> JunctionSource | None:
    """The scans, or else the clouds, that show the surroundings of places in a log with
    detections; None if there are none, or if nothing but detections was asked for."""
    if settings.junctions_from is not None:
        return None
    return _first(("scan", "cloud"), counts, settings, log)


def _first(
    ways: Iterable[Way], counts: Mapping[Channel, int], settings: ReadSettings, log: str
) -> JunctionSource | None:
    """The first of some kinds of source that the log has."""
    for way in ways:
        with suppress(LogError):
            choice, *beside = _choices(way, counts, settings, log)
            return JunctionSource(way, choice, _others(way, counts), tuple(beside))
    return None


def _ways_to_try(counts: Mapping[Channel, int], settings: ReadSettings) -> tuple[Way, ...]:
    if settings.junctions_from is not None:
        return (settings.junctions_from,)
    if settings.junction_topic is not None or settings.junction_fields is not None:
        return ("topic",)
    if settings.scan_topic is not None:
        named = "/" + settings.scan_topic.strip("/")
        types = {channel.type_name for channel in counts if channel.topic == named}
        return tuple(way for way in SENSORS if types & {*JUNCTIONS[way].types}) or ("scan",)
    return ("topic", *SENSORS)


def _choices(
    way: Way, counts: Mapping[Channel, int], settings: ReadSettings, log: str
) -> list[Choice]:
    if way == "topic":
        any_type = settings.junction_fields is not None
        return [choose_junctions(counts, settings.junction_topic, any_type, log)]
    found = choose_sensors(counts, settings.scan_topic, JUNCTIONS[way], log)
    # Of several robots in a log, that of the odometry has its sensors beside it.
    own = namespace(counts, settings, log)
    return sorted(found, key=lambda choice: not choice.topic.startswith(own))


def namespace(counts: Mapping[Channel, int], settings: ReadSettings, log: str) -> str:
    """The name of the odometry's topic up to its last slash; "/" if there is no such topic."""
    try:
        odometry = choose_odometry(counts, settings.odometry_topic, log)[0]
    except (LogError, UsageError):
        return "/"
    return odometry.topic.rpartition("/")[0] + "/"


def sensor_topics(counts: Mapping[Channel, int]) -> list[tuple[str, Way]]:
    """Every topic in which junctions can be detected, with the kind of source."""
    return sorted(
        {
            (channel.topic, way)
            for channel, count in counts.items()
            for way in SENSORS
            if count and channel.type_name in JUNCTIONS[way].types
        }
    )


def _others(way: Way, counts: Mapping[Channel, int]) -> tuple[str, ...]:
    """Topics of another kind that could be used as well."""
    if way not in ("topic", "scan"):
        return ()
    types = JUNCTIONS["scan" if way == "topic" else "topic"].types
    return tuple(sorted({c.topic for c, n in counts.items() if n and c.type_name in types}))
