"""Reading of one recorded run from a log of any format."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from ..topology.errors import DataError, LogError
from ..topology.odometry import Odometry
from ..topology.run import Detections, Run
from .frames import fixed_transforms
from .inspection import LogInfo, TopicInfo, inspect_log
from .junction_source import JunctionSource, sensor_topics, source_to_read, views_source
from .logs.finding import find_logs, with_parts_joined
from .logs.grids import GridLog, last_grid
from .logs.recording import Recording, log_exists, log_fingerprint, log_size, recording_at, run_name
from .logs.saved_map import is_saved_map, read_saved_map
from .logs.topics import Choice
from .odometry.conventions import disagreements
from .odometry.jumps import times
from .odometry.kidnapping import split_where_carried
from .odometry.reading import because, described, driven, odometry_topic, poses_of
from .odometry.track import Track
from .read_settings import DEFAULT_READ, ReadSettings
from .remote.path import LogPath
from .sightings import robot_frame_sightings
from .survey import LogRead, OnKeyframes, Progress, damage_of, kept, surveyed
from .topic_poses import Clock, TopicPoses, choose_clock

__all__ = [
    "LogInfo",
    "ReadSettings",
    "TopicInfo",
    "find_logs",
    "inspect_log",
    "log_exists",
    "log_fingerprint",
    "log_size",
    "read_log",
    "read_run",
    "run_name",
    "with_parts_joined",
]

OnBytes = Callable[[int], None]


def read_run(
    path: LogPath, settings: ReadSettings = DEFAULT_READ, *, on_bytes: OnBytes | None = None
) -> Run:
    """`read_log` for a log that holds a run; LogError if it holds only a grid."""
    found = read_log(path, settings, on_bytes=on_bytes)
    if isinstance(found, GridLog):
        raise LogError(f"{path}: holds a grid, but no run")
    return found


def read_log(
    path: LogPath,
    settings: ReadSettings = DEFAULT_READ,
    *,
    on_bytes: OnBytes | None = None,
    on_keyframes: OnKeyframes | None = None,
) -> Run | GridLog:
    """Read the odometry of one log, and its junction detections or the sensors to find junctions
    in.

    A saved map, or a log without any other source, gives a grid.

    path: an MCAP file, a ROS 1 bag, a ROS 2 bag folder, or a folder with the parts of one
    recording. on_bytes is called with the number of further bytes of `log_size(path)` processed,
    on_keyframes with the scans (`scans.keyframes.Keyframes`) of a run with scans; these are then
    matched with each other, and no junctions looked for.
    What remains of a damaged log is used, with warnings in the run. Raises LogError if there is
    nothing to use, UsageError if a topic must be named. O(bytes read); memory follows the poses
    kept.
    """
    log = str(path)
    recording = recording_at(path)
    if is_saved_map(recording.path):
        return _saved_map(recording, recording.path, on_bytes)
    recording, index = surveyed(recording)
    # Scans are read in a pass of their own.
    passes = 1 + any(
        way in ("scan", "cloud") for _, way in sensor_topics(index.counts if index else {})
    )
    progress = Progress(recording.bytes, passes, on_bytes)
    intake, findings = kept(recording, settings, progress, index)
    if findings.messages == 0:
        reason = "; ".join(damage_of(recording)) or "it holds no messages"
        raise LogError(f"{log}: nothing can be read: {reason}")
    warnings = _damage(recording, settings)
    read = LogRead(recording, intake, findings.counts, settings, tuple(warnings), progress)
    read = replace(read, on_keyframes=on_keyframes)
    try:
        source = source_to_read(findings.counts, settings, log)
        found = READERS[source.way](read, source)
    except DataError as error:
        # The damage may be the reason.
        kind = LogError if isinstance(error, LogError) else DataError
        raise kind("; ".join([str(error), *damage_of(recording)])) from error
    finally:
        progress.finish()
    further = [damage for damage in _damage(recording, settings) if damage not in warnings]
    return replace(found, warnings=(*found.warnings, *further))


def _with_detections(read: LogRead, junction: JunctionSource) -> Run:
    """The run of a log with junction detections."""
    settings, warnings = read.settings, list(read.warnings)
    odometry = odometry_topic(read)
    junctions = _junctions(read, junction.choice)
    clock = choose_clock(odometry.poses, junctions, settings.time, warnings)
    about: dict[str, Any] = {
        "odometry": described(odometry.choice, odometry.poses),
        "junctions": described(junction.choice, junctions),
        "time": clock,
    }
    if junction.passed_over:
        about["junctions"]["passed_over"] = list(junction.passed_over)
    track = driven(odometry, clock, read)
    detections, left_out = _sightings(read, junction.choice, junctions, clock, track.recorded)
    warnings += [*track.warnings, *left_out]
    topics = odometry.choice.topic, junction.choice.topic
    misread = disagreements(track.recorded, detections, *topics)
    warnings += misread
    split, carried = split_where_carried(track.odometry, detections)
    if carried:
        warnings.append(
            f"the wheels stand while the junction in view changes {times(carried)}: the robot was "
            "carried; the chain is split there"
        )
    run = Run(read.run, split, detections, about, tuple(warnings), misread=bool(misread))
    return _with_views(read, run, odometry.frames[1] or "base_link", clock, track)


def _with_views(read: LogRead, run: Run, body: str, clock: Clock, track: Track) -> Run:
    """A run with detections, and what its lasers saw around places, if it has any."""
    source = views_source(read.counts, read.settings, read.log)
    if source is None:
        return run
    from .scan_reading import views_beside  # loads what most runs do without

    try:
        views, about, warnings = views_beside(read, source, body, clock, track)
    except DataError as error:
        warnings = [f"places are known by their junctions alone: {error}"]
        return replace(run, warnings=(*run.warnings, *warnings))
    about = {**run.source, "views": about}
    return replace(run, views=views, source=about, warnings=(*run.warnings, *warnings))


def _with_scans(read: LogRead, source: JunctionSource) -> Run:
    from .scan_reading import with_scans  # loads what most runs do without

    return with_scans(read, source)


def _saved_map(recording: Recording, path: Path, on_bytes: OnBytes | None) -> GridLog:
    grid, notes = read_saved_map(path)
    if on_bytes is not None:
        on_bytes(recording.bytes)
    about = {"from": "grid", "topic": recording.files[1].path.name, "type": "map_server"}
    return GridLog(run_name(path), grid, {"junctions": about}, notes)


def _recorded_grid(read: LogRead, source: JunctionSource) -> GridLog:
    """The last grid of a topic."""
    grid = last_grid(read.recording, source.choice.topic)
    about = {"from": "grid", "topic": source.choice.topic, "type": source.choice.type_name}
    return GridLog(read.run, grid, {"junctions": about}, read.warnings)


def _damage(recording: Recording, settings: ReadSettings) -> list[str]:
    """The faults of the log; LogError if there are any, in strict mode."""
    damage = damage_of(recording)
    if damage and settings.strict:
        raise LogError(f"{recording.path}: damaged: {'; '.join(damage)}")
    return damage


def _junctions(read: LogRead, choice: Choice) -> TopicPoses:
    poses = poses_of(read, choice)
    if len(poses) == 0:
        raise LogError(
            f"{read.log}: {choice.topic} holds no usable pose{because(poses, choice.topic)}"
        )
    return poses


def _sightings(
    read: LogRead, choice: Choice, poses: TopicPoses, clock: Clock, odometry: Odometry
) -> tuple[Detections, list[str]]:
    """The detections in the robot's frame, and warnings; raises LogError if none is left."""
    frames = [frame for frame, _ in poses.frames]
    detections, warnings = robot_frame_sightings(
        poses.columns,
        poses.time_ns(clock),
        frames,
        odometry,
        partial(fixed_transforms, read.recording),
    )
    warnings = [*poses.warnings(choice.topic), *warnings]
    if len(detections) == 0:
        raise LogError(f"{read.log}: no usable junction detection: {'; '.join(warnings)}")
    return detections, warnings


READERS: Mapping[str, Callable[[LogRead, JunctionSource], Run | GridLog]] = {
    "topic": _with_detections,
    "scan": _with_scans,
    "cloud": _with_scans,
    "grid": _recorded_grid,
}
