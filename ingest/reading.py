"""Reads one recorded run out of whatever log holds it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ..topology.errors import LogError, UsageError
from ..topology.odometry import Odometry
from ..topology.run import Run
from .channels import acceptance, check_mapping, decoders, junction_choice, kept_whole
from .frames import NO_TRANSFORMS, FixedCollector, FixedTransforms
from .logs.intake import Intake, no_columns
from .logs.messages import Channel, Findings, Survey
from .logs.recording import (
    Recording,
    find_logs,
    log_fingerprint,
    log_size,
    opened,
    recording_at,
    run_name,
    sniff,
)
from .logs.topics import (
    ODOMETRY_KINDS,
    TRANSFORM_KINDS,
    Choice,
    choose_odometry,
    listing,
)
from .odometry.jumps import times, without_jumps
from .odometry.kidnapping import split_where_carried
from .odometry.plausible import check_plausible
from .odometry.track import Track, sane_track
from .read_settings import DEFAULT_READ, ReadSettings
from .sightings import Sightings, robot_frame_sightings, side_of
from .sources import (
    Clock,
    Source,
    choose_clock,
    clock_without_jumps,
    other_odometries,
    pair_of_poses,
    pair_of_transforms,
    told_pairs,
)

__all__ = [
    "LogInfo",
    "ReadSettings",
    "TopicInfo",
    "find_logs",
    "inspect_log",
    "log_fingerprint",
    "log_size",
    "read_run",
    "run_name",
]

OnBytes = Callable[[int], None]


@dataclass(frozen=True, slots=True)
class TopicInfo:
    """One topic of a log: `use` is "odometry", "junctions" or "", `why` the reason."""

    topic: str
    type_name: str
    messages: int
    use: str = ""
    why: str = ""


@dataclass(frozen=True, slots=True)
class LogInfo:
    """What a log holds. `problems`: one sentence each, empty for a whole, usable log."""

    path: Path
    name: str
    format: str
    bytes: int
    start_ns: int
    duration_s: float
    topics: tuple[TopicInfo, ...]
    problems: tuple[str, ...]


def read_run(
    path: Path, settings: ReadSettings = DEFAULT_READ, *, on_bytes: OnBytes | None = None
) -> Run:
    """Read the odometry and the junction sightings of one log.

    path: an MCAP file, a ROS 1 bag, a ROS 2 bag folder, or a folder with the parts of one
    recording. on_bytes is told how many more bytes of `log_size(path)` are done. What a damaged
    log still holds is used and reported in the run's warnings. Raises LogError if there is nothing
    to use, UsageError if a topic must be named. O(bytes read); memory follows the poses kept.
    """
    log = str(path)
    recording = recording_at(Path(path))
    recording, survey = _surveyed(recording)
    accept = acceptance(survey.counts if survey else None, settings, log)
    if survey is not None:
        check_mapping(recording, survey.counts, settings, log)
    intake = Intake(accept, decoders(settings, log), kept_whole(settings))
    findings = _walk(recording, intake, on_bytes)
    warnings = _damage(recording, findings, settings)
    try:
        odometry_choice, odometry, frames = _odometry(intake, findings.counts, settings, log)
        junction_choice, junctions = _junctions(intake, findings.counts, settings, log)
    except LogError as error:
        # What is missing may be what is damaged.
        raise LogError("; ".join([str(error), *warnings])) from error
    clock = choose_clock(odometry, junctions, settings.time, warnings)
    clock = clock_without_jumps(odometry, clock, settings.track.backward_min_s, warnings)
    described = _described(odometry_choice, odometry), _described(junction_choice, junctions)
    track = _track(odometry_choice, odometry, frames=frames, clock=clock, settings=settings)
    driven = without_jumps(track.odometry, track.jumps)
    # As recorded, but drive by drive: a reset may lead anywhere.
    drives = replace(track.odometry, breaks=driven.breaks)
    check_plausible(drives, odometry_choice.topic, log)
    fixed = _fixed_transforms(recording, junctions, track.odometry)
    sightings = _sightings(
        junction_choice,
        junctions,
        clock=clock,
        track=track,
        fixed=fixed,
        settings=settings,
        log=log,
    )
    source = {"odometry": described[0], "junctions": described[1], "time": clock}
    warnings += [*track.warnings, *sightings.warnings]
    odometry_split, carried = split_where_carried(driven, sightings.detections)
    if carried:
        warnings.append(
            f"the wheels stand while the junction in view changes {times(carried)}: the robot was "
            "carried; the chain is split there"
        )
    return Run(
        run_name(recording.path), odometry_split, sightings.detections, source, tuple(warnings)
    )


def inspect_log(path: Path, settings: ReadSettings = DEFAULT_READ) -> LogInfo:
    """What a log holds and what `read_run` would use. Reads the index, or all if there is none."""
    recording, survey = _surveyed(recording_at(Path(path)), exact=True)
    problems = list(recording.notes)
    if survey is None:
        findings = _walk(recording, Intake(lambda _: False), None)
        problems += findings.damage
        survey = _Survey(dict(findings.counts), findings.first_ns or 0, findings.last_ns or 0)
    uses = _uses(recording, survey.counts, settings, problems)
    topics: dict[tuple[str, str], int] = {}
    for channel, count in survey.counts.items():
        key = channel.topic, channel.type_name
        topics[key] = topics.get(key, 0) + count
    return LogInfo(
        recording.path,
        run_name(recording.path),
        "+".join(sorted({sniff(file) or "" for file in recording.files})),
        recording.bytes,
        survey.start_ns,
        (survey.end_ns - survey.start_ns) / 1e9,
        tuple(
            TopicInfo(topic, type_name, count, *uses.get(topic, ("", "")))
            for (topic, type_name), count in sorted(topics.items())
        ),
        tuple(problems),
    )


# Surveying


@dataclass(frozen=True, slots=True)
class _Survey:
    """What the indexes of all files say together."""

    counts: dict[Channel, int]
    start_ns: int
    end_ns: int


def _surveyed(recording: Recording, exact: bool = False) -> tuple[Recording, _Survey | None]:
    """The files by their start, and what their indexes say; None if some file has none.

    A file that is compressed as a whole is only unpacked for exactness.
    """
    surveys: list[Survey] = []
    for file in recording.files:
        if sniff(file) == "zstd" and not exact:
            return recording, None
        with opened(file) as log:
            survey = log.survey(exact)
        if survey is None:
            return recording, None
        surveys.append(survey)
    order = sorted(range(len(surveys)), key=lambda k: (surveys[k].start_ns, k))
    counts: dict[Channel, int] = {}
    for survey in surveys:
        for channel, count in survey.counts.items():
            counts[channel] = counts.get(channel, 0) + count
    filled = [survey for survey in surveys if any(survey.counts.values())]
    start = min((survey.start_ns for survey in filled), default=0)
    end = max((survey.end_ns for survey in filled), default=0)
    by_start = replace(recording, files=tuple(recording.files[k] for k in order))
    return by_start, _Survey(counts, start, end)


def _uses(
    recording: Recording,
    counts: Mapping[Channel, int],
    settings: ReadSettings,
    problems: list[str],
) -> dict[str, tuple[str, str]]:
    """Per topic what it would be used for and why; what is missing becomes a problem."""
    log = str(recording.path)
    uses: dict[str, tuple[str, str]] = {}
    try:
        for rank, choice in enumerate(choose_odometry(counts, settings.odometry_topic, log)):
            why = choice.why if rank == 0 else f"{choice.why}, if no better one serves"
            uses[choice.topic] = ("odometry", why)
    except (LogError, UsageError) as error:
        problems.append(str(error))
    try:
        choice = junction_choice(counts, settings, log)
        uses[choice.topic] = ("junctions", choice.why)
        check_mapping(recording, counts, settings, log)
    except (LogError, UsageError) as error:
        problems.append(str(error))
    return uses


# Reading


def _walk(recording: Recording, intake: Intake, on_bytes: OnBytes | None) -> Findings:
    """Read all files; on_bytes is told exactly the size of the recording in the end."""
    findings = Findings()
    for file in recording.files:
        told = 0

        def progress(count: int) -> None:
            nonlocal told
            told += count
            if on_bytes is not None:
                on_bytes(count)

        packed = sniff(file) == "zstd"
        with opened(file) as log:
            for block in log.blocks(intake.want, findings, None if packed else progress):
                intake.take(block)
        if file.stat().st_size > told:
            progress(file.stat().st_size - told)
    return findings


def _damage(recording: Recording, findings: Findings, settings: ReadSettings) -> list[str]:
    """What is wrong with the log; raises LogError if nothing is left, or if it is to be strict."""
    damage = [*recording.notes, *findings.damage]
    if recording.declared is not None and findings.messages < recording.declared:
        damage.append(
            f"metadata.yaml counts {recording.declared} messages, {findings.messages} were found"
        )
    if findings.messages == 0:
        reason = "; ".join(damage) or "it holds no messages"
        raise LogError(f"{recording.path}: nothing can be read: {reason}")
    if damage and settings.strict:
        raise LogError(
            f"{recording.path}: damaged, and --strict was asked for: {'; '.join(damage)}"
        )
    return damage


def _odometry(
    intake: Intake, counts: Mapping[Channel, int], settings: ReadSettings, log: str
) -> tuple[Choice, Source, tuple[str, str]]:
    """The first choice whose content serves: its poses between one pair of frames."""
    base = settings.base_frame.lstrip("/") if settings.base_frame else None
    reasons = []
    for choice in choose_odometry(counts, settings.odometry_topic, log):
        source = _source(intake, counts, choice.topic, log)
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
            return choice, source, (parent, child or base or "")
        lack = "no transform from an odom frame" if transforms else "no usable pose"
        if base is not None and len(source):
            lack += f" to {base} (--base-frame); it has {told_pairs(source.frames)}"
        reasons.append(f"{choice.topic} holds {lack}" + _because(source, choice.topic))
    raise LogError(f"{log}: no odometry: {', '.join(reasons)}; {listing(counts)}")


def _source(intake: Intake, counts: Mapping[Channel, int], topic: str, log: str) -> Source:
    """What a topic gave; messages of its channels that have no decoder count as failed ones."""
    intake.check(topic, log)
    source = Source.of(intake.of_topic(topic))
    refused = sum(counts.get(c, 0) for c in intake.refused if c.topic == topic)
    source.messages += refused
    source.failed += refused
    return source


def _because(source: Source, topic: str) -> str:
    reasons = source.warnings(topic)
    return f" ({'; '.join(reasons)})" if reasons else ""


def _junctions(
    intake: Intake, counts: Mapping[Channel, int], settings: ReadSettings, log: str
) -> tuple[Choice, Source]:
    choice = junction_choice(counts, settings, log)
    source = _source(intake, counts, choice.topic, log)
    if len(source) == 0:
        raise LogError(
            f"{log}: {choice.topic} holds no usable pose{_because(source, choice.topic)}"
        )
    return choice, source


def _described(choice: Choice, source: Source) -> dict[str, Any]:
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


def _fixed_transforms(
    recording: Recording, junctions: Source, odometry: Odometry
) -> FixedTransforms:
    """How frames of the robot lie to each other; the log is read again only where that is asked."""
    names = {frame for frame, _ in junctions.frames}
    if all(side_of(name, odometry.frame, odometry.child_frame) != "foreign" for name in names):
        return NO_TRANSFORMS
    collector = FixedCollector()
    intake = Intake(lambda channel: channel.type_name in TRANSFORM_KINDS, collector.decoder_for)
    _walk(recording, intake, None)
    for sink in intake.sinks:
        sink.flush()
    return collector.found


def _sightings(
    choice: Choice,
    source: Source,
    *,
    clock: Clock,
    track: Track,
    fixed: FixedTransforms,
    settings: ReadSettings,
    log: str,
) -> Sightings:
    """The detections in the robot's frame; raises LogError if none is left."""
    odometry = track.odometry
    frames = [frame for frame, _ in source.frames]
    sightings = robot_frame_sightings(
        source.columns,
        source.time_ns(clock),
        frames,
        odometry,
        fixed=fixed,
        settings=settings.sightings,
    )
    warnings = [*source.warnings(choice.topic), *sightings.warnings]
    if len(sightings.detections) == 0:
        raise LogError(f"{log}: no usable junction detection: {'; '.join(warnings)}")
    return Sightings(sightings.detections, tuple(warnings))
