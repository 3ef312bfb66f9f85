"""Recognising a merge without changes since the last one, whose output is then repeated.

A record in the cache is used if the program, its libraries, the options, the documents of all runs,
locks, discards, names of sites and the files of the merge all have the recorded checksums; else the
merge is done.
"""

from __future__ import annotations

import hashlib
import os
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal

from ..topology.errors import DocumentError
from ..topology.files import encoded, opened, read_json, write_json
from ..topology.wording import listed
from .output import Screen, folded
from .workspace import Workspace

Line = tuple[Literal["line", "folded", "verbose", "warning"], str]
"""A line of output and how it is printed; verbose: folded, and with --verbose only."""

FOLDERS = ("topology", "merge", "viz", "cli")
LIBRARIES = ("numpy", "scipy", "pydantic", "rerun-sdk", "pyarrow")
"""Libraries on which the files of a merge depend."""


@dataclass(frozen=True, slots=True)
class Said:
    """The output of a merge on the screen and in the journal."""

    lines: Sequence[Line]
    note: str

    def show(self, screen: Screen) -> None:
        """On the screen."""
        for kind, text in self.lines:
            if kind == "warning":
                screen.warn(text)
            elif kind != "verbose" or screen.verbose:
                for line in [text] if kind == "line" else folded(text):
                    screen.line(line)


def contents(place: Workspace, runs: Sequence[str]) -> dict[str, str | None]:
    """A digest of each run's map document, and of its views if there are any; None if the document
    cannot be read."""
    return {run: _content_of(place, run) for run in runs}


def _content_of(place: Workspace, run: str) -> str | None:
    document, views = (_content(place.maps / f"{run}.{kind}") for kind in ("json", "views"))
    if document is None or views is None:
        return document
    return hashlib.blake2b(encoded([document, views]), digest_size=16).hexdigest()


def changed_since(place: Workspace, merged: Mapping[str, str], runs: Sequence[str]) -> list[str]:
    """Those of the runs whose maps differ from the merged ones.

    merged: their `contents` by the document of the merge.
    """
    now = contents(place, [run for run in runs if run in merged])
    return [run for run, content in now.items() if content != merged[run]]


def told_changed(runs: Sequence[str]) -> str:
    """That the maps of these runs are not the ones that were merged."""
    return f"the map{'' if len(runs) == 1 else 's'} of {listed(runs, 3)} changed since the merge"


def made_from(place: Workspace, documents: Mapping[str, str | None], options: object) -> str:
    """A digest of everything that a merge depends on; documents: the runs' `contents`."""
    from ..merge.digests import program_digest  # which loads large arrays

    decisions = (place.locks_json, place.discards_json, place.sites_json)
    spoken = [(os.path.lexists(path), _content(path)) for path in decisions]
    libraries = [sys.version, *map(version, LIBRARIES)]
    where = [str(place.root), place.call("view", place.merge)]  # which is said
    every = [
        program_digest(*FOLDERS).hex(),
        libraries,
        where,
        repr(options),
        dict(documents),
        spoken,
    ]
    return hashlib.blake2b(encoded(every), digest_size=16).hexdigest()


def recalled(place: Workspace, asked: str) -> Said | None:
    """The output of the last merge, if it was made from the same digest and its files are
    unchanged."""
    try:
        found = read_json(place.merge_record)
        if not isinstance(found, dict) or _check(found["record"]) != found["check"]:
            return None
        record, files = found["record"], _files(place)
        if record["made_from"] != asked or record["files"] != files or None in files.values():
            return None
        return Said([(kind, str(text)) for kind, text in record["lines"]], str(record["note"]))
    except (DocumentError, OSError, KeyError, TypeError, ValueError):
        return None  # a cache: without it the merge is made


def remember(place: Workspace, asked: str, said: Said, screen: Screen) -> None:
    """Record the output of the current merge, all of whose maps were readable."""
    record = {"made_from": asked, "files": _files(place), **asdict(said)}
    try:
        write_json(place.merge_record, {"check": _check(record), "record": record})
    except OSError as error:
        screen.warn(f"{place.merge_record}: {error.strerror or error}; not kept")


def _check(record: Any) -> str:
    return hashlib.blake2b(encoded(record), digest_size=16).hexdigest()


def _files(place: Workspace) -> dict[str, str | None]:
    return {path.name: _content(path) for path in (place.merged_json, place.merged_rrd)}


def _content(path: Path) -> str | None:
    """A digest of a file; None if it cannot be read."""
    try:
        with opened(path) as file:
            return hashlib.file_digest(file, lambda: hashlib.blake2b(digest_size=16)).hexdigest()
    except (DocumentError, OSError):
        return None
