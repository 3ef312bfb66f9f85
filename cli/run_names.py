"""The names of runs by their logs: the shortest paths that tell them apart."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from ..ingest.reading import log_exists, log_fingerprint, run_name
from ..ingest.remote.path import LogPath, RemotePath, log_path
from ..topology.errors import TopobatchError
from .ingest_record import IngestRecord, origin
from .workspace import Workspace


class _Location(NamedTuple):
    """Where a log lies. folders: those that it is in, innermost first; base: its name without
    suffixes; file: with them."""

    folders: tuple[str, ...]
    base: str
    file: str

    def labels(self, depth: int, *, whole: bool) -> Iterator[str]:
        """The names that its run can have with `depth` folders or more; whole: only those with
        suffixes. A run has - for colons."""
        for own in (self.base, self.file)[whole:]:
            for number in range(depth, len(self.folders) + 1):
                yield "-".join((*reversed(self.folders[:number]), own)).replace(":", "-")


def run_names(
    logs: Iterable[LogPath], place: Workspace | None = None, *, replace: bool = False
) -> dict[LogPath, str]:
    """A run name for every log, in any order of the logs the same.

    It is the log's name without suffixes. Where several logs of the call or of the workspace have
    that one, as many folders go before it as tell its path from theirs (`robot1-run01`); logs in
    one folder (`a.bag` beside `a/`) are told apart by suffixes. A log that became a run of the
    workspace keeps that name, also if it was moved or the run renamed. Names are not checked
    (`Workspace.check_run`), and equal where all that their paths differ in is lost in names.

    replace: runs that the workspace has from other logs do not count.
    """
    where = {log: _location(log, run_name(log)) for log in logs}
    records = {} if place is None else place.ingest_records()
    names = _kept(where, records)
    others = {run: r for run, r in records.items() if not replace and run not in names.values()}
    beside = Counter((at.folders, at.base) for at in {*where.values(), *_locations(others)})
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
    taken = {*names.values(), *others}
    for depth, whole, at, log in sorted(new, key=lambda each: each[:3]):
        labels = [*at.labels(depth, whole=whole)]
        names[log] = next((name for name in labels if name not in taken), labels[-1])
        taken.add(names[log])
    return {log: names[log] for log in where}


def _location(log: LogPath, base: str) -> _Location:
    if isinstance(log, RemotePath):
        *folders, file = f"{log.root.partition('://')[2]}/{log.key}".strip("/").split("/")
    else:
        named = log if log.name not in ("", "..") else log.resolve()
        folders, file = list(named.parent.resolve().parts[1:]), named.name
    return _Location(tuple(reversed(folders)), base, file)


def _locations(records: Mapping[str, IngestRecord]) -> Iterator[_Location]:
    """Where the logs of runs lie. Whether there is a folder in a bucket is not asked."""
    for record in records.values():
        if record.log is not None:
            with suppress(TopobatchError, OSError, ValueError):  # nothing of ours wrote that
                yield _location(log_path(record.log), run_name(Path(record.log)))


def _kept(
    where: Mapping[LogPath, _Location], records: Mapping[str, IngestRecord]
) -> dict[LogPath, str]:
    """The names of the runs that the workspace has from these logs, or from logs of their names
    and content that are not there any more."""
    by_log = {record.log: run for run, record in reversed([*records.items()])}
    kept: dict[LogPath, str] = {}
    for log in where:
        with suppress(OSError, RuntimeError):  # links in a circle: reading the log will say so
            if (named := origin(log)) in by_log:
                kept[log] = by_log[named]
    gone: dict[str, list[str]] = {}
    for run, record in records.items():
        if run not in kept.values() and record.log is not None:
            with suppress(TopobatchError, OSError, ValueError):  # nothing of ours wrote that
                before = log_path(record.log)
                if isinstance(before, Path) and not log_exists(before):
                    gone.setdefault(run_name(before), []).append(run)
    for log, at in where.items():
        if log not in kept and at.base in gone:
            with suppress(TopobatchError, OSError):  # reading the log will say why
                content = log_fingerprint(log)
                same = [run for run in gone[at.base] if records[run].content in (None, content)]
                if same and same[0] not in kept.values():
                    kept[log] = same[0]
    return kept
