"""The descriptions of a file's channels, as they are met: each counts once, and all are bounded."""

from __future__ import annotations

from .messages import DamageError

DEFINITION_BYTES = 1 << 25
"""What the different schemas and channels of one file may take together, 32 MiB: a thousand topics
with the largest definitions in use take 20."""

DEFINITION_COST = 200
"""What a channel takes beside its names."""


class Described:
    """The records that describe channels of one file; writers repeat them in every chunk."""

    def __init__(self) -> None:
        self._met: set[bytes] = set()
        self._room = DEFINITION_BYTES

    def __contains__(self, record: bytes) -> bool:
        return record in self._met

    def charge(self, record: bytes) -> None:
        """Make room for a record not met yet; raises DamageError for more than any log has."""
        self._room -= len(record) + DEFINITION_COST
        if self._room < 0:
            raise DamageError("implausibly many channels")

    def add(self, record: bytes, anew: bool = False) -> None:
        """Remember a record; anew: what was met so far may mean something else from here on."""
        if anew:
            self._met.clear()
        self._met.add(record)


def contradicts(record: bytes, told: bytes | None) -> bool:
    """Whether a description is another one than an index gives, by more than a wrong bit."""
    if told is None or record == told:
        return False
    wrong = int.from_bytes(record, "little") ^ int.from_bytes(told, "little")
    return len(record) != len(told) or wrong.bit_count() > 1
