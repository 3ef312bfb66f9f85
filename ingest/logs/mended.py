"""What was found in damaged data, whatever the container."""

from __future__ import annotations

from typing import NamedTuple

from ...topology.arrays import IntArray
from .messages import Bytes


class Mended(NamedTuple):
    """Records found in damaged data.

    data: with their heads set right; where: places of the records; lost: channels of messages that
    are not among them, as far as that can be told; unreadable: bytes left out; repaired: how many
    heads were set right.
    """

    data: Bytes
    where: IntArray
    lost: list[int]
    unreadable: int
    repaired: int
