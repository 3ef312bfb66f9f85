"""The record of how a log became a run, `cache/ingest/RUN.json` of a workspace."""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from pydantic import TypeAdapter, ValidationError

from ..ingest.remote.path import LogPath
from ..topology.errors import UsageError

if TYPE_CHECKING:
    from ..ingest.read_settings import ReadSettings

PIECE = re.compile(r"#[0-9]{1,9}")
"""What the name of a piece of a run ends with (RUN#2)."""


@dataclass(frozen=True, slots=True)
class IngestRecord:
    """What is known of a run's log; of an unknown one, nothing.

    log: its path; content: its fingerprint; key: digest of content, settings and program; bytes:
    its size; read: the settings that it was read by; version: that of topobatch; runs: those that
    it gave, views: those of them with views.
    """

    log: str | None = None
    content: str | None = None
    key: str = ""
    bytes: int | None = None
    read: dict[str, Any] = field(default_factory=dict)
    version: str | None = None
    runs: list[str] = field(default_factory=list)
    views: list[str] = field(default_factory=list)

    def pieces(self, run: str) -> list[str]:
        """The runs that the log of a run gave: one, or one per piece of a broken odometry. Names
        that ingest cannot give are left out: a record must not lead to other files."""
        return [
            each
            for each in self.runs
            if each == run or (each.startswith(run) and PIECE.fullmatch(each[len(run) :]))
        ]

    def settings(self) -> ReadSettings:
        """The settings by which the log was read, as far as they are known; damage does not matter
        any more."""
        from ..ingest.read_settings import DEFAULT_READ, ReadSettings  # which loads the readers

        try:
            return replace(TypeAdapter(ReadSettings).validate_python(self.read), strict=False)
        except (ValidationError, UsageError):
            return DEFAULT_READ


RECORD = TypeAdapter(IngestRecord)
"""Reads a record from a parsed document."""


def origin(log: LogPath) -> str:
    """The path of a log as a record states it; bytes that are no text are escaped."""
    return str(log.resolve()).encode("utf-8", "backslashreplace").decode()
