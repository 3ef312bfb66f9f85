"""Logs that hold their messages in chunks: MCAP files and bags, local or remote."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from typing import Protocol

from ..remote.path import LogPath, RemotePath
from .chunk_index import ChunkIndex
from .messages import Block, Channel, Findings, Progress, Want
from .tally import Tally
from .windows import RemoteWindow, Window, window_on


class Walk(Protocol):
    """One scan of a file; tally: of its channels, as far as they are known in advance."""

    tally: Tally

    def run(self, index: ChunkIndex | None = None) -> Iterator[Block]:
        """All blocks that can be read.

        index: only those of the chunks that hold what is wanted, and nothing else is read.
        """


class ChunkedFile(ABC):
    """One log in chunks; BEHIND: bytes read behind a chunk to find its end."""

    BEHIND = 0

    def __init__(self, path: LogPath) -> None:
        self.path = path

    @abstractmethod
    def _chunks(self) -> ChunkIndex | str:
        """The contents of each chunk by the file's index, or why there is none."""

    @abstractmethod
    def _channels(self) -> Mapping[int, Channel]:
        """The channels described by the index."""

    @abstractmethod
    def _walk(self, window: Window, want: Want, findings: Findings) -> Walk:
        """A new scan of the file."""

    def cost(self, want: Want) -> int:
        """Number of bytes of a remote file to be fetched for what is wanted."""
        assert isinstance(self.path, RemotePath)
        wanted = Tally(want, Findings(), self._channels()).wanted()
        return RemoteWindow(self.path).cost(self._chunks(), wanted, self.BEHIND)

    def blocks(
        self, want: Want, findings: Findings, progress: Progress | None = None
    ) -> Iterator[Block]:
        """Scan the file once. O(bytes); memory: one chunk, compressed and decompressed."""
        with window_on(self.path, progress) as window:
            walk = self._walk(window, want, findings)
            if isinstance(window, RemoteWindow):
                index = self._chunks()
                with window.reading(index, walk.tally.wanted(), self.BEHIND):
                    yield from walk.run(None if isinstance(index, str) else index)
            else:
                yield from walk.run()
            window.passed(window.size)
