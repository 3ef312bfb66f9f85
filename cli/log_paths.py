"""The logs at a path of the command line, and errors for archives."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Sequence
from pathlib import Path

from ..ingest.logs.recording import METADATA
from ..ingest.reading import find_logs, with_parts_joined
from ..ingest.remote.path import LogPath
from ..topology.errors import LogError
from ..topology.wording import counted, listed

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
    packed = [file for file in _files_below(path) if _PACKED_LOG.search(file)]
    names = sorted(os.path.relpath(file, path) for file in packed)
    what = f"{counted(len(names), 'packed log')} passed over, to be unpacked first"
    return f"{what}: {listed(names)}" if names else ""


def _files_below(folder: Path) -> Iterator[str]:
    """Files in a folder and below that are not hidden; folders that cannot be listed are skipped,
    since `find_logs` has reported them."""
    waiting = [str(folder)]  # no recursion, as `os.walk`: folders can lie deeper than the stack
    while waiting:
        try:
            with os.scandir(waiting.pop()) as found:
                shown = [entry for entry in found if not entry.name.startswith(".")]
        except OSError:
            continue
        waiting += [e.path for e in shown if e.is_dir(follow_symlinks=False)]
        yield from (entry.path for entry in shown if entry.is_file(follow_symlinks=False))
