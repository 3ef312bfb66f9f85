"""The first pass over a log: its indexes, the channels that are kept, and what is damaged."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from ..topology.errors import LogError, UsageError
from .junction_source import source_to_read
from .logs.fields import JunctionFields, fields_decoder
from .logs.intake import Intake, decoder_for
from .logs.messages import Channel, Findings, Survey, several
from .logs.poses import PoseDecoder
from .logs.recording import Recording, run_name
from .logs.topics import JUNCTION_KINDS, ODOMETRY_KINDS, choose_odometry
from .read_settings import ReadSettings
from .topic_poses import TopicPoses

OnBytes = Callable[[int], None]
OnKeyframes = Callable[[Any], object]
"""Takes `scans.keyframes.Keyframes`, which most runs do without."""


def surveyed(recording: Recording, exact: bool = False) -> tuple[Recording, Survey | None]:
    """The files sorted by their start, and their combined indexes; None if some file has none.

    A file that is compressed as a whole is only decompressed if `exact`.
    """
    surveys: list[Survey] = []
    for file in recording.files:
        if file.packed and not exact:
            return recording, None
        with file.opened() as log:
            survey = log.survey(exact)
        if survey is None:
            return recording, None
        surveys.append(survey)
    order = sorted(range(len(surveys)), key=lambda k: (surveys[k].start_ns, k))
    counts: Counter[Channel] = Counter()
    for survey in surveys:
        counts.update(survey.counts)
    filled = [survey for survey in surveys if any(survey.counts.values())]
    start = min((survey.start_ns for survey in filled), default=0)
    end = max((survey.end_ns for survey in filled), default=0)
    by_start = replace(recording, files=tuple(recording.files[k] for k in order))
    sure = all(survey.sure for survey in surveys)
    return by_start, Survey(counts, start, end, sure)


def walk(recording: Recording, intake: Intake, on_bytes: OnBytes | None = None) -> Findings:
    """Keep the messages of a recording; the calls of on_bytes add up to its size."""
    intake.expect(recording.bytes)
    for block in recording.blocks(intake.want, on_bytes):
        intake.take(block)
        del block  # its memory, still in the processor's cache, serves the next one
    return recording.passes[-1]


def kept(
    recording: Recording, settings: ReadSettings, progress: Progress, index: Survey | None
) -> tuple[Intake, Findings]:
    """The messages of a log that are kept, and the findings of one pass over it.

    index: its claimed contents; one without a checksum may be wrong, and does not count.
    """
    log = str(recording.path)
    counts = index.counts if index is not None and index.sure else None
    accept = acceptance(counts, settings, log)
    try_mapping(recording, counts, settings)
    recording.passes.clear()
    intake = _intake(accept, settings, log)
    return intake, walk(recording, intake, progress)


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
    chosen = _chosen(counts, settings, log)
    return lambda channel: channel.topic in chosen


def _chosen(counts: Mapping[Channel, int], settings: ReadSettings, log: str) -> set[str]:
    """Topics of odometry and detections; scans are read separately, and need neither."""
    source = source_to_read(counts, settings, log)
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


def _intake(accept: Callable[[Channel], bool], settings: ReadSettings, log: str) -> Intake:
    """An intake of the accepted channels."""

    def kept_whole(channel: Channel) -> bool:
        # Detections, in three dimensions: their sensor's mounting is only known in the end.
        return channel.topic == settings.mapped_topic or channel.type_name in JUNCTION_KINDS

    return Intake(accept, decoders(settings, log), kept_whole)


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
    intake = _intake(lambda channel: channel.topic == topic, settings, log)
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


def damage_of(recording: Recording) -> list[str]:
    """The faults of a log that passes over all of it found, the first one with what could be
    read."""
    first, *others = recording.passes or [Findings()]
    damage = [*recording.notes, *first.damage]
    if recording.declared is not None and first.messages < recording.declared:
        damage.append(
            f"metadata.yaml counts {several(recording.declared, 'message')}, "
            f"{first.messages} {'was' if first.messages == 1 else 'were'} found"
        )
    return list(dict.fromkeys([*damage, *(loss for found in others for loss in found.losses)]))


@dataclass(slots=True, eq=False)
class Progress:
    """Progress of several passes over a log, reported as if it were one.

    size: of the log [bytes]; walks: number of passes.
    """

    size: int
    walks: int
    on_bytes: OnBytes | None
    _reported: int = 0
    _read: int = 0

    def __call__(self, count: int) -> None:
        """Report that so many more bytes were read, in any pass."""
        self._read = min(self._read + count, self.walks * self.size)
        upto = self._read // self.walks
        if self.on_bytes is not None and upto > self._reported:
            self.on_bytes(upto - self._reported)
            self._reported = upto

    def finish(self) -> None:
        """Report that all passes are done."""
        self(self.walks * self.size)


@dataclass(frozen=True, slots=True)
class LogRead:
    """The result of one pass over a log; warnings: damage; progress: of further passes;
    on_keyframes: takes the scans that a run's track was made from."""

    recording: Recording
    intake: Intake
    counts: Mapping[Channel, int]
    settings: ReadSettings
    warnings: tuple[str, ...]
    progress: Progress
    on_keyframes: OnKeyframes | None = None

    @property
    def log(self) -> str:
        """The path, for messages."""
        return str(self.recording.path)

    @property
    def run(self) -> str:
        """The run's name."""
        return run_name(self.recording.path)
