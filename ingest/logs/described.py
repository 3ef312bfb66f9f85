"""The descriptions of a file's channels, as they are met: each counts once, and all are bounded."""

from __future__ import annotations

import numpy as np

from ...topology.arrays import BoolArray, IntArray
from .messages import Channel, DamageError
from .tally import NUMBERS

DEFINITION_BYTES = 1 << 25
"""What the different schemas and channels of one file may take together, 32 MiB: a thousand topics
with the largest definitions in use take 20."""

DEFINITION_COST = 200
"""What a channel takes beside its names."""

SHORT_NAMES = 256
"""Names that are kept where there is no room for definitions any more: 65,536 of them take 16 MiB.
Longest name that DDS allows."""

LOOKED_AT = 2 * NUMBERS
"""So many different descriptions are looked at, every number twice; a file with more is an attack,
and each costs 10 microseconds."""

TOO_MANY = "implausibly many channels are described; what describes one anew is left out"


class Described:
    """The records that describe channels of one file; writers repeat them in every chunk.

    left: how many more that are new are looked at, whatever they describe.
    """

    def __init__(self) -> None:
        self._met: set[bytes] = set()
        self._room = DEFINITION_BYTES
        self.left = LOOKED_AT
        self._looked_at = np.zeros(2 * NUMBERS, bool)

    def __contains__(self, record: bytes) -> bool:
        return record in self._met

    def worth(self, numbers: IntArray) -> BoolArray:
        """Which of these descriptions to look at: so many, and those of a number not met.

        numbers: what each describes, below 2 NUMBERS.
        """
        out = np.zeros(len(numbers), bool)
        out[np.unique(numbers, return_index=True)[1]] = True
        out &= ~self._looked_at[numbers]
        out[: self.left] = True
        return out

    def look(self, number: int) -> None:
        """Count a description that was not met yet; number: as in `worth`."""
        self.left = max(self.left - 1, 0)
        self._looked_at[number] = True

    def add(self, record: bytes) -> bool:
        """Remember a record; whether there is room for what it says."""
        room = self.has_room(record)
        if room:
            self._met.add(record)
        return room

    def has_room(self, record: bytes) -> bool:
        """Whether there is room for what a record says; it is taken."""
        if len(record) + DEFINITION_COST > self._room:
            return False
        self._room -= len(record) + DEFINITION_COST
        return True

    def forget(self) -> None:
        """What was met so far may mean something else from here on."""
        self._met.clear()


def short(channel: Channel) -> Channel:
    """A channel without its definition; raises DamageError if its names are long."""
    if len(channel.topic) + len(channel.type_name) + len(channel.encoding) > SHORT_NAMES:
        raise DamageError(TOO_MANY)
    return channel._replace(schema=b"", schema_encoding="")


def contradicts(record: bytes, told: bytes | None) -> bool:
    """Whether a description is another one than an index gives, by more than a wrong bit."""
    if told is None or record == told:
        return False
    wrong = int.from_bytes(record, "little") ^ int.from_bytes(told, "little")
    return len(record) != len(told) or wrong.bit_count() > 1
