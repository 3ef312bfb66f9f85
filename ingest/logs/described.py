"""Bounded bookkeeping of a file's channel descriptions; each counts once."""

from __future__ import annotations

import numpy as np

from ...topology.arrays import BoolArray, IntArray
from .messages import Channel, DamageError
from .tally import NUMBERS

DEFINITION_BYTES = 1 << 25
"""Limit of the different schemas and channels of one file, 32 MiB: a thousand topics with the
largest definitions in use take 20."""

DEFINITION_COST = 200
"""Memory of a channel in addition to its names [bytes]."""

SHORT_NAMES = 256
"""Longest names kept once there is no room for definitions: 65,536 of them take 16 MiB. Longest
name that DDS allows."""

LOOKED_AT = 2 * NUMBERS
"""Number of different descriptions processed, twice for every number; a file with more is an
attack, and each costs 10 microseconds."""

TOO_MANY = "implausibly many channels are described; what describes one anew is left out"


class Described:
    """The records that describe channels of one file; writers repeat them in every chunk.

    left: number of further new ones that are processed.
    """

    def __init__(self) -> None:
        self._met: set[bytes] = set()
        self._room = DEFINITION_BYTES
        self.left = LOOKED_AT
        self._looked_at = np.zeros(2 * NUMBERS, bool)

    def __contains__(self, record: bytes) -> bool:
        return record in self._met

    def worth(self, numbers: IntArray) -> BoolArray:
        """Which of these descriptions to process: a bounded number, and those of new numbers.

        numbers: what each describes, below 2 NUMBERS.
        """
        out = np.zeros(len(numbers), bool)
        out[np.unique(numbers, return_index=True)[1]] = True
        out &= ~self._looked_at[numbers]
        out[: self.left] = True
        return out

    def look(self, number: int) -> None:
        """Count a new description; number: as in `worth`."""
        self.left = max(self.left - 1, 0)
        self._looked_at[number] = True

    def add(self, record: bytes) -> bool:
        """Remember a record; returns whether there is room for its contents."""
        room = self.has_room(record)
        if room:
            self._met.add(record)
        return room

    def has_room(self, record: bytes) -> bool:
        """Whether there is room for a record's contents, which is then reserved."""
        if len(record) + DEFINITION_COST > self._room:
            return False
        self._room -= len(record) + DEFINITION_COST
        return True

    def forget(self) -> None:
        """Forget all records, because their meaning may change from here on."""
        self._met.clear()


def short(channel: Channel) -> Channel:
    """A channel without its definition; raises DamageError if its names are long."""
    if len(channel.topic) + len(channel.type_name) + len(channel.encoding) > SHORT_NAMES:
        raise DamageError(TOO_MANY)
    return channel._replace(schema=b"", schema_encoding="")


def contradicts(record: bytes, told: bytes | None) -> bool:
    """Whether a description differs from the index's by more than one wrong bit."""
    if told is None or record == told:
        return False
    wrong = int.from_bytes(record, "little") ^ int.from_bytes(told, "little")
    return len(record) != len(told) or wrong.bit_count() > 1
