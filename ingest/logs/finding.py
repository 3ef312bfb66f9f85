"""The logs at or below some paths."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path

from ...topology.errors import LogError
from ..remote.path import SMALL_FILE_BYTES, LogPath, RemotePath, log_path
from .log_file import LogFile, is_log, is_named_like_log
from .messages import UNWANTED, Findings
from .metadata import BAG_INFORMATION
from .recording import METADATA, is_folder, recording_at
from .split_recordings import entries, path_of_parts, split_recordings


def find_logs(paths: Sequence[LogPath], *, separate: bool = False) -> list[LogPath]:
    """Every log at or below the given paths, sorted, each once.

    A ROS 2 bag folder is one log, and so are, unless separate, the parts of a split recording
    (`NAME_0`, `NAME_1`, …, each beginning where the one before ended): its path is the folder's if
    nothing else is there, else `NAME_*`. Below a folder, files are logs by content or, so that
    broken ones are reported, by name; hidden files are skipped; a folder that cannot be listed is
    returned itself, and reading it raises the error. In a bucket, files are logs by name alone, and
    parts make one log in a folder of their own only. A path given directly is returned as it is.

    Raises LogError for a path that does not exist and for a folder without any log.
    """
    found: dict[LogPath, None] = {}
    for path in map(log_path, paths):
        if not is_folder(path):
            recording_at(path)
            found[path] = None
            continue
        below = list(_below(path, separate))
        if not below:
            raise LogError(
                f"{path}: no log in this folder (MCAP, ROS 1 bag, ROS 2 bag or map.yaml)"
            )
        found |= dict.fromkeys(below)
    local = sorted(path for path in found if isinstance(path, Path))
    return [*local, *sorted(path for path in found if isinstance(path, RemotePath))]


def with_parts_joined(files: Sequence[LogPath]) -> list[LogPath]:
    """The files; where all parts of a split recording are among them, its path (`find_logs`) in
    place of theirs."""
    given: dict[Path, list[LogPath]] = {}
    for file in files:
        if isinstance(file, Path) and file.is_file():
            given.setdefault(file.parent, []).append(file)
    instead: dict[LogPath, LogPath] = {}
    for folder, named in given.items():
        for log in _listed(folder, separate=False)[0]:
            with suppress(LogError, OSError):  # reading the files will say why
                if isinstance(log, Path) and not log.is_file() and not _is_bag_folder(log):
                    parts = [file.path for file in recording_at(log).files]
                    instead |= dict.fromkeys(parts, log) if set(parts) <= set(named) else {}
    return list(dict.fromkeys(instead.get(file, file) for file in files))


def _below(folder: LogPath, separate: bool) -> Iterator[LogPath]:
    # No recursion: folders can be nested deeper than Python's stack.
    waiting = [folder]
    while waiting:
        logs, folders = _listed(waiting.pop(), separate)
        yield from logs
        waiting += folders


def _listed(folder: LogPath, separate: bool) -> tuple[list[LogPath], list[LogPath]]:
    """The logs directly in a folder, and the folders to search."""
    try:
        shown = entries(folder)
        if _is_bag_folder(folder):
            return [folder], []
        files = [entry for entry in shown if entry.is_file() and is_log(entry)]
        folders = [entry for entry in shown if entry.is_dir() and not entry.is_symlink()]
    except (OSError, LogError):
        return [folder], []
    if not separate:
        files = _with_parts_as_one(folder, files)
    # Broken links, and devices or pipes, which must not be opened: reading reports them.
    others = [e for e in shown if not e.is_file() and not e.is_dir() and is_named_like_log(e)]
    return [*files, *others], folders


def _is_bag_folder(folder: LogPath) -> bool:
    """Whether a folder is one ROS 2 bag: data sets also have files named metadata.yaml."""
    path = folder / METADATA
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return BAG_INFORMATION.encode() in file.read(SMALL_FILE_BYTES)


def _with_parts_as_one(folder: LogPath, files: Sequence[LogPath]) -> list[LogPath]:
    """The logs of a folder, split recordings as one; in a bucket only one with no others beside."""
    groups = split_recordings(files, _span)
    if len(groups) == 1 and len(files) > 1:
        return [folder]
    out: list[LogPath] = []
    for first, *others in groups:
        if others and isinstance(first, Path):
            out.append(path_of_parts(first))
        else:
            out += [first, *others]
    return out


def _span(path: LogPath) -> tuple[int, int] | None:
    """First and last log time of a part, None if it has none or is compressed as a whole.

    An unfinished part has no index and is read through. A broken one has no times; reading it later
    reports why.
    """
    file, findings = LogFile(path), Findings()
    if file.kind is None or file.packed:
        return None
    try:
        survey = file.container.survey()
        if survey is not None:
            return survey.start_ns, survey.end_ns
        for _ in file.container.blocks(lambda _: UNWANTED, findings):
            raise AssertionError("nothing was wanted")
    except (LogError, OSError):
        return None
    if findings.first_ns is None or findings.last_ns is None:
        return None
    return findings.first_ns, findings.last_ns
