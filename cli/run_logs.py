"""The logs at the paths of a call, and the names of their runs: the shortest paths that tell them
apart."""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from ..ingest.logs.recording import METADATA
from ..ingest.reading import find_logs, log_exists, log_fingerprint, run_name, with_parts_joined
from ..ingest.remote.path import LogPath, RemotePath, log_path
from ..topology.errors import LogError, TopobatchError
from ..topology.wording import counted, listed
from .ingest_record import IngestRecord, origin
from .workspace import Workspace

PACKED = {".gz": "gzip", ".zip": "zip", ".bz2": "bzip2", ".xz": "xz", ".7z": "7-Zip"}
"""Archives by their suffix; zstd, which rosbag2 writes, is read directly."""

_PACKED_LOG = re.compile(r"\.(mcap|bag|db3)(\.active)?\.(gz|zip|bz2|xz|7z)$", re.IGNORECASE)


def logs_of(
    given: Sequence[LogPath], *, separate: bool = False
) -> tuple[list[LogPath], list[tuple[LogPath, LogError]], list[str]]:
    """The logs at some paths, each once, the errors of paths without any, and warnings of packed
    ones.

    separate: parts of split recordings are logs of their own.
    """
    logs: dict[LogPath, None] = {}
    missing, files, warnings = [], [], []
    for path in given:
        try:
            found = _logs_at(path, separate=separate)
        except (LogError, OSError) as error:
            if isinstance(error, OSError):
                error = LogError(f"{error.filename or path}: {error.strerror or error}")
            missing.append((path, error))
            continue
        if passed_over := _packed_below(path):
            warnings.append(f"{path}: {passed_over}")
        logs |= dict.fromkeys(found)
        files += [path] if found == [path] else []
    if not separate and len(files) > 1:
        whole = dict.fromkeys(with_parts_joined(files))
        logs = {log: None for log in logs if log in whole or log not in files} | whole
    return list(logs), missing, warnings


def _logs_at(path: LogPath, *, separate: bool) -> list[LogPath]:
    """Every log at or below a path, as `find_logs`; metadata.yaml of a ROS 2 bag stands for its
    folder. Raises LogError, for archives with the hint to unpack them."""
    try:
        return find_logs([path], separate=separate)
    except LogError as error:
        if not isinstance(path, Path):
            raise
        if path.name == METADATA and path.is_file():
            folder = find_logs([path.parent])
            if folder == [path.parent]:
                return folder
        kind = PACKED.get(path.suffix.lower()) if path.is_file() else None
        if kind is not None:
            raise LogError(f"{path}: is packed ({kind}); unpack it, and name the log") from error
        if below := _packed_below(path):
            raise LogError(f"{error}; {below}") from error
        raise


def _packed_below(path: LogPath) -> str:
    """A hint about archived logs below a folder, which are skipped; "" without any."""
    if not isinstance(path, Path) or not path.is_dir():
        return ""
    names = []
    for folder, below, files in os.walk(path):
        below[:] = [name for name in below if not name.startswith(".")]
        packed = [name for name in files if _PACKED_LOG.search(name) and name[0] != "."]
        names += [os.path.relpath(os.path.join(folder, name), path) for name in packed]
    what = f"{counted(len(names), 'packed log')} passed over, to be unpacked first"
    return f"{what}: {listed(sorted(names))}" if names else ""


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
