"""The bytes of a log: of a file here, or of an object elsewhere."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from ...topology.arrays import IntArray
from ...topology.errors import LogError
from ..remote.path import LogPath, RemotePath
from ..remote.source import ReadAhead
from .messages import Bytes, Passed, Progress

SLAB_BYTES = 1 << 20
"""Bytes read at a time in a walk record by record."""

ALLOW_SCAN = "--allow-scan"


class FileSource(Passed):
    """Bounded look at a file: bytes of any place, from one buffer that is used again and again.

    Reusing the buffer matters: fresh memory costs a page fault per 4 KiB, more than the copy.
    """

    STEP = 1 << 15
    """So much is read beyond what is asked for: the small records behind it."""

    def __init__(self, path: Path, progress: Progress | None = None) -> None:
        super().__init__(progress)
        try:
            self._file = path.open("rb", buffering=0)
            self._second = path.open("rb")
        except OSError as error:
            raise LogError(f"{path}: cannot be opened ({error.strerror})") from error
        self.size = path.stat().st_size
        self._path = path
        self._copying = threading.Lock()
        self._buffer = np.empty(2 * self.STEP, np.uint8)
        self._base = 0
        self._fill = 0

    def __enter__(self) -> FileSource:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()
        self._second.close()

    def view(self, offset: int, length: int) -> Bytes:
        """The bytes [offset, offset + length), fewer at the file's ends; until the next call."""
        offset = max(offset, 0)
        length = max(0, min(length, self.size - offset))
        at = offset - self._base
        if at < 0 or at + length > self._fill:
            self._load(offset, length)
            at = 0
        return self._buffer[at : at + length]

    def copy(self, offset: int, length: int) -> bytes:
        """The same bytes to keep, read past the buffer. Other threads may call this."""
        offset = max(offset, 0)
        length = max(0, min(length, self.size - offset))
        if length == 0:
            return b""  # the offset may be one that no file can have
        try:
            with self._copying:
                self._second.seek(offset)
                data: bytes = self._second.read(length)
        except OSError as error:
            raise LogError(f"{self._path}: cannot be read ({error.strerror})") from error
        if len(data) < length:
            raise self._shorter()
        return data

    def _shorter(self) -> LogError:
        return LogError(f"{self._path}: became shorter while it was read; read it again")

    def _load(self, offset: int, length: int) -> None:
        """Fill the buffer from `offset` on, keeping what it already holds of it."""
        at, want = offset - self._base, length + self.STEP
        kept = self._fill - at if 0 <= at <= self._fill else 0
        if want > len(self._buffer):
            larger = np.empty(want + self.STEP, np.uint8)
            larger[:kept] = self._buffer[at : at + kept]
            self._buffer = larger
        elif kept and at:
            self._buffer[:kept] = self._buffer[at : at + kept]
        self._base, self._fill = offset, kept
        goal = min(want, self.size - offset)
        try:
            self._file.seek(self._base + self._fill)
            while self._fill < goal:
                got = self._file.readinto(self._buffer.data[self._fill : goal])
                if not got:
                    raise self._shorter()
                self._fill += got
        except OSError as error:
            raise LogError(f"{self._path}: cannot be read ({error.strerror})") from error


class RemoteSource(Passed):
    """The same of an object in a bucket or on a server. Raises LogError on server errors."""

    def __init__(self, path: RemotePath, progress: Progress | None = None) -> None:
        super().__init__(progress)
        self.path = path
        self.size = path.file.size
        self._ahead: ReadAhead | None = None

    def __enter__(self) -> RemoteSource:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    @contextmanager
    def reading(self, begin: IntArray, end: IntArray) -> Iterator[None]:
        """Context in which these ranges are read ahead."""
        with self.path.file.reading_ahead(begin, end) as self._ahead:
            yield
        self._ahead = None

    def check_scan(self, why: str) -> None:
        """Raise LogError if the whole object must not be read; why: there is no index."""
        if not self.path.allow_scan:
            raise LogError(
                f"{self.path}: {why}, so that all of its {self.size:,} bytes would have to be "
                f"read; {ALLOW_SCAN} does that"
            )

    def view(self, offset: int, length: int) -> Bytes:
        """The bytes [offset, offset + length), fewer at the ends."""
        return np.frombuffer(self.copy(offset, length), np.uint8)

    def copy(self, offset: int, length: int) -> bytes:
        """The bytes as by `view`, copied; thread-safe."""
        offset = max(offset, 0)
        length = max(0, min(length, self.size - offset))
        return self.path.file.read(offset, length, self._ahead) if length else b""


Source = FileSource | RemoteSource


def open_source(path: LogPath, progress: Progress | None = None) -> Source:
    """The bytes of the file or object at a path."""
    if isinstance(path, RemotePath):
        return RemoteSource(path, progress)
    return FileSource(path, progress)
