"""Messages decoded one by one, for encodings without fixed places."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, Generic, TypeVar

from ...topology.arrays import IntArray
from .messages import MESSAGE_BYTES, Bytes, DamageError

T = TypeVar("T")


class OneByOne(Generic[T]):
    """Applies `parse` to each message; failed: messages with a DamageError, or too long; reason: of
    the first of them."""

    LONGEST = MESSAGE_BYTES

    def __init__(self, parse: Callable[[Any], T]) -> None:
        self._parse = parse
        self.failed = 0
        self.reason = ""

    def _parsed(self, message: Bytes) -> T:
        return self._parse(message.tobytes())

    def parsed(self, data: Bytes, start: IntArray, size: IntArray) -> Iterator[tuple[int, T]]:
        """Number and content of every message of a batch that can be decoded."""
        for number, (at, length) in enumerate(zip(start.tolist(), size.tolist(), strict=True)):
            try:
                if length > self.LONGEST:
                    raise DamageError("a message is implausibly long")
                content = self._parsed(data[at : at + length])
            except DamageError as damage:
                self.failed += 1
                self.reason = self.reason or str(damage)
                continue
            yield number, content
