"""What was found in damaged data, whatever the container."""

from __future__ import annotations

from typing import NamedTuple

from .messages import Bytes, Ints


class Mended(NamedTuple):
    """Records found in damaged data.

    data: with their heads set right; where: places of the records; lost: channels of messages that
    are not among them, as far as that can be told; unreadable: bytes left out; repaired: how many
    heads were set right.
    """

    data: Bytes
    where: Ints
    lost: list[int]
    unreadable: int
    repaired: int
