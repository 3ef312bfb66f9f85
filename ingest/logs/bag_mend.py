"""Recovery of the undamaged records of a damaged bag chunk."""

from __future__ import annotations

import numpy as np

from .bag_heads import BagHeads
from .bag_wire import MESSAGE, number
from .mended import Mended
from .messages import Bytes


def mended(data: Bytes, heads: BagHeads) -> Mended:
    """All records of damaged data that can be recovered. heads: of the data. O(records)."""
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
    return Mended(data, np.array(where, np.int64), lost, unreadable, repaired)
