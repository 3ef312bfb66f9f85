"""The logs at the paths of a call, and the names of their runs: the shortest paths that tell them
apart."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple, TypeVar

from ..ingest.logs.recording import METADATA
from ..ingest.reading import find_logs, log_exists, log_fingerprint, run_name, with_parts_joined
from ..ingest.remote.path import LogPath, RemotePath, log_path
from ..topology.errors import LogError, TopobatchError
from .ingest_record import IngestRecord, origin
from .workspace import Workspace

T = TypeVar("T")

PACKED = {".gz": "gzip", ".zip": "zip", ".bz2": "bzip2", ".xz": "xz", ".7z": "7-Zip"}
"""Archives by their suffix; zstd, which rosbag2 writes, is read directly."""


def logs_of(
    given: Sequence[LogPath], *, separate: bool = False
) -> tuple[list[LogPath], list[tuple[LogPath, LogError]]]:
    """The logs at some paths, each once, and the errors of paths without any.

    separate: parts of split recordings are logs of their own.
    """
    logs: dict[LogPath, None] = {}
    missing, files = [], []
    for path in given:
        try:
            found = _logs_at(path, separate=separate)
        except (LogError, OSError) as error:
            if isinstance(error, OSError):
                error = LogError(f"{error.filename or path}: {error.strerror or error}")
            missing.append((path, error))
            continue
        logs |= dict.fromkeys(found)
        files += [path] if found == [path] else []
    if not separate and len(files) > 1:
        whole = dict.fromkeys(with_parts_joined(files))
        logs = {log: None for log in logs if log in whole or log not in files} | whole
    return list(logs), missing


def _logs_at(path: LogPath, *, separate: bool) -> list[LogPath]:
    """Every log at or below a path, as `find_logs`; metadata.yaml of a ROS 2 bag stands for its
    folder. Raises LogError, for archives with the hint to unpack them."""
    try:
        return find_logs([path], separate=separate)
    except LogError as error:
        if not isinstance(path, Path) or not path.is_file():
            raise
        if path.name == METADATA:
            folder = find_logs([path.parent])
            if folder == [path.parent]:
                return folder
        if kind := PACKED.get(path.suffix.lower()):
            raise LogError(f"{path}: is packed ({kind}); unpack it, and name the log") from error
        raise


class _Location(NamedTuple):
    """Where a log lies. base: its name without suffixes; file: with them; folders: those that it is
    in, innermost first."""

    base: str
    file: str
    folders: tuple[str, ...]


def run_names(
    logs: Iterable[LogPath], place: Workspace | None = None, *, replace: bool = False
) -> dict[LogPath, str]:
    """A run name for every log, in any order of the logs the same.

    It is the log's name without suffixes, with - for colons. Where several logs of the call or of
    the workspace have that one, as many folders go before it as tell its path from theirs
    (`robot1-run01`); logs in one folder (`a.bag` beside `a/`) are told apart by suffixes. A log
    that became a run of the workspace keeps that name, also if it was moved or the run renamed.
    Names are not checked (`Workspace.check_run`), and equal where all that their paths differ in is
    lost in names.

    replace: runs that the workspace has from other logs do not count.
    """
    where = {log: _location(log) for log in logs}
    records = {} if place is None else place.ingest_records()
    names = _kept(where, records)
    others = {run: r for run, r in records.items() if not replace and run not in names.values()}
    known = {*where.values(), *_of_logs(others, _location).values()}
    beside = Counter((at.base, at.folders) for at in known)
    shared = Counter(
        (base, *folders[:depth]) for base, folders in beside for depth in range(len(folders) + 1)
    )

    def apart(at: _Location) -> int:
        """The number of folders that tell a path from the others of its name."""
        depths = range(len(at.folders))
        alone = (depth for depth in depths if shared[at.base, *at.folders[:depth]] == 1)
        return next(alone, len(at.folders))

    taken = {*names.values(), *others}
    new = where.keys() - names.keys()
    for log in sorted(new, key=lambda log: (apart(where[log]), where[log])):
        base, file, folders = where[log]
        own = base if beside[base, folders] == 1 else file
        labels = [
            "-".join((*reversed(folders[:depth]), own)).replace(":", "-")
            for depth in range(apart(where[log]), len(folders) + 1)
        ]
        names[log] = next((label for label in labels if label not in taken), labels[-1])
        taken.add(names[log])
    return {log: names[log] for log in where}


def _location(log: LogPath) -> _Location:
    if isinstance(log, RemotePath):
        *folders, file = f"{log.root.partition('://')[2]}/{log.key}".strip("/").split("/")
    else:
        named = log if log.name not in ("", "..") else log.resolve()
        folders, file = list(named.parent.resolve().parts[1:]), named.name
    return _Location(run_name(log), file, tuple(reversed(folders)))


def _of_logs(records: Mapping[str, IngestRecord], tell: Callable[[LogPath], T]) -> dict[str, T]:
    """What a function tells of the logs of records, by run, where these state any."""
    out: dict[str, T] = {}
    for run, record in records.items():
        if record.log is not None:
            with suppress(TopobatchError, OSError, ValueError, RuntimeError):  # none of ours
                out[run] = tell(log_path(record.log))
    return out


def _kept(logs: Iterable[LogPath], records: Mapping[str, IngestRecord]) -> dict[LogPath, str]:
    """The names of the runs that the workspace has from these logs, or from logs of their content
    that are not there any more."""
    by_log = {record.log: run for run, record in reversed([*records.items()])}
    kept: dict[LogPath, str] = {}
    for log in logs:
        with suppress(OSError, RuntimeError):  # links in a circle: reading the log will say so
            if (named := origin(log)) in by_log:
                kept[log] = by_log[named]
    missing = _of_logs(records, lambda log: isinstance(log, Path) and not log_exists(log))
    gone = {
        records[run].content: run
        for run, is_missing in missing.items()
        if is_missing and run not in kept.values()
    }
    for log in logs:
        if gone and log not in kept:
            with suppress(TopobatchError, OSError):  # reading the log will say why
                if (run := gone.pop(log_fingerprint(log), None)) is not None:
                    kept[log] = run
    return kept
