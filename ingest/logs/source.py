"""The bytes of a log by position: of a file here, or of an object elsewhere."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ...topology.errors import LogError
from ..remote.path import LogPath, RemotePath
from ..remote.source import Ranges, RemoteFile

SLAB_BYTES = 1 << 20
"""Bytes read at a time in a walk record by record."""

LEAST_BYTES = 1 << 14
"""Bytes read first where little may be of use, as between damaged places."""


class FileSource:
    """A file here; raises LogError if it cannot be read."""

    def __init__(self, path: Path) -> None:
        try:
            self._file = path.open("rb")
            self.size = path.stat().st_size
        except OSError as error:
            raise LogError(f"{path}: cannot be opened ({error.strerror})") from error
        self._path = path

    def __enter__(self) -> FileSource:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    @contextmanager
    def ahead(self, ranges: Ranges) -> Iterator[None]:
        """Context in which these ranges are read; the operating system reads ahead by itself."""
        yield

    def read(self, offset: int, length: int) -> bytes:
        """The bytes [offset, offset + length), fewer at the file's end."""
        length = min(length, self.size - offset)
        if length <= 0:
            return b""  # the offset may be one that no file can have
        try:
            self._file.seek(offset)
            data = self._file.read(length)
        except OSError as error:
            raise LogError(f"{self._path}: cannot be read ({error.strerror})") from error
        if len(data) < length:
            raise LogError(f"{self._path}: became shorter while it was read; read it again")
        return data


Source = FileSource | RemoteFile


@contextmanager
def open_source(path: LogPath) -> Iterator[Source]:
    """The bytes of the file or object at a path."""
    if isinstance(path, RemotePath):
        yield path.file
        return
    with FileSource(path) as file:
        yield file
