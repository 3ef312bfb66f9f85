"""The records recovered from damaged data, for any container."""

from __future__ import annotations

from typing import NamedTuple

from ...topology.arrays import IntArray
from .messages import Bytes


class Mended(NamedTuple):
    """Records recovered from damaged data.

    data: with repaired heads; where: positions of the records; lost: channels of messages that are
    not among them, as far as known; unreadable: bytes left out; repaired: number of repaired heads.
    """

    data: Bytes
    where: IntArray
    lost: list[int]
    unreadable: int
    repaired: int
