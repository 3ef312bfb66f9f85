"""Records of a bag's chunk of which some are damaged: the others are found again."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .bag_heads import BagHeads
from .bag_wire import MESSAGE, number
from .messages import Bytes, Ints


class MendedBag(NamedTuple):
    """Records found in damaged data.

    data: with their heads set right; where: places of the records; lost: connections of messages
    that are not among them, as far as that can be told; unreadable: bytes left out; repaired: how
    many heads were set right.
    """

    data: Bytes
    where: Ints
    lost: list[int]
    unreadable: int
    repaired: int


def mended(data: Bytes, heads: BagHeads) -> MendedBag:
    """All records of damaged data that can still be found. heads: of the data. O(records)."""
    data = data.copy()
    heads = heads.within(data)
    where: list[int] = []
    lost: list[int] = []
    position = unreadable = repaired = 0
    while position < len(data):
        record = heads.record(position)
        if record is not None and (
            record.end == len(data)
            or heads.begins(record.end)
            or (record.end < len(data) and heads.repaired(record.end) is not None)
        ):
            where.append(position)
            position = record.end
            continue
        head = heads.repaired(position)
        if head is not None:
            data[position : position + len(head)] = np.frombuffer(head, np.uint8)
            repaired += 1
            continue
        found = heads.following(position + 1)
        if record is not None and record.end <= (len(data) if found is None else found):
            # Whole, with something broken behind it.
            where.append(position)
            position = record.end
            if position == found:
                continue
        elif record is not None and record.op == MESSAGE:
            lost.append(number(record.fields, b"conn"))
        unreadable += (len(data) if found is None else found) - position
        position = len(data) if found is None else found
    return MendedBag(data, np.array(where, np.int64), lost, unreadable, repaired)
