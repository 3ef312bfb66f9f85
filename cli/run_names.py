"""The names of runs by their logs: the shortest paths that tell them apart."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

from ..ingest.reading import log_exists, log_fingerprint, run_name
from ..ingest.remote.path import LogPath, RemotePath, log_path
from ..topology.errors import TopobatchError, UsageError
from .ingest_worker import called, origin
from .workspace import Workspace, run_named_after


class _Location(NamedTuple):
    """Where a log lies. folders: those that it is in, innermost first; base: its name without
    suffixes; file: with them."""

    folders: tuple[str, ...]
    base: str
    file: str

    def labels(self, depth: int = 0, *, whole: bool = False) -> Iterator[str]:
        """The names that its run can have with `depth` folders or more; whole: only those with
        suffixes."""
        for own in (self.base, self.file)[whole:]:
            for number in range(depth, len(self.folders) + 1):
                yield run_named_after("-".join((*reversed(self.folders[:number]), own)))


def run_names(
    logs: Iterable[LogPath], place: Workspace | None = None, *, replace: bool = False
) -> dict[LogPath, str]:
    """A run name for every log, in any order of the logs the same.

    It is the log's name without suffixes. Where several logs of the call or of the workspace have
    that one, as many folders go before it as tell its path from theirs (`robot1-run01`); logs in
    one folder (`a.bag` beside `a/`) are told apart by suffixes. A log that became a run of the
    workspace keeps that name, also if it was moved. Names are not checked (`checked_run_name`), and
    equal where all that their paths differ in is lost in names.

    replace: runs that the workspace has from other logs do not count.
    """
    where = {log: _location(log, run_name(log)) for log in logs}
    names = {} if place is None else _kept(where, place)
    every = {*where.values(), *(() if place is None or replace else _known(where, place))}
    beside = Counter((at.folders, at.base) for at in every)
    # By name: in how many folders of a path there is a log of that name.
    shared = Counter(
        (base, folders[:depth]) for folders, base in beside for depth in range(len(folders) + 1)
    )
    new = []
    for log, at in where.items():
        if log not in names:
            depths = range(len(at.folders) + 1)
            apart = (depth for depth in depths if shared[at.base, at.folders[:depth]] == 1)
            new.append((next(apart, len(at.folders)), beside[at.folders, at.base] > 1, at, log))
    taken = set(names.values())
    for depth, whole, at, log in sorted(new, key=lambda each: each[:3]):
        for name in at.labels(depth, whole=whole):
            names[log] = name
            other = None if place is None or replace else _record(place, name).get("log")
            if name not in taken and other is None:
                break
        taken.add(names[log])
    return {log: names[log] for log in where}


def _location(log: LogPath, base: str) -> _Location:
    if isinstance(log, RemotePath):
        *folders, file = f"{log.root.partition('://')[2]}/{log.key}".strip("/").split("/")
    else:
        named = log if log.name not in ("", "..") else log.resolve()
        folders, file = list(named.parent.resolve().parts[1:]), named.name
    return _Location(tuple(reversed(folders)), base, file)


def _kept(where: Mapping[LogPath, _Location], place: Workspace) -> dict[LogPath, str]:
    """The names of the runs that the workspace has from these logs."""
    kept: dict[LogPath, str] = {}
    for log, at in sorted(where.items(), key=lambda item: item[1]):
        for name in at.labels():
            if name not in kept.values() and _is_of(_record(place, name), log):
                kept[log] = name
                break
    return kept


def _known(where: Mapping[LogPath, _Location], place: Workspace) -> Iterator[_Location]:
    """Where the logs of runs of the workspace lie that are named like these."""
    ends = {run_named_after(name) for at in where.values() for name in (at.base, at.file)}
    for path in sorted(place.ingest_record("x").parent.glob("*.json")):
        run = path.stem
        after = (k + 1 for k, letter in enumerate(run) if letter == "-")
        if run in ends or any(run[k:] in ends for k in after):
            log = _record(place, run).get("log")
            with suppress(TopobatchError, OSError, ValueError):  # nothing of ours wrote that
                if isinstance(log, str):
                    # Whether there is a folder in a bucket is not asked.
                    yield _location(log_path(log), run_name(Path(log)))


def _record(place: Workspace, run: str) -> dict[str, Any]:
    """The record of a run, also if it was renamed; empty without one."""
    with suppress(UsageError):  # the name can be none of a run
        return place.ingested(called(place, run)) or {}
    return {}


def _is_of(record: Mapping[str, Any], log: LogPath) -> bool:
    """Whether a run was made from a log, wherever that was then."""
    before = record.get("log")
    if not isinstance(before, str) or before == origin(log):
        return isinstance(before, str)
    with suppress(TopobatchError, OSError, ValueError):
        place = log_path(before)
        if isinstance(place, Path) and not log_exists(place):
            return record.get("content") in (None, log_fingerprint(log))
    return False
