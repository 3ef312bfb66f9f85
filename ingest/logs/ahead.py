"""Reading, decompression and checksums of chunks on other threads, ahead of the decoding."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Generic, TypeVar

from .messages import Bytes

Chunk = TypeVar("Chunk")
Task = Callable[[], Bytes | bytes]

THREADS = 2
"""Threads: reading, decompression and checksums release the interpreter's lock."""

AHEAD_BYTES = 1 << 25
"""Bytes read and decompressed ahead of the decoding."""

AHEAD_CHUNKS = 64
"""Limit of the number of chunks read ahead, for small chunks."""


class Ahead(Generic[Chunk]):
    """Chunks in the order of the file, each with the task that provides its bytes.

    Tasks that only read are better run on the caller's thread: passing a chunk between threads
    takes as long as reading it. Leaving the context ends the threads and drops tasks not begun.
    """

    def __init__(self) -> None:
        self._pool: ThreadPoolExecutor | None = None
        self._waiting: deque[tuple[Chunk, Task | None, int]] = deque()
        self._bytes = 0

    def __enter__(self) -> Ahead[Chunk]:
        return self

    def __exit__(self, *_: object) -> None:
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)

    def begin(self, chunk: Chunk, task: Callable[[], bytes], size: int) -> None:
        """Start a task on another thread; its result takes `size` bytes of memory."""
        if self._pool is None:
            self._pool = ThreadPoolExecutor(THREADS)
        self._waiting.append((chunk, self._pool.submit(task).result, size))
        self._bytes += size

    def put(self, chunk: Chunk, task: Task | None) -> None:
        """Queue a task to be run by the consumer; None for a chunk that is not needed."""
        self._waiting.append((chunk, task, 0))

    @property
    def last(self) -> Chunk | None:
        """The chunk queued last, if it is still waiting."""
        return self._waiting[-1][0] if self._waiting else None

    def due(self, everything: bool = False) -> Iterator[tuple[Chunk, Task | None]]:
        """The first chunks, each with the task for its bytes; the last few stay queued unless
        `everything`.

        The last one stays in any case: records behind it in the file may belong to it.
        """
        while self._waiting and (
            everything
            or (
                len(self._waiting) > 1
                and (
                    self._waiting[0][2] == 0
                    or self._bytes > AHEAD_BYTES
                    or len(self._waiting) > AHEAD_CHUNKS
                )
            )
        ):
            chunk, task, size = self._waiting.popleft()
            self._bytes -= size
            yield chunk, task
