"""Access to the bytes of a log: a local file or a remote object."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from ...topology.arrays import IntArray
from ...topology.errors import LogError
from ..remote.path import LogPath, RemotePath
from ..remote.source import ReadAhead
from .checksum import crc32
from .chunk_index import ChunkIndex, Wanted
from .messages import Bytes, FileWindow, Passed, Progress

SLAB_BYTES = 1 << 20
"""Bytes read at a time in a walk record by record."""

ALLOW_SCAN = "--allow-scan"


class RemoteWindow(Passed):
    """A `FileWindow` on a remote object. Raises LogError on server errors."""

    def __init__(self, path: RemotePath, progress: Progress | None = None) -> None:
        super().__init__(progress)
        self.path = path
        self.size = path.file.size
        self._ahead: ReadAhead | None = None

    def __enter__(self) -> RemoteWindow:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    @contextmanager
    def reading(self, index: ChunkIndex | str, wanted: Wanted, margin: int = 0) -> Iterator[None]:
        """Context in which the chunks with wanted messages are read ahead.

        index: or the reason why there is none; margin: bytes to include after each chunk. Raises
        LogError if the whole object must be read and that was not allowed.
        """
        if isinstance(index, str) and not self.path.allow_scan:
            raise LogError(
                f"{self.path}: {index}, so that all of its {self.size:,} bytes would have to be "
                f"read; {ALLOW_SCAN} does that"
            )
        with self.path.file.reading_ahead(*self._ranges(index, wanted, margin)) as self._ahead:
            yield
        self._ahead = None

    def cost(self, index: ChunkIndex | str, wanted: Wanted, margin: int = 0) -> int:
        """Number of bytes that `reading` would fetch."""
        return self.path.file.cost(*self._ranges(index, wanted, margin))

    def _ranges(
        self, index: ChunkIndex | str, wanted: Wanted, margin: int
    ) -> tuple[IntArray, IntArray]:
        if isinstance(index, str):
            return np.array([0]), np.array([self.size])
        begin, end = index.ranges(wanted)
        return begin, np.minimum(end + margin, self.size)

    def view(self, offset: int, length: int) -> Bytes:
        """The bytes [offset, offset + length), fewer at the end."""
        return np.frombuffer(self.copy(offset, length), np.uint8)

    def checked(self, offset: int, length: int) -> tuple[Bytes, int]:
        """The bytes as by `view`, with their CRC-32."""
        data = self.view(offset, length)
        return data, crc32(data)

    def copy(self, offset: int, length: int) -> bytes:
        """The bytes as by `view`, copied; thread-safe."""
        length = max(0, min(length, self.size - offset))
        return self.path.file.read(offset, length, self._ahead) if length else b""

    def fill(self, target: Bytes, offset: int) -> None:
        """Read into all of `target`."""
        target[:] = self.view(offset, len(target))


Window = FileWindow | RemoteWindow


def window_on(path: LogPath, progress: Progress | None = None) -> Window:
    """The window on the file or object at a path."""
    if isinstance(path, RemotePath):
        return RemoteWindow(path, progress)
    return FileWindow(path, progress)
