"""Which maps changed since a merge, by the checksums that its document holds."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path

from ..merge.result import MergeResult
from ..topology.errors import DocumentError
from ..topology.files import encoded, opened
from ..topology.wording import listed
from .workspace import Workspace


def contents(place: Workspace, runs: Sequence[str]) -> dict[str, str | None]:
    """A digest of each run's map document, and of its views if there are any; None if the document
    cannot be read."""
    found: dict[str, str | None] = {}
    for run in runs:
        document, views = (_content(place.maps / f"{run}.{kind}") for kind in ("json", "views"))
        found[run] = document if None in (document, views) else _digest([document, views])
    return found


def changed_since(place: Workspace, result: MergeResult, runs: Sequence[str]) -> list[str]:
    """Those of the runs whose maps differ from the merged ones, by their `contents` in the
    document of the merge."""
    merged: Mapping[str, str] = result.info.get("maps") or {}
    now = contents(place, [run for run in runs if run in merged])
    return [run for run, content in now.items() if content != merged[run]]


def locked_since(place: Workspace, result: MergeResult) -> list[tuple[str, str]]:
    """The pairs of its runs whose locks were set or cleared since a merge."""
    runs = result.home.keys()
    now = {(lock.a, lock.b): lock.decision for lock in place.locks() if runs >= {lock.a, lock.b}}
    then = {(v.a, v.b): v.locked for v in result.verdicts if v.locked is not None}
    return sorted(pair for pair in {*now, *then} if now.get(pair) != then.get(pair))


def describe_changed(runs: Sequence[str]) -> str:
    """That the maps of these runs are not the ones that were merged."""
    return f"the map{'' if len(runs) == 1 else 's'} of {listed(runs, 3)} changed since the merge"


def _digest(value: object) -> str:
    return hashlib.blake2b(encoded(value), digest_size=16).hexdigest()


def _content(path: Path) -> str | None:
    """A digest of a file; None if it cannot be read."""
    try:
        with opened(path) as file:
            return hashlib.file_digest(file, lambda: hashlib.blake2b(digest_size=16)).hexdigest()
    except (DocumentError, OSError):
        return None
