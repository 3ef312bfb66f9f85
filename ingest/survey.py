"""The indexes of a recording, and a pass over all of its files."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from ..topology.errors import LogError
from .logs.intake import Intake
from .logs.messages import Channel, Findings, Survey, several
from .logs.recording import Recording, run_name
from .read_settings import ReadSettings

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
    counts: dict[Channel, int] = {}
    for survey in surveys:
        for channel, count in survey.counts.items():
            counts[channel] = counts.get(channel, 0) + count
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


def damage_of(recording: Recording, findings: Findings) -> list[str]:
    """The faults of a log that was read whole."""
    damage = [*recording.notes, *findings.damage]
    if recording.declared is not None and findings.messages < recording.declared:
        damage.append(
            f"metadata.yaml counts {several(recording.declared, 'message')}, "
            f"{findings.messages} {'was' if findings.messages == 1 else 'were'} found"
        )
    return damage


@dataclass(slots=True, eq=False)
class Progress:
    """Progress of several passes over a log, reported as if it were one.

    size: of the log [bytes]; walks: number of passes.
    """

    size: int
    walks: int
    on_bytes: OnBytes | None
    told: int = 0
    _read: int = 0

    def __call__(self, count: int) -> None:
        """Report that so many more bytes were read, in any pass."""
        self._read += count
        self._tell(min(self._read // self.walks, self.size))

    def finish(self) -> None:
        """Report that all passes are done."""
        self._tell(self.size)

    def _tell(self, upto: int) -> None:
        if self.on_bytes is not None and upto > self.told:
            self.on_bytes(upto - self.told)
            self.told = upto


def further_damage(recording: Recording) -> list[str]:
    """The faults of a log that only passes after the first one found."""
    known, sentences = recording.passes[:1], list[str]()
    for found in recording.passes[1:]:
        if further := found.beyond(known).damage:
            known.append(found)
            sentences += further
    return sentences


def checked_damage(log: str, damage: list[str], settings: ReadSettings) -> list[str]:
    """The faults of a log; LogError if there are any, in strict mode."""
    if damage and settings.strict:
        raise LogError(f"{log}: damaged: {'; '.join(damage)}")
    return damage


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
