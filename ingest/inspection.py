"""The contents of a log, and which of them would be used."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ..topology.errors import LogError, UsageError
from .junction_source import JunctionSource, junction_source, sensor_topics, views_source
from .logs.intake import Intake
from .logs.messages import Channel, Survey
from .logs.recording import Recording, recording_at, run_name
from .logs.saved_map import is_saved_map, read_saved_map
from .logs.topics import Way, choose_odometry, odometry_topics
from .read_settings import DEFAULT_READ, ReadSettings
from .remote.path import LogPath
from .survey import damage_of, surveyed, try_mapping, walk


@dataclass(frozen=True, slots=True)
class TopicInfo:
    """One topic of a log.

    use: "odometry", "junctions", "scans", "clouds", "grid" or ""; why: the reason, also for topics
    that could be used but are not.
    """

    topic: str
    type_name: str
    messages: int
    use: str = ""
    why: str = ""


@dataclass(frozen=True, slots=True)
class LogInfo:
    """The contents of a log. start_ns, duration_s: None for a saved map; problems: one sentence
    each, empty for a whole, usable log; warnings: those of reading it whole, if it was; usable:
    whether ingest could use what is there, though it may be damaged."""

    path: LogPath
    name: str
    format: str
    bytes: int
    start_ns: int | None
    duration_s: float | None
    topics: tuple[TopicInfo, ...]
    problems: tuple[str, ...]
    warnings: tuple[str, ...] = ()
    usable: bool = True


def inspect_log(path: LogPath, settings: ReadSettings = DEFAULT_READ) -> LogInfo:
    """The contents of a log and what `read_run` would use. Reads the index, or everything if there
    is none."""
    recording = recording_at(path)
    if is_saved_map(recording.path):
        return _saved_map_info(recording, recording.path)
    recording, survey = surveyed(recording, exact=True)
    problems = list(recording.notes)
    if survey is None:
        findings = walk(recording, Intake(lambda _: False))
        problems = damage_of(recording)
        survey = Survey(findings.counts, findings.first_ns or 0, findings.last_ns or 0)
    damage = len(problems)
    uses = _uses(recording, survey.counts, settings, problems)
    topics: Counter[tuple[str, str]] = Counter()
    for channel, count in survey.counts.items():
        topics[channel.topic, channel.type_name] += count
    return LogInfo(
        recording.path,
        run_name(recording.path),
        "+".join(sorted({file.kind or "" for file in recording.files})),
        recording.bytes,
        survey.start_ns,
        (survey.end_ns - survey.start_ns) / 1e9,
        tuple(
            TopicInfo(topic, type_name, count, *uses.get(topic, ("", "")))
            for (topic, type_name), count in sorted(topics.items())
        ),
        tuple(problems),
        usable=len(problems) == damage,
    )


def as_read(found: LogInfo, source: Mapping[str, Any]) -> LogInfo:
    """The contents of a log, with what was left out of it once it was read; source: of the run."""
    left_out = source.get("left_out", {})

    def with_use(topic: TopicInfo) -> TopicInfo:
        why = left_out.get(topic.topic)
        return topic if why is None else replace(topic, use="", why=f"not used: {why}")

    return replace(found, topics=tuple(with_use(topic) for topic in found.topics))


def _saved_map_info(recording: Recording, path: Path) -> LogInfo:
    """A saved map, as a log with one message."""
    problems: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    why = ""
    try:
        grid, notes = read_saved_map(path)
        height, width = grid.free.shape
        why = f"{width} x {height} cells of {grid.resolution_m:g} m"
    except LogError as error:
        problems = (str(error),)
    image = TopicInfo(recording.files[1].path.name, "map_server", 1, "grid", why)
    name = run_name(path)
    found = LogInfo(path, name, "saved map", recording.bytes, None, None, (image,), problems)
    return replace(found, warnings=notes, usable=not problems)


def _uses(
    recording: Recording, counts: Mapping[Channel, int], settings: ReadSettings, problems: list[str]
) -> dict[str, tuple[str, str]]:
    """For each topic its use and the reason; what is missing is added to the problems."""
    log = str(recording.path)
    uses: dict[str, tuple[str, str]] = {}
    source: JunctionSource | None = None
    missing: list[str] = []
    try:
        source = junction_source(counts, settings, log)
        if source.way == "topic":
            try_mapping(recording, counts, settings)
    except (LogError, UsageError) as error:
        missing.append(str(error))
    try:
        for rank, choice in enumerate(choose_odometry(counts, settings.odometry_topic, log)):
            why = choice.why if rank == 0 else f"{choice.why}, if no better one serves"
            uses[choice.topic] = ("odometry", why)
    except (LogError, UsageError) as error:
        # A grid needs no odometry, scans can do without.
        if source is None or source.way == "topic" or isinstance(error, UsageError):
            problems.append(str(error))
    problems += missing
    chosen = [topic for topic, (use, _) in uses.items() if use == "odometry"]
    for topic in odometry_topics(counts) if chosen else []:
        uses.setdefault(topic, ("", f"not used; --odometry-topic {topic} takes it for odometry"))
    shown = views_source(counts, settings, log) if source and source.way == "topic" else None
    walls = {choice.topic for choice in (shown.choice, *shown.beside)} if shown else set()
    for topic, way in sensor_topics(counts):
        use = "shows the walls around places" if topic in walls else "not used"
        uses[topic] = (NAMES[way], f"{use}; --junctions-from {way} finds junctions in it")
    if source is not None:
        beside = source.beside if source.way in ("scan", "cloud") else ()
        for choice in (source.choice, *beside):
            uses[choice.topic] = (NAMES[source.way], choice.why)
    return uses


NAMES: Mapping[Way, str] = {
    "topic": "junctions",
    "scan": "scans",
    "cloud": "clouds",
    "grid": "grid",
}
