"""One file of a log: its format by its first bytes, and the container that reads it."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from ...topology.errors import LogError
from ..remote.path import LogPath, RemotePath
from .bag import MAGIC as BAG_MAGIC
from .bag import BagScan, read_index
from .chunks import ChunkedLog
from .inflate import ZSTD_MAGIC, pieces
from .mcap import MAGIC as MCAP_MAGIC
from .mcap import McapScan, read_summary
from .messages import Container, DamageError
from .saved_map import is_saved_map
from .sqlite import MAGIC as SQLITE_MAGIC
from .sqlite import SqliteFile

SUFFIX = re.compile(r"(\.(mcap|bag|db3|active|zstd|zst|ya?ml))+$", re.IGNORECASE)
"""Suffixes of a log's name."""

_NAMED = re.compile(r"\.(mcap|bag|db3|bag\.active)(\.(zstd|zst))?$", re.IGNORECASE)

UNPACKED_RATIO = 1000
UNPACKED_BYTES = 1 << 28
"""Limit on the unpacked size of a file compressed as a whole: 256 MiB, or 1000 times its size."""

_MAGICS = {"mcap": MCAP_MAGIC, "bag": BAG_MAGIC, "sqlite3": SQLITE_MAGIC, "zstd": ZSTD_MAGIC}


def sniff(path: LogPath) -> str | None:
    """The format of a file by its first bytes: "mcap", "bag", "sqlite3", "zstd", or None."""
    if isinstance(path, RemotePath):
        head = path.magic()
    else:
        try:
            with path.open("rb") as file:
                head = file.read(16)
        except OSError:
            return None
    return next((kind for kind, magic in _MAGICS.items() if head.startswith(magic)), None)


def is_named_like_log(path: LogPath) -> bool:
    """Whether a file's name is that of a log."""
    return _NAMED.search(path.name) is not None


def is_log(path: LogPath) -> bool:
    """Whether a file is a log by content, or by name, so that broken logs are reported.

    Remote files are checked by name only.
    """
    if isinstance(path, RemotePath):
        return is_named_like_log(path)
    kind = sniff(path)
    if kind in ("sqlite3", "zstd"):
        return is_named_like_log(path)
    return kind is not None or is_named_like_log(path) or is_saved_map(path)


@dataclass(frozen=True)
class LogFile:
    """One file of a log, opened when it is first asked for something."""

    path: LogPath

    @cached_property
    def kind(self) -> str | None:
        """Its format (`sniff`)."""
        return sniff(self.path)

    @property
    def packed(self) -> bool:
        """Whether it is compressed as a whole."""
        return self.kind == "zstd"

    @property
    def bytes(self) -> int:
        """Its size."""
        return int(self.path.stat().st_size)

    @cached_property
    def container(self) -> Container:
        """The reader of a file that is not packed, which keeps its index; raises LogError if it is
        no log."""
        return _container(self.path, self.kind, self.path)

    @contextmanager
    def opened(self) -> Iterator[Container]:
        """The reader; a packed file is unpacked into a temporary one meanwhile."""
        if not self.packed:
            yield self.container
            return
        path = _here(self.path, "a file that is compressed as a whole can only be read as a whole")
        with tempfile.TemporaryDirectory(prefix="topobatch-") as folder:
            unpacked = _unpack(path, Path(folder) / SUFFIX.sub("", path.name))
            yield _container(unpacked, sniff(unpacked), path)


def _container(path: LogPath, kind: str | None, named: LogPath) -> Container:
    """The reader of a file of a format; named: for people."""
    if kind == "mcap":
        return ChunkedLog(path, read_summary, McapScan)
    if kind == "bag":
        return ChunkedLog(path, read_index, BagScan)
    if kind == "sqlite3":
        return SqliteFile(_here(path, "a database can only be read as a whole"))
    raise LogError(f"{named}: is no log; an MCAP file, a ROS 1 bag or a ROS 2 bag is needed")


def _here(path: LogPath, why: str) -> Path:
    """A local path; LogError for a remote one."""
    if isinstance(path, RemotePath):
        raise LogError(f"{path}: {why}; copy it here, or convert it to MCAP (`ros2 bag convert`)")
    return path


def _unpack(path: Path, target: Path) -> Path:
    written, most = 0, max(UNPACKED_BYTES, UNPACKED_RATIO * path.stat().st_size)
    # What comes before damage is read; the walk reports the truncation.
    with path.open("rb") as source, target.open("wb") as sink, suppress(DamageError):
        for piece in pieces("zstd", source):
            written += len(piece)
            if written > most:
                raise LogError(f"{path}: inflates to more than {most >> 20} MiB")
            sink.write(piece)
    return target
