"""The logs that a path on the command line names, and what to do about those that are packed."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from ..topology.errors import LogError
from ..topology.wording import counted, listed

if TYPE_CHECKING:
    from ..ingest.remote.path import LogPath

PACKED = {
    b"\x1f\x8b": "gzip",
    b"PK\x03\x04": "zip",
    b"BZh": "bzip2",
    b"\xfd7zXZ\x00": "xz",
    b"7z\xbc\xaf\x27\x1c": "7-Zip",
}
"""Archives by their first bytes. What rosbag2 packs itself (zstd) is read as it is."""

_PACKED_LOG = re.compile(r"\.(mcap|bag|db3)(\.active)?\.(gz|zip|bz2|xz|7z)$", re.IGNORECASE)


def logs_at(path: LogPath) -> list[LogPath]:
    """Every log at or below a path, as `find_logs`; the metadata of a ROS 2 bag stand for its
    folder.

    Raises LogError, which says of archives that they must be unpacked.
    """
    from ..ingest.logs.recording import METADATA
    from ..ingest.reading import find_logs

    try:
        return find_logs([path])
    except LogError as error:
        if not isinstance(path, Path):
            raise
        if path.name == METADATA and path.is_file():
            folder = find_logs([path.parent])
            if folder == [path.parent]:
                return folder
        kind = _packed(path)
        if kind is not None:
            raise LogError(f"{path}: is packed ({kind}); unpack it, and name the log") from error
        below = packed_below(path)
        if below:
            raise LogError(f"{error}; {below}") from error
        raise


def packed_below(path: LogPath) -> str | None:
    """What is said of packed logs below a folder, which are passed over; None without any."""
    if not isinstance(path, Path) or not path.is_dir():
        return None
    names = [os.path.relpath(file, path) for file in _files_below(path)]
    names = [name for name in names if _PACKED_LOG.search(name)]
    if not names:
        return None
    what = counted(len(names), "packed log")
    return f"{what} passed over, to be unpacked first: {listed(sorted(names))}"


def _files_below(folder: Path) -> Iterator[str]:
    """Files that are not hidden, in a folder and below; what cannot be listed is passed over:
    looking for logs has told of it."""
    waiting = [str(folder)]  # no recursion, as `os.walk`: folders can lie deeper than the stack
    while waiting:
        try:
            with os.scandir(waiting.pop()) as found:
                shown = [entry for entry in found if not entry.name.startswith(".")]
        except OSError:
            continue
        waiting += [e.path for e in shown if e.is_dir(follow_symlinks=False)]
        yield from (entry.path for entry in shown if entry.is_file(follow_symlinks=False))


def _packed(path: Path) -> str | None:
    """How a file is packed; None for all else, and what cannot be read."""
    if not path.is_file():
        return None
    try:
        with path.open("rb") as file:
            begin = file.read(8)
    except OSError:
        return None
    return next((kind for magic, kind in PACKED.items() if begin.startswith(magic)), None)
