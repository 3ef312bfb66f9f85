"""Recognising what changed since a merge, or that nothing did.

A merge stands if the program, its libraries, the options, the documents of all runs, locks,
discards, names of sites and its own files all have the checksums of a record in the cache.
"""

from __future__ import annotations

import hashlib
import os
import sys
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path

from ..merge.kept import program_digest
from ..topology.errors import DocumentError
from ..topology.files import encoded, opened, read_json, write_json
from ..topology.wording import listed
from .output import warn
from .workspace import Workspace

FOLDERS = ("topology", "merge", "viz", "cli")
LIBRARIES = ("numpy", "scipy", "pydantic", "rerun-sdk", "pyarrow")
"""Libraries on which the files of a merge depend."""


def contents(place: Workspace, runs: Sequence[str]) -> dict[str, str | None]:
    """A digest of each run's map document, and of its views if there are any; None if the document
    cannot be read."""
    found: dict[str, str | None] = {}
    for run in runs:
        document, views = (_content(place.maps / f"{run}.{kind}") for kind in ("json", "views"))
        found[run] = document if None in (document, views) else _digest([document, views])
    return found


def changed_since(place: Workspace, merged: Mapping[str, str], runs: Sequence[str]) -> list[str]:
    """Those of the runs whose maps differ from the merged ones.

    merged: their `contents` by the document of the merge.
    """
    now = contents(place, [run for run in runs if run in merged])
    return [run for run, content in now.items() if content != merged[run]]


def told_changed(runs: Sequence[str]) -> str:
    """That the maps of these runs are not the ones that were merged."""
    return f"the map{'' if len(runs) == 1 else 's'} of {listed(runs, 3)} changed since the merge"


def state_of(place: Workspace, documents: Mapping[str, str | None], options: object) -> str:
    """A digest of everything that a merge depends on, and of its files. documents: the `contents`
    of its runs."""
    files = (*place.decisions, place.merged_json, place.merged_rrd)
    return _digest(
        [
            program_digest(*FOLDERS).hex(),
            [sys.version, *map(version, LIBRARIES)],
            repr(options),
            dict(documents),
            [(os.path.lexists(path), _content(path)) for path in files],
        ]
    )


def stands(place: Workspace, state: str) -> bool:
    """Whether this state is that after the last merge."""
    try:
        return bool(read_json(place.merge_record) == {"state": state})
    except DocumentError:
        return False  # a cache: without it the merge is made


def remember(place: Workspace, state: str) -> None:
    """Record the state after a merge, all of whose maps were readable."""
    try:
        write_json(place.merge_record, {"state": state})
    except OSError as error:
        warn(f"{place.merge_record}: {error.strerror or error}; not kept")


def _digest(value: object) -> str:
    return hashlib.blake2b(encoded(value), digest_size=16).hexdigest()


def _content(path: Path) -> str | None:
    """A digest of a file; None if it cannot be read."""
    try:
        with opened(path) as file:
            return hashlib.file_digest(file, lambda: hashlib.blake2b(digest_size=16)).hexdigest()
    except (DocumentError, OSError):
        return None
